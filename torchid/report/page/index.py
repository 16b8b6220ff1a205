"""An index of all results below a folder: links to them, and what each one answers."""

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import torchid
from torchid.errors import TorchidError
from torchid.files import write_text
from torchid.report.page.document import environment, require_page
from torchid.report.table import Report, Table
from torchid.results.answer import DiagnosisRecord
from torchid.results.files import load
from torchid.results.words import count


class Entry(NamedTuple):
    """One result.

    Attributes:
        file: its JSON.
        headline: what it says.
        pages: in the same folder.
    """

    file: Path
    headline: str
    pages: tuple[Path, ...]


def entries(folder: Path) -> list[Entry]:
    """Every result below a folder, the newest first; other JSON files are passed over.

    Raises:
        TorchidError: no folder, or it holds no result.
    """
    if not folder.is_dir():
        raise TorchidError("there is no such folder.", got=folder)
    listed = []
    for file in sorted(folder.rglob("*.json"), key=lambda p: p.stat().st_mtime, reverse=True):
        try:
            record = load(file)
        except TorchidError:
            continue
        answer = record.answer if isinstance(record, DiagnosisRecord) else None
        headline = repr(record) if answer is None else answer.headline
        pages = sorted(p for p in file.parent.glob("*.html") if p.name != "index.html")
        listed.append(Entry(file, headline, tuple(pages)))
    if not listed:
        raise TorchidError(
            f"'{folder}' holds no result.", expected="JSON files that --out or --json wrote"
        )
    return listed


def report_of_folder(folder: Path, results: Sequence[Entry]) -> Report:
    """The results below a folder, on the terminal."""
    rows = [(str(e.file.relative_to(folder)), e.headline) for e in results]
    table = Table(f"results below {folder}", ("result", "answer"), rows, "pp")
    return Report(verdict=f"{count(len(rows), 'result')} below {folder}.", parts=[table])


def write_index(folder: Path, page: Path) -> Path:
    """Write the index as one HTML page of links to the results and their pages.

    Raises:
        TorchidError: no result below the folder, or the page cannot be written.
        MissingExtraError: Jinja2 is not installed.
    """
    require_page(page)
    template = environment().get_template("index.html.j2")
    link = partial(_link, page.parent.resolve())
    write_text(
        page,
        template.render(
            folder=folder, entries=entries(folder), link=link, version=torchid.__version__
        ),
    )
    return page


def _link(start: Path, file: Path) -> str:
    """From a folder to a file."""
    return quote(Path(os.path.relpath(file.resolve(), start)).as_posix())
