"""What a page consists of: the verdict, pictures, tables, and how all of it was obtained."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from torchid.report.page.origin import Origin
from torchid.report.table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Picture:
    """A figure that is drawn when the page is rendered.

    Attributes:
        name: unique on the page, of letters, digits and underscores.
        caption: what is shown, and what to see in it.
        alt: what those who do not see it must know.
        draw: the figure.
    """

    name: str
    caption: str
    alt: str
    draw: Callable[[], "Figure"]


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Attributes:
        key: unique on the page, as `Picture.name`.
        heading: of the section.
        notes: sentences before everything else, one a line.
        pictures, sheets: figures, then tables.
    """

    key: str
    heading: str
    notes: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    sheets: tuple[Table, ...] = ()

    @property
    def empty(self) -> bool:
        """Whether there is nothing in it."""
        return not (self.notes or self.pictures or self.sheets)


@dataclass(frozen=True)
class Page:
    """A whole page.

    Attributes:
        title: what was done to what: `Sim-to-real gap of panda`.
        verdict: one sentence.
        facts: (label, value) the few numbers beside it.
        sections: the pictures, then the tables, then remarks; empty ones are left out.
        origin: how to repeat it.
    """

    title: str
    verdict: str
    facts: tuple[tuple[str, str], ...]
    sections: tuple[Section, ...]
    origin: Origin


def result_page(
    title: str,
    verdict: str,
    facts: Sequence[tuple[str, str]],
    origin: Origin,
    *,
    pictures: Iterable[Picture],
    tables: Iterable[Table],
    notes: Iterable[str],
    findings: Sequence[str] = (),
) -> Page:
    """The page of a result: pictures, findings, numbers, and what to bear in mind."""
    sections = (
        Section("pictures", "Pictures", pictures=tuple(pictures)),
        Section("findings", "Findings", notes=tuple(findings)),
        Section("numbers", "Numbers", sheets=tuple(tables)),
        Section("remarks", "To bear in mind", notes=tuple(notes)),
    )
    return Page(title, verdict, tuple(facts), sections, origin)
