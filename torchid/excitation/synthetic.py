"""Synthetic logs: the torque of the nominal robot along a motion, and what sensors make of it.

Two kinds of noise. The report's (chapter 5) is added to the trajectory before the torque is
computed from it, so the log is free of contradictions and least squares recovers the parameters to
rounding: it tests the algebra. The honest one is what an arm has: the torque belongs to the true
motion, the encoder counts in steps, accelerations are not measured and torques are noisy.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from torchid.effects.base import Motion
from torchid.effects.registry import (
    Valued,
    effect_from_record,
    model_torque,
    nominal_effects,
)
from torchid.errors import LogError, TorchidError
from torchid.inputs import LogLike, RobotLike, as_log, as_robot
from torchid.log.columns import JOINT_SIGNALS
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.simulation.closed_loop import closed_loop as under_control
from torchid.simulation.controller import Controller
from torchid.simulation.sensors import (
    HonestNoise,
    Sensors,
    counted,
    measured_log,
    rms,
    sensed_log,
    standard,
)
from torchid.typing import Float


@dataclass(frozen=True)
class PaperNoise:
    """White noise on q, dq and ddq; the torque is computed from the noisy motion.

    Attributes:
        snr_db: ratio of each signal's mean square to the noise variance, a joint and trajectory
            [dB].

    Raises:
        TorchidError: not a number.

    >>> PaperNoise().snr_db
    30.0
    """

    snr_db: float = 30.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.snr_db):
            raise TorchidError("the signal-to-noise ratio is not a number.", got=self.snr_db)


NoiseModel = PaperNoise | HonestNoise | None
Noise = Literal["none", "paper", "honest"]
HONEST = HonestNoise()


def simulate(
    robot: RobotLike,
    motion: LogLike,
    *,
    effects: Sequence[Mapping[str, Any] | Valued] = (),
    noise: NoiseModel = HONEST,
    closed_loop: bool = False,
    rate: float | None = None,
    controller: Controller | None = None,
    seed: int = 0,
    device: torch.device | str = "cpu",
) -> Log:
    """The log that the robot would give along a motion.

    Without effects the nominal robot moves exactly along it. With effects, or `closed_loop`, a
    controller that knows the nominal robot follows it, and forward simulation tells how far the arm
    gets: effects change the motion, as they do on a real arm.

    Args:
        robot: with nominal parameters.
        motion: t [s], q, dq, ddq (T, n) [rad or m; per s; per s^2] of one or several trajectories,
            e.g. the `log()` of what `excite` designs.
        effects: that the nominal robot lacks, each as in a robot's yaml, joints from 1:
            `{"effect": "coulomb_friction", "joint": 2, "Fc": 0.6}`; or an effect and its values.
        noise: of the sensors; PaperNoise for the report's; None for the exact signals.
        closed_loop: move under control, without effects too.
        rate: under control: samples per second [Hz]; the motion's if None.
        controller: under control; the default one if None.
        seed: of the noise; the log is a function of it.
        device: where torques along the exact motion are computed; the log stays on the CPU.

    Returns:
        t, q, tau and what else the noise says is measured.

    Raises:
        RobotError: the robot has no nominal parameters, or an effect that it cannot have.
        LogError: the motion has no dq or ddq, or another number of joints.
        TorchidError: noise that does not fit, a rate without control, or an arm that runs away.

    >>> import numpy as np, torchid
    >>> robot = torchid.load_robot("3r")
    >>> t, w = np.arange(200) / 100, np.array([0.5, 0.7, 0.9])  # s, rad/s
    >>> angle = t[:, None] * w
    >>> motion = torchid.Log(t, -np.cos(angle) / w, np.sin(angle), w * np.cos(angle))
    >>> log = simulate(robot, motion, seed=1)
    >>> log.samples, log.tau is not None, log.ddq is None
    (200, True, True)
    """
    robot = as_robot(robot)
    motion = as_log(motion, robot)
    robot.require_fixed_base("a simulated log")
    own = [effect_from_record(one, robot) if isinstance(one, Mapping) else one for one in effects]
    if not (own or closed_loop):
        if rate is not None or controller is not None:
            raise TorchidError(
                "`rate=...` and a controller need motion under control.",
                expected="effects, or `closed_loop=True`",
            )
        return synthetic_log(robot, motion, noise, seed, device=device)
    if isinstance(noise, PaperNoise):
        raise TorchidError(
            "paper noise is for a torque that is computed from the trajectory.",
            got="effects, or motion under control",
            available=["HonestNoise", "None"],
        )
    # Each trajectory from its own beginning.
    parts = motion.trajectories()
    true = under_control(robot, parts, [own] * len(parts), rate=rate, controller=controller)
    log = Log.concatenate(true).replace(source=true[0].source)
    sensed = [*nominal_effects(robot), *own]
    if noise is None:
        return sensed_log(robot, log, sensed)
    return measured_log(robot, log, sensed, Sensors(noise), seed)


def noise_model(
    kind: Noise,
    *,
    snr: float,
    torque_noise: float,
    encoder_bits: int,
    colour: float | None,
    velocity_noise: float | None,
) -> NoiseModel:
    """Noise by its name.

    Args:
        kind: `none`; `paper`, of `snr` [dB] alone; or `honest`, of all the others.
        snr: signal-to-noise ratio [dB].
        torque_noise: share of each joint's RMS torque.
        encoder_bits: counts a turn, as a power of 2; 0 for exact.
        colour: [Hz] low-pass of the torque noise; white if None.
        velocity_noise: share of each joint's RMS velocity; velocities are not measured if None.

    Raises:
        TorchidError: a number out of range.
    """
    if kind == "none":
        return None
    if kind == "paper":
        return PaperNoise(snr_db=snr)
    if not 0 <= encoder_bits <= 40:
        raise TorchidError("`encoder_bits=...` lies between 0 and 40.", got=encoder_bits)
    return HonestNoise(
        encoder_step=0.0 if encoder_bits == 0 else 2 * math.pi / 2**encoder_bits,
        torque_relative=torque_noise,
        colour_hz=colour,
        include_velocity=velocity_noise is not None,
        velocity_relative=velocity_noise or 0.0,
    )


def simulation_record(
    robot: Robot, log: Log, effects: Sequence[Valued], **asked: object
) -> dict[str, Any]:
    """The schema torchid.simulation/1.

    Args:
        robot: that moved.
        log: with torque.
        effects: that the nominal robot lacks.
        asked: file, noise, closed_loop and seed.
    """
    assert log.tau is not None
    return {
        "schema": "torchid.simulation/1",
        "robot": robot.name,
        **asked,
        "effects": [effect.record(values) for effect, values in effects],
        "samples": log.samples,
        "trajectories": list(log.names),
        "torque_rms": log.tau.square().mean(0).sqrt().tolist(),
    }


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
    rates = motion.rates if isinstance(noise, HonestNoise) else [0.0] * len(parts)
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
    return model_torque(robot, nominal_effects(robot), motion)


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
    return Motion(part.q, part.dq, part.ddq, t=part.t - part.t[0])


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
    tau = tau + noise.torque_relative * rms(tau) * standard(tau, noise.colour_hz, rate, generator)
    measured = {"q": counted(true.q, noise, robot), "tau": tau}
    if noise.include_velocity:
        white = standard(tau, None, rate, generator)
        measured["dq"] = true.dq + noise.velocity_relative * rms(true.dq) * white
    return measured


def _noisy_motion(true: Motion, noise: PaperNoise, generator: torch.Generator) -> Motion:
    size = 10 ** (-noise.snr_db / 20)
    noisy = [x + size * rms(x) * standard(x, None, 0.0, generator) for x in true.state]
    return Motion(*noisy)._replace(t=true.t)
