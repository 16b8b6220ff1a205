"""An index of all results below a folder: what each one answers, and its files."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from urllib.parse import quote

import torchid
from torchid.errors import TorchidError
from torchid.files import write_text
from torchid.report.page.document import environment, require_page
from torchid.report.table import Shown, Table
from torchid.results.answer import DiagnosisRecord
from torchid.results.files import load
from torchid.results.words import count

OTHERS = ("*.html", "*.yaml", "*.xml", "*.urdf", "*.mcap", "*.rrd")
"""Files beside a result that belong to it."""


@dataclass(frozen=True)
class Entry:
    """One result.

    Attributes:
        file: its JSON.
        kind, robot, headline: what it is of, and what it says.
        date: of the file, UTC.
        others: files beside it, pages first.
    """

    file: Path
    kind: str
    robot: str
    headline: str
    date: str
    others: tuple[Path, ...]


def entries(folder: Path) -> list[Entry]:
    """Every result below a folder, the newest first; other JSON files are passed over.

    Raises:
        TorchidError: no folder, or it holds no result.
    """
    if not folder.is_dir():
        raise TorchidError("there is no such folder.", got=folder)
    found = sorted(_read(folder), key=lambda e: e.date, reverse=True)
    if not found:
        raise TorchidError(
            f"'{folder}' holds no result.", expected="JSON files that --out or --json wrote"
        )
    return found


def _read(folder: Path) -> Iterator[Entry]:
    for file in sorted(folder.rglob("*.json")):
        try:
            record = load(file)
        except TorchidError:
            continue
        answer = record.answer if isinstance(record, DiagnosisRecord) else None
        headline = repr(record) if answer is None else answer.headline
        date = datetime.fromtimestamp(file.stat().st_mtime, UTC).strftime("%Y-%m-%d %H:%M")
        others = tuple(p for mask in OTHERS for p in sorted(file.parent.glob(mask)))
        robot = getattr(record, "robot", "")
        kind = record.schema.split("/")[0].removeprefix("torchid").strip("._- ").replace("_", " ")
        yield Entry(file, kind, robot if isinstance(robot, str) else robot.name, headline, date,
                    tuple(p for p in others if p.name != "index.html"))  # fmt: skip


def index_shown(folder: Path) -> Shown:
    """The results below a folder, on the terminal."""
    found = entries(folder)
    rows = [(str(e.file.relative_to(folder)), e.robot, e.date, e.headline) for e in found]
    columns = ("result", "robot", "date, UTC", "answer")
    table = Table(f"results below {folder}", columns, rows, "pllp")
    return Shown(verdict=f"{count(len(found), 'result')} below {folder}.", parts=[table])


def write_index(folder: Path, page: Path) -> Path:
    """Write the index as one HTML page, with links to the results' pages and files.

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
            folder=folder.resolve().name, entries=entries(folder), link=link, hashes=[],
            scripts=[], library="", version=torchid.__version__,
        ),
    )  # fmt: skip
    return page


def _link(start: Path, file: Path) -> str:
    """From a folder to a file."""
    return quote(Path(os.path.relpath(file.resolve(), start)).as_posix())
