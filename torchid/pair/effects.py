"""Which effects one of both has more of, the simulator or the arm."""

import math
from collections.abc import Callable
from dataclasses import replace

import torch

from torchid.design.columns import Columns, Model
from torchid.design.segments import moving_samples, reach_of
from torchid.effects.base import Effect
from torchid.effects.registry import nominal_effects
from torchid.gap.data import prepare
from torchid.gap.describe.model import PAYLOAD
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.settings import GapSettings
from torchid.gap.told import valued
from torchid.gap.torque import STAGES, diagnose_torque
from torchid.log.model import Log
from torchid.pair.record import OneSided, Side
from torchid.parallel.pace import Pace
from torchid.results.cause import LINK, Cause
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot

NOTHING = 0.15
"""Share of one side's coefficient below which the other one has none."""

CLEAN = 100.0
"""Dry friction over the noise of a simulator's log: how far from reversals it is looked at."""

Progress = Callable[[str, int, int], None]


def effects_of(
    robot: Robot, simulated: Log, real: Log, settings: GapSettings, say: Progress
) -> tuple[tuple[OneSided, ...], tuple[TorqueDiagnosis | None, TorqueDiagnosis]]:
    """Effects that one of both has more of."""

    def of(name: str) -> Pace:
        return Pace(lambda stage, done, total: say(f"{name}: {stage}", done, total), STAGES)

    # What the simulator does beside the model; with that the model is the simulator.
    first, simulator = None, robot
    if not _as_model(robot, simulated, settings):
        first = diagnose_torque(robot, simulated, settings=settings, pace=of("simulator"))
        simulator = _with_its_load(first.corrected)
    second = diagnose_torque(simulator, real, settings=settings, pace=of("arm"))
    rows = [
        _bodies(c, second) if c.effect == LINK else _one_sided(c, second) for c in second.causes
    ]
    return tuple(sorted(rows, key=lambda x: -x.share)), (first, second)


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


def _as_model(robot: Robot, simulated: Log, settings: GapSettings) -> bool:
    """Whether the simulator's torque is the model's, but for less than is worth a name."""
    if robot.parameters is None:
        return False
    data = prepare(robot, simulated, None if settings.cutoff == "auto" else settings.cutoff)
    columns = Columns(Model.of(robot), data.samples)
    torque = data.samples.of([s.tau.T for s in data.segments])
    # Only where joints surely slide: of one that friction holds no law says the torque.
    never = torch.full((robot.n,), CLEAN, dtype=torch.float64)
    sliding = moving_samples(data.samples, reach_of(data.samples, never))
    left, whole = ((x.square() * sliding).sum(1) for x in (columns.gap, torque))
    return bool((left <= settings.worthwhile_torque**2 * whole)[data.slides].all())


def _one_sided(found: Cause, diagnosis: TorqueDiagnosis) -> OneSided:
    """A cause on the arm beside the simulator as what either has of it."""
    effect, _ = valued(found, diagnosis.robot)
    before, after = (_values(r, effect) for r in (diagnosis.robot, diagnosis.corrected))
    had, has = max(map(abs, before)), max(map(abs, after))
    less, more = sorted((had, has))
    return OneSided(
        effect=found.effect,
        joints=found.joints,
        more="arm" if has > had else "simulator",
        only=less < NOTHING * more,
        simulator=dict(zip(found.std, before, strict=True)),
        arm=dict(zip(found.std, after, strict=True)),
        std={name: math.nan if x is None else x for name, x in found.std.items()},
        unit={name: found.unit[name] for name in found.std},
        share=found.share,
        how_sure=found.how_sure,
        ambiguous_with=found.ambiguous_with,
    )


def _values(robot: Robot, effect: Effect) -> list[float]:
    """Coefficients that a robot has of an effect, whatever its shape; zeros of none."""
    total = [0.0] * len(effect.coefficients)
    for other, values in nominal_effects(robot):
        if other.identity == effect.identity:
            total = [a + b for a, b in zip(total, values, strict=True)]
    return total


def _bodies(found: Cause, diagnosis: TorqueDiagnosis) -> OneSided:
    """Links whose inertial parameters differ, by their masses."""
    of = found.at or tuple(range(diagnosis.robot.n))
    sides = [r.require_parameters("a pair").mass for r in (diagnosis.robot, diagnosis.corrected)]
    simulator, arm = ({f"m{k + 1}": float(m[k]) for k in of} for m in sides)
    side: Side = "arm" if sum(arm.values()) >= sum(simulator.values()) else "simulator"
    return OneSided(
        effect=LINK,
        joints=found.at,
        more=side,
        only=False,
        simulator=simulator,
        arm=arm,
        std={},
        unit=dict.fromkeys(arm, "kg"),
        share=found.share,
        how_sure=found.how_sure,
        ambiguous_with=found.ambiguous_with,
    )
