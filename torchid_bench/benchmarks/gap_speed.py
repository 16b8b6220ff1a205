# ruff: noqa: E402 (threads are set before numpy and torch are imported)
"""Time and memory of a diagnosis by length of the log: 7 joints at 500 Hz, one effect planted.

    python -m torchid_bench.benchmarks.gap_speed [--seconds 30 60 120 600] [--json FILE]

Each length runs in a process of its own, so that peak memory is its own. The log is synthetic: the
closed-form torque of the LWR with Coulomb friction on one joint along exciting trajectories
of 30 s, with counted positions and noisy torques; the simulator knows everything but the friction.
"""

import os

for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import json
import platform
import resource
import subprocess
import sys
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch

from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.gap.torque import diagnose_torque
from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

RATE = 500.0
DURATION = 30.0
PLANTED = MappingProxyType({"effect": "coulomb_friction", "joint": 4, "Fc": 1.5})


def peak_megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def case(seconds: float, rate: float = RATE) -> tuple[Robot, Log]:
    """A simulator, and a log of the arm it should be, at a rate [Hz]."""
    robot = load_robot("kuka_lwr4")
    arm = replace(robot, effects=(*robot.effects, PLANTED))
    count = max(1, round(seconds / DURATION))
    plan = random_trajectory(
        robot, seed=0, count=count, duration=seconds / count, fill=True, usage=0.8
    )
    return robot, synthetic_log(arm, trajectory_log(plan, rate), HonestNoise(), seed=1)


def measure(seconds: float) -> dict[str, Any]:
    """Diagnose one log in this process."""
    torch.set_num_threads(1)
    robot, log = case(seconds)
    before = peak_megabytes()
    start = time.perf_counter()
    spent: dict[str, float] = defaultdict(float)
    last = ("", start)

    def progress(stage: str, done: int, total: int) -> None:
        nonlocal last
        now = time.perf_counter()
        spent[last[0]] += now - last[1]
        last = (stage, now)

    found = diagnose_torque(robot, log, progress=progress)
    progress("", 0, 0)
    del spent[""]
    return {
        "seconds_of_log": seconds,
        "samples": len(log.t),
        "diagnosis_s": time.perf_counter() - start,
        "stages_s": dict(spent),
        "peak_mb": peak_megabytes(),
        "peak_before_mb": before,
        "status": found.status,
        "findings": [f"{cause.name} {cause.place}".rstrip() for cause in found.which],
    }


def in_a_process(seconds: float) -> dict[str, Any]:
    command = [sys.executable, __file__, "--one", str(seconds)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, nargs="+", default=[30.0, 60.0, 120.0, 600.0])
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--one", type=float, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one is not None:
        print(json.dumps(measure(args.one)))
        return
    print(f"{platform.platform()}, load {os.getloadavg()[0]:.1f}, torch {torch.__version__}")
    figures = []
    for seconds in args.seconds:
        row = in_a_process(seconds)
        figures.append(row)
        names = ", ".join(row["findings"])
        print(
            f"{seconds:4g} s, {row['samples']:6d} samples: {row['diagnosis_s']:6.1f} s, peak "
            f"{row['peak_mb']:5.0f} MB ({row['peak_before_mb']:.0f} before); {row['status']}: "
            f"{names or 'none'}",
            flush=True,
        )
        stages = sorted(row["stages_s"].items(), key=lambda item: -item[1])
        print("       " + ", ".join(f"{name} {spent:.1f}" for name, spent in stages[:5]))
    if args.json:
        args.json.write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
