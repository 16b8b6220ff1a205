"""Synthetic logs: the torque of the nominal robot along a motion, and what sensors make of it.

Two kinds of noise. The report's (chapter 5) is added to the trajectory before the torque is
computed from it, so the log is free of contradictions and least squares recovers the parameters to
rounding: it tests the algebra. The honest one is what an arm has: the torque belongs to the true
motion, the encoder counts in steps, accelerations are not measured and torques are noisy.
"""

import math
from dataclasses import dataclass

import torch
from scipy.signal import lfilter
from torch import Tensor

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.effects.registry import nominal_effect_torque
from torchid.errors import LogError, TorchidError
from torchid.log.model import JOINT_SIGNALS, Log
from torchid.log.sampling import sampling_rate
from torchid.robot.model import Robot
from torchid.typing import Float

ENCODER_STEP = 2 * math.pi / 2**18
"""An 18-bit encoder on the link side [rad]."""


@dataclass(frozen=True)
class PaperNoise:
    """White noise on q, dq and ddq; the torque is computed from the noisy motion.

    Attributes:
        snr_db: ratio of each signal's mean square to the noise variance, a joint and trajectory
            [dB].
    """

    snr_db: float = 30.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.snr_db):
            raise TorchidError("the signal-to-noise ratio is not a number.", got=self.snr_db)


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


NoiseModel = PaperNoise | HonestNoise | None


def synthetic_log(
    robot: Robot,
    motion: Log,
    noise: NoiseModel = None,
    seed: int = 0,
    *,
    device: torch.device | str = "cpu",
) -> Log:
    """A log of the robot with its nominal parameters and effects moving as `motion` says.

    Args:
        robot: with nominal parameters.
        motion: t, q, dq, ddq, e.g. from `trajectory_log`; other signals are ignored.
        noise: None for the exact q, dq, ddq, tau.
        seed: of the noise; the log is a function of it.
        device: where torques are computed; the log stays on the CPU.

    Raises:
        RobotError: the robot has no nominal parameters.
        LogError: the motion has no dq or ddq, or another number of joints.
        TorchidError: the noise model does not fit the robot or the sampling rate.
    """
    _check(robot, motion)
    generator = torch.Generator().manual_seed(seed)
    parts = motion.trajectories()
    rates = sampling_rate(motion) if isinstance(noise, HonestNoise) else [0.0] * len(parts)
    made = [
        _one(robot, _motion(part), noise, rate, generator, device)
        for part, rate in zip(parts, rates, strict=True)
    ]
    signals = {name: torch.cat([signal[name] for signal in made]) for name in made[0]}
    none = dict.fromkeys(JOINT_SIGNALS)
    return motion.replace(**none | signals, source=f"simulated {robot.name}")


def nominal_torque(robot: Robot, motion: Motion) -> Float[Tensor, "*batch n"]:
    """Torque (..., n) [N m; N] of the nominal rigid body and the nominal effects.

    Raises:
        RobotError: the robot has no nominal parameters.
    """
    return inverse_dynamics(robot, *motion.state) + nominal_effect_torque(robot, motion)


def _check(robot: Robot, motion: Log) -> None:
    robot.require_parameters("simulation")
    if motion.n != robot.n:
        raise LogError(
            f"the motion does not fit robot '{robot.name}'.",
            got=f"{motion.n} joints",
            expected=f"{robot.n} joints",
        )
    missing = [name for name in ("dq", "ddq") if getattr(motion, name) is None]
    if missing:
        raise LogError(
            f"the motion has no {' and no '.join(missing)}, from which torque is computed.",
            available=list(motion.signals),
            expected="q, dq and ddq",
            hint="`torchid excite` writes all three",
        )


def _motion(part: Log) -> Motion:
    assert part.dq is not None
    assert part.ddq is not None
    return Motion(part.q, part.dq, part.ddq)


def _one(
    robot: Robot,
    true: Motion,
    noise: NoiseModel,
    rate: float,
    generator: torch.Generator,
    device: torch.device | str,
) -> dict[str, Tensor]:
    """The signals of one trajectory that a log has, (T, n) each."""
    if noise is None or isinstance(noise, PaperNoise):
        moved = true if noise is None else _noisy_motion(true, noise, generator)
        return {
            "q": moved.q,
            "dq": moved.dq,
            "ddq": moved.ddq,
            "tau": nominal_torque(robot, moved.to(device)).cpu(),
        }
    tau = nominal_torque(robot, true.to(device)).cpu()
    tau = tau + noise.torque_relative * _rms(tau) * _standard(tau, noise.colour_hz, rate, generator)
    measured = {"q": _counted(true.q, noise, robot), "tau": tau}
    if noise.include_velocity:
        white = _standard(tau, None, rate, generator)
        measured["dq"] = true.dq + noise.velocity_relative * _rms(true.dq) * white
    return measured


def _noisy_motion(true: Motion, noise: PaperNoise, generator: torch.Generator) -> Motion:
    size = 10 ** (-noise.snr_db / 20)
    return Motion(*(x + size * _rms(x) * _standard(x, None, 0.0, generator) for x in true.state))


def _counted(q: Tensor, noise: HonestNoise, robot: Robot) -> Tensor:
    """Positions rounded to the encoder's steps."""
    given = noise.encoder_step
    steps = given if isinstance(given, tuple) else (given,) * robot.n
    if len(steps) != robot.n:
        raise TorchidError(
            "one encoder step, or one a joint, is needed.", got=len(steps), expected=robot.n
        )
    step = q.new_tensor(steps)
    safe = torch.where(step > 0, step, torch.ones_like(step))
    return torch.where(step > 0, torch.round(q / safe) * safe, q)


def _rms(x: Tensor) -> Tensor:
    """Root mean square of each joint's signal (n,)."""
    return x.square().mean(0).sqrt()


def _standard(
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
    keep = math.exp(-2 * math.pi * colour_hz / rate)
    driven = white * math.sqrt(1 - keep**2)
    driven[0] = white[0]
    return torch.from_numpy(lfilter([1.0], [1.0, -keep], driven.numpy(), axis=0)).to(like)
