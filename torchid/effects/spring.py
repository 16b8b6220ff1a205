"""Torque of springs between the links: return springs, cables and hoses, counterbalances."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.digits import number
from torchid.effects.base import Coefficient, Columns, Example, JointEffect, Motion, Shape
from torchid.effects.c_text import add
from torchid.typing import Float


@dataclass(frozen=True)
class JointSpring(JointEffect):
    """A spring about an unknown rest position, straight, progressive or a counterbalance.

    Its torque is any solution of tau'' = -curvature tau, primes along the position:

    - curvature 0: k q + c0, the spring k (q - q0) with c0 = -k q0;
    - curvature w^2 > 0: (k/w) sin wq + c0 cos wq; w = 1 is a counterbalance, whose lever turns with
      the joint (a sin q + b cos q), w < 1 a spring that softens;
    - curvature -w^2 < 0: (k/w) sinh wq + c0 cosh wq, a spring that hardens, as dress packs do:
      k' (x + w^2 x^3/6 + ..) about its rest position, x = q - q0, so k3 is about w^2 k'/6.

    So one law with one shape covers them, two columns each. Where the rest position lies need not
    be searched: the columns' span is the same about any position (addition theorems), and k and c0
    are stiffness and torque at q = 0. Travel far from 0 costs conditioning only: about q0 / travel
    for the straight spring, nothing for waves, but e^(2 w q0) for hardening ones (1e5 to 1e6 half a
    turn away, one radian of travel).

    k is negative of a counterbalance alone, whose lever turns with the joint: beyond its balance
    point it pushes away from it. A spring pulls back.

    Attributes:
        curvature: -tau''/tau [1/rad^2; 1/m^2].
    """

    curvature: float = 0.0

    name = "joint_spring"
    usual = True
    family = "gravity"
    branch = "surroundings"
    over_position = True
    essential = (0,)  # a rest torque alone is an offset
    coefficients = (
        Coefficient("k", "N m/rad", False, "stiffness at q = 0"),
        Coefficient("c0", "N m", False, "torque at q = 0; -k q0 for a straight spring"),
    )
    shapes = (
        Shape(
            "curvature",
            "1/rad^2",
            -6.0,
            2.0,
            (-4.0, -1.0, 0.0, 1.0),
            "0 straight, < 0 hardening, 1 a counterbalance",
            logarithmic=False,
        ),
    )
    meaning = "A spring, cable, hose or counterbalance pulls the joint towards a position."
    equation = (
        "k sin(w q)/w + c0 cos(w q) with w^2 = curvature; sinh and cosh where it is negative, "
        "k q + c0 where it is 0"
    )
    signature = "torque over the joint's own position, whatever the others do"
    experiment = "cover the joint's full range, also with the arm's gravity load reversed"
    remedy = (
        "Set the joint's stiffness to k and its rest position to q0 = -c0/k in the simulator, or "
        "reroute the cable; model a counterbalance as a torque over position."
    )
    source = (
        "Arakelian 2016, Gravity compensation in robotics (Advanced Robotics 30), for "
        "counterbalances; Duffing's equation for k3"
    )
    example = Example((2.0, 0.0), "position")

    @property
    def ranges(self) -> tuple[tuple[float, float], ...]:
        """No spring pushes away from its rest position, but a counterbalance."""
        # 0.5: curvature from which on a spring is a counterbalance [1/rad^2]: 1 where its lever
        # turns with the joint
        return ((0.0 if self.curvature < 0.5 else -math.inf, math.inf), super().ranges[1])

    def remarks(self, values: Sequence[float], q: Float[Tensor, "T n"]) -> list[str]:
        """Between which values its stiffness is, where that changes along the travel."""
        if self.curvature == 0:
            return []
        own = q[:, self.joint]
        least, most = torch.aminmax(self.stiffness(values, own))
        return [
            f"k is the stiffness at q = 0; where the joint moved, from {float(own.min()):.3g} to "
            f"{float(own.max()):.3g}, it is {float(least):.3g} to {float(most):.3g}"
        ]

    @classmethod
    def grid(cls, motions: Sequence[Motion], joint: int, cutoff: float) -> Float[Tensor, "S P"]:
        """As of any effect, but for springs that harden on an axis that turns on: no number holds
        their torque there."""
        rows = super().grid(motions, joint, cutoff)
        far = max(float(m.q[:, joint].abs().max()) for m in motions)
        # 30.0: exponent w q at the end of the way from which on no spring that hardens is sought
        return rows[(-rows[:, 0]).clamp(min=0.0).sqrt() * far < 30.0]

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """q S and C of curvature q^2 (`stumpff`); shapes: curvature."""
        (curvature,) = shapes
        c, s = stumpff(curvature * motion.q**2)
        return torch.stack((motion.q * s, c), -1)

    def stiffness(self, values: Sequence[float], q: Tensor) -> Tensor:
        """dtau/dq [N m/rad; N/m] at positions q [rad; m] of its joint, in q's shape."""
        c, s = stumpff(self.curvature * q**2)
        return values[0] * c - self.curvature * values[1] * q * s

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        q, k, c0 = f"q[{self.joint}]", number(values[0]), number(values[1])
        if self.curvature == 0:
            return add(self.joint, f"{k} * {q} + {c0}")
        w = number(abs(self.curvature) ** 0.5)
        sine, cosine = ("sin", "cos") if self.curvature > 0 else ("sinh", "cosh")
        return add(self.joint, f"{k} / {w} * {sine}({w} * {q}) + {c0} * {cosine}({w} * {q})")

    def attributes(self, values: Sequence[float]) -> dict[str, float] | None:
        """Stiffness of a straight spring that pulls back."""
        known = self.curvature == 0 and values[0] > 0
        return {"stiffness": values[0], "offset": values[1]} if known else None


def stumpff(x: Tensor) -> tuple[Tensor, Tensor]:
    """C = cos sqrt(x) and S = sin sqrt(x) / sqrt(x), as entire functions of x of either sign.

    With cosh and sinh for x < 0, and the power series about 0, where they have a gradient too
    (Stumpff's functions c0 and c1, Battin 1999, section 4.5).
    """
    # 1e-3: |curvature q^2| below which the series of C and S is exact to rounding
    near = x.abs() < 1e-3
    root = torch.where(near, 1.0, x).abs().sqrt()
    waves = torch.where(near | (x < 0), 0.0, root)
    grows = torch.where(x < 0, root, 0.0)
    c = torch.where(x < 0, torch.cosh(grows), torch.cos(waves))
    s = torch.where(x < 0, torch.sinh(grows), torch.sin(waves)) / root
    c_series = 1 - x / 2 * (1 - x / 12 * (1 - x / 30))
    s_series = 1 - x / 6 * (1 - x / 20 * (1 - x / 42))
    return torch.where(near, c_series, c), torch.where(near, s_series, s)
