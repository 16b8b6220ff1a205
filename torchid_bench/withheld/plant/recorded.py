"""Motions as people record them: from pose to pose, with halts between; no sums of sinusoids."""

from dataclasses import dataclass, replace

import numpy as np

from torchid_bench.withheld.plant.arms import Arm
from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.scene import HEADROOM, Nominal

Rng = np.random.Generator

_PEAKS = 2.1875, 7.5132
"""Largest speed and acceleration of a step of 1 in 1 s."""
_BRISK = 0.3  # seconds to the velocity limit, at the limit of acceleration


@dataclass(frozen=True)
class Style:
    """How people move an arm.

    Attributes:
        level: share of the velocity limits.
        dwell: halts between two poses [s].
        reach: of poses about the middle one, as a share of the position range.
        poses: of how many poses it is a cycle; 0 where each pose is a new one.
        single: whether one joint moves after another.
        tremor: of a hand that leads the arm [rad].
    """

    level: tuple[float, float]
    dwell: tuple[float, float]
    reach: float
    poses: int = 0
    single: bool = False
    tremor: float = 0.0


STYLES = {
    "pick and place": Style((0.3, 0.8), (0.3, 1.5), 0.35, poses=5),
    "one joint after another": Style((0.2, 0.6), (0.2, 0.8), 0.5, single=True),
    "slow teaching": Style((0.1, 0.25), (0.5, 3.0), 0.3, tremor=3e-3),
    "one region": Style((0.3, 0.9), (0.0, 0.5), 0.15),
}


@dataclass(frozen=True)
class Recorded:
    """A motion from pose to pose, of seventh order, so that jerk is continuous.

    Attributes:
        poses: (K + 1, n) [rad].
        begins, lasts: (K,) when each step begins and how long it lasts [s].
        tremor: (n, 2, 3) amplitude [rad], frequency [Hz] and phase of two waves on each joint.
        seconds: length [s].
    """

    poses: Array
    begins: Array
    lasts: Array
    tremor: Array
    seconds: float

    def state(self, t: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration (T, n) at times (T,)."""
        k = np.clip(np.searchsorted(self.begins, t, "right") - 1, 0, len(self.begins) - 1)
        long = self.lasts[k][:, None]
        s = np.clip((t - self.begins[k])[:, None] / long, 0.0, 1.0)
        step = self.poses[k + 1] - self.poses[k]
        x = s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
        dx = 140 * (s * (1 - s)) ** 3 / long
        ddx = 420 * (s * (1 - s)) ** 2 * (1 - 2 * s) / long**2
        # A hand trembles while it leads.
        u, du, ddu = s * (1 - s), (1 - 2 * s) / long, -2 / long**2
        w = (4 * u) ** 4
        dw = 4**5 * u**3 * du
        ddw = 4**5 * (3 * u**2 * du**2 + u**3 * ddu)
        a, f, phase = np.moveaxis(self.tremor, -1, 0)
        omega = 2 * np.pi * f
        angle = omega * t[:, None, None] + phase
        y, dy = (a * np.sin(angle)).sum(-1), (a * omega * np.cos(angle)).sum(-1)
        ddy = -(a * omega**2 * np.sin(angle)).sum(-1)
        return (
            self.poses[k] + x * step + w * y,
            dx * step + dw * y + w * dy,
            ddx * step + ddw * y + 2 * dw * dy + w * ddy,
        )

    def slower(self, factor: float) -> "Recorded":
        """The same poses in so many times as long."""
        times = replace(self, begins=self.begins * factor, lasts=self.lasts * factor)
        return replace(times, seconds=self.seconds * factor)


def recorded(
    rng: Rng, arm: Arm, nominal: Nominal, style: str, seconds: float, centre: Array
) -> Recorded:
    """A motion in a style, of about so many seconds, that the arm's motors bear.

    Args:
        rng: what is drawn.
        arm, nominal: that moves.
        style: of `STYLES`.
        seconds: length; a cycle that has begun is not cut.
        centre: (n,) about which it moves, from -1 to 1 of the position range.
    """
    own = STYLES[style]
    lower, upper, speed = (
        np.array([getattr(j, limit) for j in arm.joints])
        for limit in ("lower", "upper", "velocity")
    )
    half, middle = (upper - lower) / 2, (upper + lower) / 2
    level, clock = rng.uniform(*own.level), rng.uniform(0.3, 1.0)
    turns = rng.permutation(arm.n)
    cycle = [rng.uniform(-own.reach, own.reach, arm.n) for _ in range(own.poses)]
    poses, begins, lasts = [centre + (cycle[0] if cycle else 0.0)], list[float](), list[float]()
    while clock < seconds:
        number = len(lasts)
        if cycle:
            goal = centre + cycle[(number + 1) % len(cycle)]
        elif own.single:
            # There, to the other side, and back.
            joint, side = turns[number // 3 % arm.n], (1.0, -1.0, 0.0)[number % 3]
            goal = poses[-1].copy()
            goal[joint] = centre[joint] + side * own.reach * rng.uniform(0.5, 1.0)
        else:
            goal = centre + rng.uniform(-own.reach, own.reach, arm.n)
        goal = np.clip(goal, -0.9, 0.9)
        far = np.abs(goal - poses[-1]) * half
        least = np.maximum(
            _PEAKS[0] * far / (level * speed),
            np.sqrt(_PEAKS[1] * far / (level * speed / _BRISK)),
        )
        lasts.append(float(max(least.max(), 0.2)))
        begins.append(clock)
        clock += lasts[-1] + rng.uniform(*own.dwell)
        poses.append(goal)
    waves = np.stack(
        [own.tremor * rng.uniform(0.3, 1.0, (arm.n, 2)), rng.uniform(0.7, 3.0, (arm.n, 2)),
         rng.uniform(0, 2 * np.pi, (arm.n, 2))], -1,
    )  # fmt: skip
    motion = Recorded(
        middle + half * np.array(poses), np.array(begins), np.array(lasts), waves, clock
    )
    tried = (motion.slower(factor) for factor in (1.0, 1.2, 1.4, 1.7, 2.0, 3.0))
    return next((m for m in tried if _borne(m, arm, nominal)), motion.slower(4.0))


def _borne(motion: Recorded, arm: Arm, nominal: Nominal) -> bool:
    """Whether the motors bear a motion."""
    q, dq, ddq = motion.state(np.arange(0, motion.seconds, 0.05))
    torque = nominal.rigid(q, dq, ddq) + nominal.damping * dq
    return bool((np.abs(torque) + nominal.friction < arm.available(dq) * HEADROOM).all())
