"""How far apart models are in torque on a common motion: parameters may differ where it agrees."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import msgspec
import torch

from torchid.compare.reading import Identified
from torchid.compare.record import TorqueSpread
from torchid.design.motion import Measurement, measurements
from torchid.effects.base import Motion
from torchid.effects.registry import model_torque as full_torque
from torchid.effects.registry import nominal_effects
from torchid.excitation.design import base_regressor
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.identification.logs import prepared
from torchid.identification.model import model_torque
from torchid.log.filtering import ZeroPhaseFilter
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

RANDOM, SECONDS, RATE = 5, 20.0, 25.0
"""Random trajectories of the common motion, their length [s] and sampling [Hz]."""

SPEED, ACCELERATION = 2.0, 5.0
"""Limits in place of those that a robot does not have [rad/s, rad/s^2; m]."""

MEASURED = frozenset({"age", "velocity"})
"""Needs of effects that belong to one log: they are no part of a model."""

Model = Callable[[Motion], Tensor]
"""Torque (T, n) of one trajectory's motion."""


@dataclass(frozen=True, eq=False)
class CommonMotion:
    """Trajectories on which models are compared.

    Attributes:
        motions: each (T, n), with t.
        source: in words.
        measured: the same trajectories with measured torque; empty where there is none.
    """

    motions: tuple[Motion, ...]
    source: str
    measured: tuple[Measurement, ...] = ()


def random_motion(robot: Robot, seed: int = 0) -> CommonMotion:
    """Random Fourier trajectories that touch the robot's limits, ordinary ones in place of those
    that it does not have."""
    limits, missing = robot.limits, []
    for name, value in (("velocity", SPEED), ("acceleration", ACCELERATION)):
        given = getattr(limits, name)
        if given is None or not bool(torch.isfinite(given).all()):
            bounds = torch.tensor([[-value, value]] * robot.n, dtype=torch.float64)
            limits = replace(limits, **{name: bounds})
            missing.append(f"{name} up to {value:g}")
    if limits.position is not None and not bool(torch.isfinite(limits.position).all()):
        limits = replace(limits, position=None)
    whole = replace(robot, limits=limits)
    trajectories = random_trajectory(whole, seed, count=RANDOM, fill=True, duration=SECONDS)
    log = trajectory_log(trajectories, RATE)
    motions = tuple(
        Motion(part.q, part.dq, part.ddq, t=part.t)  # type: ignore[arg-type]
        for part in log.trajectories()
    )
    said = f"{RANDOM} random trajectories of {SECONDS:g} s within the limits"
    return CommonMotion(motions, said + (f" ({', '.join(missing)})" if missing else ""))


def log_motion(
    robot: Robot, log: Log, cutoff: float | None, reversal: Float[Tensor, " n"] | None = None
) -> CommonMotion:
    """A log's motion under a filter, with its torque if it has any.

    Raises:
        LogError: a log that does not fit the robot.
    """
    measured = log.tau is not None or (log.current is not None and robot.drive_gain is not None)
    if not measured:
        log = log.replace(tau=torch.zeros_like(log.q), current=None)
    even, _ = prepared(log, robot)
    parts = measurements(even, cutoff, reversal)
    motions = tuple(p.motion._replace(t=p.t).part(slice(p.edge, p.samples - p.edge)) for p in parts)
    return CommonMotion(
        motions, f"the motion of {', '.join(log.names)}", tuple(parts) if measured else ()
    )


def common_motion(
    robot: Robot,
    on: Log | None,
    seed: int,
    cutoff: float | None = None,
    reversal: Float[Tensor, " n"] | None = None,
) -> CommonMotion:
    """Of a log, or random where there is none."""
    return random_motion(robot, seed) if on is None else log_motion(robot, on, cutoff, reversal)


def identified_spread(
    results: Sequence[Identified], robot: Robot, *, on: Log | None = None, seed: int = 0
) -> TorqueSpread:
    """Of identified models, on random motion or along a log, with the log's torque beside it if it
    has one.

    Raises:
        LogError: a log that does not fit the robot.
    """
    cutoff = min((r.record.cutoff for r in results if r.record.cutoff is not None), default=None)
    reversal = torch.stack([r.record.reversal for r in results]).mean(0)
    motion = common_motion(robot, on, seed, cutoff, reversal)
    models = [partial(model_torque, robot, r.base, r.effects, r.values) for r in results]
    # The variance of torque that each covariance claims, averaged over the motion.
    claimed = []
    for r in results:
        rows = torch.cat(
            [base_regressor(robot, r.base, part, effects=r.effects) for part in motion.motions]
        )
        variance = ((rows @ r.covariance) * rows).sum(1).clamp(min=0)
        claimed.append(variance.reshape(-1, robot.n).mean(0))
    spread = torque_spread(models, motion)
    return msgspec.structs.replace(spread, claimed=torch.stack(claimed).mean(0).sqrt())


def torque_spread(models: Sequence[Model], motion: CommonMotion) -> TorqueSpread:
    """Of any models."""
    torque = torch.stack([torch.cat([f(part) for part in motion.motions]) for f in models])
    mean = torque.mean(0)
    apart = torque.unsqueeze(0) - torque.unsqueeze(1)
    spread = ((torque - mean).square().sum(0) / (len(models) - 1)).mean(0).sqrt()
    # RMS of measured minus modelled torque, through the motion's filter.
    errors = []
    for model in models if motion.measured else ():
        left = []
        for part in motion.measured:
            error = part.tau - model(part.whole._replace(t=part.t))
            if part.cutoff is not None:
                error = ZeroPhaseFilter(part.rate, part.cutoff).apply(error.T.contiguous()).T
            left.append(error[part.edge : part.samples - part.edge])
        errors.append(_rms(torch.cat(left)))
    return TorqueSpread(
        motion.source,
        _rms(mean),
        spread,
        _rms(apart, 2),
        errors=torch.stack(errors) if errors else None,
    )


def described_model(robot: Robot) -> Model:
    """The rigid body and effects of a robot's description.

    Raises:
        RobotError: the robot has no parameters.
    """
    effects = [pair for pair in nominal_effects(robot) if not pair[0].needs & MEASURED]
    return lambda motion: full_torque(robot, effects, motion)


def _rms(x: Tensor, over: int = 0) -> Tensor:
    return x.square().mean(over).sqrt()
