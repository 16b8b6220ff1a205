"""A whole study for people: tables in the terminal, and a folder with figures, page and sets."""

from dataclasses import replace
from pathlib import Path

from rich.table import Table

from torchid.errors import TorchidError
from torchid.feasibility.sets import ParameterSets, joined, to_record
from torchid.files import atomic_write
from torchid.json_data import write_json
from torchid.report.study.figures import drawings, save
from torchid.report.study.page import page
from torchid.report.study.sheets import rich_table
from torchid.report.study.tables import all_sheets
from torchid.report.study.verdict import headline
from torchid.study.result import Study

__all__ = ["headline", "tables", "write_study"]

_PAGE, _BEST, _ALL = "study.md", "sets.json", "all_sets.json"


def tables(study: Study) -> list[Table]:
    """Coefficients, certificates, scenarios, search, reasons, torque, wrenches, payload."""
    return [rich_table(sheet) for sheet in all_sheets(study)]


def write_study(study: Study, folder: Path) -> list[Path]:
    """Write everything: figures (PNG), the page study.md, sets.json with the best sets under their
    ids and all_sets.json with those of all runs, under ids like p_25/run_3.

    Args:
        study: what to write.
        folder: made if it does not exist.

    Returns:
        The files, the page first.

    Raises:
        TorchidError: the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TorchidError(
            f"the folder '{folder}' cannot be made: {error.strerror or error}."
        ) from error
    figures = drawings(study)
    best = joined([s.best for s in study.scenarios])
    every = joined([_named(s.extraction.sets, s.scenario.id) for s in study.scenarios])
    written = [save(d.draw(), folder / d.file) for d in figures]
    sets = [_write_sets(best, study, folder / _BEST), _write_sets(every, study, folder / _ALL)]
    # The page comes last: where it is, all that it shows is there too.
    with atomic_write(folder / _PAGE) as stream:
        stream.write(page(study, figures, [path.name for path in sets]))
    return [folder / _PAGE, *sets, *written]


def _named(sets: ParameterSets, scenario: str) -> ParameterSets:
    return replace(sets, ids=tuple(f"{scenario}/{name}" for name in sets.ids))


def _write_sets(sets: ParameterSets, study: Study, path: Path) -> Path:
    write_json(to_record(sets, study.robot), path)
    return path
