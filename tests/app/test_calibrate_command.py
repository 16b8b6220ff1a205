"""`torchid calibrate ROBOT LOG...`."""

import json

import pytest

from tests.gap.test_diagnose import REAL, logged
from torchid.log.readers import write_log
from torchid.results.files import load

FEW = ("--effects", "coulomb_friction,torque_offset", "--cutoff", "8", "--seed", "1")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A log of the 3R with friction."""
    path = tmp_path_factory.mktemp("calibrate") / "run.csv"
    write_log(logged(REAL, (3, 4, 3), 5), path)
    return path


@pytest.mark.slow
def test_a_cause_is_planted(command, run, tmp_path, types_unchecked):
    done = command("calibrate", "3r", run, *FEW, "--causes", 1, "--out", tmp_path)
    assert done.code == 0, done.err
    said = json.loads((tmp_path / "calibration.json").read_text())
    assert said["schema"] == "torchid.gap.calibration/1"
    assert len(load(tmp_path / "calibration.json").planted) == 1
    text = " ".join(done.out.split())
    assert "Coulomb friction" in text  # what the log itself lacks
    assert "Of 1 cause " in text
