"""Which log is of which unit and session."""

import csv
import io
import itertools
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from torchid.errors import TorchidError
from torchid.log.formats import open_parquet
from torchid.log.readers import guarded, is_log
from torchid.log.table import natural
from torchid.parallel.store import is_url

COLUMNS = ("log", "unit", "session")


@dataclass(frozen=True)
class FleetLog:
    """One log of a fleet. Names are text: unit `007` is not unit `7`.

    Attributes:
        unit: the one arm it is of.
        session: when; logs of one session are taken as of one day's arm.
        path: of a file or folder, or a URL that fsspec knows.
    """

    unit: str
    session: str
    path: str


def logs_of(paths: Sequence[str | Path], manifest: str | Path | None) -> tuple[FleetLog, ...]:
    """Logs by their paths, or those of a manifest.

    Raises:
        TorchidError: neither or both, or as `fleet_logs` and `read_manifest` raise.
    """
    if (manifest is None) is (not paths):
        raise TorchidError("the logs of a fleet are needed.", expected="LOG..., or `manifest=...`")
    return fleet_logs(paths) if manifest is None else read_manifest(manifest)


def fleet_logs(paths: Sequence[str | Path]) -> tuple[FleetLog, ...]:
    """Logs whose unit is the folder that they lie in and whose session is their own name; a folder
    that is no log stands for the logs in it, and in the folders in it.

    Raises:
        TorchidError: a folder without logs, a log that is there twice, or two logs that would be of
            one unit and session.
    """
    logs: list[FleetLog] = []
    for path in map(str, paths):
        inside = [Path(path)]
        if not is_url(path) and inside[0].is_dir() and not is_log(inside[0]):
            inside = sorted(p for p in inside[0].rglob("*") if p.is_file() and is_log(p))
            if not inside:
                raise TorchidError(f"there is no log in the folder '{path}'.")
        logs += [
            FleetLog(p.resolve().parent.name, p.stem, path if is_url(path) else str(p))
            for p in inside
        ]
    ordered = _apart(logs)
    for a, b in itertools.pairwise(ordered):
        if (a.unit, a.session) == (b.unit, b.session):
            raise TorchidError(
                f"two logs would be of unit '{a.unit}' and session '{a.session}'.",
                got=f"{a.path}, {b.path}",
                expected="folders with names of their own, or a manifest: two units, or one "
                "session in two logs?",
            )
    return ordered


def read_manifest(file: str | Path) -> tuple[FleetLog, ...]:
    """Logs from a table (.csv, .parquet) with the columns log, unit and session; without a session,
    each log is one. Paths are relative to the table.

    Raises:
        TorchidError: no such file, a column or an entry that is missing, a log that is there twice.
    """
    file = Path(file)
    suffix = file.suffix.lower()
    if not file.is_file() or suffix not in (".csv", ".parquet"):
        raise TorchidError(
            f"'{file}' is no manifest.",
            got="no such file" if not file.is_file() else file.suffix or "no suffix",
            expected="a .csv or .parquet file with the columns log, unit, session",
        )
    with guarded(file):
        columns = _csv_columns(file) if suffix == ".csv" else _parquet_columns(file)
    for name in COLUMNS[:2]:
        if name not in columns:
            raise TorchidError(
                f"the manifest '{file}' has no column {name}.",
                expected="log, unit, session",
                available=list(columns),
            )
    columns.setdefault("session", [Path(path).stem for path in columns["log"]])
    for name in COLUMNS:
        columns[name] = [cell.strip() for cell in columns[name]]
        if "" in columns[name]:
            row = columns[name].index("") + 1
            raise TorchidError(f"the manifest '{file}' has no {name} in row {row}.")
    paths = [log if is_url(log) else str(file.parent / log) for log in columns["log"]]
    return _apart(list(map(FleetLog, columns["unit"], columns["session"], paths)))


def _csv_columns(file: Path) -> dict[str, list[str]]:
    """Cells by column, as they are written."""
    text = file.read_bytes().decode("utf-8-sig")
    commented = itertools.takewhile(lambda line: line.startswith("#"), text.splitlines(True))
    text = text[sum(map(len, commented)) :]
    delimiter = max(",;\t", key=text.partition("\n")[0].count)
    rows = [row for row in csv.reader(io.StringIO(text, newline=""), delimiter=delimiter) if row]
    names = [name.strip() for name in rows[0]] if rows else []
    cells = itertools.zip_longest(*(row[: len(names)] for row in rows), fillvalue="")
    return {name: list(column[1:]) for name, column in zip(names, cells, strict=False)}


def _parquet_columns(file: Path) -> dict[str, list[str]]:
    """Cells by column as text: whole numbers with all their digits."""
    with open_parquet(file) as opened:
        table = opened.read([n for n in opened.schema_arrow.names if n in COLUMNS])
    return {n: table[n].cast(pa.string()).fill_null("").to_pylist() for n in table.column_names}


def in_order(logs: Iterable[FleetLog]) -> list[FleetLog]:
    """By unit, session and path, numbers in names by their value: 2 before 10."""
    return sorted(logs, key=lambda x: [(natural(w), w) for w in (x.unit, x.session, x.path)])


def _apart(logs: Sequence[FleetLog]) -> tuple[FleetLog, ...]:
    """The logs in the order of unit, session and path, which are then in no other's place."""
    if not logs:
        raise TorchidError("there is no log.", expected="LOG..., or a manifest")
    places = Counter(x.path if is_url(x.path) else str(Path(x.path).resolve()) for x in logs)
    place, times = places.most_common(1)[0]
    if times > 1:
        raise TorchidError("a log is named twice.", got=place, expected="each log once")
    return tuple(in_order(logs))
