"""What is loaded can do what was saved: a method of a result is one of its record, too."""

import inspect
from dataclasses import fields
from importlib import import_module
from pkgutil import walk_packages
from types import UnionType
from typing import get_args

import pytest

from tests.documents import PACKAGES
from torchid.results.answer import Diagnosis
from torchid.results.files import RECORDS
from torchid.results.record import Record, Result

CANNOT = {
    # The log, or what is to be done to it, is not in the file.
    "Examination": {"mended", "waiting"},
    # The population of the search is not in the file; the sets that came of it are.
    "Extraction": {"found"},
    # How base parameters are sums is not in the file.
    "Fleet": {"base"},
    # The file holds the tables that were computed of these.
    "EqualTorqueStudy": {"degree", "rows", "worst"},
    # Robots, simulators and logs that files are written from, or replayed, are not in the file.
    "Correction": {"files"},
    "Randomisation": {"one", "write"},
    "PositionDiagnosis": {"before", "closed", "corrected", "unseen", "write_corrected"},
    "PairDiagnosis": {"write_corrected"},
    # Torques over time are not in the file.
    "TorqueDiagnosis": {"over_time"},
    "Replay": {"error"},
}  # fmt: skip
"""What a loaded result cannot do, and why."""


def _all() -> dict[type[Result], type[Record]]:
    """Every result, and what it is read back as."""
    for package in PACKAGES:
        for module in walk_packages(import_module(package).__path__, f"{package}."):
            # Drivers of other packages run in their own environments.
            if not module.name.endswith("__main__") and ".targets.in_" not in module.name:
                import_module(module.name)
    places = (place.split(":") for place in RECORDS.values())
    records = {name: getattr(import_module(module), name) for module, name in places}
    found, todo = {}, [Result]
    while todo:
        for kind in todo.pop().__subclasses__():
            todo.append(kind)
            abstract = kind is Diagnosis or issubclass(kind, Record)
            if kind.__module__.partition(".")[0] in PACKAGES and not abstract:
                made = inspect.getattr_static(kind, "record")
                given = getattr(made, "fget", None) or made.func
                record = given.__annotations__["return"]
                if isinstance(record, UnionType):  # of either kind of log
                    record = get_args(record)[0]
                found[kind] = records[record] if isinstance(record, str) else record
    return found


FOUND = _all()


@pytest.mark.parametrize("kind", FOUND, ids=lambda kind: kind.__name__)
def test_what_is_loaded_can_do_what_was_saved(kind) -> None:
    computed = {field.name for field in fields(kind)}
    public = {name for name in dir(kind) if not name.startswith("_")} - computed
    missing = {name for name in public if not hasattr(FOUND[kind], name)}
    assert missing == CANNOT.get(kind.__name__, set())


def test_only_results_are_excused() -> None:
    assert set(CANNOT) <= {kind.__name__ for kind in FOUND}
