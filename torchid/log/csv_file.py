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
        before: lines before the header that are neither comments nor empty.
        cut: the last line, if it ends too soon.
    """

    names: tuple[str, ...]
    width: int
    delimiter: str
    decimal: str
    skipped: int
    first: str
    before: tuple[str, ...] = ()
    cut: str = ""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is left out of the file."""
        out = []
        if n := len(self.before):
            lines = f"{n} line{'s' * (n > 1)} before the header left out"
            out.append(f"{lines}: {'; '.join(line[:60] for line in self.before[:5])}")
        if self.cut:
            out.append(f"the last line ends too soon, and is left out: {self.cut[:60]}")
        return tuple(out)


def csv_table(path: Path, request: Request) -> Table:
    """The table of a text file with a header line; comments (#, %) before it are skipped. What ROS
    echoes is read by the names in its rows, if no mapping says otherwise, and pairs of columns
    (`Name;A;Name;B` above times and values, as a TwinCAT scope writes them) as A, B at one time.

    The header is the first line of the longest run of lines with equally many cells.

    Without a header line all columns are one array `data`, if a mapping says which is which.

    Raises:
        LogError: no text, or no header line and no mapping.
    """
    if request.columns is None and (echo := echo_table(path, request)) is not None:
        return echo
    dialect = _dialect(path)
    said = tuple(f"'{path}': {text}" for text in dialect.warnings)
    if dialect.names and _are_pairs(dialect.names):
        return _pairs_table(path, dialect, said)
    if dialect.names:
        names = dialect.names
        columns: dict[str, Shape | None] = dict.fromkeys(names, (-1,))

        def read(wanted: Sequence[str]) -> dict[str, np.ndarray]:
            # By position: columns that are ignored may have any name, twice.
            return _read(path, dialect, {str(names.index(name)): name for name in wanted})

        return Table(path, "csv", columns, read, repeated=repeated(names), warnings=said)
    if request.columns is None:
        raise LogError(
            f"'{path}' has no header line.",
            got=dialect.first[:80],
            expected=EXPECTED,
            hint="put the names of the columns in the first line, or say which are which, counted "
            'from 0: `columns="t=data[:,0],q=data[:,1:7],tau=data[:,7:13]"`',
        )

    def read_data(wanted: Sequence[str]) -> dict[str, np.ndarray]:
        values = _read(path, dialect, {str(k): f"data[:,{k}]" for k in range(dialect.width)})
        return {"data": np.stack(list(values.values()), 1)} if wanted else {}

    shapes = {"data": (-1, dialect.width)}
    return Table(path, "csv without header", shapes, read_data, warnings=said)


def _are_pairs(names: Sequence[str]) -> bool:
    """Whether columns are pairs of time and value, each pair headed by the same word."""
    return len(names) > 2 and not len(names) % 2 and {n.lower() for n in names[::2]} == {"name"}


def _pairs_table(path: Path, dialect: _Dialect, said: tuple[str, ...]) -> Table:
    """Columns of a table of pairs, at the times of the longest."""
    values = _read(path, dialect, {str(k): str(k) for k in range(dialect.width)})
    pairs = {}
    for k, name in enumerate(dialect.names[1::2]):
        t, x = values[str(2 * k)], values[str(2 * k + 1)]
        there = np.isfinite(t.astype(np.float64)) & np.isfinite(x.astype(np.float64))
        pairs[name] = t[there].astype(np.float64), x[there].astype(np.float64)
    t, columns = at_one_time(pairs, f"'{path}'")
    unit = " [ms]" if re.search(r"\[ms\]", dialect.first) else ""
    repeats = repeated(dialect.names[1::2])
    arrays = {f"time{unit}": t, **columns}
    return Table.in_memory(path, "csv of pairs", arrays, repeated=repeats, warnings=said)


