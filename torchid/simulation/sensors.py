"""What sensors and loggers make of a true motion and a true torque."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torchid.effects.base import Motion
from torchid.effects.registry import Valued
from torchid.errors import LogError, TorchidError
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.simulation.loads import changes_measurement

ENCODER_STEP = 2 * math.pi / 2**18
"""An 18-bit encoder on the link side [rad]."""


@dataclass(frozen=True)
class HonestNoise:
    """What sensors make of a motion and its torque. The log has no accelerations.

    Attributes:
        encoder_step: positions are rounded to multiples of it [rad or m]; one for all joints, or
            one a joint; 0 for exact positions.
        torque_relative: standard deviation of the torque noise, as a share of the RMS torque of
            each joint and trajectory.
        colour_hz: None for white torque noise; otherwise it is first-order low-pass noise (AR(1))
            of the same standard deviation, with this cut-off [Hz].
        include_velocity: whether velocities are measured.
        velocity_relative: standard deviation of their white noise, as a share of the RMS velocity.

    Raises:
        TorchidError: a size that is negative, a cut-off that is no frequency.

    >>> HonestNoise(torque_relative=0.02).encoder_step == ENCODER_STEP
    True
    """

    encoder_step: float | tuple[float, ...] = ENCODER_STEP
    torque_relative: float = 0.01
    colour_hz: float | None = None
    include_velocity: bool = False
    velocity_relative: float = 0.0

    def __post_init__(self) -> None:
        steps = self.encoder_step if isinstance(self.encoder_step, tuple) else (self.encoder_step,)
        sizes = (*steps, self.torque_relative, self.velocity_relative)
        if not all(math.isfinite(x) and x >= 0 for x in sizes):
            raise TorchidError("sizes of noise must not be negative.", got=self)
        if self.colour_hz is not None and not 0 < self.colour_hz < math.inf:
            raise TorchidError(
                "the cut-off of coloured noise is a frequency.", got=self.colour_hz, expected="> 0"
            )


@dataclass(frozen=True)
class Sensors:
    """Sensors and logger of an arm.

    Attributes:
        noise: of positions, torques and velocities.
        torque_std: standard deviation of the torque noise [N m; N], one for all joints or one a
            joint, in place of the noise's share of the RMS torque.
        jitter: standard deviation of the instants at which samples are taken [s]; the time stamps
            are those instants.
        every: the logger keeps every k-th sample.
    """

    noise: HonestNoise = field(default_factory=HonestNoise)
    torque_std: float | tuple[float, ...] | None = None
    jitter: float = 0.0
    every: int = 1

    def __post_init__(self) -> None:
        given = () if self.torque_std is None else self.torque_std
        sizes = (*(given if isinstance(given, tuple) else (given,)), self.jitter)
        if not all(math.isfinite(x) and x >= 0 for x in sizes) or self.every < 1:
            raise TorchidError("sizes of noise must not be negative.", got=self)


def sensed_log(robot: Robot, log: Log, effects: Sequence[Valued]) -> Log:
    """What the effects in the sensors make of a true motion: a gain, a delay, a compliance under
    the encoder, ...

    Args:
        robot: the true arm.
        log: true q, dq, ddq, tau of one or several trajectories, e.g. of `closed_loop`.
        effects: of this arm, in the order in which they act; those that change how it moves are
            passed over.

    Raises:
        LogError: a signal is missing.
    """
    missing = [name for name in ("dq", "ddq", "tau") if getattr(log, name) is None]
    if missing:
        raise LogError(
            "a true motion has q, dq, ddq and tau.",
            got=list(log.signals),
            hint="`closed_loop` gives all of them",
        )
    parts = []
    for part in log.trajectories():
        assert part.dq is not None
        assert part.ddq is not None
        motion = Motion(part.q, part.dq, part.ddq, t=part.t - part.t[0], torque=part.tau)
        for effect, values in effects:
            if changes_measurement(effect):
                motion = effect.measured(motion, values, robot)
        q, dq, ddq = motion.state
        parts.append(part.replace(q=q, dq=dq, ddq=ddq, tau=motion.torque))
    return Log.concatenate(parts).replace(source=log.source)


def measured_log(
    robot: Robot, log: Log, effects: Sequence[Valued], sensors: Sensors, seed: int = 0
) -> Log:
    """The log that sensors and logger make of a true motion.

    In this order: the effects that are in the sensors (see `sensed_log`), sampling, noise, then
    samples that the logger loses.

    Args:
        robot: for the number of its joints.
        log: true q, dq, ddq, tau of one or several trajectories, e.g. of `closed_loop`.
        effects: of this arm; those that change how it moves are passed over.
        sensors: noise and sampling.
        seed: of the noise; the log is a function of it.

    Raises:
        LogError: a signal is missing.
        TorchidError: the noise does not fit the robot or the sampling rate.
    """
    generator = torch.Generator().manual_seed(seed)
    lost = [pair for pair in effects if pair[0].after_noise]
    others = [pair for pair in effects if not pair[0].after_noise]
    seen = sensed_log(robot, log, others)
    parts = [_measured(robot, part, sensors, generator) for part in seen.trajectories()]
    return Log.concatenate([_held(p, lost) for p in parts]).replace(source=log.source)


def _held(log: Log, lost: Sequence[Valued]) -> Log:
    """What the logger makes of it: samples that it loses are the last ones, noise and all."""
    assert log.tau is not None
    motion = Motion(log.q, log.q, log.q, t=log.t - log.t[0], torque=log.tau)
    for effect, values in lost:
        motion = effect.measured(motion, values)
    return log.replace(tau=motion.torque)


def _measured(robot: Robot, log: Log, sensors: Sensors, generator: torch.Generator) -> Log:
    t, q, dq, tau = _sampled(log, sensors, generator)
    noise = sensors.noise
    rate = Log(t, q).rates[0] if len(t) > 1 else 1.0
    size = noise.torque_relative * rms(tau)
    if sensors.torque_std is not None:
        size = _one_a_joint(sensors.torque_std, robot, "size of torque noise")
    white = standard(tau, noise.colour_hz, rate, generator)
    measured = Log(t, counted(q, noise, robot), tau=tau + size * white, names=log.names)
    if not noise.include_velocity:
        return measured
    white = standard(dq, None, rate, generator)
    return measured.replace(dq=dq + noise.velocity_relative * rms(dq) * white)


def _sampled(
    log: Log, sensors: Sensors, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Stamps, positions, velocities and torques when samples are taken."""
    assert log.dq is not None
    assert log.tau is not None
    t, kept = log.t, log.t[:: sensors.every]
    if sensors.jitter == 0:
        q, dq, tau = (x[:: sensors.every] for x in (log.q, log.dq, log.tau))
        return kept, q, dq, tau
    step = float(kept[1] - kept[0]) if len(kept) > 1 else 0.0
    shift = sensors.jitter * torch.randn(len(kept), generator=generator, dtype=torch.float64)
    # Less than half a step either way: the order of the samples stays.
    instants = (kept + shift.clamp(-0.45 * step, 0.45 * step)).clamp(float(t[0]), float(t[-1]))
    # Torques step, where a spline would ring.
    right = torch.searchsorted(t, instants).clamp(1, len(t) - 1)
    share = ((instants - t[right - 1]) / (t[right] - t[right - 1])).unsqueeze(-1)
    return (
        instants,
        _between(t, log.q, instants),
        _between(t, log.dq, instants),
        (log.tau[right - 1] + share * (log.tau[right] - log.tau[right - 1])),
    )


