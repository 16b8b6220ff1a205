"""Tables in text files: comma, semicolon, tab or spaces between values, decimal point or comma."""

import io
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

from torchid.errors import LogError
from torchid.log.columns import EXPECTED
from torchid.log.formats import from_arrow, repeated
from torchid.log.ros_echo import echo_table
from torchid.log.table import Request, Shape, Table

_LINES_LOOKED_AT = 100
_COMMENT = ("#", "%")


@dataclass(frozen=True)
class _Dialect:
    """How a text file is written.

    Attributes:
        names: of the columns; empty without a header line.
        width: number of columns.
        delimiter: between values; a space for any white space.
        decimal: point or comma.
        skipped: lines before the first values.
        first: the first line that is no comment.
    """

    names: tuple[str, ...]
    width: int
    delimiter: str
    decimal: str
    skipped: int
    first: str


def csv_table(path: Path, request: Request) -> Table:
    """The table of a text file with a header line; comments (#, %) before it are skipped. What ROS
    echoes is read by the names in its rows, if no mapping says otherwise.

    Without a header line all columns are one array `data`, if a mapping says which is which.

    Raises:
        LogError: no text, or no header line and no mapping.
    """
    if request.columns is None and (echo := echo_table(path, request)) is not None:
        return echo
    dialect = _dialect(path)
    if dialect.names:
        names = dialect.names
        columns: dict[str, Shape | None] = dict.fromkeys(names, (-1,))

        def read(wanted: Sequence[str]) -> dict[str, np.ndarray]:
            # By position: columns that are ignored may have any name, twice.
            return _read(path, dialect, {str(names.index(name)): name for name in wanted})

        return Table(path, "csv", columns, read, repeated=repeated(names))
    if request.columns is None:
        raise LogError(
            f"'{path}' has no header line.",
            got=dialect.first[:80],
            expected=EXPECTED,
            hint="put the names of the columns in the first line, or say which are which, counted "
            'from 0: `columns="t=data[:,0],q=data[:,1:7],tau=data[:,7:13]"`',
        )

    def read_data(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        found = _read(path, dialect, {str(k): f"data[:,{k}]" for k in range(dialect.width)})
        return {"data": np.stack(list(found.values()), 1)} if wanted else {}

    return Table(path, "csv without header", {"data": (-1, dialect.width)}, read_data)


def _dialect(path: Path) -> _Dialect:
    with open(path, encoding="utf-8-sig") as file:
        lines = [
            line.rstrip("\r\n")
            for line in islice(iter(lambda: file.readline(1_000_000), ""), _LINES_LOOKED_AT)
        ]
    if any("\0" in line for line in lines):
        raise LogError(f"'{path}' is not a csv file, though its name says so.")
    comments = next((k for k, line in enumerate(lines) if not line.startswith(_COMMENT)), 0)
    first = lines[comments] if lines else ""
    delimiter = max(",;\t", key=first.count)
    if delimiter not in first and len(first.split()) > 1:
        delimiter = " "
    decimal_comma = delimiter != "," and re.search(r"\d,\d", "".join(lines[comments + 1 :][:1]))
    decimal = "," if decimal_comma else "."
    names, skipped = _names(first, delimiter), comments + 1
    numbers = sum(_is_number(name, decimal) for name in names)
    # The names may stand in the last comment.
    above = _names(lines[comments - 1].lstrip("#% "), delimiter) if comments else []
    if numbers == len(names) or (2 * numbers > len(names) == len(above)):
        names, skipped = above if len(above) == len(names) else [], comments
    width = len(_names(first, delimiter))
    return _Dialect(tuple(names), width, delimiter, decimal, skipped, first)


def _names(line: str, delimiter: str) -> list[str]:
    parts = line.split() if delimiter == " " else line.split(delimiter)
    return [name.strip().strip("\"'").strip() for name in parts]


def _is_number(text: str, decimal: str) -> bool:
    try:
        float(text.replace(decimal, "."))
    except ValueError:
        return False
    return True


def _read(path: Path, dialect: _Dialect, wanted: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Columns by name, of their positions."""
    if not wanted:
        return {}
    try:
        # The type is given: inferred, it would be that of the first block of lines only.
        table = _arrow(path, dialect, list(wanted), pa.float64())
    except pa.ArrowInvalid as error:
        if "conversion error" not in str(error):
            raise
        # As text, so that the column and the value can be named.
        table = _arrow(path, dialect, list(wanted), pa.string())
    found = {}
    for k, name in wanted.items():
        column = table[k]
        with suppress(pa.ArrowInvalid):  # as it is where not all of it are numbers
            column = column.cast(pa.float64())
        found[name] = from_arrow(column, name, path)
    return found


def _arrow(path: Path, dialect: _Dialect, wanted: list[str], kind: pa.DataType) -> pa.Table:
    source: Path | io.BytesIO = path
    delimiter = dialect.delimiter
    if delimiter == " ":
        lines = path.read_text(encoding="utf-8-sig").split("\n")
        text, delimiter = "\n".join("\t".join(line.split()) for line in lines), "\t"
        source = io.BytesIO(text.encode())
    return pa.csv.read_csv(
        source,
        read_options=pa.csv.ReadOptions(
            column_names=[str(k) for k in range(dialect.width)],
            skip_rows=dialect.skipped,
            use_threads=False,
        ),
        parse_options=pa.csv.ParseOptions(delimiter=delimiter),
        convert_options=pa.csv.ConvertOptions(
            include_columns=wanted,
            column_types=dict.fromkeys(wanted, kind),
            strings_can_be_null=True,
            decimal_point=dialect.decimal,
        ),
    )
