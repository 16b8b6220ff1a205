"""`torchid correct` and `torchid export RESULT --log`: one function, two ways to it, and nothing
written where it cannot be used."""

import json
from dataclasses import replace

import pytest

from torchid.excitation.synthetic import synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.log.readers import write_log
from torchid.robot.library import load_robot
from torchid.simulation.sensors import Sensors, measured_log

FEW = ("--effects", "coulomb_friction,stribeck_friction")
FRICTION = (
    {"effect": "coulomb_friction", "joint": 2, "Fc": 0.6},
    {"effect": "coulomb_friction", "joint": 3, "Fc": 0.3},
)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Three runs of the 3R with friction of two joints."""
    path = tmp_path_factory.mktemp("correct")
    arm = replace(load_robot("3r"), effects=FRICTION)
    for k in range(3):
        motion = trajectory_log(random_trajectory(arm, k, duration=8.0, fill=True), 200.0)
        log = measured_log(arm, synthetic_log(arm, motion), [], Sensors(torque_std=0.02), seed=k)
        write_log(log, path / f"{k}.csv")
    return [path / f"{k}.csv" for k in range(3)]


@pytest.fixture(autouse=True)
def _few_simulations(monkeypatch):
    monkeypatch.setattr("torchid.export.correct_torque.STARTS", 8)
    monkeypatch.setattr("torchid.export.correct_torque.HORIZONS", (0.1,))


@pytest.mark.slow
def test_a_diagnosis_is_carried_out_into_the_simulator(command, runs, tmp_path, types_unchecked):
    """It is judged by folds, and the JSON of `gap` with the logs gives the same file."""
    record, out = tmp_path / "gap.json", tmp_path / "out"
    for words in (("gap", "--json", record), ("correct", "--to", "mjcf", "--out", out)):
        done = command(words[0], "3r", *runs, *FEW, *words[1:])
        assert done.code == 0, done.err
    said = json.loads((out / "correction.json").read_text())
    assert said["schema"] == "torchid.correction/1"
    errors = said["judged"]["torque_error_percent"]
    assert max(errors["file_in_engine"]) < 0.5 * max(errors["nominal"])
    friction = {e["joint"]: e["Fc"] for e in said["bodies"]["fields"] if "Fc" in e}
    assert friction[2] == pytest.approx(0.6, abs=0.05)
    again = tmp_path / "again"
    logs = [word for path in runs for word in ("--log", path)]
    done = command("export", record, "--robot", "3r", *logs, "--to", "mjcf", "--out", again)
    assert done.code == 0, done.err
    assert "the log that was fitted" in " ".join(done.out.split())
    first, second = (folder / "3r_corrected.xml" for folder in (out, again))
    assert first.read_text() == second.read_text()
    # As a robot it needs no log: all its effects are in the yaml.
    assert command("export", record, "--to", "yaml", "--out", again).code == 0
    assert len(load_robot(again / "3r.yaml").effects) >= 2
    # But a simulator's file is refitted, and that needs the logs.
    out = tmp_path / "none"
    refused = command("export", record, "--to", "mjcf", "--out", out)
    assert refused.code == 1
    assert "--log LOG" in refused.err
    refused = command("export", record, "--to", "c", "--out", out, *logs)
    assert (refused.code, "refitted" in refused.err) == (1, True)
    refused = command("export", record, "--robot", "ur10e", *logs, "--to", "urdf", "--out", out)
    assert refused.code == 1
    assert not out.exists()
