"""All friction of a joint as one law: of the model and found, over speed, with its band.

An effect of the library is one detail of the law. The coefficients of all details are fitted
together, so that the band of their sum is narrower than those of details that take each other's
place.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from msgspec import structs

from torchid.design.columns import Columns
from torchid.effects.base import Effect
from torchid.effects.motion import Motion
from torchid.effects.registry import Valued
from torchid.gap.cause_records import unit_of
from torchid.gap.causes.candidates import Term
from torchid.gap.describe.checked import Decision
from torchid.gap.describe.claims import Claim, with_a_name
from torchid.gap.describe.shares import Shares
from torchid.gap.diagnosis import HowFar
from torchid.gap.problem import Problem
from torchid.results.cause import Cause
from torchid.results.friction import (
    FrictionAt,
    FrictionCurve,
    FrictionDetail,
    FrictionLaw,
)
from torchid.results.record import Rows
from torchid.results.words import digits
from torchid.robot.model import joint_unit
from torchid.statistics.criteria import LIKELY
from torchid.statistics.proportion import HALF_95
from torchid.typing import Float, Tensor

ENDS = (0.01, 0.99)
"""Of a direction's speeds, between which its curve is drawn."""
AT = (0.1, 0.5, 0.9)
"""Shares of the motion that is slower than the slow, the middle and the fast speed."""
FEWEST = 20
"""Samples in a direction, below which the log does not have it."""


def friction_laws(decision: Decision, taken: Shares, causes: Sequence[Cause]) -> Rows[FrictionLaw]:
    """The law of each joint that has friction, in the model as given or found.

    Args:
        decision: the answered explanation, with a covariance where anything was fitted.
        taken: what each of its terms takes of the error.
        causes: that have a name; of one alone a law has its probability.
    """
    problem = decision.found.problem
    samples = problem.data.samples
    speeds = samples.of([s.motion.dq.T for s in samples.segments])
    told = with_a_name(decision.claims, taken.of_all(decision.checked.far.less)[0])
    out = []
    for joint in range(samples.n):
        own = speeds[joint, problem.data.keep[joint] & (speeds[joint] != 0)]
        friction = _Friction(decision, speeds[joint], joint)
        moves = any(friction.moves(own, way) for way in (-1.0, 1.0))
        if moves and (friction.corrected or friction.given):
            law = friction.law(own, taken, told)
            named = [c.how_sure for c in causes if c.at == (joint,) and law.has(c.effect)]
            alone = len(named) == 1 and not law.unnamed > 0
            out.append(structs.replace(law, how_sure=named[0]) if alone else law)
    return Rows(out)


