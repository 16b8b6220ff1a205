"""`torchid simulate`: with and without effects, and how bad effects are refused."""

import json

import pytest
import torch

from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.log.readers import read_log, write_log
from torchid.robot.library import load_robot


@pytest.fixture(scope="module")
def trajectory(tmp_path_factory):
    path = tmp_path_factory.mktemp("simulate") / "trajectory.csv"
    write_log(trajectory_log(random_trajectory(load_robot("3r"), 0, duration=3.0), 100.0), path)
    return path


def _simulate(command, trajectory, tmp_path, *options):
    target = tmp_path / "log.parquet"
    report = tmp_path / "log.json"
    arguments = ("simulate", "3r", trajectory, "--to", target, "--json", report, *options)
    return command(*arguments), target, report


def test_without_effects_the_arm_is_on_the_trajectory(command, trajectory, tmp_path) -> None:
    done, target, report = _simulate(command, trajectory, tmp_path, "--noise", "none")
    assert done.code == 0, done.err
    assert torch.equal(read_log(target).q, read_log(trajectory).q)
    said = json.loads(report.read_text())
    assert said["effects"] == []
    assert said["closed_loop"] is False


@pytest.mark.slow
def test_effects_change_the_motion(command, trajectory, tmp_path) -> None:
    friction = "coulomb_friction:joint=2,Fc=0.6"
    gain = "torque_gain:joint=1,gain=0.5"
    done, target, report = _simulate(
        command, trajectory, tmp_path, "--noise", "none", "--effect", friction, "--effect", gain
    )
    assert done.code == 0, done.err
    log, wanted = read_log(target), read_log(trajectory)
    away = (log.q - wanted.q).abs().amax(0)
    assert log.samples == wanted.samples
    assert float(away[1]) > 1e-3
    said = json.loads(report.read_text())
    assert said["closed_loop"] is True
    assert [(e["effect"], e["joint"]) for e in said["effects"]] == [
        ("coulomb_friction", 2),
        ("torque_gain", 1),
    ]
    assert said["effects"][0]["Fc"] == 0.6


def test_several_trajectories_are_several_logs(command, trajectory, tmp_path) -> None:
    """Side by side, each as it is alone; the noise of each is its own."""
    given = ("simulate", "3r", trajectory, trajectory)
    exact = command(*given, "--to", tmp_path / "run{k}.csv", "--noise", "none")
    assert exact.code == 0, exact.err
    for k in (1, 2):
        assert torch.equal(read_log(tmp_path / f"run{k}.csv").q, read_log(trajectory).q)
    assert command(*given, "--to", tmp_path / "noisy{k}.csv").code == 0
    one, two = (read_log(tmp_path / f"noisy{k}.csv").tau for k in (1, 2))
    assert not torch.equal(one, two)
    refused = command(*given, "--to", tmp_path / "run.csv")
    assert refused.code == 1
    assert "run{k}.parquet" in refused.err
    assert not (tmp_path / "run.csv").exists()
