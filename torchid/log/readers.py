"""Logs from and to files: .parquet, .csv, .npz, and whatever `register_reader` adds.

Columns: t [s]; q1..qn [rad or m]; and, where there are any, dq1.. ddq1.. tau1.. [N m or N],
i1.. [A]; traj, an integer that separates trajectories. Any other column is ignored.
"""

import re
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import torch

from torchid.errors import LogError
from torchid.log.files import atomic_write
from torchid.log.model import JOINT_SIGNALS, Log

Reader = Callable[[Path], Log]
Columns = Mapping[str, np.ndarray]

_PREFIXES = dict(zip(JOINT_SIGNALS, ("q", "dq", "ddq", "tau", "i"), strict=True))
_JOINT_COLUMN = re.compile(r"(q|dq|ddq|tau|i)(\d+)")
_EXPECTED = "t, q1..qn and, where known, dq1..dqn, ddq1..ddqn, tau1..taun or i1..in, traj"


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
        writer(_columns_of(log), file)


def log_from_columns(columns: Columns, path: str | Path) -> Log:
    """A Log from named columns, each an array (T,) of numbers.

    Args:
        columns: as in the module's description; others are ignored.
        path: the file they came from, for names and errors.

    Raises:
        LogError: t or q is missing, joints are not numbered 1..n, counts differ, a column is not
            numeric or has another length, or there are fewer than two samples.
    """
    path = Path(path)
    joints = _joint_columns(columns, path)
    values = {
        name: _numeric(columns[name], name, path)
        for name in ("t", *(column for group in joints.values() for column in group))
    }
    _same_length(values, path)
    trajectory, names = _trajectories(columns.get("traj"), len(values["t"]), path)
    signals: dict[str, Any] = {
        signal: torch.from_numpy(np.stack([values[c] for c in group], 1))
        for signal, group in joints.items()
    }
    return Log(
        t=torch.from_numpy(values["t"]),
        **signals,
        trajectory=torch.from_numpy(trajectory),
        names=names,
        source=str(path),
    )


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


# --- columns


def _wanted(name: str) -> bool:
    return name in ("t", "traj") or _JOINT_COLUMN.fullmatch(name) is not None


def _joint_columns(names: Iterable[str], path: Path) -> dict[str, list[str]]:
    """The columns of each joint signal in order, e.g. {"q": ["q1", "q2"], ...}."""
    names = list(names)
    groups = {signal: _numbered(names, prefix, path) for signal, prefix in _PREFIXES.items()}
    if "t" not in names:
        raise LogError(f"'{path}' has no column t.", expected=_EXPECTED, available=_some(names))
    count = len(groups["q"])
    if count == 0:
        raise LogError(f"'{path}' has no column q1.", expected=_EXPECTED, available=_some(names))
    for signal, group in groups.items():
        if group and len(group) != count:
            raise LogError(
                f"'{path}' has {count} q columns and {len(group)} {_PREFIXES[signal]} columns.",
                got=_range(group),
                expected=_range([f"{_PREFIXES[signal]}{i + 1}" for i in range(count)]),
            )
    return {signal: group for signal, group in groups.items() if group}


def _numbered(names: Sequence[str], prefix: str, path: Path) -> list[str]:
    matches = (_JOINT_COLUMN.fullmatch(name) for name in names)
    found = sorted((int(m[2]), m[0]) for m in matches if m is not None and m[1] == prefix)
    expected = [f"{prefix}{i + 1}" for i in range(len(found))]
    got = [name for _, name in found]
    if got != expected:
        raise LogError(
            f"'{path}': the {prefix} columns are not numbered {_range(expected)}.",
            got=", ".join(_some(got)),
            expected=", ".join(_some(expected)),
        )
    return got


def _range(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]}..{names[-1]}"


def _some(names: Sequence[str]) -> list[str]:
    return [*names[:40], f"and {len(names) - 40} more"] if len(names) > 40 else list(names)