def _between(t: Tensor, x: Tensor, at: Tensor) -> Tensor:
    from scipy.interpolate import CubicSpline

    return torch.from_numpy(CubicSpline(t.numpy(), x.numpy())(at.numpy()))


def _one_a_joint(given: float | tuple[float, ...], robot: Robot, what: str) -> Tensor:
    values = given if isinstance(given, tuple) else (given,) * robot.n
    if len(values) != robot.n:
        raise TorchidError(
            f"one {what}, or one a joint, is needed.", got=len(values), expected=robot.n
        )
    return torch.tensor(values, dtype=torch.float64)


def counted(q: Tensor, noise: HonestNoise, robot: Robot) -> Tensor:
    """Positions rounded to the encoder's steps."""
    step = _one_a_joint(noise.encoder_step, robot, "encoder step").to(q)
    safe = torch.where(step > 0, step, torch.ones_like(step))
    return torch.where(step > 0, torch.round(q / safe) * safe, q)


def rms(x: Tensor) -> Tensor:
    """Root mean square of each joint's signal (n,)."""
    return x.square().mean(0).sqrt()


def standard(
    like: Tensor, colour_hz: float | None, rate: float, generator: torch.Generator
) -> Tensor:
    """Noise (T, n) of standard deviation 1: white, or AR(1), stationary from the first sample."""
    white = torch.randn(like.shape, generator=generator, dtype=torch.float64)
    if colour_hz is None:
        return white.to(like)
    if not colour_hz < rate / 2:
        raise TorchidError(
            "the cut-off of coloured noise is above half the sampling rate.",
            got=f"{colour_hz:g} Hz",
            expected=f"below {rate / 2:g} Hz",
        )
    from scipy.signal import lfilter

    keep = math.exp(-2 * math.pi * colour_hz / rate)
    driven = white * math.sqrt(1 - keep**2)
    driven[0] = white[0]
    return torch.from_numpy(lfilter([1.0], [1.0, -keep], driven.numpy(), axis=0)).to(like)
