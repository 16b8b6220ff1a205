"""A new user's way: every command and the Python of the README run, in its order, on a small arm.

The arm is the report's 3R as a URDF; its logs are simulated, with friction that grows with load.
"""

import csv
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from tests.documents import ROOT, blocks
from tests.position.planted import planted, true_servos
from torchid.log.readers import write_log
from torchid.robot.library import load_robot
from torchid.robot.writer import write_robot

README = ROOT / "README.md"
SMALLER = {
    " --cases 40": " --cases 1",
    " --runs 10": " --runs 2 --stages 2",
    "kuka_lwr4 --kind random": "kuka_lwr4 --kind random --duration 8",
    "torchid withheld leave-out": "true leave-out",  # long, and tested elsewhere
    # In a folder of its own: a project file holds for every command below it.
    "torchid init  ": "mkdir short; cp my_arm.urdf run[234].csv short; cd short; torchid init  ",
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
for k in 1 2 3 4; do
  torchid excite my_arm.urdf --kind random --usage 1 --duration 8 --seed $k --max-acceleration 5 \\
    --to motion$k.csv
done
E="--effect load_dependent_friction:joint=2,mu=0.05"
k=0
for run in run1 run2 run3 run4 run1_again; do
  k=$((k+1))
  torchid simulate my_arm.urdf motion$((k % 5 + k / 5)).csv $E --rate 200 --seed $k --to $run.csv
done
cp run1.csv arm.csv
torchid simulate my_arm.urdf motion1.csv --rate 200 --seed 7 --to sim.csv
LOAD=payload:m=0.5,mx=0,my=0,mz=0,Jxx=0,Jxy=0,Jxz=0,Jyy=0,Jyz=0,Jzz=0
torchid simulate my_arm.urdf motion1.csv --effect $LOAD --rate 200 --seed 9 --to full.csv
torchid simulate my_arm.urdf motion1.csv --closed-loop --rate 200 --seed 8 --to empty.csv
torchid identify my_arm.urdf run1.csv --out monday
torchid identify my_arm.urdf run2.csv --out tuesday
"""


def _shell(script: str, folder: Path) -> str:
    """Run a script in bash, where `torchid` is this one; its output."""
    command = folder / "bin" / "torchid"
    if not command.exists():
        command.parent.mkdir()
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m torchid "$@"\n')
        command.chmod(0o755)
    environment = os.environ | {
        "PATH": f"{command.parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
    }
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=3600,
    )  # fmt: skip
    assert done.returncode == 0, f"{script}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout


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


def _servo_logs(folder: Path) -> None:
    """Of an arm that logs commands and positions: run1.parquet to run4.parquet."""
    for k, run in enumerate(planted(true_servos(3), motions=4).trajectories(), start=1):
        write_log(run, folder / f"run{k}.parquet")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With all files that the README's commands name."""
    out = tmp_path_factory.mktemp("readme")
    _shell(PREPARE, out)
    _raw_log(out / "run1.csv", out / "raw.csv")
    (out / "run1.csv").unlink()
    _servo_logs(out)
    write_robot(load_robot(out / "my_arm.urdf").with_parameters(None), out / "kinematics.yaml")
    return out


@pytest.mark.slow
def test_commands_and_python_of_the_readme_run(folder: Path) -> None:
    found = [
        block for block in blocks(README, "") if block.lstrip().startswith(("torchid ", "for "))
    ]
    assert len(found) >= 10
    for block in found:
        _shell(_small(block), folder)
    for name in (
        "run1.csv",
        "mended.parquet",
        "result.html",
        "exported/my_arm.urdf",
        "gap.html",
        "corrected.yaml",
    ):
        assert (folder / name).stat().st_size > 0, name
    code = "\n".join(blocks(README, "python"))
    before = Path.cwd()
    os.chdir(folder)
    try:
        names = dict(
            zip(("q", "dq", "ddq"), torch.zeros(3, 5, 3, dtype=torch.float64), strict=True)
        )
        exec(compile(code, "README.md", "exec"), names)
    finally:
        os.chdir(before)
    assert names["tau"].shape == (5, 3)
    assert torch.isfinite(names["tau"]).all()
    assert names["best"].ids == (f"run_{names['found'].best + 1}",)
