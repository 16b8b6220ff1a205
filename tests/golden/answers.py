"""Answers to twelve small logs, to be held against those of another version of the code.

    python -m tests.golden.answers [--write] [NAME ...]

Each answer is the JSON of a whole call (seven diagnoses of torque, three of commands and positions,
a pair, a fleet) without times and paths. It is held against `answers/NAME.json`: names, statuses
and words must be the same, numbers too, up to rounding. A difference is printed as `path: was ->
is`, and the exit code is 1. `--write` stores the answers of today.

Code that is moved leaves every answer `the same`. Code that changes an answer comes with the
changed files, whose diff says what has changed.
"""

import argparse
import json
import math
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

import torchid
from tests.documents import ROOT
from tests.fleet.simulated import Plan, make
from tests.gap.small_logs import ONCE, REPEATED, ROBOT, Recording, arm, carrying, friction, logged
from tests.position.planted import planted, true_servos
from torchid.json_data import plain
from torchid.robot.library import load_robot

STORED = Path(__file__).parent / "answers"

MADE = ROOT / "build" / "golden"
"""Where the answers of today are written."""

WITHOUT = (
    "seconds", "version", "source", "robot", "model", "corrected", "covariance", "information",
    "meaning", "remedy", "command", "files", "folder", "log", "logs", "path",
)  # fmt: skip
"""Keys left out: times, paths, robots and what the library says of an effect."""

DIGITS = 12
"""Significant digits that are stored."""

ROUNDING = 1e-9
"""Relative difference of two numbers below which they count as the same on one machine."""

TOLERANCE = 1e-3
"""The same between machines: kernels round differently, and searches for shapes end there."""

WITHIN = 1e-9
"""Numbers below this are zero, in whatever unit."""

SHORT = partial(Recording, duration=6.0)


def _gap(robot: Any, log: Any, **options: Any) -> dict[str, Any]:
    settings = torchid.GapSettings(**options.pop("settings", {}))
    return torchid.diagnose(robot, log, settings=settings, **options).plain()


def _friction_and_load() -> dict[str, Any]:
    """Two causes: friction of joint 2, and a body on the last link."""
    real = arm(friction(2, Fc=0.6), robot=carrying(0.4, (0.1, 0.0, 0.05), 2e-3))
    return _gap(ROBOT, logged(real, SHORT(REPEATED)))


def _base_parameters() -> dict[str, Any]:
    """A robot without parameters: base parameters and viscous friction are fitted first."""
    bare = replace(ROBOT, parameters=None)
    log = logged(arm(friction(2, Fc=0.6), friction(1, Fv=0.4)), Recording(REPEATED))
    return _gap(bare, log, settings={"background": ("viscous_friction",)})


def _held_out() -> dict[str, Any]:
    """Causes of two joints, judged on a motion of its own."""
    real = arm(
        {"effect": "rotor_inertia", "joint": 1, "Ia": 0.1},
        {"effect": "load_dependent_friction", "joint": 2, "mu": 0.06},
    )
    log, apart = logged(real, SHORT(ONCE)), logged(real, SHORT((5,), seed=3))
    return _gap(ROBOT, log, held_out=apart)


def _six_joints() -> dict[str, Any]:
    """The demonstration's arm: a load, friction and a spring, with the whole library."""
    from torchid.withheld.demo import write_files

    with tempfile.TemporaryDirectory() as folder:
        files = write_files(Path(folder), seed=3)
        robot, log = torchid.load_robot(str(files.robot)), torchid.read_log(list(files.logs))
        apart = torchid.read_log(files.new)
        return _gap(robot, log, held_out=apart)


def _servos(**extra: tuple[int, float]) -> dict[str, Any]:
    log = planted(true_servos(3, **extra), motions=3, seconds=12.0)
    return torchid.diagnose(ROBOT, log).plain()


def _pair() -> dict[str, Any]:
    """A simulator's log without the arm's friction."""
    few = torchid.GapSettings(effects=("coulomb_friction", "viscous_friction", "torque_offset"))
    simulated, real = (logged(a, SHORT(ONCE)) for a in (ROBOT, arm(friction(2, Fc=0.6))))
    return torchid.compare_pair(simulated, real, ROBOT, settings=few).plain()


