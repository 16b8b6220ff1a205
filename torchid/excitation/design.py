"""Design of exciting trajectories: which motion tells the base parameters apart best.

The error of least squares grows with the condition number of the weighted stacked regressor of the
base parameters, W Y1 (eq. 2.19, section 2.2), and its covariance is sigma^2 (Y1' W^2 Y1)^-1. Both
are functions of the trajectory's coefficients, through the closed form of the regressor, so they
are improved by gradient: Adam on several restarts in one batch. No penalty is needed for limits of
motion: a candidate is first scaled, joint by joint, until it touches them, and the scale is part of
what is differentiated. What couples joints is in `restriction`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from torchid.effects.base import JointEffect, Motion
from torchid.effects.registry import on_every_joint
from torchid.errors import IdentificationError, TorchidError
from torchid.excitation.clearance import Clearance
from torchid.excitation.descent import HARDLY, Progress, improved
from torchid.excitation.fourier import FourierTrajectory
from torchid.excitation.limits import motion_limits
from torchid.excitation.restriction import restricted
from torchid.excitation.settings import DURATION, EXCITED_EFFECTS, HARMONICS, RESTARTS, USAGE
from torchid.excitation.torque import TorqueLimits, nominal_torque_limits
from torchid.excitation.trajectories import Designed, random_trajectory
from torchid.identification.base_parameters import (
    BaseParameters,
    base_parameters,
    stacked_regressor,
)
from torchid.inputs import RobotLike, as_robot
from torchid.robot.model import Basis, Robot
from torchid.typing import Float

Criterion = Literal["condition", "d_optimal"]
_RATE = 50.0  # [Hz], for the condition numbers that are reported


@dataclass(frozen=True, eq=False)
class Excitation(Designed):
    """A designed trajectory and what the design gained.

    Attributes:
        trajectory: the best, (n, L), within the limits at every instant.
        condition_before: (restarts,) condition numbers of the random starts, scaled to the limits
            like the result; `start_condition` is their median.
        condition_after: condition number of `trajectory`.
        criterion: what was improved, `condition` or `d_optimal`.
        base: the base parameters it was designed for.
        warnings: sentences for the user.
        gain: how much lower the cost is than the median start's: the logarithm of the standard
            deviation of what the criterion looks at, which a motion of as much driving time leaves.
        torque: the torque limits kept; None where there are none, or no model.
    """

    trajectory: FourierTrajectory
    condition_before: tuple[float, ...]
    condition_after: float
    criterion: Criterion
    base: BaseParameters
    warnings: tuple[str, ...]
    gain: float
    torque: TorqueLimits | None = None

    def __repr__(self) -> str:
        return (
            f"Excitation({self.trajectory.duration:g} s of {len(self.trajectory.q0)} joints, "
            f"condition number {self.start_condition:.3g} -> {self.condition_after:.3g})"
        )

    @property
    def hardly(self) -> bool:
        """Whether it is hardly better than a random motion within the same limits: by less than a
        tenth more driving time is."""
        return self.gain < HARDLY

    @property
    def start_condition(self) -> float:
        """Median condition number of the random starts."""
        ordered = sorted(self.condition_before)
        k = len(ordered)
        return (ordered[(k - 1) // 2] + ordered[k // 2]) / 2


def excite(
    robot: RobotLike,
    *,
    effects: Sequence[str | JointEffect] = EXCITED_EFFECTS,
    criterion: Criterion = "condition",
    basis: Basis | None = None,
    duration: float = DURATION,
    harmonics: int = HARMONICS,
    restarts: int = RESTARTS,
    iterations: int = 250,
    usage: float = USAGE,
    torque: TorqueLimits | None = None,
    clearance: Clearance | None = None,
    seed: int = 0,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
) -> Excitation:
    """A motion that makes the base parameters visible, within the robot's limits, at rest at both
    ends.

    Of several random starts, improved in one batch, the best is taken; rows of torque count by the
    joints' limits, where all are known.

    Args:
        robot: kinematics, gravity and limits of position, velocity and acceleration; a URDF has
            none of the last: `robot.with_limits(acceleration=5.0)`.
        effects: to be identified with it: names, on every joint, or effects.
        criterion: `condition`, the condition number of the regressor, or `d_optimal`, the
            determinant of the information matrix.
        basis: of the base parameters whose condition number it is; the robot's own if None.
        duration: [s].
        harmonics: of the Fourier series.
        restarts: random starts of the design.
        iterations: of the search from each.
        usage: share of the limits that may be used.
        torque: limits to keep too; by default the robot's, by its nominal parameters, if any.
        clearance: distances that the motion keeps, from
            `torchid.excitation.clearance.motion_clearance`; none if None.
        seed: of the random starts; the result is a function of it.
        device: where regressors are evaluated.
        progress: called with (iterations done, all iterations).

    Returns:
        The design; its `log()` is what to drive: t, q, dq, ddq.

    Raises:
        RobotError: the limits are incomplete, or no motion keeps the torque limits.
        TorchidError: an unknown effect or criterion, or no restarts.
        IdentificationError: the trajectory has fewer torques than there are base parameters.

    >>> import torchid
    >>> found = excite(torchid.load_robot("3r"), duration=4.0, restarts=1, iterations=20)
    >>> found.condition_after <= found.start_condition, found.log(50).samples
    (True, 201)
    """
    robot = as_robot(robot)
    robot.require_fixed_base("the design of motions")
    modelled = [e for e in effects if not isinstance(e, str)]
    modelled += on_every_joint([e for e in effects if isinstance(e, str)], robot.n)
    if criterion not in ("condition", "d_optimal"):
        raise TorchidError(
            "unknown criterion.", got=criterion, available=["condition", "d_optimal"]
        )
    if restarts < 1 or iterations < 0:
        raise TorchidError(
            "a design needs at least one start.",
            got=f"{restarts} restarts, {iterations} iterations",
        )
    limits = motion_limits(robot, usage=usage)
    torque = torque or nominal_torque_limits(robot, usage=usage)
    kept = restricted(torque, clearance)
    base = base_parameters(robot, modelled, basis=basis)
    weights = row_weights(robot)
    start = random_trajectory(
        robot,
        seed,
        count=restarts,
        fill=True,
        usage=usage,
        harmonics=harmonics,
        duration=duration,
    )

    def information(trajectory: FourierTrajectory, t: Tensor) -> Tensor:
        motion = trajectory.at(t).to(device)
        y = base_regressor(robot, base, motion, weights, effects=modelled)
        y = y.reshape(restarts, -1, len(base))
        return (y.transpose(1, 2) @ y / t.shape[0]).cpu()

    def cost(trajectory: FourierTrajectory, t: Tensor) -> Tensor:
        return _cost(information(trajectory, t), criterion)

    def condition(trajectory: FourierTrajectory) -> float:
        motion = trajectory.sample(_RATE).motion
        return condition_number(robot, base, motion, weights, effects=modelled)

    t = torch.arange(0, duration, 1 / _RATE, dtype=torch.float64)
    begun, best, costs = improved(start, limits, cost, t, iterations, progress, kept)
    return Excitation(
        best,
        tuple(condition(begun.select(k)) for k in range(restarts)),
        condition(best),
        criterion,
        base,
        tuple(dict.fromkeys([*limits.warnings, *base.warnings])),
        float(costs[:restarts].quantile(0.5) - costs.min()),
        torque,
    )


def condition_number(
    robot: Robot,
    base: BaseParameters,
    motion: Motion,
    weights: Float[Tensor, " n"] | None = None,
    *,
    effects: Sequence[JointEffect] = (),
) -> float:
    """Condition number (2-norm) of the weighted stacked regressor of the base parameters.

    Args:
        robot: kinematics and gravity.
        base: its base parameters with `effects`.
        motion: q, dq, ddq, each (..., n); leading axes are stacked.
        weights: (n,) of the torque rows, e.g. 1 / noise [1/(N m)]; 1 if None.
        effects: those that `base` was made with.

    Raises:
        IdentificationError: there are fewer rows than base parameters.
    """
    y = base_regressor(robot, base, motion, weights, effects=effects)
    if y.shape[0] < y.shape[1]:
        raise IdentificationError(
            "the motion has fewer torques than there are base parameters.",
            got=y.shape[0],
            expected=f"at least {y.shape[1]}",
        )
    sizes = torch.linalg.svdvals(torch.linalg.qr(y, mode="r").R)
    return float(sizes[0] / sizes[-1])


def base_regressor(
    robot: Robot,
    base: BaseParameters,
    motion: Motion,
    weights: Float[Tensor, " n"] | None = None,
    *,
    effects: Sequence[JointEffect] = (),
) -> Float[Tensor, "R B"]:
    """Weighted stacked regressor of the base parameters (R, B), R instants times joints.

    Arguments as for `condition_number`. Differentiable in the motion.
    """
    flat = Motion(*(x.reshape(-1, robot.n) for x in motion.state))
    if motion.direction is not None:
        flat = flat._replace(direction=motion.direction.reshape(-1, robot.n))
    y = stacked_regressor(robot, effects, flat)
    if y.shape[1] != len(base.parameter_names):
        raise ValueError(
            f"base parameters of {len(base.parameter_names)} columns do not fit a regressor of "
            f"{y.shape[1]}: were they made with the same effects?"
        )
    y = y[:, list(base.independent)]
    if weights is None:
        return y
    return y * weights.to(y).repeat(y.shape[0] // robot.n).unsqueeze(-1)


def row_weights(robot: Robot) -> Float[Tensor, " n"] | None:
    """1 / torque limit of every joint (n,), relative to the strongest; None where one is unknown.

    Drives differ in strength by an order of magnitude and their torque noise with them.
    """
    limits = robot.limits.torque
    if limits is None or not bool(torch.isfinite(limits).all()):
        return None
    size = limits.abs().amax(-1)
    return size.max() / size if bool((size > 0).all()) else None


def _cost(information: Float[Tensor, "K B B"], criterion: Criterion) -> Float[Tensor, " K"]:
    """Logarithm of the condition number, or minus that of the determinant's B-th root, halved."""
    values = torch.linalg.eigvalsh(information)
    # Rounding can make the smallest negative where the motion does not excite.
    values = values.clamp(min=1e-15 * float(values.detach().max()))
    if criterion == "condition":
        return (values[:, -1].log() - values[:, 0].log()) / 2
    return -values.log().mean(-1) / 2
