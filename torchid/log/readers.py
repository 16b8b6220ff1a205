"""Logs from files, folders and tables in memory, and to files.

Read: .parquet, .csv, .npz, .json, .jsonl, .mat, .h5; ROS bags; LeRobot datasets; motions of SAGE.
Columns that have the names of `torchid.log.columns` are found by themselves; others by a mapping
(`torchid.log.mapping`). Written: .parquet, .csv and .npz.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

import torchid
from torchid.errors import LogError, TorchidError
from torchid.files import atomic_write, similar_files
from torchid.log.assemble import (
    log_from_table,
    one_for_all,
    require_columns,
    with_hint,
)
from torchid.log.columns import Columns, columns_of, first_names, log_from_columns
from torchid.log.csv_file import csv_table
from torchid.log.formats import (
    npz_table,
    parquet_table,
    repeated,
    write_csv,
    write_npz,
    write_parquet,
)
from torchid.log.hdf5 import hdf5_table, matlab_table
from torchid.log.json_lines import json_lines_table, json_table
from torchid.log.lerobot import is_lerobot, lerobot_table
from torchid.log.mapping import ColumnMapping, read_mapping
from torchid.log.ros import bag_table, is_bag_folder
from torchid.log.sage import is_sage, sage_table
from torchid.log.side_files import with_side_files
from torchid.log.table import AbsentColumnError, Request, Table

Opener = Callable[[Path, Request], Table]


@runtime_checkable
class Frame(Protocol):
    """A table in memory with named columns: of pandas, polars or pyarrow."""

    @property
    def columns(self) -> Any:
        """The frame's columns, or their names."""

    def __getitem__(self, name: Any, /) -> Any:
        """One column."""


if TYPE_CHECKING:
    from torchid.log.model import Log

    OneLog = Log | str | Path | Mapping[str, Any] | Frame
    LogLike = OneLog | Iterable[OneLog]
else:  # a Log loads torch, which files and their headers are looked at without
    OneLog = LogLike = Any
"""A log, or what `read_log` makes one of."""

__all__ = ["log_from_columns", "open_log", "read_log", "write_log"]


def read_log(
    logs: LogLike,
    *,
    columns: str | Path | Mapping[str, Any] | ColumnMapping | None = None,
    topic: str | None = None,
    joints: Sequence[str] = (),
    spare: Sequence[str] = (),
) -> "torchid.Log":
    """One log, or several as the trajectories of one, of files or of tables in memory.

    Args:
        logs: a file or folder, whose suffix chooses the reader; a table in memory: a DataFrame, or
            arrays, tensors or lists by name, `t` with `q`, `tau`, .. (T, n) or `q1`, `tau1`, ..; a
            Log, which stays as it is; or several of them.
        columns: which columns are what, where they have other names than ours: text, a yaml file,
            or a dict (see `torchid.log.mapping`).
        topic: of the joint states in a bag with several.
        joints: names of the robot's joints in order, by which the joints of a bag or a LeRobot
            dataset are found; without them the order of their names is taken, with a warning.
        spare: names of other joints that such a recording may have (`Robot.spare`): held ones,
            those that follow others, those of another part.

    Raises:
        LogError: a file is missing, is not what its suffix says, or lacks columns; has a joint
            that the robot lacks; the files do not go together; or something that is no log.
        MissingExtraError: the package that reads this format is not installed.

    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder) / "run.csv"
    ...     _ = file.write_text("ms,pos_1\\n0,0\\n10,90\\n20,180\\n")
    ...     log = read_log(file, columns={"t": "ms ms", "q": "pos_{j} deg"})
    >>> log.t.tolist()
    [0.0, 0.01, 0.02]
    >>> [round(q, 4) for q in log.q[:, 0].tolist()]
    [0.0, 1.5708, 3.1416]
    >>> read_log({"t": [0.0, 0.01], "q": [[0.1, 0.2], [0.3, 0.4]]})
    Log(2 joints, 2 samples of q, 0.01 s at 100 Hz)
    """
    given = each_log(logs)
    if not given:
        raise LogError("no log is given.", expected="at least one file", available=_suffixes())
    mapping = None if columns is None else read_mapping(columns)
    request = Request(mapping, topic, tuple(joints), spare_joints=tuple(spare))
    sources = [
        _source(one, f"table {k}" if len(given) > 1 else "table")
        for k, one in enumerate(given, start=1)
    ]
    return torchid.Log.concatenate([log for _, log in open_logs(sources, request)])


