"""Results read back from their files, whatever their kind."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from torchid import other_packages
from torchid.errors import TorchidError
from torchid.robot.config_files import ROBOT_FILES

if TYPE_CHECKING:
    from torchid.results.record import Record

_R = TypeVar("_R", bound="Record")

RECORDS = other_packages.RECORDS | {
    "torchid.identification/1": "torchid.identification.record:IdentificationRecord",
    "torchid.parameter_sets/1": "torchid.feasibility.sets:SetsRecord",
    "torchid.extraction/1": "torchid.extraction.record:ExtractionRecord",
    "torchid.atlas/1": "torchid.extraction.record:AtlasRecord",
    "torchid.feasibility/1": "torchid.feasibility.record:FeasibilityRecord",
    "torchid.payload/1": "torchid.identification.payload:Payload",
    "torchid.gap/2": "torchid.gap.record:GapRecord",
    "torchid.pair/2": "torchid.pair.record:PairRecord",
    "torchid.position_gap/1": "torchid.position.record:PositionRecord",
    "torchid.position_motion/1": "torchid.position.next_motion:NextCommandsRecord",
    "torchid.replay/1": "torchid.position.replay:ReplayRecord",
    "torchid.correction/1": "torchid.export.record:CorrectionRecord",
    "torchid.randomisation/1": "torchid.export.record:RandomisationRecord",
    "torchid.export/1": "torchid.export.record:ExportRecord",
    "torchid.doctor/1": "torchid.doctor.record:DoctorRecord",
    "torchid.compare/2": "torchid.fleet.comparison:Comparison",
    "torchid.fleet/1": "torchid.fleet.record:FleetRecord",
    "torchid.fleet_gap/1": "torchid.fleet.gap:FleetGap",
    "torchid.gap.calibration/1": "torchid.withheld.planted:CalibrationRecord",
}
"""Where the record of each schema stands; of several of one schema, with what tells them apart."""
AGAIN = "run the command that wrote it again, with this version"


class _Head(msgspec.Struct):
    """What says of which kind a file is."""

    schema: str
    mode: str | None = None

    @property
    def kind(self) -> str:
        return " ".join(filter(None, (self.schema, self.mode)))


def load(path: str | Path) -> "Record":
    """A result that a command or `save` has written.

    Args:
        path: a JSON file, e.g. gap.json.

    Returns:
        Its record: what the file holds, by the names of its keys; joints count from 0 in it.

    Raises:
        TorchidError: no such file, no result, or a fault in it, with its place.

    >>> import torchid
    >>> from tempfile import TemporaryDirectory
    >>> found = torchid.check(torchid.load_robot("3r"))
    >>> with TemporaryDirectory() as folder:
    ...     found.save(Path(folder) / "check.json")
    ...     load(Path(folder) / "check.json").sets[0].feasible
    True
    """
    return read(path, tuple(RECORDS))


def read(
    path: str | Path, kinds: Sequence[str], what: str = "a result", hint: str | None = None
) -> "Record":
    """A result of one of several kinds.

    Args:
        path: of the file.
        kinds: keys of `RECORDS`.
        what: it should be, for the errors.
        hint: how such a file is made.

    Raises:
        TorchidError: no such file, none of these kinds, or a fault in it, with its place.
    """
    path = Path(path)
    kind = require_result(path, what, hint)
    if kind not in kinds:
        raise TorchidError(
            f"'{path}' is not {what}.", got=f"schema {kind}", available=_schemas(kinds), hint=hint
        )
    record: type[Record] = other_packages.loaded(RECORDS[kind])
    return parsed(contents(path, what, hint), record, path, what, hint or AGAIN)


def require_result(path: Path, what: str = "a result", hint: str | None = None) -> str:
    """Which kind of result a file holds, without loading torch.

    Raises:
        TorchidError: no such file, no result, or one of another version.
    """
    again = hint or AGAIN
    if hint is None:
        hint = "a result is the JSON that a command writes, or that `save` of a result does"
        if path.suffix.lower() in ROBOT_FILES:
            hint = f"a robot, with what was found of it, is shown by: torchid robot {path}"
    head = parsed(contents(path, what, hint), _Head, path, what, hint)
    assert isinstance(head, _Head)
    name = head.schema.partition("/")[0]
    versions = [schema for schema in _schemas(RECORDS) if schema.partition("/")[0] == name]
    if versions and head.schema not in versions:
        got = f"schema {head.schema}, of another version"
        raise TorchidError(f"'{path}' is not {what}.", got=got, available=versions, hint=again)
    return head.kind


def _schemas(kinds: Iterable[str]) -> list[str]:
    """Schemas of the keys of `RECORDS`."""
    return list(dict.fromkeys(kind.partition(" ")[0] for kind in kinds))


def read_as(path: str | Path, record: type[_R], what: str, hint: str | None = None) -> _R:
    """A result of one kind of record; see `read`."""
    result = read(path, [str(record.__struct_config__.tag)], what, hint)
    assert isinstance(result, record)
    return result


def contents(path: Path, what: str, hint: str | None = None) -> bytes:
    """What a file holds.

    Raises:
        TorchidError: it cannot be read.
    """
    try:
        return path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        said = getattr(error, "strerror", None) or error
        raise TorchidError(f"'{path}' cannot be read: {said}.", expected=what, hint=hint) from error


def parsed(content: bytes, kind: type[Any], path: Path, what: str, hint: str | None = None) -> Any:
    """The content of a file as a record.

    Raises:
        TorchidError: no JSON, or a fault in it, with its place.
    """
    try:
        if kind is _Head:
            return msgspec.json.decode(content, type=kind)
        from torchid.results.record import decode

        return decode(content, kind, str(path))
    except msgspec.ValidationError as error:
        raise TorchidError(
            f"'{path}' is not {what} as torchid writes it.", got=str(error), hint=hint
        ) from error
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        raise TorchidError(
            f"'{path}' is not JSON.", got=str(error), expected=what, hint=hint
        ) from error
