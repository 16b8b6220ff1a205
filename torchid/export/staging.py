"""Files that appear all together, or not at all."""

import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from torchid.errors import TorchidError


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