def at_one_time(
    signals: Mapping[str, tuple[np.ndarray, np.ndarray]], label: str, clock_of: str | None = None
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Signals at the times of one of them, as far as all of them go.

    Args:
        signals: by name, times (T,) that rise and values (T,) or (T, k).
        label: of the file, for the messages.
        clock_of: whose times count; of the signal with the most samples if None.

    Returns:
        Times, and each signal there: straight lines between its samples.

    Raises:
        LogError: times that do not rise, or have no part in common.
    """
    for name, (t, _) in signals.items():
        if len(t) < 2 or not bool((np.diff(t) > 0).all()):
            whose = f"the times of {name} do" if name else "its time does"
            raise LogError(f"{label}: {whose} not increase.", got=f"{len(t)} samples")
    if clock_of is None:
        clock_of = max(signals, key=lambda name: len(signals[name][0]))
    clock = signals[clock_of][0]
    first = max(t[0] for t, _ in signals.values())
    last = min(t[-1] for t, _ in signals.values())
    clock = clock[(clock >= first) & (clock <= last)]
    if len(clock) < 2:
        raise LogError(
            f"{label}: signals were not recorded at the same time.",
            got="; ".join(f"{name}: {t[0]:g} to {t[-1]:g}" for name, (t, _) in signals.items()),
            expected="times of one clock",
        )

    def there(t: np.ndarray, x: np.ndarray) -> np.ndarray:
        if x.ndim == 1:
            return np.interp(clock, t, x)
        return np.stack([np.interp(clock, t, column) for column in x.T], 1)

    return clock, {name: there(t, x) for name, (t, x) in signals.items()}


def _dialect(path: Path) -> _Dialect:
    with open(path, encoding="utf-8-sig") as file:
        # 200: lines that tell a table's form
        lines = [
            line.rstrip("\r\n") for line in islice(iter(lambda: file.readline(1_000_000), ""), 200)
        ]
    if any("\0" in line for line in lines):
        raise LogError(f"'{path}' is not a csv file, though its name says so.")
    comments = next((k for k, line in enumerate(lines) if not line.startswith(_COMMENT)), 0)
    begin, delimiter = _header(lines, comments)
    first = lines[begin] if lines else ""
    decimal_comma = delimiter != "," and any(
        re.search(r"\d,\d", line) for line in lines[begin + 1 : begin + 20]
    )
    decimal = "," if decimal_comma else "."
    names, skipped = _names(first, delimiter), begin + 1
    numbers = sum(_is_number(name, decimal) for name in names)
    width = len(names)
    # The names may stand in the last comment.
    above = _names(lines[begin - 1].lstrip("#% "), delimiter) if begin else []
    if numbers == width or (begin == comments and 2 * numbers > width == len(above)):
        names, skipped = above if len(above) == width else [], begin
    before = tuple(line.strip() for line in lines[comments:begin] if line.strip())
    if before:  # what stands between the header and the numbers: units, types, comments
        rows = [k for k in range(begin + 1, len(lines)) if _is_row(lines[k], delimiter, decimal)]
        under = lines[begin + 1 : rows[0]] if rows else []
        first, skipped = "\n".join([first, *under]), rows[0] if rows else skipped
    elif names and skipped < len(lines) and _are_units(_names(lines[skipped], delimiter), width):
        units = _names(lines[skipped], delimiter)
        names, skipped = (
            [f"{n} {u}".strip() for n, u in zip(names, units, strict=True)],
            skipped + 1,
        )
    cut = _last_line(path) if len(lines) > skipped + 1 else ""
    cut = cut if 0 < len(_names(cut, delimiter)) < width and cut.strip() else ""
    return _Dialect(tuple(names), width, delimiter, decimal, skipped, first, before, cut)


def _header(lines: Sequence[str], first: int) -> tuple[int, str]:
    """Which line is the header, or else the first of the table, and what is between its cells.

    Args:
        lines: the file's beginning.
        first: the first of them that is no comment: the header, unless fewer lines have as many
            cells as it than have another number of cells on end, below a line of names.
    """
    text = lines[first] if lines else ""
    delimiter = max(",;\t", key=text.count)
    if delimiter not in text and len(text.split()) > 1:
        delimiter = " "
    # Three lines are a table, where other lines stand before it.
    best, header = 2, (first, delimiter)
    for other in dict.fromkeys((delimiter, *";\t, ")):
        width, length, begin = 0, 0, first
        for k in range(first, len(lines)):
            cells = len(_names(lines[k], other))
            if not lines[k].strip():
                continue
            if cells != width:
                width, length, begin = cells, 0, k
            length += 1
            decimal = "." if other == "," else ","
            if begin == first:
                fits = other == delimiter
            else:  # names above numbers
                rows = [_is_row(lines[j], other, decimal) for j in (begin, k)]
                fits = width > 1 and rows == [False, True]
            if fits and length > best:
                best, header = length, (begin, other)
    return header


def _is_row(line: str, delimiter: str, decimal: str) -> bool:
    """Whether all cells are numbers or empty, and one is a number."""
    cells = [cell for cell in _names(line, delimiter) if cell]
    return bool(cells) and all(_is_number(cell, decimal) for cell in cells)


def _are_units(cells: Sequence[str], width: int) -> bool:
    """Whether the line under the header says units in brackets, of most columns."""
    bracketed = [bool(re.fullmatch(r"\[[^\[\]]*\]|\([^()]*\)", cell)) for cell in cells]
    return (
        len(cells) == width
        and any(bracketed)
        and all(b or not c for b, c in zip(bracketed, cells, strict=True))
    )


def _last_line(path: Path) -> str:
    """The last line, where it is not very long."""
    with open(path, "rb") as file:
        # 1 << 16: bytes that hold the last line
        file.seek(max(0, path.stat().st_size - (1 << 16)))
        tail = file.read().decode("utf-8-sig", errors="replace").rstrip("\r\n")
    return tail.rpartition("\n")[2].rstrip("\r")


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
    columns = {}
    for k, name in wanted.items():
        column = table[k]
        with suppress(pa.ArrowInvalid):  # as it is where not all of it are numbers
            column = column.cast(pa.float64())
        columns[name] = from_arrow(column, name, path)
    return columns


def _arrow(path: Path, dialect: _Dialect, wanted: list[str], kind: pa.DataType) -> pa.Table:
    source: Path | io.BytesIO = path
    delimiter, cut = dialect.delimiter, dialect.cut
    if delimiter == " ":
        cut = "\t".join(cut.split())
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
        parse_options=pa.csv.ParseOptions(
            delimiter=delimiter,
            invalid_row_handler=lambda row: "skip" if cut and row.text == cut else "error",
        ),
        convert_options=pa.csv.ConvertOptions(
            include_columns=wanted,
            column_types=dict.fromkeys(wanted, kind),
            strings_can_be_null=True,
            decimal_point=dialect.decimal,
        ),
    )
