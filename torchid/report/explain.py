"""A result that was read back, for people."""

from torchid.report import diagnosis
from torchid.report.table import Shown, Table
from torchid.results.answer import DiagnosisRecord
from torchid.results.record import Record
from torchid.results.words import listed

MOST_ROWS = 60
"""Of a table of entries."""
MOST_CHARACTERS = 60
"""Of a cell."""


def shown(record: Record) -> Shown:
    """The answer of a diagnosis with all that it rests on; of another result its main table.

    Raises:
        TorchidError: a diagnosis of an older version, which holds no answer.
    """
    if isinstance(record, DiagnosisRecord):
        return diagnosis.shown(record)
    rows = record.table.plain()
    columns = list(rows[0]) if rows else []
    cells = [[_cell(row.get(name)) for name in columns] for row in rows[:MOST_ROWS]]
    more = f"{len(rows) - MOST_ROWS} more rows are in the file." if len(rows) > MOST_ROWS else ""
    words = [name.replace("_", " ") for name in columns]
    table = Table(record.schema, words, cells, words=words, note=more)
    warnings = getattr(record, "warnings", ())
    return Shown(verdict=repr(record), parts=[table] if cells else [], warnings=warnings)


def _cell(value: object) -> str:
    """Short text of an entry."""
    if isinstance(value, float):
        text = f"{value:.4g}"
    elif isinstance(value, list):
        text = listed(_cell(x) for x in value)
    elif isinstance(value, dict):
        text = ", ".join(f"{k} {_cell(v)}" for k, v in value.items())
    else:
        text = "-" if value is None else str(value)
    return text if len(text) <= MOST_CHARACTERS else text[: MOST_CHARACTERS - 1] + "…"
