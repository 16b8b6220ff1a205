"""Backlash of a gear: which flank is in contact depends on the past of the torque."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.effects.base import Coefficient, Columns, Example, Motion
from torchid.effects.instants import derivative, interval
from torchid.effects.variation import (
    OneJointEffect,
    link_lag_torque,
    needed,
    secant_at,
    with_joint,
)
from torchid.robot.model import Robot
from torchid.typing import Float

CALM = 4
"""Crossings over which the torque that drives the play is averaged, against its noise, and, where
only the model's torque is known, against the pulse that this has at a crossing."""


@dataclass(frozen=True)
class Backlash(OneJointEffect):
    """The gear has play, and the encoder is on the motor: q_link = q_motor - b/2 s(t).

    s = 1 or -1 is the flank in contact, a play operator driven by the torque: it flips when the
    torque exceeds a dead band on the other side and holds in between. The link crosses the play in
    a finite time, along a raised cosine. The column is the secant of the model's torque in b.

    When it flips, the measured torque says, its sign alone: the model's torque along the motor's
    motion has a pulse there that is larger than what it passes through.

    Attributes:
        at: width of the play the secant is taken at [rad or m].
        band: dead band, as a share of the joint's 99 % torque along the motion.
        crossing: time a flip takes [s].
    """

    at: float = 1e-3
    band: float = 0.02
    crossing: float = 0.03

    name = "backlash"
    family = "hysteresis"
    needs = frozenset({"robot", "torque", "t"})
    jumps = True
    coefficients = (Coefficient("width", "rad", True, "angle between the flanks", 0.05),)
    meaning = "Gear teeth lose contact and cross the play when the torque reverses."
    equation = "tau(q - width/2 s e_j, ..) - tau(q, ..), s = 1 or -1 the flank in contact"
    signature = "pulses where the joint's torque, not its speed, changes sign"
    experiment = "bias the joint with a gravity load so that its torque does not change sign"
    remedy = (
        "Preload or adjust the gear; in the simulator, a joint of range `width` between motor and "
        "link."
    )
    source = (
        "Nordin and Gutman 2002, Controlling mechanical systems with backlash: a survey, "
        "Automatica 38(10), section 2"
    )
    example = Example((2e-3,), "time")
    smooth = True
    linearised = True

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """Secant of the torque of all joints over the width of the play (T, n, 1)."""
        arm = needed(robot, self.name)
        at = secant_at(self.at, 1e-7)
        lag = (at / 2 * s for s in self.flank(motion, CALM))
        change = link_lag_torque(arm, motion, self.joint, *lag)
        return (change / at).to(motion.q).unsqueeze(-1)

    def measured(self, motion: Motion, values: Sequence[float]) -> Motion:
        """The motor's motion in place of the link's."""
        state = (
            with_joint(x, self.joint, (values[0] / 2 * s).to(x))
            for x, s in zip(motion.state, self.flank(motion), strict=True)
        )
        return motion._replace(**dict(zip(("q", "dq", "ddq"), state, strict=True)))

    def flank(
        self, motion: Motion, calm: float = 0.0
    ) -> tuple[Float[Tensor, " T"], Float[Tensor, " T"], Float[Tensor, " T"]]:
        """The flank in contact, smoothed over the crossing, and its first two derivatives.

        Args:
            motion: with t, and with torque, or torque as sensed.
            calm: crossings over which the torque is averaged first.
        """
        drive = motion.require("torque", self.name) if motion.sensed is None else motion.sensed
        torque = drive[:, self.joint].double()
        t = motion.require("t", self.name)
        if torque.shape[0] == 0:
            return torque, torque, torque
        samples = self.crossing / interval(t)
        if calm:
            torque = _smooth(torque, calm * samples)
        band = self.band * float(torch.quantile(torque[:: 1 + len(torque) // 100_000].abs(), 0.99))
        s = _smooth(_relay(torque, band), samples)
        rate = derivative(s, t)
        return s, rate, derivative(rate, t)


def _relay(x: Float[Tensor, " T"], band: float) -> Float[Tensor, " T"]:
    """Sign of the last value outside the band; before the first one, of that one."""
    outside = x.abs() > band
    if not outside.any():
        return torch.zeros_like(x)
    index = torch.arange(x.shape[0], device=x.device)
    last = torch.where(outside, index, -torch.ones_like(index)).cummax(0).values
    first = int(outside.to(torch.int8).argmax())
    return torch.sign(x)[last.clamp(min=first)]


def _smooth(s: Float[Tensor, " T"], samples: float) -> Float[Tensor, " T"]:
    """Average over a raised cosine of that many samples: its shape is the speed of a step."""
    half = max(1, round(samples / 2))
    angle = torch.linspace(-torch.pi, torch.pi, 2 * half + 3, dtype=s.dtype, device=s.device)
    window = (1 + torch.cos(angle))[1:-1]
    kernel = (window / window.sum()).reshape(1, 1, -1)
    ends = (s[:1].expand(half), s, s[-1:].expand(half))
    return torch.nn.functional.conv1d(torch.cat(ends).reshape(1, 1, -1), kernel).reshape(-1)
