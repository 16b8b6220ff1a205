"""Reading and writing .parquet, .csv and .npz."""

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from torchid.errors import LogError
from torchid.log.columns import (
    EXPECTED,
    PREFIXES,
    Columns,
    is_wanted,
    joint_columns,
    log_from_columns,
    refuse_repeated,
)
from torchid.log.model import Log


def read_parquet(path: Path) -> Log:
    """A log from a parquet file."""
    with _format(path, "parquet", pa.ArrowException), pa.parquet.ParquetFile(path) as file:
        names = list(file.schema_arrow.names)
        refuse_repeated(names, path)
        wanted = [name for name in names if is_wanted(name)]
        table = file.read(columns=wanted)
        columns = {name: _from_arrow(table.column(name)) for name in table.column_names}
        del table
    if "t" not in columns or "q1" not in columns:
        joint_columns(names, path)  # an error that lists all columns, not only the wanted
    log = log_from_columns(columns, path)
    del columns
    pa.default_memory_pool().release_unused()
    return log


def read_csv(path: Path) -> Log:
    """A log from a csv file with a header line."""
    with _format(path, "csv", pa.ArrowException, UnicodeDecodeError):
        names, delimiter = _csv_header(path)
        refuse_repeated(names, path)
        # Columns are told apart by position: those that are ignored may have any name, twice.
        keys = [str(k) for k in range(len(names))]
        wanted = {key: name for key, name in zip(keys, names, strict=True) if is_wanted(name)}
        joint_columns(names, path)
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
            expected=EXPECTED,
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


def read_npz(path: Path) -> Log:
    """A log from an npz archive of columns, or of t and q, dq, ... as (T, n) arrays; no pickles."""
    if not zipfile.is_zipfile(path):
        raise LogError(f"'{path}' is not a npz file, though its name says so.")
    problems = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError)
    columns: dict[str, np.ndarray] = {}
    with _format(path, "npz", *problems), np.load(path, allow_pickle=False) as arrays:
        groups = {name: name for name in PREFIXES} | {"i": "current"}
        for key in arrays.files:
            if key in groups or is_wanted(key):
                for name, column in _npz_columns(arrays, key, groups.get(key), path):
                    if name in columns:
                        raise LogError(f"'{path}' gives {name} twice, as an array and alone.")
                    columns[name] = column
        names = list(arrays.files)
    if "t" not in columns or "q1" not in columns:
        joint_columns([*columns, *(name for name in names if name not in columns)], path)
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
        yield (key if signal is None else f"{PREFIXES[signal]}1"), array
    elif array.ndim == 2 and signal is not None:
        for k in range(array.shape[1]):
            yield f"{PREFIXES[signal]}{k + 1}", array[:, k]
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


def write_parquet(columns: Columns, file: IO[bytes]) -> None:
    """Columns as parquet."""
    pa.parquet.write_table(_table(columns), file)


def write_csv(columns: Columns, file: IO[bytes]) -> None:
    """Columns as csv, numbers in full precision."""
    file.write((",".join(columns) + "\n").encode())
    pa.csv.write_csv(_table(columns), file, pa.csv.WriteOptions(include_header=False))


def write_npz(columns: Columns, file: IO[bytes]) -> None:
    """Columns as a compressed npz archive."""
    np.savez_compressed(file, **columns)  # type: ignore[arg-type]


def _table(columns: Columns) -> pa.Table:
    return pa.table({name: np.ascontiguousarray(column) for name, column in columns.items()})
