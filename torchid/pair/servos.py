"""Servos of both sides: what commands and positions say where no torque is.

The first question is what the simulator's log has: with its servos the model is the simulator. The
second is what the arm's log has otherwise, each cause beside those servos. What is not named is the
simulator's on both sides, one nuisance of both logs, and each cause is then asked of both: absent,
as large in both, or new. Neither clock nor rate of one log touches the other.

Where both have one number, it is between the two that either log wants alone. Of two logs that lose
a and b with the other's number, both together lose no more than a b / (a + b): the parallel sum of
their curvatures (Anderson and Duffin 1969), which they reach where they are alike.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch

from torchid.effects.servo import INDEX, PARAMETERS, PER_KP, TORQUES, ServoParameter
from torchid.log.model import Log
from torchid.pair.effects import Progress, one_sided
from torchid.pair.record import OneSided, ServoDifference
from torchid.parallel.pace import Pace
from torchid.position.data import WINDOW_S
from torchid.position.diagnose import STAGES, diagnose_positions
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.effects import BY_NAME, KEPT
from torchid.position.evidence import LeastFall
from torchid.position.judge import value_interval
from torchid.position.model import ServoArm
from torchid.position.problem import MOST_WINDOWS, some_of
from torchid.position.record import PositionFinding
from torchid.position.servo_model import Motions, ServoModel
from torchid.results.cause import Cause
from torchid.robot.model import Robot
from torchid.simulation.servo_loop import body_near, windows_of
from torchid.statistics.criteria import LIKELY
from torchid.typing import Bool, Float, Tensor

LATE = INDEX["delay"]
DELAY = next(effect for effect in KEPT if "delay" in effect.parameters)
Sides = tuple[PositionDiagnosis, PositionDiagnosis]
"""The simulator's, and the arm's beside the simulator's servos."""


def servos_of(
    robot: Robot, simulated: Log, real: Log, say: Progress
) -> tuple[tuple[OneSided, ...], tuple[Cause, ...], Sides]:
    """Causes that one of both has more of, those that close most first; what the file lacks of
    both; and the diagnoses of the simulator's log and of the arm's.

    Raises:
        LogError: a log that `diagnose_positions` cannot use.
    """

    def of(name: str) -> Pace:
        return Pace(lambda stage, done, total: say(f"{name}: {stage}", done, total), STAGES)

    first = diagnose_positions(robot, simulated, trusted=True, pace=of("simulator"))
    arm = _simulator(first)
    # Rods stay what an arm without masses is taken for.
    arm = replace(arm, robot=robot) if robot.parameters is None else arm
    second = diagnose_positions(arm.robot, real, trusted=True, start=arm, pace=of("arm"))
    new = sorted(_new((first, second), arm), key=lambda one: -one.share)
    differs = {(one.effect, one.joints) for one in new}
    both = [c for c in first.answer.causes if (c.effect, c.joints) not in differs]
    return tuple(new), tuple(both), (first, second)


def _simulator(first: PositionDiagnosis) -> ServoArm:
    """The simulator's arm, whose commands come as late as they do before a log holds them."""
    arm = first.corrected
    joint = arm.servos.joint.clone()
    joint[:, LATE] = (joint[:, LATE] - 0.5 * first.data.held).clamp(min=0.0)
    servos = replace(arm.servos, joint=joint)
    return replace(arm, servos=servos, scale=torch.ones_like(arm.scale))


@dataclass(frozen=True, eq=False)
class _Side:
    """One log with a model in which all is the simulator's but what is named."""

    motions: Motions
    model: ServoModel

    @classmethod
    def of(cls, found: PositionDiagnosis, model: ServoModel) -> "_Side":
        """Of a diagnosis' motions. No row of a log tells when in a cycle commands come: delays are
        each log's own."""
        windows = some_of(windows_of(found.data.tracks, WINDOW_S), MOST_WINDOWS)
        motions = Motions(found.data, windows)
        model = model.freed(["delay"], motions.every)
        return cls(motions, model.fitted(motions, 8, plane=True))

    def losing(self, other: "_Side", cause: PositionFinding) -> tuple[float, float]:
        """Nats by which the log is less likely with the other side's numbers of a cause, all that
        is named besides fitted anew; and what a cause must be worth here."""
        motions, model = self.motions, self.model
        fall = LeastFall.beside(motions, model.servos)
        if cause.effect in BY_NAME and cause.joints:
            values = other.model.servos.joint.clone()
            values[:, LATE] += 0.5 * (motions.data.held - other.motions.data.held)
            theirs = ServoModel(replace(model.servos, joint=values), {})
            model = model.joined(
                theirs, _places(cause, model.servos.n), BY_NAME[cause.effect].parameters
            )
        else:  # what the whole arm carries or touches
            data, robot = motions.data, other.motions.data.robot
            body = body_near(robot, data.q, data.dq, data.link).midway(data.tracks.last)
            motions = replace(motions, data=replace(data, robot=robot, body=body))
            servos = replace(model.servos, plane=other.model.servos.plane.clone())
            model = replace(model, servos=servos, plane=False)
        told = fall.told(model.fitted(motions, 8, plane=True).losses(motions))
        at = list(cause.joints) or slice(None)
        paid = fall.price + fall.paid(len(cause.parameters), at)
        return max(0.0, float(told[at].sum())), paid


