"""Exciting trajectories as finite Fourier series that start and end at rest (eq. 5.1).

A trajectory is linear in its coefficients: q(t) - q0 = c' phi(t) with c = (a, b) and fixed basis
functions phi, blends included. Scaling c scales the motion about q0 exactly, so a trajectory is
brought inside limits by one number a joint.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchid.effects.base import Motion
from torchid.errors import TorchidError
from torchid.typing import Float

BASE_PULSATION = 0.15 * math.pi
"""w_f of the report [rad/s]."""

_SERIES_STEP = 0.01  # [s], of the grid on which extremes are looked for
_RAMP_POINTS = 200


class Extremes(NamedTuple):
    """Lower and upper values of q, dq and ddq, each (..., n, 2)."""

    q: Tensor
    dq: Tensor
    ddq: Tensor


@dataclass(frozen=True, eq=False)
class FourierTrajectory:
    """q_j(t) = q0_j + sum_l a_lj/(l w_f) sin(l w_f t) - b_lj/(l w_f) cos(l w_f t) (eq. 5.1).

    During the first and the last `ramp` seconds a quartic takes the place of the series: the
    velocity is the cubic that joins rest (velocity and acceleration 0) to the velocity and
    acceleration of the series, and the position its integral, so that position, velocity and
    acceleration are continuous everywhere. The arm starts and ends at rest, at positions that
    follow from the blend.

    Attributes:
        a, b: (..., n, L) [rad/s or m/s], any leading batch of trajectories.
        q0: (..., n) [rad or m], where the series is centred.
        w_f: base pulsation [rad/s].
        duration: [s].
        ramp: [s] at either end; 0 gives the bare series.
        warnings: what the user should know, one sentence each.

    Raises:
        TorchidError: the duration is not positive, or the two ramps do not fit into it.
    """

    a: Float[Tensor, "*batch n L"]
    b: Float[Tensor, "*batch n L"]
    q0: Float[Tensor, "*batch n"]
    w_f: float = BASE_PULSATION
    duration: float = 20.0
    ramp: float = 1.0
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.a.shape != self.b.shape or self.a.shape[:-1] != self.q0.shape:
            raise ValueError(
                f"a {tuple(self.a.shape)}, b {tuple(self.b.shape)} and q0 "
                f"{tuple(self.q0.shape)} are not (..., n, L), (..., n, L) and (..., n)"
            )
        if not (0 < self.duration < math.inf and 0 < self.w_f < math.inf):
            raise TorchidError(
                "a trajectory needs a positive duration and pulsation.",
                got=f"{self.duration:g} s, {self.w_f:g} rad/s",
            )
        if not 0 <= self.ramp <= self.duration / 2:
            raise TorchidError(
                "the ramps at both ends do not fit into the trajectory.",
                got=f"{self.ramp:g} s each in {self.duration:g} s",
                expected=f"between 0 and {self.duration / 2:g} s",
            )

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.q0.shape[-1]

    @property
    def harmonics(self) -> int:
        """L, the number of harmonics."""
        return self.a.shape[-1]

    @property
    def coefficients(self) -> Float[Tensor, "*batch n C"]:
        """(a, b) side by side (..., n, 2 L)."""
        return torch.cat([self.a, self.b], -1)

    @property
    def fastest(self) -> float:
        """Highest frequency of the series [Hz]."""
        return self.harmonics * self.w_f / (2 * math.pi)

    def at(self, t: Float[Tensor, " T"]) -> Motion:
        """The motion at times t (T,) [s]: q, dq, ddq, each (..., T, n).

        Before 0 and after `duration` the arm is at rest (with `ramp` 0 the series goes on).
        """
        c = self.coefficients
        q, dq, ddq = ((c @ phi.T).transpose(-1, -2) for phi in self._basis(t.to(c)))
        return Motion(q + self.q0.unsqueeze(-2), dq, ddq)

    def sample(self, rate: float) -> Motion:
        """The motion at 0, 1/rate, ... up to the duration, with these times; rate [Hz]."""
        t = sample_times(self.duration, rate).to(self.q0)
        return self.at(t)._replace(t=t)

    def extremes(self) -> Extremes:
        """Bounds that q, dq and ddq cannot leave at any instant: each (..., n, 2), lower and upper.

        On a grid that contains the ends of the blends, between two grid points h apart a function
        exceeds both by at most h^2/8 times the largest value of its second derivative, which has
        an analytic bound here. For 20 s and the default ramp the bounds are within 2e-4 of the
        motion's size of the true extremes.
        """
        c = self.coefficients
        out = []
        for phi, slack in zip(self._basis(self._grid().to(c)), self._slack(), strict=True):
            values = c @ phi.T
            out.append(torch.stack([values.amin(-1) - slack, values.amax(-1) + slack], -1))
        return Extremes(out[0] + self.q0.unsqueeze(-1), out[1], out[2])

    def scaled(self, factor: Float[Tensor, "*batch n"]) -> "FourierTrajectory":
        """The motion about q0 times a factor a joint (..., n); q0 stays."""
        return replace(self, a=self.a * factor.unsqueeze(-1), b=self.b * factor.unsqueeze(-1))

    def at_speed(self, speed: float) -> "FourierTrajectory":
        """This path at `speed` times the velocity, in 1 / speed times the duration."""
        return replace(
            self,
            a=self.a * speed,
            b=self.b * speed,
            w_f=self.w_f * speed,
            duration=self.duration / speed,
            ramp=self.ramp / speed,
        )

    def towards(
        self, rest: Float[Tensor, " n"], share: Float[Tensor, "*batch"]
    ) -> "FourierTrajectory":
        """rest + share (q - rest): the motion drawn towards a posture (n,)."""
        centre = torch.lerp(rest.expand_as(self.q0), self.q0, share.unsqueeze(-1))
        return replace(self.scaled(share.unsqueeze(-1).expand_as(self.q0)), q0=centre)

    def select(self, index: "int | Tensor") -> "FourierTrajectory":
        """One trajectory, or several, of a batch with one leading axis."""
        return replace(self, a=self.a[index], b=self.b[index], q0=self.q0[index])

    def _basis(self, t: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """phi, phi', phi'' at times t: (T, 2 L) each."""
        if self.ramp == 0:
            return self._series(t)
        t = t.clamp(0.0, self.duration)
        border = t.new_tensor([self.ramp, self.duration - self.ramp])
        joints = self._series(border)
        start = _blend(t / self.ramp, self.ramp, *(phi[0] for phi in joints))
        # The end is a start in reversed time, where velocities change their sign.
        left = (self.duration - t) / self.ramp
        end = _blend(left, self.ramp, joints[0][1], -joints[1][1], joints[2][1])
        end = (end[0], -end[1], end[2])
        early, late = (t < border[0]).unsqueeze(-1), (t > border[1]).unsqueeze(-1)
        q, dq, ddq = (
            torch.where(early, first, torch.where(late, last, middle))
            for first, middle, last in zip(start, self._series(t), end, strict=True)
        )
        return q, dq, ddq

    def _series(self, t: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        w = self.w_f * torch.arange(1, self.harmonics + 1, dtype=t.dtype, device=t.device)
        angle = t.unsqueeze(-1) * w
        sin, cos = torch.sin(angle), torch.cos(angle)
        return (
            torch.cat([sin / w, -cos / w], -1),
            torch.cat([cos, sin], -1),
            torch.cat([-sin * w, cos * w], -1),
        )

    def _grid(self) -> Tensor:
        """Times that contain 0, the borders of the blends and the duration."""
        inner = max(2, math.ceil((self.duration - 2 * self.ramp) / _SERIES_STEP) + 1)
        middle = torch.linspace(self.ramp, self.duration - self.ramp, inner, dtype=torch.float64)
        if self.ramp == 0:
            return middle
        start = torch.linspace(0, self.ramp, _RAMP_POINTS + 1, dtype=torch.float64)
        return torch.cat([start, middle, self.duration - start])

    def _slack(self) -> tuple[Tensor, Tensor, Tensor]:
        """What q, dq and ddq can exceed their values on the grid by: (..., n) each.

        The series' k-th derivative is at most sum_l (|a_l| + |b_l|) (l w_f)^(k-1). A blend's
        derivatives are at most what velocity and acceleration at its border allow: with the
        Hermite cubics of `_blend`, |q''| <= 1.5 v/r + a, |q'''| <= 6 v/r^2 + 4 a/r and
        |q''''| <= 12 v/r^3 + 6 a/r^2.
        """
        size = self.a.detach().abs() + self.b.detach().abs()
        w = self.w_f * torch.arange(1, self.harmonics + 1, dtype=size.dtype, device=size.device)
        v, a, jerk, snap = ((size * w**k).sum(-1) for k in range(4))
        h = _SERIES_STEP**2 / 8
        series = (h * a, h * jerk, h * snap)
        if self.ramp == 0:
            return series
        r = self.ramp
        blends = (1.5 * v / r + a, 6 * v / r**2 + 4 * a / r, 12 * v / r**3 + 6 * a / r**2)
        h = (r / _RAMP_POINTS) ** 2 / 8
        q, dq, ddq = (torch.maximum(s, h * p) for s, p in zip(series, blends, strict=True))
        return q, dq, ddq


def stacked(many: Sequence[FourierTrajectory]) -> FourierTrajectory:
    """Several trajectories of one shape as a batch."""
    parts = zip(*((x.a, x.b, x.q0) for x in many), strict=True)
    a, b, q0 = (torch.stack(part) for part in parts)
    return replace(many[0], a=a, b=b, q0=q0)


def midpoints(duration: float, count: int) -> Float[Tensor, " T"]:
    """Middles of `count` equal parts of a duration [s]."""
    return (torch.arange(count, dtype=torch.float64) + 0.5) * (duration / count)


def sample_times(duration: float, rate: float) -> Float[Tensor, " T"]:
    """0, 1/rate, ... up to the duration [s].

    Raises:
        TorchidError: the rate is not positive, or too low for two samples.
    """
    if not (0 < rate < math.inf and duration * rate >= 1):
        raise TorchidError(
            "the sampling rate is too low for the trajectory.",
            got=f"{rate:g} Hz over {duration:g} s",
        )
    # The last instant may miss the duration by rounding.
    count = math.floor(duration * rate * (1 + 1e-12) + 1e-9) + 1
    return torch.arange(count, dtype=torch.float64) / rate


def _blend(
    tau: Tensor, r: float, q: Tensor, dq: Tensor, ddq: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """From rest at tau = 0 to (q, dq, ddq) at tau = 1, r seconds later: (T, ...) each.

    Velocity dq h(tau) + r ddq g(tau) with h = 3 tau^2 - 2 tau^3 and g = tau^3 - tau^2, position
    its integral backwards from q.
    """
    tau = tau.unsqueeze(-1)
    h, g = tau**2 * (3 - 2 * tau), tau**2 * (tau - 1)
    left_h = 0.5 - tau**3 * (1 - tau / 2)
    left_g = -1 / 12 - tau**3 * (tau / 4 - 1 / 3)
    return (
        q - r * dq * left_h - r**2 * ddq * left_g,
        dq * h + r * ddq * g,
        dq / r * (6 * tau * (1 - tau)) + ddq * (tau * (3 * tau - 2)),
    )
