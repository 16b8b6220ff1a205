"""What packages beside torchid have stands where torchid says, and loads when it is asked for."""

import subprocess
import sys
from importlib import import_module

import pytest

from tests.documents import PACKAGES, ROOT
from torchid.other_packages import COMMANDS, FIGURES, PUBLIC, RECORDS, loaded

BESIDE = tuple(name for name in PACKAGES if name != "torchid")


def test_torchid_imports_none_of_them():
    imported = "torchid, torchid.results.files, torchid.report.plots"
    code = f"import sys, {imported}; print([m for m in sys.modules if m.startswith({BESIDE})])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("place", [*COMMANDS.values(), *RECORDS.values(), *FIGURES.values()])
def test_every_place_is_there_and_beside_torchid(place):
    assert place.startswith(BESIDE)
    assert callable(loaded(place.partition(" ")[0]))


def test_modules_are_there():
    for name, module in PUBLIC.items():
        assert callable(getattr(import_module(module), name))
