"""`torchid payload` as a user calls it."""

import json
import re

import pytest
import torch
import typer
from typer.testing import CliRunner

from torchid.app.identify import payload_command
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.identification.payload import with_payload
from torchid.log.readers import write_log
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """empty.parquet, full.parquet (1.2 kg) and again.parquet (empty, other noise) of the 3R."""
    folder = tmp_path_factory.mktemp("payload")
    robot = load_robot("3r_friction")
    motion = trajectory_log(random_trajectory(robot, 0, count=2, fill=True), 100.0)
    box = InertialParameters.from_com(
        torch.tensor([1.2], dtype=torch.float64),
        torch.tensor([[0.03, -0.02, 0.08]], dtype=torch.float64),
        torch.tensor([[0.005, 0, 0, 0.004, 0, 0.002]], dtype=torch.float64),
    ).pi[0]
    for name, arm, seed in (
        ("empty", robot, 0),
        ("full", with_payload(robot, box), 1),
        ("again", robot, 2),
    ):
        write_log(synthetic_log(arm, motion, HonestNoise(), seed), folder / f"{name}.parquet")
    return folder


def call(*arguments: object):
    app = typer.Typer()
    app.command("payload")(payload_command)
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.mark.slow
def test_the_payload_is_estimated_printed_and_written(logs, tmp_path):
    full = logs / "full.parquet"
    got = call(
        "3r_friction", logs / "empty.parquet", "--loaded", full, "--cutoff", 5, "--seed", 4,
        "--json", tmp_path / "p.json", "--out", tmp_path / "out",
    )  # fmt: skip
    assert got.exit_code == 0, got.output
    assert re.search(r"carries 1\.(199|2)", " ".join(got.output.split()))
    assert "tool frame" in got.output
    data = json.loads((tmp_path / "p.json").read_text())
    assert data == json.loads((tmp_path / "out" / "payload.json").read_text())
    assert data["schema"] == "torchid.payload/1"
    assert data["frames"]["tool"]["mass"]["value"][0] == pytest.approx(1.2, rel=0.01)
    assert data["seen"]
    assert (data["cutoff_hz"], data["seed"]) == (5.0, 4)


@pytest.mark.slow
def test_no_payload_is_said(logs, tmp_path):
    got = call(
        "3r_friction", logs / "empty.parquet", "--loaded", logs / "again.parquet",
        "--cutoff", 5, "--json", tmp_path / "p.json",
    )  # fmt: skip
    assert got.exit_code == 0, got.output
    assert "No payload can be seen" in got.output
    assert ["com", "x", "-", "-"] in [line.split() for line in got.output.splitlines()]
    data = json.loads((tmp_path / "p.json").read_text())
    assert not data["seen"]
    assert data["frames"]["tool"]["com"]["value"] == [None] * 3
