"""Cases of the gap benchmark: what is planted in which arm, and the logs of it.

A case is a function of its id and the seed alone. Arms are simulated under control, many at once;
their true motions are kept in files, so that a changed diagnosis needs no new simulation.
"""

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gap_plant import (
    DURATION,
    NEEDS_FRICTION,
    NEEDS_SMOOTH,
    PAUSE,
    Planted,
    Scene,
    generator,
    on_clock,
    pick,
    plant,
    record_of,
    scene,
)

from torchid.effects.base import JointEffect
from torchid.effects.registry import KINDS, Valued
from torchid.effects.variation import OneJointEffect
from torchid.errors import TorchidError
from torchid.log.model import Log
from torchid.simulation.closed_loop import closed_loop
from torchid.simulation.sensors import ENCODER_STEP, HonestNoise, Sensors, measured_log

ROBOTS = ("3r", "kuka_lwr4", "3r_friction", "kuka_lwr4_friction")
SMOOTH, RUBBING = ROBOTS[:2], ROBOTS[2:]
COLOUR = 5.0
"""Cut-off of coloured torque noise [Hz]."""

SIZE = 5.0
"""Of what is planted, in standard deviations of the torque noise."""

LEVELS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
GRADED = (
    "coulomb_friction",
    "viscous_friction",
    "stribeck_friction",
    "torque_offset",
    "joint_elasticity",
    "cogging",
)
COLLINEAR = (
    ("coulomb_friction", "viscous_friction"),
    ("coulomb_friction", "stribeck_friction"),
    ("viscous_friction", "rotor_inertia"),
    ("torque_offset", "joint_spring"),
    ("coulomb_friction", "load_dependent_friction"),
    ("viscous_friction", "power_law_friction"),
    ("coulomb_friction", "presliding_hysteresis"),
    ("torque_gain", "joint_spring"),
    ("time_delay", "viscous_friction"),
    ("encoder_offset", "torque_offset"),
)
SUITES = ("none", "single", "pairs", "triples", "leave_one_out", "severity", "closing")
SIMULATED_AS = {"leave_one_out": "single", "closing": "single"}
"""Suites that diagnose another one's logs."""

LONGEST_STEP = 1e-3
"""Of the integration [s]. With 2 ms, an implicit step of the LWR's last joint adds Fv h / 2 = 6e-5
kg m^2 to its inertia, and the diagnosis names it."""

ARMS = 64
"""Simulated together."""

RECIPE = 5
"""Counts up when cases of the same id change, so that simulated ones are not mixed."""


@dataclass(frozen=True)
class Case:
    """What is asked.

    Attributes:
        suite, label, number: of the case; the label is the effect, pair or level.
        robot: name of the nominal model.
        names: effects planted.
        size: of each, in standard deviations of the torque noise.
        same_joint: whether all are on one joint.
        colour_hz: of the torque noise; None for white.
        repeats: whether a trajectory is repeated.
        seed: of the benchmark.
    """

    suite: str
    label: str
    number: int
    robot: str
    names: tuple[str, ...]
    size: float
    same_joint: bool
    colour_hz: float | None
    repeats: bool
    seed: int

    @property
    def id(self) -> str:
        return "/".join(
            x for x in (self._family(self.suite), self.label, f"{self.number:03d}") if x
        )

    @property
    def arm(self) -> str:
        """Of the simulation: suites that share it have the same."""
        own = self._family(SIMULATED_AS.get(self.suite, self.suite))
        return "/".join(
            x for x in (f"seed-{self.seed}", own, self.label, f"{self.number:03d}") if x
        )

    @property
    def key(self) -> str:
        """What its random numbers depend on; cases of different size share them."""
        suite = SIMULATED_AS.get(self.suite, self.suite)
        label = self.names[0] if suite == "severity" else self.label
        return f"{self.seed}/{suite}/{label}/{self.number}"

    def _family(self, suite: str) -> str:
        return suite if self.repeats else f"{suite}-no-repeats"


