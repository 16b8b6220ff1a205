"""Design of exciting trajectories: which motion tells the base parameters apart best.

With K what is known before and N = sum_t Y' W' W Y over the weighted rows of the base parameters
that a motion gives, the white covariance after it is (K + N)^-1. Of a first motion nothing is known
before, and what its criterion looks at is the condition number of W Y, with which the error of
least squares grows (eq. 2.19, section 2.2). The next motion for an identification is the same with
the K of its log. What the jackknife found each parameter's standard deviation to exceed the white
one by, k = s / sqrt(diag K^-1), stands for autocorrelation and model error, and is taken to be the
same in the next log:

    predicted std = k sqrt(diag (K + N)^-1).

Its criterion is the mean logarithm of those of the least known parameters (A-optimal, with relative
terms, so that no unit counts more than another); either may have the logarithm of the determinant
(D-optimal: the volume of the confidence ellipsoid). All are functions of the trajectory's
coefficients, through the closed form of the regressor, so they have gradients: see `search`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from torchid.effects.base import JointEffect, Motion
from torchid.effects.names import EXCITED_EFFECTS
from torchid.effects.registry import on_every_joint
from torchid.errors import IdentificationError, TorchidError
from torchid.excitation.clearance import Clearance
from torchid.excitation.fourier import FourierTrajectory, midpoints, stacked
from torchid.excitation.limits import motion_limits
from torchid.excitation.restriction import AllOf
from torchid.excitation.search import HARDLY, Progress, search
from torchid.excitation.settings import DURATION, HARMONICS, RESTARTS, USAGE
from torchid.excitation.torque import (
    TorqueLimits,
    identified_torque_limits,
    nominal_torque_limits,
)
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.identification.base_parameters import (
    BaseParameters,
    base_parameters,
    stacked_regressor,
)
from torchid.identification.values import Prior
from torchid.inputs import RobotLike, as_robot
from torchid.log.model import Log
from torchid.robot.model import Basis, Robot
from torchid.typing import Bool, Float

Criterion = Literal["condition", "d_optimal"]
Goal = Literal["a_optimal", "d_optimal"]


_RATE = 50.0  # [Hz], for the condition numbers that are reported


@dataclass(frozen=True, eq=False, kw_only=True)
class Designed:
    """A motion that was designed.

    Attributes:
        trajectory: the best, (n, L), within the limits at every instant.
        warnings: sentences for the user.
        torque: the torque limits kept; None where there are none, or no model.
    """

    trajectory: FourierTrajectory
    warnings: tuple[str, ...] = ()
    torque: TorqueLimits | None = None

    def log(self, rate: float = 100.0) -> Log:
        """The motion as a log without torque: t [s], q, dq, ddq (T, n), `rate` samples a second.

        Raises:
            TorchidError: a rate that is too low.
        """
        return trajectory_log(self.trajectory, rate)


@dataclass(frozen=True, eq=False, kw_only=True)
class Excitation(Designed):
    """A designed trajectory and what the design gained.

    Attributes:
        trajectory, warnings, torque: see `Designed`.
        condition_before: (restarts,) condition numbers of the random starts, scaled to the limits
            like the result; `start_condition` is their median.
        condition_after: condition number of `trajectory`.
        criterion: what was improved, `condition` or `d_optimal`.
        base: the base parameters it was designed for.
        gain: how much lower the cost is than the median start's: the logarithm of the standard
            deviation of what the criterion looks at, which a motion of as much driving time leaves.
    """

    condition_before: tuple[float, ...]
    condition_after: float
    criterion: Criterion
    base: BaseParameters
    gain: float

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
        return float(torch.tensor(self.condition_before, dtype=torch.float64).quantile(0.5))


@dataclass(frozen=True, eq=False, kw_only=True)
class InformedDesign(Designed):
    """A motion, and what it would add.

    Attributes:
        trajectory, warnings, torque: see `Designed`; torque by the identified base parameters.
        plain: one designed for the condition number alone, of the same length.
        prior: what was known.
        targets: (B,) parameters that the design is for.
        before: (B,) standard deviations; infinite where the log determined nothing.
        with_plain, after: (B,) predicted for the log and this motion together.
        goal: criterion.
    """

    plain: FourierTrajectory
    prior: Prior
    targets: Bool[Tensor, " B"]
    before: Float[Tensor, " B"]
    with_plain: Float[Tensor, " B"]
    after: Float[Tensor, " B"]
    goal: Goal

    @property
    def hardly(self) -> bool:
        """Whether it adds less to the plain motion's standard deviations than a tenth more driving
        time would."""
        return math.log(self.shrinks(self.with_plain) / self.shrinks(self.after)) < HARDLY

    def shrinks(self, std: Float[Tensor, " B"]) -> float:
        """Geometric mean over the targets of std against before (or, where that is infinite,
        against the plain motion's)."""
        known = torch.isfinite(self.before)
        reference = torch.where(known, self.before, self.with_plain)
        return float((std / reference)[self.targets].log().mean().exp())


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
    _check_criterion(criterion, ["condition", "d_optimal"])
    if restarts < 1 or iterations < 0:
        raise TorchidError(
            "a design needs at least one start.",
            got=f"{restarts} restarts, {iterations} iterations",
        )
    torque = torque or nominal_torque_limits(robot, usage=usage)
    base = base_parameters(robot, modelled, basis=basis)
    weights = row_weights(robot)
    start = random_trajectory(
        robot, seed, count=restarts, fill=True, usage=usage, harmonics=harmonics, duration=duration
    )
    none = torch.zeros(len(base), dtype=torch.float64)
    rows = torch.ones(robot.n, dtype=torch.float64) if weights is None else weights
    nothing_known = Prior(
        base, tuple(modelled), none, none.bool(), none, none.diag(), none + 1, rows.diag(), _RATE
    )
    kept = AllOf.of(robot, usage, torque, clearance)
    begun, best, costs = _designed(
        robot, nothing_known, start, criterion, kept, iterations, progress, device
    )

    def condition(trajectory: FourierTrajectory) -> float:
        return condition_number(robot, base, trajectory.sample(_RATE), weights, effects=modelled)

    return Excitation(
        trajectory=best,
        condition_before=tuple(condition(begun.select(k)) for k in range(restarts)),
        condition_after=condition(best),
        criterion=criterion,
        base=base,
        warnings=tuple(dict.fromkeys([*start.warnings, *base.warnings])),
        gain=float(costs[:restarts].quantile(0.5) - costs.min()),
        torque=torque,
    )


def design_for(
    robot: Robot,
    prior: Prior,
    *,
    seed: int,
    goal: Goal = "a_optimal",
    restarts: int = 8,
    iterations: int = 250,
    usage: float = 1.0,
    harmonics: int = 5,
    duration: float = 20.0,
    clearance: Clearance | None = None,
    progress: Progress | None = None,
) -> InformedDesign:
    """The motion after which, with the log, the parameters are known best.

    Args:
        robot: the one identified, with its limits.
        prior: from `read_prior`.
        seed: of the random starts.
        goal: `a_optimal` for the least known parameters, `d_optimal` for all.
        restarts, iterations, usage, harmonics, duration, clearance: as for `excite`.
        progress: called with (iterations done, all iterations).

    Raises:
        RobotError: the limits are incomplete, or no motion keeps the torque limits and the
            clearance.
        TorchidError: unknown goal.
    """
    _check_criterion(goal, ["a_optimal", "d_optimal"])
    settings: dict[str, Any] = {"usage": usage, "harmonics": harmonics, "duration": duration}
    torque = identified_torque_limits(robot, prior, usage=usage)
    plain = excite(
        robot, effects=prior.effects, seed=seed, restarts=restarts, iterations=iterations,
        torque=torque, basis=prior.base.basis, clearance=clearance, **settings,
    ).trajectory  # fmt: skip
    # The plain design is a start too: the result is never worse than it.
    random = random_trajectory(robot, seed, count=restarts, fill=True, **settings)
    start = stacked([*(random.select(k) for k in range(restarts - 1)), plain])
    _, best, _ = _designed(
        robot, prior, start, goal, AllOf.of(robot, usage, torque, clearance), iterations, progress
    )
    return InformedDesign(
        trajectory=best,
        plain=plain,
        prior=prior,
        targets=least_known(prior) if goal == "a_optimal" else torch.ones(len(prior.base)).bool(),
        before=torch.where(prior.known, prior.std, math.inf),
        with_plain=predicted_std(robot, prior, [plain]),
        after=predicted_std(robot, prior, [best]),
        goal=goal,
        warnings=start.warnings,
        torque=torque,
    )


def _check_criterion(criterion: str, available: list[str]) -> None:
    if criterion not in available:
        raise TorchidError("unknown criterion.", got=criterion, available=available)


def _designed(
    robot: Robot,
    prior: Prior,
    start: FourierTrajectory,
    criterion: str,
    kept: AllOf,
    iterations: int,
    progress: Progress | None,
    device: torch.device | str = "cpu",
) -> tuple[FourierTrajectory, FourierTrajectory, Tensor]:
    """What `search` returns for a criterion, beside what is known."""
    least = least_known(prior)

    def cost(trajectory: FourierTrajectory, t: Tensor) -> Float[Tensor, " K"]:
        added = information(robot, prior, trajectory, t, device)
        if criterion == "condition":
            values = torch.linalg.eigvalsh(prior.information + added)
            # Rounding can make the smallest negative where the motion does not excite.
            values = values.clamp(min=1e-15 * float(values.detach().max()))
            return (values[:, -1] / values[:, 0]).log() / 2
        if criterion == "a_optimal":
            return _white_variance(prior, added)[..., least].log().mean(-1) / 2
        root, size = _root(prior, added)
        return -(root.diagonal(dim1=-2, dim2=-1).log() + size.log()).mean(-1)

    # 100: instants during the search: five a second, the regressor's fastest harmonics need
    few, many = midpoints(start.duration, 100), _times(prior, start.duration)
    return search(
        start, motion_limits(robot, usage=kept.usage),
        lambda x: cost(x, few), lambda x: cost(x, many), iterations, progress, kept=kept,
    )  # fmt: skip


def least_known(prior: Prior) -> Bool[Tensor, " B"]:
    """Parameters whose relative standard deviation exceeds 30 %, or that are not known at all; all
    where there are none."""
    relative = 100 * prior.std / prior.values.abs().clamp(min=1e-300)
    # 30.0: relative standard deviation from which a parameter counts as little known [%]
    out = ~prior.known | (relative > 30.0)
    return out if bool(out.any()) else torch.ones_like(out)


def predicted_std(
    robot: Robot, prior: Prior, motions: Sequence[FourierTrajectory]
) -> Float[Tensor, " B"]:
    """Standard deviations (B,) after the log and these motions."""
    informations = (information(robot, prior, x, _times(prior, x.duration)) for x in motions)
    return prior.inflation * _white_variance(prior, sum(informations, torch.zeros(()))).sqrt()


def information(
    robot: Robot,
    prior: Prior,
    trajectory: FourierTrajectory,
    t: Float[Tensor, " T"],
    device: torch.device | str = "cpu",
) -> Float[Tensor, "*batch B B"]:
    """N of a motion, from its rows at times t, as many as the fit would have. Differentiable."""
    y = base_regressor(robot, prior.base, trajectory.at(t).to(device), effects=prior.effects).cpu()
    y = y.reshape(*trajectory.q0.shape[:-1], len(t), robot.n, len(prior.base))
    y = (prior.whitening @ y).flatten(-3, -2)
    rows = prior.per_second * trajectory.duration
    return y.mT @ y * (rows / len(t))


def _white_variance(prior: Prior, added: Tensor) -> Tensor:
    """diag (K + N)^-1; infinite-like where nothing determines."""
    root, size = _root(prior, added)
    eye = torch.eye(root.shape[-1], dtype=root.dtype).expand_as(root)
    inverse = torch.linalg.solve_triangular(root, eye, upper=False)
    return inverse.square().sum(-2) / size.square()


def _root(prior: Prior, added: Tensor) -> tuple[Tensor, Tensor]:
    """Cholesky factor of K + N, columns scaled to length one, and their lengths."""
    whole = prior.information + added
    size = whole.diagonal(dim1=-2, dim2=-1).clamp(min=1e-300).sqrt()
    eye = torch.eye(whole.shape[-1], dtype=whole.dtype)
    scaled = whole / size.unsqueeze(-1) / size.unsqueeze(-2)
    return torch.linalg.cholesky_ex(scaled + 1e-14 * eye)[0], size


def _times(prior: Prior, duration: float) -> Float[Tensor, " T"]:
    return midpoints(duration, max(200, round(duration * min(_RATE, prior.per_second))))


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
