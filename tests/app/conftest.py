"""Run commands in this process, as a user would, and see what they print and leave."""

import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.log.readers import read_log, write_log
from torchid.robot.library import load_robot


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


@pytest.fixture
def command(monkeypatch, capsys):
    """command("identify", "3r", path, ...) -> Outcome; never a traceback."""

    def call(*arguments: object) -> Outcome:
        from torchid.app.commands import run

        monkeypatch.setattr(sys, "argv", ["torchid", *(str(a) for a in arguments)])
        code = 0
        try:
            run()
        except SystemExit as stop:
            code = int(stop.code or 0)
        text = capsys.readouterr()
        assert "Traceback" not in text.err + text.out
        return Outcome(code, text.out, text.err)

    return call


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """Logs of the 3R with friction: fit.parquet (two trajectories), check.csv."""
    path = tmp_path_factory.mktemp("logs")
    robot = load_robot("3r_friction")
    for name, seed, count in (("fit.parquet", 0, 2), ("check.csv", 9, 1)):
        motion = trajectory_log(random_trajectory(robot, seed, count=count, fill=True), 100.0)
        write_log(synthetic_log(robot, motion, HonestNoise(), seed), path / name)
    return path


def table_of(log) -> dict[str, torch.Tensor]:
    """Columns of a log, by their names."""
    table = {"t": log.t.clone()}
    for name, signal in log.signals.items():
        table |= {f"{name}{j + 1}": signal[:, j].clone() for j in range(log.n)}
    return table


def write_table(table: dict[str, torch.Tensor], path: Path) -> Path:
    rows = torch.stack(list(table.values()), -1).tolist()
    lines = [",".join(table), *(",".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def broken(folder, tmp_path):
    """broken(change) -> a csv of the check log after `change(table)`."""
    return lambda change: write_table(
        change(table_of(read_log(folder / "check.csv"))), tmp_path / "broken.csv"
    )
