"""A table as plain cells, with its three writers: the terminal, the page and Markdown; a whole page
and all that is shown of a result; and numbers and names as tables, pictures and pages show them."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

from msgspec import UNSET
from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table as RichTable
from rich.text import Text

from torchid.errors import visible
from torchid.results.record import Col, Joint, Real
from torchid.results.words import (
    measure,
    number_list,
    short,
    unit_behind,
    unit_words,
    value_words,
    within,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from torchid.report.brief import Screen
    from torchid.report.panels import Picture
    from torchid.results.answer import Answer
    from torchid.typing import Tensor

Cell = str | Text
"""Plain text; a `Text` where the terminal shows it in a colour."""


@dataclass(frozen=True)
class Table:
    """Cells of a table.

    Attributes:
        title: what it shows, with units.
        columns: headings.
        rows: cells, one a column; an empty row is a line between others.
        align: a letter a column: `l` words that stay on one line, `p` words that may be broken, `r`
            numbers, as all columns are beyond the last letter.
        note: sentences below it.
        most: rows that are printed; a page has all of them.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    align: str = ""
    note: str = ""
    most: int | None = None

    @property
    def printed(self) -> "Table":
        """The rows that are printed, and how many more there are."""
        if self.most is None or len(self.rows) <= self.most:
            return self
        more = f"{self.note} And {len(self.rows) - self.most} more, in the JSON."
        return replace(self, rows=self.rows[: self.most], note=more.strip(), most=None)

    @property
    def letters(self) -> str:
        """Letters of all columns together."""
        return self.align.ljust(len(self.columns), "r")

    def __bool__(self) -> bool:
        """Whether there is a row: what is empty is shown nowhere."""
        return any(self.rows)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """For the terminal. Where that is too narrow, columns of words are broken first, then
        headings and cells at their spaces; no number is cut, and the last columns for which there
        is no room are left out."""
        shown, widths, gap = self.printed._fitted(options.max_width)
        if self.title:
            yield Text(visible(self.title), "table.title")
        table = RichTable(box=box.SIMPLE_HEAD)
        table.padding = (0, gap > 1, 0, gap > 2)
        table.show_header = any(name.strip() for name in shown.columns)
        for k, (name, letter) in enumerate(zip(shown.columns, shown.letters, strict=True)):
            table.add_column(
                Text(visible(name)),
                justify="right" if letter == "r" else "left",
                no_wrap=letter != "p" and not widths,
                overflow="fold",
                width=widths[k] if widths else None,
            )
        for row in shown.rows:
            if row:
                table.add_row(*(c if isinstance(c, Text) else Text(visible(c)) for c in row))
            else:
                table.add_section()
        yield table
        if shown.note:
            yield Text(visible(shown.note), "table.caption")

    def _fitted(self, room: int) -> "tuple[Table, list[int], int]":
        """The table with those columns that fit into `room` characters, their widths, none where
        all are as wide as they like, and the characters between them."""
        whole, own, least = zip(*map(self._needs, range(len(self.columns))), strict=True)
        usual = [o if x == "p" else w for w, o, x in zip(whole, own, self.letters, strict=True)]
        if sum(usual) + 3 * len(usual) < room:
            return self, [], 3
        count = max(1, sum(sum(least[: k + 1]) + k + 1 < room for k in range(len(least))))
        shown = self
        if count < len(least):
            absent = ", ".join(" ".join(name.split()) for name in self.columns[count:])
            note = f"{self.note} Not shown for want of room, but in the JSON: {absent}.".strip()
            rows = [row[:count] for row in self.rows]
            shown = replace(self, columns=self.columns[:count], rows=rows, note=note)
            shown = replace(shown, align=self.letters[:count])
        ways = [(own, 3), (own, 2), (own, 1), (least, 1)]
        free = [room - 1 - sum(some[:count]) - gap * count for some, gap in ways]
        way = next((k for k, left in enumerate(free) if left >= 0), -1)
        widths, left = list(ways[way][0][:count]), free[way]
        # What is left goes to the narrowest that want more.
        for goal in (own, whole):
            while left > 0 and (short := [k for k in range(count) if widths[k] < goal[k]]):
                widths[min(short, key=widths.__getitem__)] += 1
                left -= 1
        return shown, widths, ways[way][1]

    def _needs(self, column: int) -> tuple[int, int, int]:
        """Characters of a column with all on one line, with the heading broken at spaces and words
        as narrow as they may be, and with its cells broken at spaces, too."""
        head, *texts = (visible(str(row[column])) for row in (self.columns, *self.rows) if row)
        lines, words = (
            _widest(x) for x in ("\n".join(texts).splitlines(), " ".join(texts).split())
        )
        whole, top = max(lines, _widest(head.splitlines())), _widest(head.split())
        if self.letters[column] == "p":
            # 16: characters that a column of words has at least, if it has so long ones
            lines = words = min(16, lines)
        return whole, max(top, lines), max(top, words)

    def on_page(self) -> "Table":
        """For the page: a capital letter first, real superscripts in units, no colours."""

        def plain(cells: Iterable[Cell]) -> list[str]:
            return [unit_words(str(cell)) for cell in cells]

        title, note = plain((self.title, self.note))
        return replace(
            self,
            title=title[:1].upper() + title[1:],
            columns=[name.strip() for name in plain(self.columns)],
            rows=[plain(row) for row in self.rows if row],
            note=note,
        )

    def markdown(self) -> str:
        """Title, table and note."""
        marks = ["--:" if letter == "r" else ":--" for letter in self.letters]
        rows = (self.columns, *filter(None, self.rows))
        head, *body = ([_plain(str(cell)) for cell in row] for row in rows)
        lines = [f"**{_plain(self.title)}**", "", pipe_table(head, body, marks)]
        if self.note:
            lines += ["", _plain(self.note)]
        return "\n".join(lines) + "\n"

    def plain(self) -> dict[str, object]:
        """As JSON has it: words without colours, and the headings of the columns of words; the rows
        that are printed."""
        kinds = list(zip(self.columns, self.letters, strict=True))
        names, words = ([name for name, kind in kinds if kind == letter] for letter in "lp")
        printed = self.printed
        rows = [[str(cell) for cell in row] for row in printed.rows]
        head = {"title": self.title, "note": printed.note, "columns": list(self.columns)}
        return {**head, "names": names, "words": words, "rows": rows}


