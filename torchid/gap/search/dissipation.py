"""Whether the friction of a joint resists: all of its laws together, at the speeds of a log.

One law may fall below zero beside another (lubricant that thins beside viscous friction, what a
robot's file has too much of); the sum may not drive the joint at any speed that the log has.
"""

from collections.abc import Sequence

import torch

from torchid.design.columns import Columns
from torchid.effects.base import Effect, JointEffect
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.friction_laws import AsymmetricFriction, PowerLawFriction, StribeckFriction
from torchid.effects.motion import Motion
from torchid.effects.registry import Valued
from torchid.gap.search.terms import Term
from torchid.statistics.criteria import FORBIDDEN_STD
from torchid.typing import Float, Tensor

STEADY = (
    CoulombFriction, ViscousFriction, PowerLawFriction, StribeckFriction, AsymmetricFriction
)  # fmt: skip
"""Friction that is a curve of the joint's speed."""

QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9, 0.98)
"""Of the speeds of each direction, at which the curve is looked at."""

RARE = 0.02
"""Share of the instants below which a log does not have a direction."""


def over_speed(effect: JointEffect, speed: Float[Tensor, " G"]) -> Float[Tensor, "C G"]:
    """Columns at speeds of the effect's joint, of what depends on nothing else; all others rest."""
    zero = speed.new_zeros(len(speed), effect.joint + 1)
    dq = zero.clone()
    dq[:, effect.joint] = speed
    return effect.columns(Motion(zero, dq, zero)).T


class Dissipation:
    """The steady friction of joints at the speeds of a log.

    Args:
        columns: with the motions.
        given: effects of the model as given, with their coefficients.
    """

    def __init__(self, columns: Columns, given: Sequence[Valued]):
        self._dq = torch.cat([m.dq for m in columns.motions])
        self._speeds: dict[int, Tensor] = {}
        self._kept: dict[Effect, Tensor] = {}
        self._given = [(e, v) for e, v in given if isinstance(e, STEADY)]

    def speeds(self, joint: int) -> Float[Tensor, " G"]:
        """Speeds [rad/s; m/s] of a joint in the directions that the log has."""
        if joint not in self._speeds:
            dq, at = self._dq[:, joint], torch.tensor(QUANTILES, dtype=torch.float64)
            own = [s * dq[s * dq > 0] for s in (1.0, -1.0)]
            self._speeds[joint] = torch.cat(
                [dq.new_zeros(0)]
                + [
                    s * torch.quantile(x[:: max(1, len(x) // 100_000)], at)
                    for s, x in zip((1.0, -1.0), own, strict=True)
                    if len(x) > RARE * len(dq)
                ]
            )
        return self._speeds[joint]

    def resisting(self, effect: Effect) -> Float[Tensor, "C G"]:
        """Torque against the motion per unit coefficient, at the speeds of its joint."""
        if effect not in self._kept:
            assert isinstance(effect, STEADY)
            speeds = self.speeds(effect.joint)
            self._kept[effect] = over_speed(effect, speeds) * speeds.sign()
        return self._kept[effect]

    def driving(
        self, terms: Sequence[Term], x: Float[Tensor, " K"], root: Float[Tensor, "K K"]
    ) -> list[Term]:
        """Terms that make the friction of their joint drive it, by more than its uncertainty: that
        which drives most where this is worst, joint by joint.

        Args:
            terms: of an explanation.
            x, root: their coefficients, and the root of their covariance.
        """
        out, sizes = list[Term](), [t.count for t in terms]
        parts = zip(terms, x.split(sizes), root.split(sizes), strict=True)
        steady = [(t, v, r) for t, v, r in parts if isinstance(t.alone, STEADY)]
        for joint in {t.place for t, v, _ in steady if bool((v < 0).any()) or t.count > 1}:
            own = [p for p in steady if p[0].place == joint]
            gone = {o.effects[0] for t, *_ in own for _, o, _ in t.instead}
            file = [(e, v) for e, v in self._given if e.joint == joint and e not in gone]
            at = [self.resisting(t.effects[0]) for t, *_ in own]
            added = torch.stack([v @ c for (_, v, _), c in zip(own, at, strict=True)])
            std = sum(c.T @ r for (*_, r), c in zip(own, at, strict=True)).norm(dim=1)
            whole = added.sum(0) + sum(x.new_tensor(v) @ self.resisting(e) for e, v in file)
            below = (whole + FORBIDDEN_STD * std + 1e-12).where(added.sum(0) < 0, torch.inf)
            if len(below) and float(below.min()) < 0:
                worst = added[:, int(below.argmin())]
                out.append(own[int(worst.argmin())][0])
        return out