def _numeric(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    if values.dtype.kind not in "iuf":
        raise LogError(
            f"'{path}': column {name} is not numeric.", got=_sample(values), expected="numbers"
        )
    return np.array(values, dtype=np.float64)  # a copy: arrow's buffers are read-only


def _sample(values: np.ndarray) -> str:
    """The type of a column and one of its values that is not a number."""
    for value in values.ravel().tolist():
        try:
            float(value)
        except (TypeError, ValueError):
            if value is not None:
                return f"{values.dtype.name}, such as {str(value)[:40]!r}"
    return values.dtype.name


def _same_length(values: Columns, path: Path) -> None:
    samples = len(values["t"])
    for name, column in values.items():
        if len(column) != samples:
            raise LogError(
                f"'{path}': column {name} has another length than t.",
                got=len(column),
                expected=samples,
            )
    if samples == 0:
        raise LogError(f"'{path}' has columns and no rows.", got=0, expected="samples")
    if samples == 1:
        raise LogError(f"'{path}' has one sample only.", got=1, expected="a trajectory")


def _trajectories(
    column: np.ndarray | None, samples: int, path: Path
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Trajectory numbers from 0, and their names."""
    if column is None:
        return np.zeros(samples, dtype=np.int64), (path.stem,)
    ids = _numeric(column, "traj", path)
    _same_length({"t": np.empty(samples), "traj": ids}, path)
    if not np.isfinite(ids).all() or (ids != np.round(ids)).any():
        wrong = ids[~np.isfinite(ids) | (ids != np.round(ids))]
        raise LogError(f"'{path}': column traj is not integer.", got=float(wrong[0]))
    starts = np.flatnonzero(np.diff(ids, prepend=ids[0] - 1))
    order = ids[starts].astype(np.int64).tolist()
    lengths = np.diff(starts, append=samples)
    if len(set(order)) < len(order):
        again = next(k for k, i in enumerate(order) if i in order[:k])
        raise LogError(
            f"'{path}': trajectory {order[again]} comes back in row {starts[again] + 1} after "
            f"trajectory {order[again - 1]}.",
            expected="the rows of a trajectory together",
            hint="sort the rows by traj, then by t",
        )
    if (lengths < 2).any():
        raise LogError(
            f"'{path}': trajectory {order[int(np.argmin(lengths))]} has one sample only.",
            got=1,
            expected="at least two",
        )
    if len(order) == 1:
        return np.zeros(samples, dtype=np.int64), (path.stem,)
    numbers = np.repeat(np.arange(len(order)), lengths)
    return numbers, tuple(f"{path.stem}[traj={i}]" for i in order)


def _unique(names: Sequence[str], path: Path) -> None:
    twice = sorted({name for name in names if _wanted(name) and names.count(name) > 1})
    if twice:
        raise LogError(f"'{path}' has two columns {twice[0]}.", got=", ".join(twice))


# --- formats


def _read_parquet(path: Path) -> Log:
    with _format(path, "parquet", pa.ArrowException), pa.parquet.ParquetFile(path) as file:
        names = list(file.schema_arrow.names)
        _unique(names, path)
        wanted = [name for name in names if _wanted(name)]
        table = file.read(columns=wanted)
        columns = {name: _from_arrow(table.column(name)) for name in table.column_names}
        del table
    if "t" not in columns or "q1" not in columns:
        _joint_columns(names, path)  # an error that lists all columns, not only the wanted
    log = log_from_columns(columns, path)
    del columns
    pa.default_memory_pool().release_unused()
    return log


def _read_csv(path: Path) -> Log:
    with _format(path, "csv", pa.ArrowException, UnicodeDecodeError):
        names, delimiter = _csv_header(path)
        _unique(names, path)
        # Columns are told apart by position: those that are ignored may have any name, twice.
        keys = [str(k) for k in range(len(names))]
        wanted = {key: name for key, name in zip(keys, names, strict=True) if _wanted(name)}
        _joint_columns(names, path)
        try:
            # The type is given: inferred, it would be that of the first block of lines only.
            table = _csv_table(path, keys, list(wanted), delimiter, pa.float64())
        except pa.ArrowInvalid as error:
            if "conversion error" not in str(error):
                raise
            # As text, so that the column and the value can be named.
            table = _csv_table(path, keys, list(wanted), delimiter, pa.string())
        columns = {name: _from_arrow(_parsed(table[key])) for key, name in wanted.items()}
    return log_from_columns(columns, path)


def _parsed(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """A column of a csv as numbers, or as it is where not all of it are numbers."""
    try:
        return column.cast(pa.float64())
    except pa.ArrowInvalid:
        return column


def _csv_table(
    path: Path, keys: list[str], wanted: list[str], delimiter: str, kind: pa.DataType
) -> pa.Table:
    return pa.csv.read_csv(
        path,
        read_options=pa.csv.ReadOptions(column_names=keys, skip_rows=1, use_threads=False),
        parse_options=pa.csv.ParseOptions(delimiter=delimiter),
        convert_options=pa.csv.ConvertOptions(
            include_columns=wanted,
            column_types=dict.fromkeys(wanted, kind),
            strings_can_be_null=True,
        ),
    )


def _csv_header(path: Path) -> tuple[list[str], str]:
    """The column names of the first line, and what separates them: comma, semicolon or tab."""
    with open(path, encoding="utf-8-sig") as file:
        line = file.readline(1_000_000).rstrip("\r\n")
    if "\0" in line:
        raise LogError(f"'{path}' is not a csv file, though its name says so.")
    delimiter = max(",;\t", key=line.count)
    names = [name.strip().strip("\"'").strip() for name in line.split(delimiter)]
    if all(_is_number(name) for name in names):
        raise LogError(
            f"'{path}' has no header line.",
            got=line[:80],
            expected=_EXPECTED,
            hint="put the names of the columns in the first line",
        )
    return names, delimiter


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _from_arrow(column: pa.ChunkedArray) -> np.ndarray:
    """A column as floats, empty cells as NaN; as it is where it is not numeric."""
    kind = column.type
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return column.cast(pa.float64()).to_numpy()
    return np.array(column.to_pylist(), dtype=object)


def _read_npz(path: Path) -> Log:
    if not zipfile.is_zipfile(path):
        raise LogError(f"'{path}' is not a npz file, though its name says so.")
    problems = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError)
    columns: dict[str, np.ndarray] = {}
    with _format(path, "npz", *problems), np.load(path, allow_pickle=False) as arrays:
        groups = {name: name for name in _PREFIXES} | {"i": "current"}
        for key in arrays.files:
            if key in groups or _wanted(key):
                for name, column in _npz_columns(arrays, key, groups.get(key), path):
                    if name in columns:
                        raise LogError(f"'{path}' gives {name} twice, as an array and alone.")
                    columns[name] = column
        names = list(arrays.files)
    if "t" not in columns or "q1" not in columns:
        _joint_columns([*columns, *(name for name in names if name not in columns)], path)
    return log_from_columns(columns, path)


def _npz_columns(
    arrays: Any, key: str, signal: str | None, path: Path
) -> Iterator[tuple[str, np.ndarray]]:
    """The named columns in one array of a npz file: (T,) is one, (T, n) are n."""
    try:
        array = arrays[key]
    except ValueError as error:
        raise LogError(
            f"'{path}': array {key} cannot be read: it holds Python objects or is damaged.",
            got=str(error).splitlines()[0],
            expected="numbers",
        ) from error
    if not isinstance(array, np.ndarray):
        raise LogError(f"'{path}': {key} is not an array.", got=type(array).__name__)
    if array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim == 1:
        yield (key if signal is None else f"{_PREFIXES[signal]}1"), array
    elif array.ndim == 2 and signal is not None:
        for k in range(array.shape[1]):
            yield f"{_PREFIXES[signal]}{k + 1}", array[:, k]
    else:
        raise LogError(
            f"'{path}': array {key} has the wrong number of dimensions.",
            got=f"shape {array.shape}",
            expected="(samples,)" if signal is None else "(samples, joints)",
        )


@contextmanager
def _format(path: Path, kind: str, *problems: type[BaseException]) -> Iterator[None]:
    """Turn a library's complaint about the content into a LogError."""
    try:
        yield
    except problems as error:
        raise LogError(
            f"'{path}' is not a {kind} file, though its name says so, or is damaged.",
            got=(str(error).splitlines() or [type(error).__name__])[0][:200],
        ) from error


def _columns_of(log: Log) -> dict[str, np.ndarray]:
    columns = {"t": log.t.detach().cpu().numpy()}
    if log.trajectory_count > 1:
        columns["traj"] = log.trajectory.cpu().numpy()
    for signal, values in log.signals.items():
        array = values.detach().cpu().numpy()
        columns |= {f"{_PREFIXES[signal]}{k + 1}": array[:, k] for k in range(log.n)}
    return columns


def _write_parquet(columns: Columns, file: IO[bytes]) -> None:
    pa.parquet.write_table(_table(columns), file)


def _write_csv(columns: Columns, file: IO[bytes]) -> None:
    file.write((",".join(columns) + "\n").encode())
    pa.csv.write_csv(_table(columns), file, pa.csv.WriteOptions(include_header=False))


def _write_npz(columns: Columns, file: IO[bytes]) -> None:
    np.savez_compressed(file, **columns)  # type: ignore[arg-type]


def _table(columns: Columns) -> pa.Table:
    return pa.table({name: np.ascontiguousarray(column) for name, column in columns.items()})


_READERS: dict[str, Reader] = {".parquet": _read_parquet, ".csv": _read_csv, ".npz": _read_npz}
_WRITERS: dict[str, Callable[[Columns, IO[bytes]], None]] = {
    ".parquet": _write_parquet,
    ".csv": _write_csv,
    ".npz": _write_npz,
}
