"""A diagnosis for people, the same for every kind of log: the answer, then the evidence for it."""

from functools import partial
from typing import TYPE_CHECKING

from torchid.errors import TorchidError
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.record import GapRecord
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.record import PositionRecord
from torchid.report import gap, gap_figures, position
from torchid.report.brief import Screen
from torchid.report.page.diagnosis import page
from torchid.report.table import Shown, Table
from torchid.results.answer import (
    MOST_SIZES,
    Answer,
    Diagnosis,
    DiagnosisRecord,
    named_size,
)
from torchid.results.words import sure

if TYPE_CHECKING:
    from torchid.report.panels import Figures


def suspects_table(answer: Answer) -> Table:
    """The likeliest causes that are not sure enough for a name."""
    rows = [
        (f"{c.name} {c.place}".strip(), ", ".join(map(named_size, c.sizes[:MOST_SIZES])),
         sure(c.how_sure), c.remedy)
        for c in answer.suspects
    ]  # fmt: skip
    columns = ("suspect", "value ± std", "sure", "what would settle it")
    title = "suspects: the likeliest causes that are not sure enough"
    return Table(title, columns, rows, "lrrp")


def shown(result: Diagnosis | DiagnosisRecord, model: str = "") -> Shown:
    """All that there is to see of a diagnosis, or of one that was read back.

    Args:
        result: what was diagnosed.
        model: which model to use next, one sentence.

    Raises:
        TorchidError: the file of an older version, which holds no answer.
    """
    record = result.record
    assert isinstance(record, DiagnosisRecord)
    if record.answer is None:
        raise TorchidError(
            "this file of an older version holds no answer.", hint="diagnose its logs again"
        )
    figures: Figures
    if isinstance(record, GapRecord):
        assert isinstance(result, TorqueDiagnosis | GapRecord)
        band, lower, notes = record.band_hz, gap.tables(record), gap.remarks(record)
        figures = gap_figures.figures(result)
    else:
        assert isinstance(record, PositionRecord)
        assert isinstance(result, PositionDiagnosis | PositionRecord)
        band, lower, notes = None, position.tables(record), position.remarks(record)
        figures = position.figures(result)
    return Shown(
        screen=Screen(answer=record.answer, band=band, warnings=record.warnings, model=model),
        verdict=record.answer.headline,
        parts=[suspects_table(record.answer), *lower, *notes],
        warnings=record.warnings,
        last=model,
        figures=figures,
        page=partial(page, result) if isinstance(result, Diagnosis) else None,
    )