@dataclass(frozen=True)
class InputFile:
    """A file as it was when it was read.

    Attributes:
        role: `robot`, `log`, `held-out log`, ...
        name: as the user gave it.
        size: [bytes].
        sha256: hexadecimal.
    """

    role: str
    name: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Origin:
    """What is needed to obtain a result again.

    Attributes:
        command: the command line, or empty for a result of the library.
        finished: date and time, in UTC.
        seconds: taken, reading and figures included.
        versions: (package, version).
        seeds, settings: (name, value).
        files: inputs.
    """

    command: str
    finished: str
    seconds: float
    versions: tuple[tuple[str, str], ...]
    seeds: tuple[tuple[str, str], ...]
    settings: tuple[tuple[str, str], ...]
    files: tuple[InputFile, ...]


@dataclass(frozen=True)
class Code:
    """Text to copy, with a note above it."""

    text: str
    note: str


@dataclass(frozen=True)
class Section:
    """A part of a page, which folds; what is empty is left out.

    Attributes:
        title: of the section.
        parts: tables, figures, texts to copy, and lists of sentences, in their order; empty ones
            are left out.
        folded: whether its reader opens it.
    """

    title: str
    parts: "Sequence[Table | Picture | Code | Sequence[str] | None]"
    folded: bool = True

    @property
    def key(self) -> str:
        """Key of the section's place on the page."""
        return "".join(c if c.isalnum() else "-" for c in self.title.lower())