@dataclass(frozen=True, eq=False)
class _Friction:
    """The friction of one joint.

    Attributes:
        decision: as of `friction_laws`.
        speed: (N,) of the joint.
        joint: which.
    """

    decision: Decision
    speed: Float[Tensor, " N"]
    joint: int

    @property
    def problem(self) -> Problem:
        """The problem that the law is of."""
        return self.decision.found.problem

    @property
    def columns(self) -> Columns:
        """Columns at the corrected model."""
        return self.decision.found.solution.columns

    def _is_own(self, effect: Effect) -> bool:
        return effect.branch == "friction" and effect.joints == (self.joint,)

    @cached_property
    def given(self) -> list[Valued]:
        """Friction of this joint in the model as given."""
        return [p for p in self.decision.found.solution.start.effects if self._is_own(p[0])]

    @cached_property
    def corrected(self) -> list[Valued]:
        """Friction of this joint in the corrected model."""
        return [p for p in self.decision.found.solution.model.effects if self._is_own(p[0])]

    def law(self, own: Float[Tensor, " M"], taken: Shares, told: list[bool]) -> FrictionLaw:
        """The law.

        Args:
            own: speeds of the samples in which the joint moves.
            taken: what each term takes of the error.
            told: which terms are told by name.
        """
        robot, far = self.problem.given.model.robot, self.decision.checked.far
        named = [k for k, one in enumerate(self.decision.claims) if self._terms_effects(one)]
        judged = [self.decision.claims[k] for k in named]
        sure = [max(one.branch_sure, one.law_sure) for one in judged]
        nameless = [k for k in named if not told[k]]
        shown = self.decision.final.far
        removes = taken.of_bars(shown.rms_before, shown.rms_after)[named].sum(0)
        return FrictionLaw(
            joint=self.joint,
            how_sure=max(sure, default=None),
            share=self._share(named, taken, far),
            unnamed=self._share(nameless, taken, far) if max(sure, default=0.0) >= LIKELY else 0.0,
            removes=tuple(removes.tolist()),
            unit=joint_unit(robot, self.joint),
            speed_unit=unit_of("rad/s", [self.joint], robot),
            details=self._details(),
            at=self._table(own),
            curve=self._curve(own),
        )

    def _terms_effects(self, one: Claim) -> list[Effect]:
        """Effects of a judged term that are friction of this joint."""
        solution = self.decision.found.solution
        effects = solution.parts[solution.number(one.term)].effects
        return [e for e in effects if self._is_own(e)]

    def _share(self, named: list[int], taken: Shares, far: HowFar) -> float:
        """Of the error that the law takes; of a term that joints share this joint's part."""
        shares, _ = taken.of_all(far.less)
        total = 0.0
        for k in named:
            common = self.decision.claims[k].term.common
            part = taken.falls[k, self.joint] / taken.falls[k].sum() if common else 1.0
            total += shares[k] * float(part)
        return total

    def _details(self) -> tuple[FrictionDetail, ...]:
        """Details that are likely, and those of the model as given; the surest first. What takes
        each other's place, none of it sure alone, is one of them."""
        without: dict[str, float] = {}
        effects: dict[str, list[str]] = {}
        named, out = set(), []
        for one in self.decision.claims:
            here, instead = self._terms_effects(one), self._instead(one)
            words = _least([here, *(instead[t][0] for t in one.in_set if t in instead)])
            one_of = bool(here) and len(words) > 1
            if one_of:
                mass = one.alone_sure + sum(p for _, p in instead.values())
                every = {
                    e.name: e for some in (here, *(x for x, _ in instead.values())) for e in some
                }
                own = tuple(n for n, e in every.items() if any(e.detail in w for w in words))
                text = ", or ".join(" and ".join(w) for w in words)
                out.append(FrictionDetail(detail=text, effects=own, how_sure=mass))
                continue
            # What excludes each other adds up; terms beside each other are there or not.
            masses: dict[str, float] = {}
            found = [(here, one.alone_sure), *instead.values()]
            for effect, mass in ((e, mass) for some, mass in found for e in some):
                masses[effect.detail] = masses.get(effect.detail, 0.0) + mass
                effects.setdefault(effect.detail, []).append(effect.name)
            for detail, mass in masses.items():
                without[detail] = without.get(detail, 1.0) * max(0.0, 1 - mass)
            named |= {e.detail for e in here}
        told = {name for one in out for name in one.effects}
        known = set()
        for effect, _ in (*self.corrected, *self.given):
            if effect.name not in told:
                effects.setdefault(effect.detail, []).append(effect.name)
                known.add(effect.detail)
        for detail, names in effects.items():
            likely = 1 - without.get(detail, 1.0)
            # 0.05: probability of a detail from which on it is said
            says = detail in named or likely >= 0.05
            if says or detail in known:
                own, sure = tuple(dict.fromkeys(names)), likely if says else None
                out.append(FrictionDetail(detail=detail, effects=own, how_sure=sure))
        return tuple(sorted(out, key=lambda d: -(d.how_sure or 0.0)))

    def _instead(self, one: Claim) -> dict[Term, tuple[list[Effect], float]]:
        """Friction of this joint that may stand in a term's place, with probabilities."""
        every = ((t, p, None if t.common else t.effect) for t, p in one.others)
        return {t: ([e], p) for t, p, e in every if e is not None and self._is_own(e)}

    def _table(self, own: Float[Tensor, " M"]) -> tuple[FrictionAt, ...]:
        """Torque at three speeds, as they are read, both ways."""
        speeds = own.abs().quantile(own.new_tensor(AT))
        speeds = own.new_tensor([float(digits(x, 2)) for x in speeds.tolist()])
        ways = [
            [x if self.moves(own, way) else torch.full_like(speeds, torch.nan) for x in found]
            for way in (1.0, -1.0)
            for found in [self._torque(way * speeds)]
        ]
        given = torch.full_like(speeds, torch.nan)
        if self.given:
            given = 0.5 * (self._sum(self.given, speeds) - self._sum(self.given, -speeds))
        rows = torch.stack([speeds, *ways[0], *ways[1], given], 1)
        return tuple(FrictionAt(*row) for row in rows.tolist())

    def _curve(self, own: Float[Tensor, " M"]) -> FrictionCurve:
        """Torque over the speeds of each direction that the log has."""
        at = []
        for way in (-1.0, 1.0):
            if self.moves(own, way):
                slow, fast = own[own * way > 0].abs().quantile(own.new_tensor(ENDS)).tolist()
                # 24: of a curve, in each direction
                at.append(way * torch.linspace(slow, fast, 24, dtype=own.dtype))
        speed = torch.cat(at).sort().values
        torque, std = self._torque(speed)
        every = (speed, torque, HALF_95 * std, self._sum(self.given, speed))
        return FrictionCurve(*(tuple(x.tolist()) for x in every))

    @staticmethod
    def moves(own: Float[Tensor, " M"], way: float) -> bool:
        """Whether enough samples say what friction is this way."""
        return int((own * way > 0).sum()) >= FEWEST

    def _torque(
        self, speed: Float[Tensor, " G"]
    ) -> tuple[Float[Tensor, " G"], Float[Tensor, " G"]]:
        """Of the corrected model at these speeds, and its standard deviation."""
        solution = self.decision.found.solution
        columns = speed.new_zeros(len(solution.covariance), len(speed))
        for k, part in enumerate(solution.parts):
            for effect in (e for e in part.effects if self._is_own(e)):
                columns[solution.at(k)] += self._over_speed(effect, speed)
        for k, shape in enumerate(solution.shapes, len(solution.a)):
            if self._is_own(shape.effect):
                low, high = (self._over_speed(e, speed) for e in shape.around)
                slope = (high - low) / (shape.near[1] - shape.near[0])
                columns[k] = solution.values[shape.part] @ slope
        variance = ((solution.covariance @ columns) * columns).sum(0)
        return self._sum(self.corrected, speed), variance.clamp(min=0).sqrt()

    def _sum(self, effects: list[Valued], speed: Float[Tensor, " G"]) -> Float[Tensor, " G"]:
        """Torque of effects."""
        each = (
            speed.new_tensor(values) @ self._over_speed(effect, speed) for effect, values in effects
        )
        return sum(each, torch.zeros_like(speed))

    def _over_speed(self, effect: Effect, speed: Float[Tensor, " G"]) -> Float[Tensor, "C G"]:
        """Columns at speeds. Of what depends on more than the speed the straight line in speed
        through what they are along the log, in each direction."""
        if effect.of_speed:
            return over_speed(effect, speed)
        along = self.columns.on_all_joints(effect)[:, self.joint]
        out = speed.new_zeros(len(along), len(speed))
        for way in (1.0, -1.0):
            rows = self.problem.data.keep[self.joint] & (self.speed * way > 0)
            there = speed * way > 0
            if int(rows.sum()) < FEWEST:
                continue
            line = torch.stack([torch.ones_like(self.speed), self.speed], 1)
            fitted = torch.linalg.lstsq(line[rows], along[:, rows].T).solution
            at = torch.stack([torch.ones_like(speed), speed], 1)
            out[:, there] = (at @ fitted).T[:, there]
        return out


def over_speed(effect: Effect, speed: Float[Tensor, " G"]) -> Float[Tensor, "C G"]:
    """Columns at speeds of the effect's joint, of what depends on nothing else; all others rest."""
    (joint,) = effect.joints
    zero = speed.new_zeros(len(speed), joint + 1)
    dq = zero.clone()
    dq[:, joint] = speed
    return effect.own_columns(Motion(zero, dq, zero))[0].T


def _least(choices: Sequence[Sequence[Effect]]) -> list[list[str]]:
    """Details of effects that are there together, of each of some choices; none that has all of
    another one."""
    words = [list(dict.fromkeys(e.detail for e in some)) for some in choices]
    words = [w for k, w in enumerate(words) if w not in words[:k]]
    return [w for w in words if not any(set(other) < set(w) for other in words)]
