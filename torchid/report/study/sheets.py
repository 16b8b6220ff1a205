"""A table as plain cells, which becomes a table in the terminal or in Markdown."""

from dataclasses import dataclass

from rich.markup import escape
from rich.table import Table

from torchid.report.identification import compact


@dataclass(frozen=True)
class Sheet:
    """Cells of a table.

    Attributes:
        title: what it shows, with units.
        columns: headings.
        rows: cells, one a column.
        text: headings of the columns that hold words, which are left-aligned.
        note: sentences below it.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text: frozenset[str] = frozenset()
    note: str = ""


def rich_table(sheet: Sheet) -> Table:
    """For the terminal."""
    table = compact(escape(sheet.title))
    table.caption = escape(sheet.note) or None
    table.caption_justify = "left"
    for name in sheet.columns:
        words = name in sheet.text
        table.add_column(
            escape(name),
            justify="left" if words else "right",
            overflow="fold",
            no_wrap=not words,
        )
    for row in sheet.rows:
        table.add_row(*(escape(cell) for cell in row))
    return table


def markdown(sheet: Sheet) -> str:
    """Title, table and note."""
    lines = [
        f"**{_plain(sheet.title)}**",
        "",
        _line(sheet.columns),
        "|" + "|".join(":--" if name in sheet.text else "--:" for name in sheet.columns) + "|",
        *(_line(row) for row in sheet.rows),
    ]
    if sheet.note:
        lines += ["", _plain(sheet.note)]
    return "\n".join(lines) + "\n"


def _line(cells: tuple[str, ...]) -> str:
    return "| " + " | ".join(_plain(cell) for cell in cells) + " |"


def _plain(text: str) -> str:
    """Markdown that reads as the text does."""
    for mark in ("|", "*", "<"):
        text = text.replace(mark, f"\\{mark}")
    return text