@dataclass(frozen=True)
class Page:
    """A whole page.

    Attributes:
        title: what was done to what: `Sim-to-real gap of panda`.
        verdict: one sentence.
        facts: (label, value) the few numbers beside it.
        origin: how to repeat it.
        sections: below them, in their order.
        answer: of a diagnosis: joints, bars and causes.
        band: below which its errors are counted [Hz].
        advice: (title, sentences) what to do.
        sortable: whether its tables can be sorted by a click.
    """

    title: str
    verdict: str
    facts: Sequence[tuple[str, str]]
    origin: Origin
    sections: Sequence[Section]
    answer: "Answer | None" = None
    band: float | None = None
    advice: Sequence[tuple[str, Sequence[str]]] = ()
    sortable: bool = False

    @property
    def pictures(self) -> "list[Picture]":
        """All pictures, in their order."""
        from torchid.report.panels import Picture

        return [p for s in self.sections for p in s.parts if isinstance(p, Picture)]


@dataclass(frozen=True, kw_only=True)
class Report:
    """A result for people.

    Attributes:
        screen: the answer on one screen; where there is one, all else is printed on demand.
        verdict: the answer, which stands out.
        parts: tables and sentences in the order in which they are printed; empty ones are left
            out.
        warnings: one sentence each.
        last: said at the end.
        figures: what draws each figure, by the names of their files.
        page: of the origin of the result.
    """

    screen: "Screen | None" = None
    verdict: str = ""
    parts: "Sequence[Table | Screen | str | None]"
    warnings: Iterable[str] = ()
    last: str = ""
    figures: "Mapping[str, Callable[[], Figure | None]]" = field(default_factory=dict)
    page: Callable[[Origin], Page] | None = None

    def __post_init__(self) -> None:
        """Leave out what is empty."""
        object.__setattr__(self, "parts", [part for part in self.parts if part])

    def plain(self) -> dict[str, object]:
        """The report's words as JSON has them: `verdict`, `parts` (tables and sentences),
        `warnings`, `last`."""
        parts = [part.plain() if isinstance(part, Table) else part for part in self.parts]
        words = {"verdict": self.verdict, "warnings": list(self.warnings), "last": self.last}
        return {**words, "parts": parts}


def pipe_table(
    head: Sequence[str], body: Iterable[Sequence[object]], marks: Sequence[str] | None = None
) -> str:
    """Cells as a table of Markdown, as they are; `marks` align the columns."""
    lines = ["| " + " | ".join(head) + " |", f"|{'|'.join(marks or ['---'] * len(head))}|"]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in body]
    return "\n".join(lines)


def _widest(parts: Iterable[str]) -> int:
    return max(map(cell_len, parts), default=0)


def _plain(text: str) -> str:
    """Markdown that reads as the text does."""
    for mark in ("|", "*", "<"):
        text = text.replace(mark, f"\\{mark}")
    return text


def table_of(
    title: str,
    entries: Iterable[object],
    columns: str = "",
    note: str = "",
    most: int | None = None,
    beside: Mapping[str, Sequence[Cell]] | None = None,
) -> Table:
    """Parts of a result as a table: a row each, a column for each field or property that declares
    one (`Col`).

    Integers, words and yes or no stand as they are, joints from 1, lists with commas, the numbers
    of a tensor (n,) beside each other, a dash for what is not there; a number with its digits, its
    unit, and its standard deviation or interval, as its column says.

    Args:
        title: of the table.
        entries: all of one class.
        columns: names of some of them in their order, with spaces between; all if empty: fields,
            then properties.
        note: sentences below it.
        most: rows that are printed.
        beside: headings and cells of columns at the right that no single entry tells.
    """
    rows = list(entries)
    kind: Any = type(rows[0]) if rows else None
    declared = _declared(kind) if rows else {}
    chosen = [declared[name] for name in (columns.split() if rows else ()) or declared]
    more = {} if beside is None else beside
    heads = [
        (col.heading or name.replace("_", " ")) + (f" [{col.unit}]" if col.unit else "")
        for name, col, _ in chosen
    ]
    lines = [
        [*(_cell(row, name, col) for name, col, _ in chosen), *others]
        for row, *others in zip(rows, *more.values(), strict=True)
    ]
    letters = ["r" if number else "p" for _, _, number in chosen] + ["p"] * len(more)
    return Table(title, [*heads, *more], lines, "".join(letters), note, most=most)


