"""What is named: effects by what they were worth in windows, how sure they are, and their sizes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torchid.effects.servo import INDEX, PARAMETERS, PER_KP, PLANE, TORQUES, ServoEffect, as_share
from torchid.position.answered import Answered
from torchid.position.checked import Checked
from torchid.position.diagnosis import Number, finding_of
from torchid.position.effects import BY_NAME, GRAVITY, PAYLOAD
from torchid.position.equal import OF_TYPE
from torchid.position.evidence import Evidence
from torchid.position.fit import VALLEYS
from torchid.position.judge import Equations, value_interval
from torchid.position.known_numbers import APART
from torchid.position.payload import Loaded
from torchid.position.problem import Problem
from torchid.position.record import PositionFinding
from torchid.statistics.criteria import LIKELY, UNSURE_SCALE
from torchid.statistics.proportion import HALF_95
from torchid.typing import Bool, Float

IN_DEGREES = "in N m/rad: the file's is about 180/pi off, as if one of the two were N m/degree"

_OF_ROBOT = {effect.name: effect for effect in (PAYLOAD, GRAVITY)}


@dataclass(frozen=True, eq=False)
class _Naming:
    """What names need.

    Attributes:
        answered, known, problem, checked: as of `describe_findings`.
        shares: joints of which torques are told as shares of kp.
    """

    answered: Answered
    known: Equations
    problem: Problem
    checked: Checked
    shares: Bool[Tensor, " n"]

    @cached_property
    def evidence(self) -> Evidence:
        """What effects are held against."""
        motions = self.answered.motions
        data, noise = motions.data, self.problem.noise.at_least(motions.data.slight)
        if data.beside is not None:
            noise = noise.hypot(data.beside.unsure(motions.windows))
        left, whole = self.checked.left(noise / data.scale)
        left = left * data.scale.square()
        return Evidence(motions, self.known, noise, left, whole)

    def sure(self, effect: ServoEffect, joint: int | None, numbers: int, joints: int = 1) -> float:
        """Probability of an effect; see `Evidence.sure`."""
        worth = self.answered.worth[effect.name]
        return self.evidence.sure(effect, joint, *worth, numbers, joints)

    def errors(self, effect: str) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
        """RMS errors (n,) in windows without an effect and with it [mrad of the log's unit]."""
        rows = float(len(self.answered.motions.data.tracks.u))
        without, with_it = (
            1e3 * (x.sum(0) / rows).sqrt() / self.answered.motions.data.scale
            for x in self.answered.worth[effect]
        )
        return without, with_it

    def of_all(self, effect: ServoEffect) -> PositionFinding:
        """An effect that all joints feel."""
        numbers: Sequence[Number] = ()
        if effect is PAYLOAD and self.answered.load is not None:
            numbers = _load_sizes(self.answered.load, float(self.known.torque_std.amax()))
        elif effect is not GRAVITY:
            values = zip(PLANE, self.answered.model.servos.plane.tolist(), strict=True)
            units, ends = {"stiffness": "N/m"}, (math.nan, math.nan)
            numbers = [Number(key, units.get(key, "m"), value, ends) for key, value in values]
        without, with_it = (float(x.square().mean().sqrt()) for x in self.errors(effect.name))
        others = self.answered.rivals.get((effect.name, None), ())
        more = {"ambiguous_with": others, "how_sure": self.sure(effect, None, len(numbers))}
        return finding_of(effect, None, numbers, (without, with_it), **more)

    def of_joints(self, effect: ServoEffect) -> list[PositionFinding]:
        """An effect on all joints that have it."""
        data, known, free = self.answered.motions.data, self.known, self.answered.model.free
        without, with_it = self.errors(effect.name)
        joints = torch.nonzero(without.isfinite() & ~data.still).flatten().tolist()
        first = effect.parameters[0]
        motions = list(zip(data.log.names, data.log.duration, strict=True))
        out = []
        # Of the bus, or of the servos' type, most joints' is one cause of them all.
        most = first in OF_TYPE and 2 * len(joints) > int((~data.still).sum())
        for j in joints:
            sizes = [
                self.size(name, j)
                for name in effect.parameters
                if (name in free and bool(free[name][j])) or self.in_file(name, j)
            ]
            fitted = first in free and bool(free[first][j])
            again = None
            if fitted and effect.family != "world" and first not in VALLEYS:
                again = known.replication(first, j, motions)
            others = self.answered.rivals.get((effect.name, j), ())
            below = bool(sizes) and sizes[0].value < PARAMETERS[INDEX[first]].neutral
            if effect.twin and (below or not effect.twin_below):
                others += (effect.twin,)
            changed = any(not math.isnan(size.was) for size in sizes)
            sure = self.sure(effect, j, len(sizes), len(joints) if most else 1)
            # Nor is an effect sure whose interval holds none of it.
            if fitted and sizes[0].holds(PARAMETERS[INDEX[first]].neutral):
                sure = min(sure, LIKELY - 0.01)
            # No change is whose interval holds what the robot's file says, and none at all which
            # is within half of it.
            if changed and not any(map(has_changed, sizes)):
                sure = min(sure, LIKELY - 0.01) if any(has_changed(s, 0.5) for s in sizes) else 0.0
            more = dict[str, object](ambiguous_with=others, replication=again, how_sure=sure)
            if any(s.name == "kp" and in_degrees(s.value / s.was) for s in sizes):
                more["remedy"] = f"{effect.remedy[:-1]}, {IN_DEGREES}."
            out.append(finding_of(effect, j, sizes, (float(without[j]), float(with_it[j])), **more))
        return out

    def size(self, name: str, joint: int) -> Number:
        """A number of an effect on one joint, of torques but the gain as a share of it if asked
        for, beside what the robot's file says."""
        servos, start = self.known.servos, self.problem.start
        value, kind, title = float(servos.of(name)[joint]), PARAMETERS[INDEX[name]], name
        was, unit = math.nan, kind.unit
        if start is not None and self.in_file(name, joint):
            was = float(start.servos.of(name)[joint])
        std, names = math.nan, self.known.names
        if name in names:
            std = float(self.known.deviations(self.shares)[joint, names.index(name)])
        unsure = bool(self.shares[joint]) or std > UNSURE_SCALE
        if name == "kp" and unsure and bool(self.problem.doubted[joint]):
            # The log leaves it open: what all else says, but for what would be doubted, too.
            value = float(self.problem.gains[joint])
            return Number(title, unit, value, (value / APART, value * APART), was)
        if name == "delay":
            # Commands are simulated along straight lines; that they are held until the next one
            # makes them half a sample late on average, which is no delay of its own.
            value -= 0.5 * self.answered.motions.data.held
        if bool(self.shares[joint]) and name in TORQUES and name != "kp":
            value /= float(servos.of("kp")[joint])
            believed = self.problem.believed
            was /= 1.0 if believed is None else float(believed.servos.of("kp")[joint])
            unit, title = PER_KP[unit], as_share(name)
        return Number(title, unit, value, value_interval(name, value, std), was)

    def in_file(self, name: str, joint: int) -> bool:
        """Whether the robot's file has a number of a joint's servo."""
        start, k = self.problem.start, INDEX[name]
        return start is not None and float(start.servos.joint[joint, k]) != PARAMETERS[k].neutral


def describe_findings(
    answered: Answered,
    known: Equations,
    problem: Problem,
    checked: Checked,
    shares: Bool[Tensor, " n"],
) -> tuple[PositionFinding, ...]:
    """What is named, those that close most first.

    Args:
        answered: the model, and what its effects are worth.
        known: how well it is known.
        problem: the question.
        checked: what it does on motions that were left out.
        shares: joints of which torques are told as shares of kp.
    """
    naming = _Naming(answered, known, problem, checked, shares)
    out: list[PositionFinding] = []
    for name in answered.worth:
        effect = _OF_ROBOT.get(name) or BY_NAME[name]
        out += naming.of_joints(effect) if effect.parameters else [naming.of_all(effect)]
    return tuple(sorted(out, key=lambda f: f.error_with - f.error_without))


def _load_sizes(load: Loaded, unsure: float) -> tuple[Number, ...]:
    """Mass and centre of a load.

    Args:
        load: whose mass is known beside the masses of the robot's file.
        unsure: standard deviation of those, as a share [1].
    """
    below, above = (
        math.exp(math.hypot(HALF_95 * unsure, math.log(end / load.mass))) for end in load.between
    )
    half = (HALF_95 * load.std).tolist()
    mass = Number("mass", "kg", load.mass, (load.mass / below, load.mass * above))
    com = (
        Number(key, "m", value, (value - h, value + h))
        for key, value, h in zip("xyz", load.com.tolist(), half, strict=True)
    )
    return (mass, *com)


def in_degrees(factor: float) -> bool:
    """Whether two gains by this factor apart are one in N m/rad and in N m/degree, to a fifth."""
    return abs(abs(math.log(factor)) - math.log(180 / math.pi)) < 0.2


def has_changed(size: Number, share: float = 1.0) -> bool:
    """Whether the interval of a number, or a share of it, leaves out what the robot's file has; no,
    where it has none."""
    return not math.isnan(size.was) and not size.holds(size.was, share)