def _fleet() -> dict[str, Any]:
    """Four units, of which one rubs more, identified together."""
    from torchid.fleet.identify import fleet_identify
    from torchid.fleet.model import FleetModel
    from torchid.fleet.settings import FleetSettings

    robot = load_robot("3r_friction")
    effects = ("viscous_friction", "coulomb_friction", "torque_offset")
    with tempfile.TemporaryDirectory() as folder:
        logs = make(robot, Plan(units=4, sessions=2, odd={2: ("Fv2", 0.3)}), Path(folder))
        return fleet_identify(FleetModel(robot, FleetSettings(effects=effects)), logs).plain()


ANSWERS: dict[str, Callable[[], dict[str, Any]]] = {
    "six_joints": _six_joints,
    "servo_dead_zone": partial(_servos, dead_zone=(2, 0.02)),
    "servo_profile": partial(_servos, acceleration=(2, 4.0)),
    "servo_plain": _servos,
    "friction_and_load": _friction_and_load,
    "held_out": _held_out,
    "base_parameters": _base_parameters,
    "no_gap": lambda: _gap(ROBOT, logged(ROBOT, SHORT(REPEATED))),
    "heavier": lambda: _gap(carrying(0.5, (0.1, 0.0, 0.0), 1e-3), logged(ROBOT, SHORT(ONCE))),
    "one_run": lambda: _gap(ROBOT, logged(arm(friction(3, Fc=0.3)), Recording((0,)))),
    "pair": _pair,
    "fleet": _fleet,
}
"""Name -> answer; the longest first, for two processes share them."""


def answer(name: str) -> dict[str, Any]:
    """As it is stored."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    return json.loads(json.dumps(_kept(plain(ANSWERS[name]()))))


def _kept(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _kept(item) for key, item in value.items() if key not in WITHOUT}
    if isinstance(value, list):
        return [_kept(item) for item in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def differences(was: Any, now: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Each `path: was -> is`, and by how much: relative, infinite where no number changed."""
    if isinstance(was, dict) and isinstance(now, dict):
        for key in {**was, **now}:
            yield from differences(was.get(key), now.get(key), f"{path}.{key}".lstrip("."))
    elif isinstance(was, list) and isinstance(now, list) and len(was) == len(now):
        for k, (one, other) in enumerate(zip(was, now, strict=True)):
            yield from differences(one, other, f"{path}[{k}]")
    elif was != now:
        by = math.inf
        if {type(was), type(now)} <= {int, float}:
            by = abs(was - now) / max(abs(was), abs(now), WITHIN)
        said = (json.dumps(x) for x in (was, now))
        yield f"{path}: " + " -> ".join(x if len(x) < 70 else f"{x[:67]}..." for x in said), by


def _told(name: str, tolerance: float) -> tuple[str, str, bool]:
    """Name, what is to be said of its answer, and whether it is another one than before."""
    begun = time.monotonic()
    now = answer(name)
    took = f"{time.monotonic() - begun:.0f} s"
    file = STORED / f"{name}.json"
    was = json.loads(file.read_text()) if file.exists() else {}
    MADE.mkdir(parents=True, exist_ok=True)
    (MADE / file.name).write_text(json.dumps(now, indent=1) + "\n")
    found = list(differences(was, now))
    most = max((by for _, by in found), default=0.0)
    if most <= ROUNDING:
        return name, f"{name}: the same ({took})", False
    if most <= tolerance:
        return name, f"{name}: the same up to {most:.0e} ({took})", False
    lines = [text for text, by in found if by > tolerance]
    rest = [f"and {len(lines) - 12} more"] if len(lines) > 12 else []
    return name, "\n  ".join([f"{name}: OTHER ({took})", *lines[:12], *rest]), True


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[*ANSWERS, []])
    parser.add_argument("--write", action="store_true", help="store the answers of today")
    parser.add_argument("--tolerance", type=float, default=TOLERANCE, help="relative, of a number")
    asked = parser.parse_args()
    STORED.mkdir(exist_ok=True)
    changed = 0
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        tell = partial(_told, tolerance=asked.tolerance)
        for name, said, other in pool.imap_unordered(tell, asked.names or list(ANSWERS)):
            print(said, flush=True)
            changed += other
            if asked.write:
                (MADE / f"{name}.json").replace(STORED / f"{name}.json")
    print(f"{changed} of {len(asked.names or ANSWERS)} answers are others than before")
    return int(changed > 0 and not asked.write)


if __name__ == "__main__":
    sys.exit(main())
