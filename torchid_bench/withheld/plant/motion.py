"""Reference motions: random sums of sinusoids that begin and end at rest, within the limits."""

from dataclasses import dataclass, replace

import numpy as np

from torchid_bench.withheld.plant.arms import Arm
from torchid_bench.withheld.plant.bodies import Array

FADE = 1.2
"""Seconds in which a motion comes and goes, with continuous jerk."""

SETTLE = 1.0
"""Seconds at rest before a trajectory is logged."""

_HARMONICS = 5  # sinusoids a joint
_REACH = 0.85  # share of the position range that is used
_BRISK = 0.3  # seconds to the velocity limit, at the limit of acceleration


@dataclass(frozen=True)
class MotionPlan:
    """What is drawn of a case's trajectories.

    Attributes:
        seed: of the sums of sinusoids.
        shapes: which sum each trajectory follows; equal numbers are repeats.
        levels: share of the velocity limit that each sum may use.
        seconds: length of each sum.
        pauses: before each trajectory [s], on the log's clock.
        moving: joints (from 0) that move; the others stay.
        reach: share of the position range that may be used, of what is usual.
    """

    seed: int
    shapes: tuple[int, ...]
    levels: tuple[float, ...]
    seconds: tuple[float, ...]
    pauses: tuple[float, ...]
    moving: tuple[int, ...]
    reach: float = 1.0


@dataclass(frozen=True)
class Sum:
    """q(t) = middle + fade(t) sum_k amplitude_k sin(2 pi f_k t + phase_k).

    Attributes:
        middle: (n,) [rad].
        amplitudes, frequencies, phases: (n, K) [rad; Hz; rad].
        seconds: length.
    """

    middle: Array
    amplitudes: Array
    frequencies: Array
    phases: Array
    seconds: float

    def state(self, t: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration (T, n) at times (T,); at rest outside."""
        omega = 2 * np.pi * self.frequencies
        angle = omega * t[:, None, None] + self.phases
        wave, cowave = self.amplitudes * np.sin(angle), self.amplitudes * np.cos(angle)
        x = wave.sum(-1)
        dx = (omega * cowave).sum(-1)
        ddx = -(omega**2 * wave).sum(-1)
        w, dw, ddw = (a[:, None] for a in _fade(t, self.seconds))
        q = self.middle + w * x
        return q, w * dx + dw * x, w * ddx + 2 * dw * dx + ddw * x

    def scaled(self, factor: Array | float) -> "Sum":
        """The sum with its amplitudes times a factor, () or (n,)."""
        factor = np.broadcast_to(factor, self.middle.shape)
        return replace(self, amplitudes=self.amplitudes * factor[:, None])


def sums(arm: Arm, plan: MotionPlan) -> list[Sum]:
    """The different motions of a plan, each within the limits at its level of speed."""
    lower, upper, speed = (
        np.array([getattr(j, limit) for j in arm.joints])
        for limit in ("lower", "upper", "velocity")
    )
    shape, moves = (arm.n, _HARMONICS), np.isin(np.arange(arm.n), plan.moving)
    out = []
    for number, (level, seconds) in enumerate(zip(plan.levels, plan.seconds, strict=True)):
        rng = np.random.default_rng([plan.seed, number])
        # A slower motion is the same dance at lower frequencies, not only a smaller one.
        frequencies = np.sort(rng.uniform(0.08, 0.75, shape), axis=1) * max(level, 0.15) ** 0.6
        amplitudes = rng.uniform(0.3, 1.0, shape) / (frequencies + 0.15)
        phases = rng.uniform(0, 2 * np.pi, shape)
        room = (upper - lower) / 2 * _REACH
        middle = (upper + lower) / 2 + rng.uniform(-0.25, 0.25, arm.n) * room
        raw = Sum(middle, amplitudes, frequencies, phases, seconds)
        grid = np.arange(0, seconds, 0.01)
        q, dq, ddq = (np.abs(x).max(0) for x in replace(raw, middle=middle * 0).state(grid))
        left = np.minimum(upper - middle, middle - lower) * _REACH * plan.reach
        factor = np.minimum(left / q, level * speed / dq)
        factor = np.minimum(factor, level * speed / _BRISK / ddq)
        out.append(raw.scaled(factor * moves))
    return out


def _fade(t: Array, seconds: float) -> tuple[Array, Array, Array]:
    """1 in the middle, 0 outside, three times continuously differentiable; two derivatives."""
    up, down = np.clip(t / FADE, 0, 1), np.clip((seconds - t) / FADE, 0, 1)
    rising = t < seconds / 2
    x, sign = np.where(rising, up, down), np.where(rising, 1.0, -1.0) / FADE
    w = x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)
    dw = 140 * x**3 * (1 - x) ** 3
    ddw = 420 * x**2 * (1 - x) ** 2 * (1 - 2 * x)
    return w, dw * sign, ddw / FADE**2
