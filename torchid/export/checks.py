"""Comparing what was written with the result's own model: torque at random states, by whatever
can read the file."""

import math
import secrets
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import torch

from torchid.effects.base import Motion
from torchid.effects.registry import Valued
from torchid.errors import TorchidError
from torchid.export.c_code import CFile, identifier
from torchid.files import discard, place
from torchid.results.record import Col, Part
from torchid.robot.config_files import filled_template
from torchid.typing import Joints

EXACT = 1e-9
"""Largest difference of a joint's torque, relative to its largest torque, of what was reloaded."""
COMPILED = 1e-12
"""The same of compiled code, which repeats the library's own operations."""
_SMALL = 1e-6
"""Share of the largest joint's torque below which a joint's own does not count as its scale."""


class Comparison(Part, frozen=True, rename={"difference": "largest_relative_difference"}):
    """One reader of an export, against the result's model.

    Attributes:
        reader: who read it, with its version.
        compared: what was compared, in words.
        states: number of random states.
        difference: largest difference of a joint's torque over the largest of that torque; None
            where the reader is missing or refused the file.
        limit: what it may be.
        ok: whether it is no larger; None where there is none.
        note: why there is no difference, or what was left aside.
    """

    reader: Annotated[str, Col()]
    compared: Annotated[str, Col()]
    states: Annotated[int, Col()]
    difference: Annotated[float | None, Col("largest difference", ".1e")]
    limit: Annotated[float, Col(digits="g")]
    ok: bool | None = None
    note: str = ""

    @property
    def result(self) -> Annotated[str, Col()]:
        """Whether it agrees, and the note."""
        agrees = "not compared" if self.difference is None else "agrees"
        return ": ".join(filter(None, (agrees, self.note)))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.difference is not None:
            msgspec.structs.force_setattr(self, "ok", self.difference <= self.limit)


def relative_difference(found: Joints, expected: Joints) -> float:
    """Largest difference of a joint's torque relative to its largest expected torque; infinite for
    what is not a number.

    A joint whose torque hardly exists (a balanced wrist) is measured against a millionth of the
    largest joint's, beneath which there is rounding only.
    """
    if found.shape != expected.shape or not bool(torch.isfinite(found).all()):
        return math.inf
    largest = expected.abs().amax(0)
    scale = torch.maximum(largest, _SMALL * largest.max()).clamp(min=1e-300)
    return float(((found - expected).abs().amax(0) / scale).max())


def compared(
    reader: str,
    what: str,
    motion: Motion,
    expected: Joints,
    found: Joints,
    limit: float = EXACT,
) -> Comparison:
    """The torque that a reader finds against the expected one."""
    return Comparison(reader, what, len(motion.q), relative_difference(found, expected), limit)


def missing(reader: str, what: str, why: str) -> Comparison:
    """A reader that could not be asked."""
    return Comparison(reader, what, 0, None, EXACT, note=why)


def compiler() -> str | None:
    """A C compiler, or None."""
    return next((found for name in ("cc", "gcc", "clang") if (found := shutil.which(name))), None)


def check_c(code: CFile, file_name: str, motion: Motion, expected: Joints) -> Comparison:
    """Compile the code as strict C99 and run it at the states."""
    what = "torque of the compiled function"
    cc = compiler()
    if cc is None:
        return missing("C99", what, "no C compiler (cc, gcc or clang) was found: not compiled")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / f"{file_name}.c").write_text(code.source, encoding="utf-8")
        (folder / f"{file_name}.h").write_text(code.header, encoding="utf-8")
        n, function = motion.q.shape[-1], f"{identifier(file_name)}_torque"
        words = {"file": file_name, "function": function, "n": n, "states": 3 * n, "last": 2 * n}
        main = filled_template("read_states.c", **words)
        (folder / "main_.c").write_text(main, encoding="utf-8")
        command = [cc, "-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-O2", "-o", "run_"]
        sources = ["main_.c", f"{file_name}.c", "-lm"]
        made = subprocess.run(
            [*command, *sources], cwd=folder, capture_output=True, text=True, check=False
        )
        if made.returncode:
            first = (made.stderr.strip() or "no message").splitlines()[0]
            note = f"does not compile: {first}"
            return Comparison("C99", what, 0, math.inf, COMPILED, note=note)
        rows = torch.cat([motion.q, motion.dq, motion.ddq], -1).tolist()
        text = "\n".join(" ".join(float(x).hex() for x in row) for row in rows)
        ran = subprocess.run(
            [str(folder / "run_")], input=text, capture_output=True, text=True, check=False
        )
        values = [float.fromhex(word) for word in ran.stdout.split()]
    found = torch.full_like(expected, math.nan, dtype=torch.float64)
    if ran.returncode == 0 and len(values) == expected.numel():
        found = torch.tensor(values, dtype=torch.float64).reshape(expected.shape)
    return compared(f"C99 ({Path(cc).name})", what, motion, expected, found, COMPILED)


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


def require_agreement(comparisons: Sequence[Comparison]) -> tuple[Comparison, ...]:
    """The comparisons, or a TorchidError where one fails."""
    for one in comparisons:
        if one.ok is False:
            raise TorchidError(
                "what was written does not reproduce the result, so nothing was kept.",
                got=f"{one.reader}: {one.compared} differs by {one.difference:.3g}"
                + (f" ({one.note})" if one.note else ""),
                expected=f"at most {one.limit:g} of each joint's largest torque",
            )
    return tuple(comparisons)


@contextmanager
def staged_files(folder: Path, files: Mapping[str, bytes | None]) -> Iterator[dict[str, Path]]:
    """Write files under hidden names, and give them their own when the block ends well, or, in a
    command, with all else that it writes.

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
        place({folder / name: paths.get(name) for name in files})
    except BaseException as error:
        discard({path: path for path in paths.values()})
        if isinstance(error, OSError):
            raise TorchidError(
                f"the export cannot be written to '{folder}': {error.strerror or error}."
            ) from error
        raise
