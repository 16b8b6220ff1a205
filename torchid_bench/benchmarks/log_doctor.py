"""How often the log doctor finds a fault that was planted in a log, and what it does to clean ones.

    python -m torchid_bench.benchmarks.log_doctor FOLDER [--seeds N] [--only WORD,WORD]
    python -m torchid_bench.benchmarks.log_doctor --arms 3r,kuka_lwr4,ur10e,panda [--seeds N] [--only WORD,WORD]

FOLDER is of real logs, one folder an arm with robot.yaml or robot.urdf and log*.parquet; else logs are
made, N an arm with plain friction and N with that of gears. `--only none`: clean ones alone.
"""

import itertools
import time
import zlib
from collections import Counter
from pathlib import Path

import numpy as np
import torch

from torchid.doctor.check import Check
from torchid.doctor.examine import Examination, examine
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid_bench.benchmarks.log_clean import clean
from torchid_bench.benchmarks.log_faults import FAULTS, Fault
from torchid_bench.benchmarks.real_logs import UR10E_GAINS
from torchid_bench.benchmarks.runner import command, table

LEFT_OUT = ("jointwise", "5periods")
"""Logs of single joints, and one whose time axis is known to be wrong."""


def of_folder(folder: Path) -> dict[str, tuple[Robot, Log]]:
    """The arms' logs with torques, by name."""
    logs = {}
    for path in sorted(folder.glob("*/*.parquet")):
        if any(word in path.stem for word in LEFT_OUT):
            continue
        robot = load_robot(next(path.parent.glob("robot.*")))
        log = read_log(path)
        if log.tau is None:
            # Without the currents: a fault is planted in the torque alone.
            log = log.with_torque(torch.tensor(UR10E_GAINS)).replace(current=None)
        logs[f"{path.parent.name}/{path.stem}"] = robot, log
    return logs


def made(arms: tuple[str, ...], seeds: int) -> dict[str, tuple[Robot, Log]]:
    """Clean logs of built-in arms, every second one described with nominal parameters."""
    logs = {}
    for name in arms:
        for seed in range(seeds):
            for gears in (False, True):
                nominal = (seed + gears) % 2 == 1
                robot, log = clean(name, seed, nominal=nominal, gears=gears)
                logs[str(log.source)] = robot, log
    return logs


def main(
    folder: Path | None = None,
    *,
    arms: tuple[str, ...] = (),
    seeds: int = 1,
    only: tuple[str, ...] = ("",),
    logs: str = "",
) -> int | None:
    """Clean logs (those whose name holds `logs`), and faults whose names hold one of the words."""
    if (folder is None) == (not arms):
        print("give either FOLDER or --arms")
        return 2
    every = made(arms, seeds) if folder is None else of_folder(folder)
    chosen = {k: v for k, v in every.items() if logs in k}
    lags, rows = _clean_ones(chosen), []
    for fault, plant in FAULTS.items():
        if any(word in fault for word in only):
            rows += _planted_ones(fault, plant, chosen, lags, 1 if arms else seeds)
    said = ("fault", "planted", "found", "another said, too")
    table((*said, "log mended", "undecided", "made worse"), rows)
    return None


def _clean_ones(logs: dict[str, tuple[Robot, Log]]) -> dict[str, float]:
    """A line for each log, and how late its torque is as it stands [s]."""
    alarms, start, lags = 0, time.process_time(), {}
    for name, (robot, log) in logs.items():
        result = examine(robot, log)
        lags[name] = next((c.estimate or 0.0 for c in result.checks if c.name == "lag"), 0.0)
        said = [f"{c.name} ({c.verdict})" for c in _alarms(result)]
        alarms += bool(said)
        print(f"clean {name}: {', '.join(said) or 'silent'}", flush=True)
    took = (time.process_time() - start) / max(1, len(logs))
    print(f"clean logs with an alarm: {alarms} of {len(logs)}, {took:.1f} s of CPU a log\n")
    return lags


def _planted_ones(
    fault: str,
    plant: Fault,
    logs: dict[str, tuple[Robot, Log]],
    lags: dict[str, float],
    seeds: int,
) -> list[tuple[object, ...]]:
    """The row of the table, where the fault can be; printed is what was not found or was said
    besides."""
    hits, others, mended = [], [], Counter()
    for (name, (robot, log)), seed in itertools.product(logs.items(), range(seeds)):
        planted = plant(robot, log, np.random.default_rng([seed, zlib.crc32(name.encode())]))
        if planted is None:
            continue
        if "lag" in planted.names:
            planted = planted.on_top_of(lags[name])
        result = examine(planted.robot, planted.log)
        hits.append(planted.found(result.checks))
        others.append(
            any(c.name not in planted.names and not planted.chooses(c) for c in _alarms(result))
        )
        outcome = _outcome(log, result)
        mended[outcome] += 1
        if others[-1] or not hits[-1] or outcome == "worse":
            said = [f"{c.name} {[k + 1 for k in c.joints]} {c.estimate}" for c in _alarms(result)]
            joints = [k + 1 for k in planted.joints or ()]
            word = "found" if hits[-1] else "MISSED"
            said = f"{'; '.join(said) or 'silent'} ({outcome})"
            print(f"{fault}: {word} {name} {joints}: {said}", flush=True)
    outcomes = [mended[name] for name in ("mended", "undecided", "worse")]
    return [(fault, len(hits), sum(hits), sum(others), *outcomes)] if hits else []


def _outcome(clean: Log, result: Examination) -> str:
    """What the repairs that are applied make of a log: mended where each column is within 30 % of
    the clean one's (of its spread, at the same time), worse where they leave one that is not."""
    if not result.repairs:
        left = any(c.choices and c.chosen is None for c in result.checks)
        return "undecided" if left else "untouched"
    made = result.mended()
    for signal, own in made.signals.items():
        if signal not in clean.signals:
            continue
        for was, now in zip(clean.signals[signal].T.numpy(), own.T.numpy(), strict=True):
            left = now - np.interp(made.t.numpy(), clean.t.numpy(), was)
            if np.median(np.abs(left - np.median(left))) > 0.3 * max(was.std(), 1e-6):
                return "undecided" if result.undecided else "worse"
    return "mended"


def _alarms(result: Examination) -> list[Check]:
    return [c for c in result.checks if c.verdict in ("wrong", "doubtful")]


if __name__ == "__main__":
    command(main)
