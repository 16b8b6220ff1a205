"""Which log is of which unit and session."""

import itertools
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchid.errors import TorchidError
from torchid.log.csv_file import csv_table
from torchid.log.formats import parquet_table
from torchid.log.readers import is_log
from torchid.log.table import Request
from torchid.parallel.store import is_url

COLUMNS = ("log", "unit", "session")


@dataclass(frozen=True, order=True)
class FleetLog:
    """One log of a fleet.

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
    table = (csv_table if suffix == ".csv" else parquet_table)(file, Request())
    for name in COLUMNS[:2]:
        if name not in table.columns:
            raise TorchidError(
                f"the manifest '{file}' has no column {name}.",
                expected="log, unit, session",
                available=list(table.columns),
            )
    columns = {
        name: _words(cells)
        for name, cells in table.read([name for name in COLUMNS if name in table.columns]).items()
    }
    columns.setdefault("session", [Path(path).stem for path in columns["log"]])
    for name in COLUMNS:
        if "" in columns[name]:
            row = columns[name].index("") + 1
            raise TorchidError(f"the manifest '{file}' has no {name} in row {row}.")
    paths = [log if is_url(log) else str(file.parent / log) for log in columns["log"]]
    return _apart(list(map(FleetLog, columns["unit"], columns["session"], paths)))


def _words(array: np.ndarray) -> list[str]:
    """Cells as text; whole numbers, which units and sessions may be, without a point."""
    cells = ("" if x is None or x != x else str(x) for x in array.tolist())
    return [re.sub(r"(?<=\d)\.0$", "", cell) for cell in cells]


def _apart(logs: Sequence[FleetLog]) -> tuple[FleetLog, ...]:
    """The logs in the order of unit, session and path, which are then in no other's place."""
    if not logs:
        raise TorchidError("there is no log.", expected="LOG..., or a manifest")
    places = Counter(x.path if is_url(x.path) else str(Path(x.path).resolve()) for x in logs)
    place, times = places.most_common(1)[0]
    if times > 1:
        raise TorchidError("a log is named twice.", got=place, expected="each log once")
    return tuple(sorted(logs))