def each_log(logs: LogLike) -> list[OneLog]:
    """One or several logs as a list."""
    if isinstance(logs, torchid.Log | str | Path | Mapping | Frame):
        return [logs]
    return list(logs) if isinstance(logs, Iterable) else [logs]


def _source(given: object, name: str) -> "Path | Table | torchid.Log":
    """What a log is read of: a file, a table in memory, or the log itself.

    Raises:
        LogError: something else, or a table of what is no numbers.
    """
    if isinstance(given, torchid.Log | Path):
        return given
    if isinstance(given, str):
        return Path(given)
    if not isinstance(given, Mapping | Frame) or isinstance(given, type):
        raise LogError(
            "this is no log.",
            got=type(given).__name__,
            expected="a Log, a file or folder, a DataFrame or a mapping of arrays with t, q1.. (or "
            "q), or a list of these",
        )
    names = getattr(
        given, "column_names", list(given if isinstance(given, Mapping) else given.columns)
    )
    arrays: dict[str, np.ndarray] = {}
    for key in names:
        column = given[key]
        if hasattr(column, "detach"):
            column = column.detach().cpu()
        if column is not None:
            try:
                arrays[str(key)] = np.asarray(column)
            except (TypeError, ValueError, RuntimeError) as error:  # lists of several lengths
                raise LogError(
                    f"'{name}': column {key} is no table of numbers.", got=str(error)
                ) from error
    return Table.in_memory(
        Path(name), "table in memory", arrays, repeated=repeated([*map(str, names)])
    )


def open_logs(
    paths: "Sequence[Path | Table | torchid.Log]", request: Request
) -> "list[tuple[Table | None, torchid.Log]]":
    """Several logs, each as `open_log` does.

    Raises:
        As `read_log`; where one of several does not have what the others' mapping names, with
        the way out.
    """
    try:
        return [open_log(path, request) for path in paths]
    except AbsentColumnError as error:
        if len(paths) == 1:
            raise
        raise with_hint(error, one_for_all("columns")) from None


def open_log(
    path: "Path | Table | torchid.Log", request: Request
) -> "tuple[Table | None, torchid.Log]":
    """One log as a Log, and as the table it was; None of a Log.

    Raises:
        As `read_log`.
    """
    if isinstance(path, Table):
        return path, log_from_table(path, request.columns, request.joints)
    if not isinstance(path, Path):
        return None, path
    opener = require_log(path)
    try:
        table = _joined(opener, path, request)
        if request.topic is not None and table.topic is None:
            raise LogError(
                f"'{path}' is no bag: it has no topics.",
                got=f'`topic="{request.topic}"`',
                hint=one_for_all("topic"),
            )
        return table, log_from_table(table, request.columns, request.joints)
    except OSError as error:
        raise LogError(f"'{path}' cannot be read: {error.strerror or error}") from error


def require_header(path: Path, request: Request) -> None:
    """Refuse a text or Parquet file whose header lacks the columns of a log, as far as it tells
    without the robot and without torch.

    Raises:
        LogError: as `open_log`.
    """
    opener = require_log(path)
    if opener is csv_table or opener is parquet_table:
        table = _joined(opener, path, request)
        require_columns(table, request.columns)


