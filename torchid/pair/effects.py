"""Which effects one of both has more of, the simulator or the arm.

The first question is what the simulator's log has beside the robot's file: with that the model is
the simulator. The second is what is new in the arm's log beside the simulator's, both fitted as one
problem (`torchid.gap.causes.earlier`): more of an effect, less of it, or one that only the arm has.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import torch
from msgspec import structs

from torchid.effects.registry import nominal_effects
from torchid.gap.causes.earlier import BOTH
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.settings import GapSettings
from torchid.gap.torque import STAGES, diagnose_torque
from torchid.log.model import Log
from torchid.pair.record import OneSided, Side
from torchid.parallel.pace import Pace
from torchid.results.cause import LINK, Cause
from torchid.results.words import PAYLOAD
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot

NOTHING = 0.15
"""Share of one side's coefficient below which the other one has none."""

Progress = Callable[[str, int, int], None]


def effects_of(
    robot: Robot, simulated: Log, real: Log, settings: GapSettings, say: Progress
) -> tuple[tuple[OneSided, ...], tuple[Cause, ...], tuple[TorqueDiagnosis, TorqueDiagnosis]]:
    """Effects that one of both has more of, most of the gap first; what the file lacks of both; and
    the diagnoses of the simulator's log and of the arm's."""

    def of(name: str) -> Pace:
        return Pace(lambda stage, done, total: say(f"{name}: {stage}", done, total), STAGES)

    first = diagnose_torque(robot, simulated, settings=settings, pace=of("simulator"))
    second = diagnose_torque(
        _with_its_load(first.corrected), real, settings=settings, pace=of("arm"), before=simulated
    )
    new = [_torque_sided(cause, second) for cause in second.causes if cause.when != BOTH]
    differs = {(one.effect, one.at) for one in new}
    both = [c for c in (*first.causes, *second.causes) if (c.effect, c.at) not in differs]
    return tuple(sorted(new, key=lambda one: -one.share)), tuple(both), (first, second)


def _with_its_load(robot: Robot) -> Robot:
    """The robot whose last link holds what it carries, so that less of it can be found, too."""
    pi = robot.require_parameters("a pair").pi.clone()
    others = []
    for effect, values in nominal_effects(robot):
        if effect.name == PAYLOAD:
            pi[-1] += torch.tensor(values, dtype=torch.float64)
        else:
            others.append(effect.record(values))
    return replace(robot.with_parameters(InertialParameters(pi)), effects=tuple(others))


def _torque_sided(cause: Cause, diagnosis: TorqueDiagnosis) -> OneSided:
    """A cause that is new in the arm's log, with what the simulator has of it, none where that is
    not said."""
    simulator = {size.name: size.was or 0.0 for size in cause.sizes}
    had, has = (
        max(map(abs, values), default=0.0)
        for values in (simulator.values(), [size.value for size in cause.sizes])
    )
    if cause.effect == LINK:
        of = list(cause.at) or slice(None)
        masses = (
            r.require_parameters("a pair").mass for r in (diagnosis.robot, diagnosis.corrected)
        )
        had, has = (float(mass[of].sum()) for mass in masses)
    return one_sided(cause, simulator, had, has)


def one_sided(
    cause: Cause, simulator: Mapping[str, float], had: float, has: float, **more: object
) -> OneSided:
    """A cause with what the simulator has of it, and how large it is there and on the arm."""
    side: Side = "arm" if has >= had else "simulator"
    only = min(had, has) < NOTHING * max(had, has)
    fields = structs.asdict(cause) | {"file": dict(simulator), **more}
    return OneSided(**fields, more=side, only=only)
