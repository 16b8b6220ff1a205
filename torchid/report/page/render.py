"""A page as HTML: one file, nothing to load, no script."""

from pathlib import Path
from typing import TYPE_CHECKING

from torchid.errors import MissingExtraError
from torchid.files import atomic_write
from torchid.report.page.document import Page
from torchid.report.page.svg import inline_svg
from torchid.report.text import printable

if TYPE_CHECKING:
    from jinja2 import Environment

MOST_BYTES = 3_000_000
"""Of a page, and more than any of them needs."""
_WORDS_AND_TABLES = 400_000
"""Bytes of it that figures leave free."""


def require_templates() -> None:
    """See before any work whether a page can be made.

    Raises:
        MissingExtraError: Jinja2 is not installed.
    """
    _environment()


def render(page: Page) -> str:
    """The page as HTML.

    Figures are inline SVG whose colours follow the reader's light or dark theme. Pictures beyond
    `MOST_BYTES` are left out, and the page says so.

    Raises:
        MissingExtraError: Jinja2 is not installed.
    """
    template = _environment().get_template("page.html.j2")
    room, drawn = MOST_BYTES - _WORDS_AND_TABLES, {}
    for picture in (picture for section in page.sections for picture in section.pictures):
        svg = inline_svg(picture)
        room -= len(svg.encode())
        if room < 0:
            break
        drawn[picture.name] = svg
    return template.render(page=page, drawn=drawn)


def write_page(page: Page, path: str | Path) -> Path:
    """Write the page atomically.

    Raises:
        TorchidError: the file cannot be written, or Jinja2 is not installed.
    """
    text = render(page)
    with atomic_write(path) as stream:
        stream.write(text)
    return Path(path)


def _environment() -> "Environment":
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
    except ModuleNotFoundError as error:
        raise MissingExtraError("jinja2", "report", "A page") from error
    made = Environment(
        loader=PackageLoader("torchid.report.page", "templates"),
        autoescape=True,  # names of robots and files come from anywhere
        # What a macro or the figures' writer made is markup, and stays.
        finalize=lambda value: printable(value) if type(value) is str else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["thousands"] = lambda k: f"{k:,}".replace(",", "\u202f")
    return made
