"""`torchid gap` on commands and positions, its model, and `torchid simulate --replay` with it."""

import json

import pytest
import torch

from tests.position.planted import planted, robot, true_servos
from torchid.log.readers import read_log, write_log
from torchid.position.model import ServoArm
from torchid.results.files import load
from torchid.robot.writer import write_robot


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two logs of an arm with known servos, and its model."""
    folder = tmp_path_factory.mktemp("position")
    servos = true_servos(3)
    ones = torch.ones(3, dtype=torch.float64)
    ServoArm(robot(), servos, ones).write(folder / "model.yaml")
    for k, part in enumerate(planted(servos, motions=2, seconds=12.0).trajectories()):
        write_log(part, folder / f"run{k}.csv")
    write_robot(robot(), folder / "plain.yaml")
    return folder


@pytest.mark.parametrize("windows", [None, 2])
def test_replay_writes_what_the_model_foretells(command, folder, tmp_path, windows):
    logs = [folder / "run0.csv", folder / "run1.csv"]
    out, record = tmp_path / "simulated", tmp_path / "replay.json"
    extra = () if windows is None else ("--windows", str(windows))
    result = command(
        "simulate", folder / "model.yaml", *logs, "--replay", *extra, "--to", out, "--json", record
    )
    assert result.code == 0, result.err
    assert sorted(p.name for p in out.iterdir()) == ["run0.csv", "run1.csv"]
    for path in logs:
        real, simulated = read_log(path), read_log(out / path.name)
        assert list(simulated.signals) == ["q"]
        assert torch.equal(simulated.t, real.t)
        # The log is of the same servos: what differs is the encoder's count at the starts.
        assert float((simulated.q - real.q).abs().max()) < 5e-3
    assert json.loads(record.read_text())["schema"] == "torchid.replay/1"
    again = load(record)
    assert [one.file for one in again.logs] == ["run0.csv", "run1.csv"]
    assert all(bool((one.error_mrad < 5).all()) for one in again.logs)
