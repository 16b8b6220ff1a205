"""Files before they are kept: all of an export appears together, and only if it is right."""

import os
import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from torchid.effects.registry import Valued
from torchid.errors import TorchidError
from torchid.export.checks import Comparison


@dataclass(frozen=True, eq=False)
class Draft:
    """What an export writes.

    Attributes:
        files: content by name, the main file first; None for one that must not be there.
        in_file, beside, left_out: effects that the format knows, that go into the sidecar, and that
            go nowhere.
        notes: sentences for the user.
    """

    files: Mapping[str, bytes | None]
    in_file: tuple[Valued, ...] = ()
    beside: tuple[Valued, ...] = ()
    left_out: tuple[Valued, ...] = ()
    notes: tuple[str, ...] = ()


def kept(comparisons: Sequence[Comparison]) -> tuple[Comparison, ...]:
    """The comparisons, or a TorchidError where one fails."""
    for one in comparisons:
        if not one.ok:
            raise TorchidError(
                "what was written does not reproduce the result, so nothing was kept.",
                got=f"{one.reader}: {one.compared} differs by {one.difference:.3g}"
                + (f" ({one.note})" if one.note else ""),
                expected=f"at most {one.limit:g} of each joint's largest torque",
            )
    return tuple(comparisons)


@contextmanager
def staged(folder: Path, files: Mapping[str, bytes | None]) -> Iterator[dict[str, Path]]:
    """Write files under hidden names, and give them their own when the block ends well.

    The hidden names keep the stem's relation between a file and its sidecar, and lie in the same
    folder, so that relative references hold. On any error nothing is left, and files that were
    there before stay.

    Args:
        folder: exists.
        files: content by final name; None for a file that is to be removed.

    Yields:
        The path of each written file, by its final name.
    """
    prefix = f".torchid-{secrets.token_hex(6)}-"
    paths = {name: folder / f"{prefix}{name}" for name, data in files.items() if data is not None}
    try:
        for name, path in paths.items():
            path.write_bytes(files[name] or b"")
        yield paths
        for name, path in paths.items():
            os.replace(path, folder / name)
        for name in set(files) - set(paths):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise TorchidError(
            f"the export cannot be written to '{folder}': {error.strerror or error}."
        ) from error
    finally:
        for path in paths.values():
            with suppress(OSError):
                path.unlink()
