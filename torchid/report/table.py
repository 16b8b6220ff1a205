"""A table as plain cells, with its three writers: the terminal, the page and Markdown."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from rich import box
from rich.markup import escape
from rich.table import Table as RichTable
from rich.text import Text

Cell = str | Text
"""Plain text; a `Text` where the terminal shows it in a colour."""


@dataclass(frozen=True)
class Table:
    """Cells of a table.

    Attributes:
        title: what it shows, with units.
        columns: headings; those of numbers are right-aligned.
        rows: cells, one a column; an empty row is a line between others.
        names: headings of the columns of words that stay on one line.
        words: headings of the columns of words that may be broken.
        note: sentences below it.
        least_width: characters in the terminal.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    names: Collection[str] = ()
    words: Collection[str] = ()
    note: str = ""
    least_width: int | None = None

    @property
    def left(self) -> tuple[str, ...]:
        """Headings of all columns of words, which are left-aligned."""
        return (*self.names, *self.words)

    def __rich__(self) -> RichTable:
        """For the terminal."""
        table = compact(escape(self.title))
        table.show_header = any(name.strip() for name in self.columns)
        table.caption = escape(self.note) or None
        table.caption_justify = "left"
        table.min_width = self.least_width
        for name in self.columns:
            breaks = name in self.words
            table.add_column(
                Text(name),
                justify="left" if name in self.left else "right",
                no_wrap=not breaks,
                overflow="fold" if breaks else "ellipsis",
            )
        for row in self.rows:
            if row:
                table.add_row(*(Text.assemble(cell) for cell in row))
            else:
                table.add_section()
        return table

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
            names=plain(self.names),
            words=[name.strip() for name in plain(self.words)],
            note=note,
        )

    def markdown(self) -> str:
        """Title, table and note."""
        marks = (":--" if name in self.left else "--:" for name in self.columns)
        lines = [
            f"**{_plain(self.title)}**",
            "",
            _line(self.columns),
            f"|{'|'.join(marks)}|",
            *(_line(row) for row in self.rows),
        ]
        if self.note:
            lines += ["", _plain(self.note)]
        return "\n".join(lines) + "\n"


def compact(title: str) -> RichTable:
    """An empty table in the house style."""
    return RichTable(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1))


def unit_words(unit: str) -> str:
    """`kg m^2` as `kg m²`."""
    return unit.replace("^2", "²").replace("^3", "³")


def _line(cells: Sequence[Cell]) -> str:
    return "| " + " | ".join(_plain(str(cell)) for cell in cells) + " |"


def _plain(text: str) -> str:
    """Markdown that reads as the text does."""
    for mark in ("|", "*", "<"):
        text = text.replace(mark, f"\\{mark}")
    return text
