"""Tables in .parquet and .npz files; writing .parquet, .csv and .npz."""

import math
import zipfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.csv
import pyarrow.parquet
from numpy.lib import format as npy

from torchid.errors import LogError
from torchid.log.columns import Columns
from torchid.log.table import Request, Shape, Table


def parquet_table(path: Path, request: Request) -> Table:
    """The table of a parquet file; a column of lists is an array."""
    with open_parquet(path) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
    names = list(schema.names)
    columns: dict[str, Shape | None] = {
        name: (rows, width) if (width := _width(schema.field(k).type)) else (rows,)
        for k, name in enumerate(names)
    }

    def read(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        return read_parquet_columns(path, wanted)

    # 10_000_000: values of a parquet file whose columns are read one at a time: opening it costs
    # less then
    large = rows * len(names) > 10_000_000
    return Table(path, "parquet", columns, read, one_by_one=large, repeated=repeated(names))


def open_parquet(path: Path) -> pa.parquet.ParquetFile:
    """A parquet file, whose checksums are verified where it has some."""
    return pa.parquet.ParquetFile(path, page_checksum_verification=True)


def read_parquet_columns(path: Path, wanted: Sequence[str]) -> dict[str, np.ndarray]:
    """Columns of a parquet file by name: (T,), or (T, k) where they are lists of numbers."""
    columns: dict[str, np.ndarray] = {}
    with open_parquet(path) as file:
        # One at a time, so that only one is in memory twice.
        for name in wanted:
            table = file.read(columns=[name])
            columns |= {n: from_arrow(table.column(n), n, path) for n in table.column_names}
            del table
    pa.default_memory_pool().release_unused()
    return columns


def _width(kind: pa.DataType) -> int:
    """Numbers in one row: 0 for a plain column, -1 where rows may differ."""
    if pa.types.is_fixed_size_list(kind):
        return int(kind.list_size)
    return -1 if pa.types.is_list(kind) or pa.types.is_large_list(kind) else 0


def from_arrow(column: pa.ChunkedArray, name: str, path: Path) -> np.ndarray:
    """A column as numbers, empty cells as NaN; as it is where it is not numeric."""
    kind = column.type
    if pa.types.is_integer(kind) and column.null_count == 0:
        return _in_one(column)
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return _in_one(column.cast(pa.float64(), safe=False))
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        return column.to_numpy().astype("M8[ns]" if pa.types.is_timestamp(kind) else "m8[ns]")
    if _width(kind):
        # (T, k) of a column of lists, which must be equally long.
        lengths = pa.compute.list_value_length(column).to_numpy()
        if len(lengths) == 0 or (lengths != lengths[0]).any():
            raise LogError(
                f"'{path}': the lists in column {name} are not equally long.",
                got="no rows" if len(lengths) == 0 else f"{min(lengths)} to {max(lengths)} values",
            )
        flat = pa.compute.list_flatten(column)
        if not (pa.types.is_integer(flat.type) or pa.types.is_floating(flat.type)):
            return np.array(column.to_pylist(), dtype=object)
        return flat.cast(pa.float64(), safe=False).to_numpy().reshape(len(lengths), -1)
    return np.array(column.to_pylist(), dtype=object)


def _in_one(column: pa.ChunkedArray) -> np.ndarray:
    """A column of numbers as one array, empty cells as NaN. Its own `to_numpy` loads pandas."""
    if column.null_count:
        column = column.fill_null(math.nan)
    parts = [np.from_dlpack(chunk) for chunk in column.chunks if len(chunk)]
    return np.concatenate(parts) if parts else column.to_numpy()


def repeated(names: Sequence[str]) -> tuple[str, ...]:
    """The names that are there more than once."""
    return tuple(sorted(name for name, times in Counter(names).items() if times > 1))


def npz_table(path: Path, request: Request) -> Table:
    """The table of a npz archive; no pickles."""
    if not zipfile.is_zipfile(path):
        raise LogError(f"'{path}' is not a npz file, though its name says so.")
    with np.load(path, allow_pickle=False) as arrays:
        names = list(arrays.files)

    def read(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        with np.load(path, allow_pickle=False) as arrays:
            return {name: _npz_array(arrays, name, path) for name in wanted}

    return Table(path, "npz", dict.fromkeys(names), read, arrays=True)


def _npz_array(arrays: Any, name: str, path: Path) -> np.ndarray:
    packed = arrays.zip
    try:
        with packed.open(name if name in packed.namelist() else f"{name}.npy") as member:
            first = npy.read_magic(member) == (1, 0)
            header = npy.read_array_header_1_0 if first else npy.read_array_header_2_0
            shape, _, kind = header(member)
        require_held(path, name, math.prod(shape) * kind.itemsize, path.stat().st_size)
        array = arrays[name]
    except ValueError as error:
        raise LogError(
            f"'{path}': array {name} cannot be read: it holds Python objects or is damaged.",
            got=str(error).splitlines()[0],
            expected="numbers",
        ) from error
    return np.asarray(array)


def require_held(path: Path, name: str, claimed: int, held: int) -> None:
    """Refuse an array that claims more than its file can hold, before memory is taken for it.

    Args:
        path, name: of the file and the array.
        claimed: bytes that its header says it has.
        held: bytes of the file, or of what it keeps for the array.

    Raises:
        LogError: not even the best compression makes so much of so little.
    """
    # 1032: of deflate, which packs the arrays of npz, HDF5 and MATLAB files
    if claimed > 1032 * (held + 1024):
        raise LogError(
            f"'{path}': array {name} claims more numbers than the file can hold.",
            got=f"{claimed:.3g} bytes",
            expected=f"what {held} bytes can hold",
        )


def write_parquet(columns: Columns, file: IO[bytes]) -> None:
    """Columns as parquet."""
    pa.parquet.write_table(_table(columns), file, write_page_checksum=True)


def write_csv(columns: Columns, file: IO[bytes]) -> None:
    """Columns as csv, numbers in full precision."""
    file.write((",".join(columns) + "\n").encode())
    pa.csv.write_csv(_table(columns), file, pa.csv.WriteOptions(include_header=False))


def write_npz(columns: Columns, file: IO[bytes]) -> None:
    """Columns as a compressed npz archive."""
    np.savez_compressed(file, **columns)  # type: ignore[arg-type]


def _table(columns: Columns) -> pa.Table:
    return pa.table({name: _arrow(np.ascontiguousarray(x)) for name, x in columns.items()})


def _arrow(x: np.ndarray) -> pa.Array | np.ndarray:
    """Numbers as they lie in memory: of an array, pyarrow imports pandas to ask whether it is its
    own, which takes as long as a simulation."""
    if x.dtype != np.float64 or x.ndim != 1:
        return x
    return pa.Array.from_buffers(pa.float64(), len(x), [None, pa.py_buffer(x)])