def _places(cause: PositionFinding, n: int) -> Bool[Tensor, " n"]:
    """Joints (n,) that a cause is on."""
    return (torch.arange(n)[:, None] == torch.tensor(cause.joints)).any(1)


def _new(sides: Sides, arm: ServoArm) -> Iterator[OneSided]:
    """Causes of the arm's log that are likelier there alone than nowhere, and than as large in the
    simulator's."""
    first, second = sides
    named = [f for f in second.findings if (f.how_sure or 0.0) >= LIKELY]
    mine = ServoModel(first.servos, {})
    values = first.servos.joint.clone()
    values[:, LATE] = arm.servos.joint[:, LATE] + 0.5 * second.data.held
    for cause in named:
        here = _places(cause, len(values))
        names = BY_NAME[cause.effect].parameters if cause.joints else ()
        mine = mine.freed(names, here)
        for k in (INDEX[name] for name in names):
            values[here, k] = second.servos.joint[here, k]
    plane = any(cause.effect == "plane_contact" for cause in named)
    theirs = replace(first.servos, joint=values, plane=second.servos.plane)
    simulator, real = _Side.of(first, mine), _Side.of(second, replace(mine, servos=theirs))
    real = replace(real, model=replace(real.model, plane=plane))
    # Half a row of either log hides when commands come.
    hidden = 0.5 * sum(side.data.tracks.dt for side in sides)
    for cause in named:
        (a, _), (b, paid) = simulator.losing(real, cause), real.losing(simulator, cause)
        told = a * b / max(a + b, 1e-300) - paid
        sure = min(cause.how_sure or 0.0, 1 / (1 + math.exp(min(-told, 700.0))))
        late = cause.parameters.get("delay", math.inf) - cause.was.get("delay", 0.0)
        if sure < LIKELY or (cause.effect == DELAY.name and abs(late) < hidden):
            continue
        sizes = [
            max((_strength(*one) for one in x.items()), default=0.0)
            for x in (cause.was, cause.parameters)
        ]
        yield one_sided(cause.cause, cause.was, *sizes, how_sure=sure)


def _strength(name: str, value: float) -> float:
    """How large a number of a cause is: of a limit the lower one is more."""
    neutral = PARAMETERS[INDEX[name]].neutral if name in INDEX else 0.0
    return 1 / max(abs(value), 1e-300) if math.isinf(neutral) else abs(value - neutral)


def numbers_of(sides: Sides, new: Sequence[OneSided]) -> Iterator[ServoDifference]:
    """Parameters that either side's answer has, joint by joint, of joints that both move; one
    differs that is of a cause that is new. Where the motions, or a robot without masses, leave a
    common factor of all torques open, torques are compared as shares of kp."""
    moves = ~torch.stack([side.still for side in sides]).any(0)
    ratio = torch.stack([side.ratio_only for side in sides]).any(0)
    differs = {(p, j) for one in new for j in one.joints for p in BY_NAME[one.effect].parameters}
    for j in moves.nonzero().flatten().tolist():
        for p in PARAMETERS:
            shared = bool(ratio[j]) and p.name in TORQUES and p.name != "kp"
            (a, a_ci95), (b, b_ci95) = (_number(side, j, p, shared) for side in sides)
            # Where the arm's is the simulator's, it is known as well as that.
            b_ci95 = a_ci95 if b_ci95 is None and b == a else b_ci95
            apart = (p.name, j) in differs
            if apart or (not (a_ci95 is b_ci95 is None) and not (p.name == "kp" and ratio[j])):
                unit = PER_KP[p.unit] if shared else p.unit
                yield ServoDifference(j, p.name, unit, shared, a, a_ci95, b, b_ci95, apart)


def _number(
    found: PositionDiagnosis, j: int, p: ServoParameter, shared: bool
) -> tuple[float, tuple[float, float] | None]:
    """A value, or its share of kp, with its 95 % interval; none where a side does not have the
    parameter."""
    gain = float(found.servos.of("kp")[j]) if shared else 1.0
    value = float(found.servos.of(p.name)[j]) / gain
    if p.name == "delay":  # of commands, before a log holds them
        value = max(0.0, value - 0.5 * found.data.held)
    for one in found.known:
        if one.joint == j and p.name in one.names:
            way: Float[Tensor, " K"] = torch.zeros(len(one.names), dtype=torch.float64)
            way[one.names.index(p.name)] = 1.0 if p.kind == "log" else 1 / gain
            if shared and "kp" in one.names:  # else it is the simulator's
                way[one.names.index("kp")] = -1.0 if p.kind == "log" else -value
            std = math.sqrt(max(float(way @ one.covariance @ way), 0.0))
            return value, value_interval(p.name, value, std)
    return value, None
