"""How often the log doctor finds a fault that was planted in a log, and what it does to clean ones.

python benchmarks/log_doctor.py FOLDER [--seeds N] [--only WORDS] (FOLDER: of real logs, one folder
an arm with robot.yaml or robot.urdf and log*.parquet)
python benchmarks/log_doctor.py --arms 3r,kuka_lwr4,ur10e,panda [--seeds N] [--only WORDS] (made
logs, N an arm with plain friction and N with that of gears; --only none: clean ones alone)
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from log_clean import clean
from log_faults import FAULTS

from torchid.doctor.examine import examine
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

UR10E_GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
"""[N m/A], for the logs that hold currents (Gaz et al., quoted beside the data)."""
LEFT_OUT = ("jointwise", "5periods")
"""Logs of single joints, and one whose time axis is known to be wrong."""


def logs(folder: Path) -> dict[str, tuple[Robot, Log]]:
    """The arms' logs with torques, by name."""
    found = {}
    for path in sorted(folder.glob("*/*.parquet")):
        if any(word in path.stem for word in LEFT_OUT):
            continue
        robot = load_robot(next(path.parent.glob("robot.*")))
        log = read_log(path)
        if log.tau is None:
            log = log.with_torque(torch.tensor(UR10E_GAINS))
        found[f"{path.parent.name}/{path.stem}"] = robot, log
    return found


def made(arms: str, seeds: int) -> dict[str, tuple[Robot, Log]]:
    """Clean logs of built-in arms, every second one described with nominal parameters."""
    found = {}
    for name in arms.split(","):
        for seed in range(seeds):
            for gears in (False, True):
                nominal = (seed + gears) % 2 == 1
                robot, log = clean(name, seed, nominal=nominal, gears=gears)
                found[str(log.source)] = robot, log
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--arms", default="")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--only", default="")
    parser.add_argument("--logs", default="")
    arguments = parser.parse_args()
    if (arguments.folder is None) == (arguments.arms == ""):
        parser.error("give either FOLDER or --arms")
    every = made(arguments.arms, arguments.seeds) if arguments.arms else logs(arguments.folder)
    found = {k: v for k, v in every.items() if arguments.logs in k}
    alarms = 0
    torch.set_num_threads(1)
    for name, (robot, log) in found.items():
        start = time.process_time()
        checks = examine(robot, log).checks
        said = [f"{c.name} ({c.verdict})" for c in checks if c.verdict in ("wrong", "doubtful")]
        alarms += bool(said)
        took = time.process_time() - start
        print(f"clean {name}: {', '.join(said) or 'silent'}, {took:.1f} s of CPU", flush=True)
    print(f"clean logs with an alarm: {alarms} of {len(found)}\n")
    for fault, plant in FAULTS.items():
        if arguments.only not in fault:
            continue
        hits, missed = [], []
        for name, (robot, log) in found.items():
            for seed in range(1 if arguments.arms else arguments.seeds):
                planted = plant(robot, log, np.random.default_rng(seed + len(name)))
                if planted is None:
                    continue
                result = examine(planted.robot, planted.log)
                hits.append(planted.found(result.checks))
                if not hits[-1]:
                    said = [
                        f"{c.name} {[k + 1 for k in c.joints]} {c.estimate}"
                        for c in result.checks
                        if c.verdict in ("wrong", "doubtful")
                    ]
                    joints = [k + 1 for k in planted.joints or ()]
                    missed.append(f"    {name} {joints}: {'; '.join(said) or 'silent'}")
        if hits:
            print(f"{fault:32s} {sum(hits):3d} of {len(hits):3d}", flush=True)
            print("\n".join(missed), flush=True) if missed else None


if __name__ == "__main__":
    main()