@cache
def _declared(kind: type) -> dict[str, tuple[str, Col, bool]]:
    """Columns by the name of their field or property: that name, the column, and whether it holds
    numbers."""
    hints = get_type_hints(kind, include_extras=True)
    for base in reversed(kind.__mro__):
        for name, value in vars(base).items():
            if isinstance(value, property):
                hints[name] = value.fget.__annotations__.get("return")
    columns = {}
    for name, hint in hints.items():
        for col in getattr(hint, "__metadata__", ()):
            if isinstance(col, Col):
                value = get_args(hint)[0]
                number = not {value, *get_args(value)}.isdisjoint((Joint, Real, int, float))
                columns[name] = (name, col, number)
    return columns


def _cell(entry: object, name: str, col: Col) -> str:
    """A cell, as `table_of` has it."""
    value = getattr(entry, name)
    if hasattr(value, "tolist"):
        return " ".join(cells(value, col.digits)) if col.words is None else col.words(value)
    if value is None or value is UNSET or value != value:
        return "-"
    if col.words is not None:
        return col.words(value)
    unit = getattr(entry, col.unit_of) if col.unit_of else ""
    spread = getattr(entry, col.spread) if col.spread else None
    if isinstance(spread, tuple):
        return within(value, spread, unit)
    if col.spread:
        return measure(value, spread, unit_behind(unit))
    match value:
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:{col.digits}} {unit_behind(unit)}".rstrip()
        case (float(), float()):
            return " .. ".join(dict.fromkeys(cells(value, col.digits)))
        case tuple() | list():
            numbers = all(isinstance(x, int | float) for x in value)
            return (number_list(value) if numbers else ", ".join(map(str, value))) or "-"
    return number_list([value]) if isinstance(value, Joint) else str(value)


def cells(values: "Iterable[float | None] | Tensor", digits: str = ".3g") -> list[str]:
    """Numbers of one row; a dash for what is not finite."""
    return [cell(v, digits) for v in (values.tolist() if hasattr(values, "tolist") else values)]


def cell(value: float | None, digits: str = ".3g") -> str:
    """A number; a dash where there is none, or it is not finite."""
    return "-" if value is None or not math.isfinite(value) else f"{value:{digits}}"


def plain_table(
    title: str, entries: Sequence[Mapping[str, object]], note: str = "", most: int = 60
) -> Table:
    """Plain data as a table: a row an entry, a column a key."""
    keys = list(dict.fromkeys(key for entry in entries for key in entry))
    rows = [[short(value_words(one.get(key, "-"), ".4g"), 80) for key in keys] for one in entries]
    heads = [key.replace("_", " ") for key in keys]
    numbers = [all(type(one.get(key)) in (int, float) for one in entries) for key in keys]
    letters = "".join("r" if number else "p" for number in numbers)
    return Table(title, heads, rows, letters, note, most=most)


def joint_table(
    title: str,
    rows: "Iterable[tuple[str, Iterable[float] | Tensor]]",
    digits: str = ".3g",
    last: Sequence[str] = (),
) -> Table:
    """One column a joint, and one row of numbers a name.

    Args:
        title: of the table.
        rows: names, and numbers of the joints and of the `last` columns, which may lack some.
        digits: of the numbers.
        last: headings of columns behind the joints'.
    """
    lines = [(name, *cells(values, digits)) for name, values in rows]
    n = max(map(len, lines), default=1)
    heads = ("", *joint_numbers(n - 1 - len(last)), *last)
    return Table(title, heads, [(*line, *[""] * (n - len(line))) for line in lines], "p")


def joint_numbers(n: int) -> list[str]:
    """Headings of one column a joint."""
    return [str(j + 1) for j in range(n)]
