"""Tables as notebooks show them, and as pandas has them."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

from torchid.errors import MissingExtraError

if TYPE_CHECKING:
    from pandas import DataFrame


def html_table(head: Iterable[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in HTML, of cells as text."""
    names = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(str(cell))}</td>' for cell in row)}</tr>" for row in rows
    )
    return f"<table><thead><tr>{names}</tr></thead><tbody>{body}</tbody></table>"


def data_frame() -> "type[DataFrame]":
    """pandas' class of tables.

    Raises:
        MissingExtraError: pandas is not installed.
    """
    try:
        from pandas import DataFrame
    except ImportError as error:
        raise MissingExtraError("pandas", "frames", "a DataFrame") from error
    return DataFrame
