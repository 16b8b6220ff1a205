"""Time and memory of a diagnosis by length of the log and number of joints, one effect planted.

    python -m torchid_bench.benchmarks.gap_speed [--seconds 30 60 120 600] [--joints 7] [--out DIR]

Each case runs in a process of its own, so that peak memory is its own. The log is synthetic, at
500 Hz: the closed-form torque of the arm with Coulomb friction on one joint along exciting
trajectories of 30 s, with counted positions and noisy torques; the simulator knows everything but
the friction. Seven joints are the LWR; other numbers are chains of like links whose axes turn by a
right angle from one to the next.
"""

import json
import resource
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any

import torch

from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.gap.torque import STAGES, diagnose_torque
from torchid.log.model import Log
from torchid.parallel.pace import Pace
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid_bench.benchmarks.cpu_time import machine
from torchid_bench.benchmarks.runner import command, results, table

RATE = 500.0
PLANTED = MappingProxyType({"effect": "coulomb_friction", "Fc": 1.5})
LINK, SHRINKS = 0.2, 0.85
"""Length of a chain's links [m], and mass of each over that of the one before [1]."""


def peak_megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def chain(joints: int) -> Robot:
    """An arm of so many revolute joints, by turns about crossed axes."""
    masses = [5.0 * SHRINKS**k for k in range(joints)]
    turns = [
        {"type": "R", "a": LINK, "alpha_deg": 90 * (-1) ** k, "d": 0, "theta": 0}
        for k in range(joints)
    ]
    size = [m * LINK**2 / 3 for m in masses]
    document = {
        "name": f"chain_{joints}",
        "dh": {"convention": "classical", "joints": turns},
        "gravity": [0, 0, -9.81],
        "limits": {"position": [1.5] * joints, "velocity": [2.0] * joints, "acceleration": [8.0] * joints},
        "parameters": {
            "mass": masses,
            "com": [[-LINK / 2, 0.01, 0.01] for _ in masses],
            "inertia_about_link_frame": [[s / 10, 0, 0, s, 0, s] for s in size],
        },
    }  # fmt: skip
    with TemporaryDirectory() as folder:
        file = Path(folder) / "chain.yaml"
        file.write_text(json.dumps(document))
        return load_robot(str(file))


def case(seconds: float, rate: float = RATE, joints: int = 7) -> tuple[Robot, Log]:
    """A simulator, and a log of the arm it should be, at a rate [Hz]."""
    robot = load_robot("kuka_lwr4") if joints == 7 else chain(joints)
    arm = replace(robot, effects=(*robot.effects, {**PLANTED, "joint": joints // 2 + 1}))
    # 30.0: length of a trajectory [s]
    count = max(1, round(seconds / 30.0))
    plan = random_trajectory(
        robot, seed=0, count=count, duration=seconds / count, fill=True, usage=0.8
    )
    return robot, synthetic_log(arm, trajectory_log(plan, rate), HonestNoise(), seed=1)


def measure(seconds: float, joints: int) -> dict[str, Any]:
    """Diagnose one log in this process."""
    torch.set_num_threads(1)
    robot, log = case(seconds, joints=joints)
    before, used = peak_megabytes(), time.process_time()
    start = time.perf_counter()
    spent: dict[str, float] = defaultdict(float)
    last = ("", start)

    def progress(stage: str, done: int, total: int) -> None:
        nonlocal last
        now = time.perf_counter()
        spent[last[0]] += now - last[1]
        last = (stage, now)

    diagnosis = diagnose_torque(robot, log, pace=Pace(progress, STAGES))
    progress("", 0, 0)
    del spent[""]
    return {
        "seconds_of_log": seconds,
        "samples": len(log.t),
        "diagnosis_s": time.perf_counter() - start,
        "cpu_s": time.process_time() - used,
        "stages_s": dict(spent),
        "peak_mb": peak_megabytes(),
        "peak_before_mb": before,
        "status": diagnosis.status,
        "findings": [f"{cause.name} {cause.place}".rstrip() for cause in diagnosis.which],
    }


def main(
    *,
    seconds: Sequence[float] = (30.0, 60.0, 120.0, 600.0),
    joints: Sequence[int] = (7,),
    out: Path | None = None,
) -> None:
    """Diagnose logs of so many seconds of so many joints; figures are kept in the folder `out`."""
    print(machine())
    rows = []
    cases = {f"{s:g} s, {n} joints": (s, n) for n in joints for s in seconds}
    for name, measured in results(measure, cases, out, fresh=True):
        stages = sorted(measured["stages_s"].items(), key=lambda item: -item[1])
        rows.append(
            (
                name, measured["samples"], f"{measured['diagnosis_s']:.1f}", f"{measured['cpu_s']:.1f}",
                f"{measured['peak_mb']:.0f}", f"{measured['peak_before_mb']:.0f}", measured["status"], ", ".join(measured["findings"]),
                ", ".join(f"{stage} {spent:.1f}" for stage, spent in stages[:5]),
            )
        )  # fmt: skip
    heads = (
        "log",
        "samples",
        "s",
        "CPU s",
        "peak MB",
        "MB before",
        "status",
        "names",
        "longest stages [s]",
    )
    table(heads, rows)


if __name__ == "__main__":
    command(main)
