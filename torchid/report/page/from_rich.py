"""Tables of the terminal as tables of the page, so that both say the same."""

from rich.table import Table
from rich.text import Text

from torchid.report.page.document import unit_words
from torchid.report.study.sheets import Sheet


def sheet(table: Table) -> Sheet:
    """Title, headings, cells and alignment of a terminal table, its markup taken off."""
    columns = table.columns
    headings = tuple(_plain(c.header) if table.show_header else "" for c in columns)
    words = frozenset(
        name for name, c in zip(headings, columns, strict=True) if c.justify != "right"
    )
    rows = zip(*([_plain(cell) for cell in c.cells] for c in columns), strict=True)
    title = _plain(table.title)
    return Sheet(title[:1].upper() + title[1:], headings, tuple(rows), words, _plain(table.caption))


def _plain(content: object) -> str:
    if content is None:
        return ""
    text = content if isinstance(content, Text) else Text.from_markup(str(content))
    return unit_words(text.plain)
