"""A result that was read back, for people: what was printed when it was made."""

from pathlib import Path
from typing import Any

import msgspec
from msgspec import UNSET, UnsetType

from torchid.report.brief import Screen
from torchid.report.table import Report, Table, plain_table
from torchid.results.answer import Answer
from torchid.results.files import contents, load, parsed, require_result
from torchid.results.record import Record


class _StoredTable(msgspec.Struct):
    """What `Table.plain` gave."""

    title: str
    columns: list[str]
    names: list[str]
    words: list[str]
    rows: list[list[str]]
    note: str

    def table(self) -> Table:
        """The table again."""
        kinds = dict.fromkeys(self.names, "l") | dict.fromkeys(self.words, "p")
        align = "".join(kinds.get(name, "r") for name in self.columns)
        return Table(self.title, self.columns, self.rows, align, self.note)


class _Explanation(msgspec.Struct):
    """What was printed of a result."""

    parts: list[_StoredTable | str]
    verdict: str = ""
    warnings: tuple[str, ...] = ()
    last: str = ""


class _Stored(msgspec.Struct):
    """What a result's file says to people."""

    schema: str
    explanation: _Explanation | UnsetType = UNSET
    answer: Answer | None = None
    band_hz: float | None = None


def report_of_file(path: Path) -> tuple[dict[str, Any], Report]:
    """The content of a result's file, and all that there is to say of it.

    Raises:
        TorchidError: no such file, no result, or a diagnosis of an older version, which holds no
            answer.
    """
    require_result(path)  # with a hint where it is another kind of file
    content = contents(path, "a result")
    stored = parsed(content, _Stored, path, "a result")
    if stored.explanation is UNSET:  # of Python's `save`, or of an older version
        record = load(path)
        return record.plain(), report_of_record(record)
    own, screen = stored.explanation, None
    if stored.answer is not None:
        screen = Screen(
            answer=stored.answer, band=stored.band_hz, warnings=own.warnings, model=own.last
        )  # fmt: skip
    parts = [part if isinstance(part, str) else part.table() for part in own.parts]
    said = Report(
        screen=screen, verdict=own.verdict, parts=parts, warnings=own.warnings, last=own.last
    )
    return msgspec.json.decode(content), said


def report_of_record(record: Record) -> Report:
    """The answer of a diagnosis with all that it rests on; of another result its main table.

    Raises:
        TorchidError: a diagnosis of an older version, which holds no answer.
    """
    from torchid.report import diagnosis
    from torchid.results.answer import DiagnosisRecord

    if isinstance(record, DiagnosisRecord):
        return diagnosis.report_of_diagnosis(record)
    table = plain_table(record.schema, record.table.plain())
    warnings = getattr(record, "warnings", ())
    return Report(verdict=repr(record), parts=[table], warnings=warnings)
