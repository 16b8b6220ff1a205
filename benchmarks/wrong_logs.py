"""Wrong logs that `gap` must not explain away: stopped, said in the first line, or missed.

    python benchmarks/wrong_logs.py DATA [NUMBER ...]

DATA is the folder of benchmarks/real_logs.py. Twenty-one mistakes are made in real logs: columns
exchanged, signs, units, a clock in milliseconds, a run with a load among runs without, a channel
that lags, samples that are missing. Only the checks before a diagnosis are made: where they raise,
the diagnosis is stopped; what they doubt begins its headline.
"""

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path

import torch
from log_faults import moved, scaled, shifted
from real_logs import UR10E_GAINS

from torchid.doctor.first import WrongLogError, ask_first
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.robot.library import load_robot

MOTION = ("q", "dq", "ddq")
DEGREES = 180 / math.pi
UR10E = ("ur10e", "log_est_30s_12harm", "log_exc_20s_8harm")
LOADED = "log_loaded_2p6kg_jan13"
Change = Callable[[Log], Log]


def exchanged(signals: tuple[str, ...], i: int, j: int) -> Change:
    """Columns of two joints, from 1."""

    def change(log: Log) -> Log:
        order = list(range(log.n))
        order[i - 1], order[j - 1] = j - 1, i - 1
        return moved(log, signals, order)

    return change


def negated(signals: tuple[str, ...], *joints: int) -> Change:
    """Columns of some joints, from 1; of all where none is said."""

    def change(log: Log) -> Log:
        sign = [-1.0 if not joints or k + 1 in joints else 1.0 for k in range(log.n)]
        return scaled(log, signals, torch.tensor(sign, dtype=torch.float64))

    return change


def late(joint: int, seconds: float) -> Change:
    """The torque of one joint, from 1."""

    def change(log: Log) -> Log:
        tau = shifted(log, ("tau",), seconds).tau
        assert tau is not None
        assert log.tau is not None
        mixed = log.tau.clone()
        mixed[:, joint - 1] = tau[:, joint - 1]
        return log.replace(tau=mixed)

    return change


def without_samples(log: Log) -> Log:
    """A burst of half a second is lost in every five."""
    keep = torch.ones(log.samples, dtype=torch.bool)
    for rows in log.slices():
        t = log.t[rows] - log.t[rows][0]
        keep[rows] = t % 5.0 < 4.5
    return log.select(keep)


CASES: tuple[tuple[str, tuple[str, ...], Change], ...] = (
    ("torque columns 2 and 3 exchanged", UR10E, exchanged(("tau",), 2, 3)),
    ("torque columns 5 and 6 exchanged", UR10E, exchanged(("tau",), 5, 6)),
    ("torque columns 1 and 2 exchanged", ("kuka_kr300", "log_A_ident"), exchanged(("tau",), 1, 2)),
    ("position columns 2 and 3 exchanged", UR10E, exchanged(MOTION, 2, 3)),
    ("position columns 4 and 5 exchanged", ("xmate7p", "log_traj1", "log_traj2"),
     exchanged(MOTION, 4, 5)),
    ("position columns 1 and 6 exchanged", ("ur10_unisa", "log_exciting"), exchanged(MOTION, 1, 6)),
    ("torque negated", UR10E, negated(("tau",))),
    ("torque negated", ("panda_gaz", "log_exciting_traj1"), negated(("tau",))),
    ("torque of joint 2 negated", UR10E, negated(("tau",), 2)),
    ("torque of joint 6 negated", ("xmate7p", "log_traj1", "log_traj2"), negated(("tau",), 6)),
    ("position of joint 3 negated", UR10E, negated(MOTION, 3)),
    ("position and torque of joint 2 negated", ("panda_unisa", "log_exciting"),
     negated((*MOTION, "tau"), 2)),
    ("position in mm", ("emps", "log_train"), lambda log: scaled(log, MOTION, 1000.0)),
    ("position in degrees, velocity in rad/s", UR10E, lambda log: scaled(log, ("q",), DEGREES)),
    ("position and velocity in degrees", ("kuka_kr300", "log_A_ident"),
     lambda log: scaled(log, MOTION, DEGREES)),
    ("time in ms", UR10E, lambda log: log.replace(t=log.t * 1000.0)),
    ("a run with 2.6 kg among others", (*UR10E, LOADED), lambda log: log),
    ("a run with 2.6 kg beside one", ("ur10e", "log_unloaded_dec23", LOADED), lambda log: log),
    ("torque of joint 2 late by 60 ms", UR10E, late(2, 0.06)),
    ("torque late by 60 ms", UR10E, lambda log: shifted(log, ("tau",), 0.06)),
    ("half a second in five missing", UR10E, without_samples),
)  # fmt: skip
"""What is wrong, the arm and its logs, and how it is made."""


def verdict(data: Path, files: tuple[str, ...], change: Change) -> tuple[str, str]:
    """Stopped, said or missed, and what is said."""
    folder, *names = files
    robot = load_robot(str(next((data / folder).glob("[rk]*.*[fl]"))))
    logs = [read_log(data / folder / f"{name}.parquet") for name in names]
    gains = torch.tensor(UR10E_GAINS, dtype=torch.float64)
    logs = [log if log.tau is not None else log.with_torque(gains) for log in logs]
    try:
        doubts = ask_first(robot, change(Log.concatenate(logs)))
    except WrongLogError as stop:
        return "stopped", str(stop.problem).partition("wrong: ")[2]
    return ("said", doubts.short) if doubts.short else ("MISSED", "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("numbers", type=int, nargs="*", help="of cases, from 1; all by default")
    given = parser.parse_args()
    torch.set_num_threads(1)
    counts: dict[str, int] = {}
    for number, (name, files, change) in enumerate(CASES, 1):
        if given.numbers and number not in given.numbers:
            continue
        begin = time.perf_counter()
        word, said = verdict(given.data, files, change)
        counts[word] = counts.get(word, 0) + 1
        took = time.perf_counter() - begin
        print(f"{number:2} {word:8} {files[0]:12} {name}: {said} ({took:.1f} s)", flush=True)
    print(", ".join(f"{count} {word}" for word, count in counts.items()))


if __name__ == "__main__":
    main()
