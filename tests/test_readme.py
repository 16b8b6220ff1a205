"""A new user's way: every command and the Python of the README run, in its order, and all those of
the tutorial on a small arm.

The arm is the report's 3R as a URDF; its logs are simulated, with friction that grows with load.
"""

import csv
import math
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.documents import ROOT, blocks
from tests.position.planted import planted, true_servos
from tests.shell import Shell, shell
from torchid.excitation.synthetic import simulate
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.log.model import Log
from torchid.log.readers import write_log
from torchid.robot.library import load_robot
from torchid.robot.writer import write_robot

README = ROOT / "README.md"
TUTORIAL = ROOT / "docs/tutorial.md"
PYTHON = ROOT / "docs/python.md"
SMALLER = {
    " --cases 40": " --cases 1",
    " --causes 30": " --causes 1",
    " --runs 10": " --runs 2 --stages 2",
    "3r --kind random": "3r --kind random --duration 5",
    "--workers 8": "--workers 1",
    # What this arm's diagnosis leaves open, its vertical first joint, no motion can show.
    "torchid excite --for gap/gap.json": "true excite --for gap/gap.json",
}
"""What would take too long here, or has nothing to work on."""

PREPARE = """
torchid export 3r_friction --to urdf --name my_arm
sed 's/"link_3"/"wrist_3"/; s/"3r_friction"/"my_arm"/' my_arm.urdf > renamed
mv renamed my_arm.urdf
torchid export 3r --to mjcf --name my_arm
torchid export 3r --to urdf --name so101
"""
LOAD = ("mx", "my", "mz", "Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz")
IDENTIFY = """
torchid identify my_arm.urdf run1.csv --out monday
torchid identify my_arm.urdf run2.csv --out tuesday
"""


def _small(block: str) -> str:
    for long, short in SMALLER.items():
        block = block.replace(long, short)
    return block


def _raw_log(source: Path, target: Path) -> None:
    """The same log under other names, in milliseconds, degrees and mN m."""
    with source.open() as file:
        rows = list(csv.DictReader(file))
    joints = (1, 2, 3)
    with target.open("w", newline="") as file:
        writer = csv.writer(file)
        names = [f"pos_{j}" for j in joints] + [f"eff_{j}" for j in joints]
        writer.writerow(["time_ms", *names])
        for row in rows:
            degrees = [math.degrees(float(row[f"q{j}"])) for j in joints]
            torque = [1e3 * float(row[f"tau{j}"]) for j in joints]
            writer.writerow([1e3 * float(row["t"]), *degrees, *torque])


def _logs(folder: Path) -> None:
    """Five runs of the arm with friction that its file lacks, which are stepped together, and one
    of another day, with a payload; of the model that lacks it, one as a simulator has it, and two
    without and with a payload."""
    robot = load_robot(folder / "my_arm.urdf").with_limits(acceleration=5)
    motion = trajectory_log(random_trajectory(robot, 1, count=4, duration=8.0, fill=True), 200.0)
    runs = motion.trajectories()
    runs.append(runs[0])
    friction = {"effect": "load_dependent_friction", "joint": 2, "mu": 0.05}
    real = simulate(robot, Log.concatenate(runs), effects=[friction], seed=1)
    names = ("run1", "run2", "run3", "run4", "run1_again")
    for name, run in zip(names, real.trajectories(), strict=True):
        write_log(run, folder / f"{name}.csv")
    shutil.copy(folder / "run1.csv", folder / "arm.csv")
    for k in (1, 2):  # a fleet of two
        (folder / "logs" / f"arm-{k}").mkdir(parents=True)
        shutil.copy(folder / f"run{k}.csv", folder / "logs" / f"arm-{k}" / "monday.csv")
    load = {"effect": "payload", "m": 0.5} | dict.fromkeys(LOAD, 0.0)
    for name, effects in (
        ("sim", []),
        ("empty", []),
        ("full", [load]),
        ("friday", [friction, load]),
    ):
        log = simulate(robot, runs[0], effects=effects, seed=9)
        write_log(log, folder / f"{name}.csv")


def _servo_logs(folder: Path) -> None:
    """Of an arm that logs commands and positions: run1.parquet to run4.parquet."""
    for k, run in enumerate(planted(true_servos(3), motions=4).trajectories(), start=1):
        write_log(run, folder / f"run{k}.parquet")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shell]:
    """A folder with all files that the tutorial's commands name."""
    out = tmp_path_factory.mktemp("tutorial")
    with shell(out) as place:
        place.run(PREPARE)
        _logs(out)
        place.run(IDENTIFY)
        _raw_log(out / "run1.csv", out / "raw.csv")
        (out / "run1.csv").unlink()
        _servo_logs(out)
        write_robot(load_robot(out / "my_arm.urdf").with_parameters(None), out / "kinematics.yaml")
        yield place


def test_six_short_commands_lead_to_a_corrected_model() -> None:
    first = next(b for b in blocks(TUTORIAL, "") if b.lstrip().startswith("torchid "))
    lines = [line.split("#")[0].strip() for line in first.strip().splitlines()]
    assert len(lines) <= 6
    assert all(len(line) <= 75 for line in lines), lines
    assert any("--save-model" in line for line in lines)


def _commands_run(page: Path, place: Shell) -> int:
    """How many blocks of commands a page has; all of them are run."""
    found = [block for block in blocks(page, "") if block.lstrip().startswith(("torchid ", "for "))]
    for block in found:
        place.run(_small(block))
    return len(found)


def _python_runs(page: Path, folder: Path) -> dict[str, Any]:
    """The names that a page's Python leaves: its blocks run as printed, in order, with nothing but
    the files that the shell lines made."""
    names: dict[str, Any] = {}
    before = Path.cwd()
    os.chdir(folder)
    try:
        for k, block in enumerate(blocks(page, "python"), start=1):
            exec(compile(block, f"{page.name}, Python block {k}", "exec"), names)
    finally:
        os.chdir(before)
    tensors = {name: x for name, x in names.items() if isinstance(x, torch.Tensor)}
    assert all(bool(torch.isfinite(x).all()) for x in tensors.values()), tensors
    return names


@pytest.mark.slow
def test_commands_and_python_of_the_readme_run(tmp_path: Path) -> None:
    """In an empty folder: the README needs no robot or log of anybody's."""
    with shell(tmp_path) as place:
        assert _commands_run(README, place) == 4
    for name in ("gap/gap.json", "corrected.yaml", "exported/ur10e.urdf", "next/trajectory.csv"):
        assert (tmp_path / name).stat().st_size > 0, name
    assert blocks(README, "python")
    before = set(tmp_path.rglob("*"))
    for page in (README, PYTHON):
        _python_runs(page, tmp_path)
    assert set(tmp_path.rglob("*")) > before, "what the README's Python saves"


@pytest.mark.nightly
def test_commands_and_python_of_the_tutorial_run(place: Shell) -> None:
    assert _commands_run(TUTORIAL, place) >= 10
    for name in (
        "run1.csv",
        "mended.parquet",
        "result.html",
        "exported/my_arm.urdf",
        "gap.html",
        "arm.yaml",
        "so101.yaml",
    ):
        assert (place.folder / name).stat().st_size > 0, name
    names = _python_runs(TUTORIAL, place.folder)
    assert names["best"].ids == (f"run_{names['found'].best + 1}",)