def cases(
    suite: str, count: int, seed: int, effects: Sequence[str] | None, repeats: bool
) -> Iterator[Case]:
    """The first cases of a suite.

    Args:
        suite: which.
        count: cases an effect, a level and effect, or in all (none, pairs, triples).
        seed: of the benchmark.
        effects: for suites with one effect a case; None for all of them.
        repeats: whether logs hold repeats.
    """
    for number in range(count):
        if suite == "none":
            yield _case(suite, "", number, (), 0.0, seed, repeats)
        elif suite in ("pairs", "triples"):
            names, same = _several(suite, number, seed)
            yield _case(suite, "", number, names, SIZE, seed, repeats, same)
        else:
            graded = suite == "severity"
            for name in GRADED if graded else KINDS:
                if effects is not None and name not in effects:
                    continue
                for level in LEVELS if graded else (SIZE,):
                    label = f"{name}-{level:g}" if graded else name
                    yield _case(suite, label, number, (name,), level, seed, repeats)


def _case(
    suite: str,
    label: str,
    number: int,
    names: tuple[str, ...],
    size: float,
    seed: int,
    repeats: bool,
    same_joint: bool = False,
) -> Case:
    """Robots and colours take turns, each effect beginning with another one."""
    turn = number + (zlib.crc32(names[0].encode()) if len(names) == 1 else 0)
    rubbing = suite == "triples" or any(name in NEEDS_FRICTION for name in names)
    smooth = any(name in NEEDS_SMOOTH for name in names)
    robots = RUBBING if rubbing else SMOOTH if smooth else ROBOTS
    robot = robots[turn % len(robots)]
    coloured = (turn + turn // len(robots)) % 2 == 1
    colour = COLOUR if coloured else None
    return Case(suite, label, number, robot, names, size, same_joint, colour, repeats, seed)


def _several(suite: str, number: int, seed: int) -> tuple[tuple[str, ...], bool]:
    """Effects of a pair or triple: collinear pairs on one joint and random ones take turns."""
    if suite == "pairs" and number % 2 == 0:
        return COLLINEAR[number // 2 % len(COLLINEAR)], True
    g = generator("names", seed, suite, number)
    names: list[str] = []
    # A payload is the same as the last link's parameters.
    known = [name for name in KINDS if name != "payload"]
    while len(names) < (2 if suite == "pairs" else 3):
        name = known[pick(g, len(known))]
        if name not in names and _go_together([name, *names], suite == "triples"):
            names.append(name)
    return tuple(names), pick(g, 2) == 0


def _go_together(names: Sequence[str], rubbing: bool) -> bool:
    """Effects that need a smooth torque are not planted beside dry friction."""
    dry = rubbing or any(KINDS[name].jumps for name in names if name not in NEEDS_SMOOTH)
    return not (dry and any(name in NEEDS_SMOOTH for name in names))


@dataclass(frozen=True, eq=False)
class Arm:
    """A case with its effects drawn.

    Attributes:
        case: which.
        scene: nominal model, references, noise.
        planted: effects.
    """

    case: Case
    scene: Scene
    planted: tuple[Planted, ...]

    @property
    def effects(self) -> list[Valued]:
        return [p.valued for p in self.planted]


def drawn(case: Case) -> Arm:
    """The case's arm; the same whenever it is drawn."""
    place = scene(case.robot, case.key, case.repeats)
    joint = pick(generator("joint", case.key), place.robot.n) if case.same_joint else None
    planted = tuple(
        plant(place, name, case.size, generator("effect", case.key, name), joint, SIZE)
        for name in case.names
    )
    return Arm(case, place, planted)


def fresh_scene(arm: Arm) -> Scene:
    """Four other trajectories of the same arm, later on its clock."""
    return scene(
        arm.case.robot,
        f"{arm.case.key}/fresh",
        False,
        first=len(arm.scene.starts) * (DURATION + PAUSE),
    )


def truth(arm: Arm) -> list[dict[str, Any]]:
    """What is planted, for a file; joints from 1."""
    out = []
    for p in arm.planted:
        out.append(
            {
                "name": p.effect.name,
                "family": p.effect.family,
                "place": place_of(p.effect),
                "joints": [j + 1 for j in p.joints],
                "size": p.size,
                "record": record_of(p.valued),
            }
        )
    return out


def place_of(effect: Any) -> list[int]:
    """Joints, from 1, that say where an effect is; none for the whole arm."""
    located = isinstance(effect, JointEffect | OneJointEffect)
    return sorted(j + 1 for j in effect.joints) if located else []


def files_of(case: Case, work: Path, fresh: bool) -> Path:
    name = f"recipe-{RECIPE}/{case.arm}{'-fresh' if fresh else ''}.npz"
    return work / name


def simulate(some: Sequence[Case], work: Path, fresh: bool = False) -> dict[str, str]:
    """Simulate cases whose motions are not on file yet; {id: error} of those that cannot be.

    Args:
        some: of one robot's kinematics each; arms of the same robot go together.
        work: folder of the files.
        fresh: the later trajectories instead of those that are diagnosed.
    """
    errors: dict[str, str] = {}
    for robot in dict.fromkeys(c.robot for c in some):
        arms: list[tuple[Arm, Scene]] = []
        for case in some:
            if case.robot != robot or files_of(case, work, fresh).exists():
                continue
            try:
                arm = drawn(case)
            except ValueError as error:
                errors[case.id] = str(error)
                continue
            arms.append((arm, fresh_scene(arm) if fresh else arm.scene))
        for start in range(0, len(arms), max(1, ARMS // 4)):
            errors |= _simulated(arms[start : start + ARMS // 4], work, fresh)
    return errors


def _simulated(arms: Sequence[tuple[Arm, Scene]], work: Path, fresh: bool) -> dict[str, str]:
    references = [log for _, place in arms for log in place.references]
    effects = [on_clock(arm.effects, start) for arm, place in arms for start in place.starts]
    try:
        logs = closed_loop(arms[0][1].robot, references, effects, longest_step=LONGEST_STEP)
    except TorchidError as error:
        if len(arms) == 1:
            return {arms[0][0].case.id: f"simulation: {error}"}
        # One that runs away must not take the others with it.
        found: dict[str, str] = {}
        for one in arms:
            found |= _simulated([one], work, fresh)
        return found
    first = 0
    for arm, place in arms:
        own = logs[first : first + len(place.references)]
        first += len(place.references)
        _write(files_of(arm.case, work, fresh), own)
    return {}


def _write(path: Path, logs: Sequence[Log]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    signals = {
        f"{name}{k}": getattr(log, name).numpy()
        for k, log in enumerate(logs)
        for name in ("t", "q", "dq", "ddq", "tau")
    }
    partial = path.with_suffix(".partial.npz")
    np.savez(partial, **signals)
    partial.replace(path)


def true_logs(case: Case, work: Path, fresh: bool = False) -> list[Log]:
    """True motion and torque of every trajectory."""
    with np.load(files_of(case, work, fresh)) as data:
        count = sum(1 for name in data.files if name.startswith("tau"))
        return [
            Log(
                *(torch.from_numpy(data[f"{name}{k}"]) for name in ("t", "q", "dq", "ddq", "tau")),
                names=(f"trajectory {k + 1}",),
            )
            for k in range(count)
        ]


def measured(arm: Arm, work: Path) -> Log:
    """What sensors and logger make of the arm's motions: all that the diagnosis sees."""
    robot = arm.scene.robot
    own = any("velocity" in KINDS[name].needs for name in arm.case.names)
    noise = HonestNoise(
        colour_hz=arm.case.colour_hz,
        include_velocity=own,
        velocity_relative=1e-3 if own else 0.0,
    )
    sensors = Sensors(noise, torque_std=tuple(arm.scene.noise.tolist()))
    logs = true_logs(arm.case, work)
    parts = []
    for k, (log, start) in enumerate(zip(logs, arm.scene.starts, strict=True)):
        seed = int(torch.randint(2**31, (1,), generator=generator("noise", arm.case.key, k)))
        # No arm repeats a motion to a fraction of an encoder's count; a simulated one would, and
        # quantisation would then cancel in the difference of repeats.
        phase = torch.rand(robot.n, generator=generator("phase", arm.case.key, k)).double()
        moved = log.replace(q=log.q + (phase - 0.5) * ENCODER_STEP)
        parts.append(measured_log(robot, moved, on_clock(arm.effects, start), sensors, seed))
    return Log.concatenate(parts).replace(source=arm.case.id)
