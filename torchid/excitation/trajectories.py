"""Trajectories to run on a robot: random, the report's own, sinusoids; and their files."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.effects.base import Motion
from torchid.excitation.fourier import (
    BASE_PULSATION,
    Extremes,
    FourierTrajectory,
    sample_times,
)
from torchid.excitation.limits import largest_scale, motion_limits
from torchid.excitation.settings import HARMONICS
from torchid.log.model import Log
from torchid.robot.config_files import config_folder
from torchid.robot.model import Robot
from torchid.typing import Float
from torchid.yaml_data import parsed_yaml


def paper_trajectories_3r() -> FourierTrajectory:
    """The three trajectories of table 5.1, a batch (3,), with the coefficients as printed.

    They keep the 3R's limits (table 3.3), so no scaling is applied.
    """
    path = config_folder("trajectories") / "3r_table_5_1.yaml"
    data = parsed_yaml(path.read_text(encoding="utf-8"))
    a, b, q0 = (
        torch.tensor([entry[key] for entry in data["trajectories"]], dtype=torch.float64)
        for key in ("a", "b", "q0")
    )
    w_f = math.pi * data["w_f_over_pi"]
    return FourierTrajectory(a, b, q0, w_f, data["duration"], data["ramp"])


def random_trajectory(
    robot: Robot,
    seed: int,
    *,
    count: int | None = None,
    fill: bool = False,
    usage: float = 1.0,
    harmonics: int = HARMONICS,
    w_f: float = BASE_PULSATION,
    duration: float = 20.0,
    ramp: float = 1.0,
) -> FourierTrajectory:
    """Fourier series with random coefficients that keeps the robot's limits at every instant.

    Coefficients are uniform in +-0.5 rad/s (m/s), centres in the inner fifth of the position range,
    as in table 5.1. A joint that would leave a limit is scaled down until it touches it.

    Args:
        robot: its limits.
        seed: of the coefficients.
        count: how many; a leading batch axis of this length, or none if None.
        fill: scale every joint, up too, until it touches a limit.
        usage: share of the limits that may be used.
        harmonics, w_f, duration, ramp: see FourierTrajectory.

    Raises:
        RobotError: the limits are incomplete, see `motion_limits`.
    """
    limits = motion_limits(robot, usage=usage)
    generator = torch.Generator().manual_seed(seed)
    shape = (1 if count is None else count, robot.n)

    def uniform(*size: int) -> Tensor:
        return 2 * torch.rand(size, generator=generator, dtype=torch.float64) - 1

    # 0.5: random a and b lie within +-0.5 rad/s, as in table 5.1
    a, b = (0.5 * uniform(*shape, harmonics) for _ in range(2))
    # 0.2: of the half range; table 5.1 has q0 within +-0.5 of +-2.9 rad
    q0 = limits.middle + 0.2 * limits.half_range * uniform(*shape)
    raw = FourierTrajectory(a, b, q0, w_f, duration, ramp, limits.warnings)
    scale = largest_scale(raw, limits)
    scaled = raw.scaled(scale if fill else scale.clamp(max=1.0))
    return scaled if count is not None else scaled.select(0)


@dataclass(frozen=True, eq=False)
class Sinusoid:
    """dq_i(t) = A_i sin(2 pi t / T_i) (eq. 5.2), at rest at t = 0, for validation.

    Attributes:
        amplitude: A (n,) [rad/s or m/s], of either sign.
        period: T (n,) [s].
        start: q(0) (n,) [rad or m].
        duration: [s].
        warnings: what the user should know.
    """

    amplitude: Float[Tensor, " n"]
    period: Float[Tensor, " n"]
    start: Float[Tensor, " n"]
    duration: float = 10.0
    warnings: tuple[str, ...] = ()

    @property
    def fastest(self) -> float:
        """Highest frequency [Hz]."""
        return 1 / float(self.period.min())

    def at_speed(self, speed: float) -> "Sinusoid":
        """This path at `speed` times the velocity, in 1 / speed times the duration."""
        return replace(
            self,
            amplitude=self.amplitude * speed,
            period=self.period / speed,
            duration=self.duration / speed,
        )

    def towards(self, rest: Float[Tensor, " n"], share: Float[Tensor, ""]) -> "Sinusoid":
        """rest + share (q - rest): the motion drawn towards a posture (n,)."""
        start = torch.lerp(rest, self.start, share)
        return replace(self, amplitude=share * self.amplitude, start=start)

    def at(self, t: Float[Tensor, " T"]) -> Motion:
        """q, dq, ddq at times t (T,): (T, n) each."""
        w = 2 * math.pi / self.period
        angle = t.to(w).unsqueeze(-1) * w
        sin, cos = torch.sin(angle), torch.cos(angle)
        return Motion(
            self.start + self.amplitude / w * (1 - cos),
            self.amplitude * sin,
            self.amplitude * w * cos,
        )

    def sample(self, rate: float) -> Motion:
        """The motion at 0, 1/rate, ... up to the duration, with these times; rate [Hz]."""
        t = sample_times(self.duration, rate)
        return self.at(t)._replace(t=t)

    def extremes(self) -> Extremes:
        """Bounds on q, dq, ddq at any instant: (n, 2) each, lower and upper."""
        w = 2 * math.pi / self.period
        size = self.amplitude.abs()
        ends = torch.stack([self.start, self.start + 2 * self.amplitude / w], -1)
        both = torch.tensor([-1.0, 1.0]).to(size)
        return Extremes(
            torch.sort(ends, -1).values,
            size.unsqueeze(-1) * both,
            (size * w).unsqueeze(-1) * both,
        )


def sinusoid(robot: Robot, seed: int, *, duration: float = 10.0, usage: float = 1.0) -> Sinusoid:
    """A random validation motion (eq. 5.2) that keeps the robot's limits at every instant.

    Periods are uniform between a fifth of the duration and the whole of it. Given the period T, the
    three limits allow |A| up to min(v, a T / 2 pi, range pi / T); |A| is uniform between 0.3 and 1
    of that, the sign random, the start uniform where the stroke A T / pi fits.

    Raises:
        RobotError: the limits are incomplete, see `motion_limits`.
    """
    limits = motion_limits(robot, usage=usage)
    generator = torch.Generator().manual_seed(seed)
    period, size, sign, place = torch.rand(
        4, robot.n, generator=generator, dtype=torch.float64
    ).unbind()
    # of a sinusoid's duration
    shortest_period_share = 0.2
    period = duration * (shortest_period_share + (1 - shortest_period_share) * period)
    # A sinusoid goes as far up as down: of both limits the smaller counts.
    speed, acceleration = (x.abs().amin(-1) for x in (limits.velocity, limits.acceleration))
    largest = torch.minimum(
        torch.minimum(speed, acceleration * period / (2 * math.pi)),
        2 * limits.half_range * math.pi / period,
    ) * (1 - 1e-9)
    # of the fastest that the limits allow
    smallest_speed_share = 0.3
    amplitude = largest * (smallest_speed_share + (1 - smallest_speed_share) * size)
    amplitude = torch.where(sign < 0.5, -amplitude, amplitude)
    stroke = amplitude * period / math.pi
    lowest = limits.position[:, 0] - stroke.clamp(max=0)
    highest = limits.position[:, 1] - stroke.clamp(min=0)
    start = lowest + place * (highest - lowest)
    return Sinusoid(amplitude, period, start, duration, limits.warnings)


def trajectory_log(
    trajectory: FourierTrajectory | Sinusoid, rate: float, names: Sequence[str] = ()
) -> Log:
    """The planned motion as a log without torque: t, q, dq, ddq.

    Args:
        trajectory: a batch of any shape becomes as many trajectories, in order.
        rate: samples per second [Hz].
        names: one a trajectory.
    """
    motion = trajectory.sample(rate)
    samples, n = motion.q.shape[-2:]
    count = motion.q.numel() // (samples * n)
    return Log(
        t=motion.require("t", "a log").repeat(count),
        q=motion.q.reshape(-1, n),
        dq=motion.dq.reshape(-1, n),
        ddq=motion.ddq.reshape(-1, n),
        trajectory=torch.arange(count).repeat_interleave(samples),
        names=tuple(names),
        source="trajectory",
        warnings=trajectory.warnings,
    )
