"""How far apart models are in torque on a common motion: parameters may differ where it agrees."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch

from torchid.design.motion import Measurement, measurements
from torchid.effects.base import Motion
from torchid.effects.registry import model_torque, nominal_effects
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.fleet.comparison import TorqueSpread
from torchid.identification.logs import prepared
from torchid.log.filtering import ZeroPhaseFilter
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

RANDOM, SECONDS, RATE = 5, 20.0, 25.0
"""Random trajectories of the common motion, their length [s] and sampling [Hz]."""

ORDINARY = {"velocity": 2.0, "acceleration": 5.0}
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


def common_motion(
    robot: Robot,
    on: Log | None,
    seed: int,
    cutoff: float | None,
    reversal: Float[Tensor, " n"] | None,
) -> CommonMotion:
    """A log's motion under a filter, with its torque if it has any; random Fourier trajectories
    that touch the robot's limits where there is no log.

    Raises:
        LogError: a log that does not fit the robot.
    """
    if on is not None:
        measured = on.tau is not None or (on.current is not None and robot.drive_gain is not None)
        log = on if measured else on.replace(tau=torch.zeros_like(on.q), current=None)
        parts = measurements(prepared(log, robot)[0], cutoff, reversal)
        motions = [p.motion._replace(t=p.t).part(slice(p.edge, p.samples - p.edge)) for p in parts]
        said = f"the motion of {', '.join(on.names)}"
        return CommonMotion(tuple(motions), said, tuple(parts) if measured else ())

    def lacks(name: str) -> bool:
        limit = getattr(robot.limits, name)
        return limit is None or not bool(torch.isfinite(limit).all())

    missing = {name: value for name, value in ORDINARY.items() if lacks(name)}
    bounded = robot.with_limits(**missing)
    if lacks("position"):
        bounded = replace(bounded, limits=replace(bounded.limits, position=None))
    trajectories = random_trajectory(bounded, seed, count=RANDOM, fill=True, duration=SECONDS)
    random = trajectory_log(trajectories, RATE).trajectories()
    said = f"{RANDOM} random trajectories of {SECONDS:g} s within the limits"
    up_to = ", ".join(f"{name} up to {value:g}" for name, value in missing.items())
    return CommonMotion(
        tuple(Motion(p.q, p.dq, p.ddq, t=p.t) for p in random),  # type: ignore[arg-type]
        f"{said} ({up_to})" if up_to else said,
    )


def torque_spread(
    models: Sequence[Model], motion: CommonMotion, claims: Sequence[Model] = ()
) -> TorqueSpread:
    """How far the torques of two models or more are apart on a motion.

    Args:
        models: their torques.
        motion: on which; with its measured torque, if it has one.
        claims: variances of the models' torques.
    """

    def rms(x: Tensor) -> Tensor:
        return x.square().mean(0).sqrt()

    torque = torch.stack([torch.cat([f(part) for part in motion.motions]) for f in models])
    claimed = [torch.cat([f(part) for part in motion.motions]).mean(0) for f in claims]
    errors = []
    for model in models if motion.measured else ():
        left = []
        for part in motion.measured:  # through the motion's filter
            error = part.tau - model(part.whole._replace(t=part.t))
            if part.cutoff is not None:
                error = ZeroPhaseFilter(part.rate, part.cutoff).apply(error.T.contiguous()).T
            left.append(error[part.edge : part.samples - part.edge])
        errors.append(rms(torch.cat(left)))
    return TorqueSpread(
        motion.source,
        rms(torque.mean(0)),
        torque.var(0).mean(0).sqrt(),
        torch.stack(claimed).mean(0).sqrt() if claimed else None,
        torch.stack(errors) if errors else None,
    )


def described_model(robot: Robot) -> Model:
    """The rigid body and effects of a robot's description.

    Raises:
        RobotError: the robot has no parameters.
    """
    effects = [pair for pair in nominal_effects(robot) if not pair[0].needs & MEASURED]
    return lambda motion: model_torque(robot, effects, motion)
