"""Logs from and to files: .parquet, .csv, .npz, and whatever `register_reader` adds.

The columns are those of `torchid.log.columns`.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO

from torchid.errors import LogError
from torchid.files import atomic_write
from torchid.log.columns import Columns, columns_of, log_from_columns
from torchid.log.formats import (
    read_csv,
    read_npz,
    read_parquet,
    write_csv,
    write_npz,
    write_parquet,
)
from torchid.log.model import Log

Reader = Callable[[Path], Log]

__all__ = ["log_from_columns", "read_log", "register_reader", "write_log"]


def read_log(paths: str | Path | Sequence[str | Path]) -> Log:
    """Read one log, or several as the trajectories of one.

    Args:
        paths: a file, or files; the suffix chooses the reader.

    Raises:
        LogError: a file is missing, is not what its suffix says, or lacks columns; or the files
            do not go together.
    """
    files = [paths] if isinstance(paths, str | Path) else list(paths)
    if not files:
        raise LogError("no log is given.", expected="at least one file", available=_suffixes())
    return Log.concatenate([_read_file(Path(file)) for file in files])


def register_reader(suffix: str, function: Reader) -> None:
    """Let `function` read files that end in `suffix`, such as ".mcap"; replaces an earlier one.

    Args:
        suffix: with the dot; upper and lower case are the same.
        function: takes the path of an existing file and returns a Log (`log_from_columns` helps).
    """
    if not suffix.startswith(".") or len(suffix) < 2:
        raise ValueError(f"a suffix starts with a dot, got {suffix!r}")
    _READERS[suffix.lower()] = function


def write_log(log: Log, path: str | Path) -> None:
    """Write a log as .parquet, .csv or .npz, with `traj` if it has more than one trajectory.

    The values are written in full precision. Names, source and warnings are not kept.

    Raises:
        LogError: unknown suffix.
        TorchidError: the folder does not exist, or the file cannot be written.
    """
    path = Path(path)
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise LogError(
            f"'{path}' has a suffix that logs are not written as.",
            got=path.suffix or "no suffix",
            available=sorted(_WRITERS),
        )
    with atomic_write(path, "wb") as file:
        writer(columns_of(log), file)


def _read_file(path: Path) -> Log:
    if path.is_dir():
        raise LogError(f"'{path}' is a folder.", expected="a log", available=_inside(path))
    if not path.exists():
        raise LogError(
            f"log '{path}' does not exist.",
            available=_inside(path.parent) if path.parent.is_dir() else None,
        )
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise LogError(
            f"'{path}' has a suffix that no reader is registered for.",
            got=path.suffix or "no suffix",
            available=_suffixes(),
        )
    try:
        if path.is_file() and path.stat().st_size == 0:
            raise LogError(f"'{path}' is empty.")
        return reader(path)
    except OSError as error:
        raise LogError(f"'{path}' cannot be read: {error.strerror or error}") from error


def _suffixes() -> list[str]:
    return sorted(_READERS)


def _inside(folder: Path) -> list[str] | None:
    """The logs in a folder, at most ten, for an error message."""
    try:
        found = sorted(p.name for p in folder.iterdir() if p.suffix.lower() in _READERS)
    except OSError:
        return None
    more = [f"and {len(found) - 10} more"] if len(found) > 10 else []
    return found[:10] + more or None


_READERS: dict[str, Reader] = {".parquet": read_parquet, ".csv": read_csv, ".npz": read_npz}
_WRITERS: dict[str, Callable[[Columns, IO[bytes]], None]] = {
    ".parquet": write_parquet,
    ".csv": write_csv,
    ".npz": write_npz,
}