def write_log(log: LogLike, path: str | Path) -> None:
    """Write a log as .parquet, .csv or .npz, with `traj` if it has more than one trajectory.

    The values are written in full precision. Names, source and warnings are not kept.

    Args:
        log: one or several trajectories, or what `read_log` makes them of.
        path: the file.

    Raises:
        LogError: unknown suffix.
        TorchidError: the folder does not exist, or the file cannot be written.

    >>> from tempfile import TemporaryDirectory
    >>> log = torchid.Log(t=[0.0, 0.01], q=[[0.1, 0.2], [0.3, 0.4]])
    >>> with TemporaryDirectory() as folder:
    ...     write_log(log, Path(folder) / "run.parquet")
    ...     read_log(Path(folder) / "run.parquet").q.tolist()
    [[0.1, 0.2], [0.3, 0.4]]
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
        writer(columns_of(read_log(log)), file)


def written_suffixes() -> tuple[str, ...]:
    """Suffixes of files that `write_log` writes."""
    return tuple(sorted(_WRITERS))


def require_log(path: Path) -> Opener:
    """What opens a file or folder.

    Raises:
        LogError: it is not there, or no log by its name; logs beside it with a similar name are
            proposed.
    """
    if path.is_dir():
        for fits, opener in _FOLDERS:
            if fits(path):
                return opener
        raise LogError(
            f"'{path}' is a folder.",
            expected="a log, a bag with metadata.yaml, a LeRobot dataset with meta/info.json, or a "
            "motion of SAGE with state_motor.csv",
            available=_inside(path),
        )
    if not path.exists():
        near = similar_files(path, _TABLES)
        raise LogError(
            f"log '{path}' does not exist.",
            available=_inside(path.parent) if path.parent.is_dir() else None,
            hint=f"did you mean {near[0]}?" if near else None,
        )
    suffix = path.suffix.lower()
    if suffix not in _TABLES:
        raise LogError(
            f"'{path}' has a suffix that no reader is for.",
            got=path.suffix or "no suffix",
            available=_suffixes(),
            hint=_CONVERT.get(suffix),
        )
    if not path.is_file():
        raise LogError(f"'{path}' is no file, but a device or a pipe.")
    if path.stat().st_size == 0:
        raise LogError(f"'{path}' is empty.", expected="t, q1.. and tau1.., row by row")
    return _TABLES[suffix]


def _joined(opener: Opener, path: Path, request: Request) -> Table:
    """What a file holds, with the files beside it that the mapping names."""
    table = _table(opener, path, request)
    if request.columns is None:
        return table
    return with_side_files(table, request.columns, lambda f: _table(csv_table, f, request))


def _table(opener: Opener, path: Path, request: Request) -> Table:
    """What a file holds, with one error for whatever its library stumbles over, now or when its
    arrays are read."""
    with guarded(path):
        table = opener(path, request)

    def read(names: Sequence[str]) -> dict[str, np.ndarray]:
        with guarded(path):
            return table.read(names)

    return replace(table, read=read)


@contextmanager
def guarded(path: Path) -> Iterator[None]:
    """Whatever a library raises on a damaged file becomes a LogError that names it."""
    try:
        yield
    except TorchidError:
        raise
    except MemoryError as error:
        raise LogError(f"'{path}' needs more memory than there is.", got=str(error)) from error
    except Exception as error:  # libraries raise anything where a file is damaged
        if isinstance(error, OSError) and error.errno is not None:
            raise
        kind = f"{path.suffix[1:]} file" if path.suffix else "log"
        raise LogError(
            f"'{path}' is not a {kind}, though its name says so, or is damaged.",
            got=(str(error).splitlines() or [type(error).__name__])[0][:200],
        ) from error


def _suffixes() -> list[str]:
    return sorted(_TABLES)


def _inside(folder: Path) -> list[str] | None:
    """The logs in a folder, at most ten, for an error message."""
    try:
        logs = sorted(p.name for p in folder.iterdir() if is_log(p))
    except OSError:
        return None
    return first_names(logs, 10) or None


def is_log(path: Path) -> bool:
    """Whether it looks like a log by its name; most texts are none, nor most JSON."""
    if path.is_dir():
        return any(fits(path) for fits, _ in _FOLDERS)
    return path.suffix.lower() in set(_TABLES) - {".txt", ".dat", ".json"}


_CONVERT = dict.fromkeys(
    (".ipynb", ".pkl", ".pickle", ".npy", ".pt", ".xlsx"),
    "write it as columns t, q1.., tau1..; in Python: DataFrame(..).to_csv('run.csv', index=False)",
)
"""What to do with files that people have their logs in, and that no reader is for."""
_FOLDERS: tuple[tuple[Callable[[Path], bool], Opener], ...] = (
    (is_lerobot, lerobot_table),
    (is_bag_folder, bag_table),
    (is_sage, sage_table),
)
_TABLES: dict[str, Opener] = {
    ".parquet": parquet_table,
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat"), csv_table),
    ".npz": npz_table,
    **dict.fromkeys((".jsonl", ".ndjson"), json_lines_table),
    ".json": json_table,
    ".mat": matlab_table,
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), hdf5_table),
    **dict.fromkeys((".bag", ".mcap", ".db3"), bag_table),
}
_WRITERS: dict[str, Callable[[Columns, IO[bytes]], None]] = {
    ".parquet": write_parquet,
    ".csv": write_csv,
    ".npz": write_npz,
}
