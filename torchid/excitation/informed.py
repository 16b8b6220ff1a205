"""The next motion for an identification: what the log has told already counts.

With R the factor of the log's weighted rows and N = sum_t Y_R' W' W Y_R over the rows that a new
motion would give, the white covariance after both is (R'R + N)^-1. What the jackknife found each
parameter's standard deviation to exceed the white one by, k = s / sqrt(diag (R'R)^-1), stands for
autocorrelation and model error, and is taken to be the same in the next log:

    predicted std = k sqrt(diag (R'R + N)^-1).

The design minimises, within the limits, the mean logarithm of those of the least known parameters
(an A-optimal design whose terms are relative, so that no unit counts more than another), or the
logarithm of the determinant (D-optimal: the volume of the confidence ellipsoid).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import torch

from torchid.errors import TorchidError
from torchid.excitation.clearance import Clearance
from torchid.excitation.descent import HARDLY, Progress, improved
from torchid.excitation.design import base_regressor, excite
from torchid.excitation.fourier import FourierTrajectory
from torchid.excitation.limits import motion_limits
from torchid.excitation.restriction import restricted
from torchid.excitation.torque import TorqueLimits, identified_torque_limits
from torchid.excitation.trajectories import Designed, random_trajectory
from torchid.identification.values import Prior
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

Goal = Literal["a_optimal", "d_optimal"]

LEAST_KNOWN = 30.0
"""Relative standard deviation from which a parameter counts as little known [%]."""


@dataclass(frozen=True, eq=False)
class InformedDesign(Designed):
    """A motion, and what it would add.

    Attributes:
        trajectory: the best.
        plain: one designed for the condition number alone, of the same length.
        prior: what was known.
        targets: (B,) parameters that the design is for.
        before: (B,) standard deviations; infinite where the log determined nothing.
        with_plain, after: (B,) predicted for the log and this motion together.
        goal: criterion.
        warnings: sentences for the user.
        torque: the torque limits kept, by the identified base parameters; None if there are none.
    """

    trajectory: FourierTrajectory
    plain: FourierTrajectory
    prior: Prior
    targets: Bool[Tensor, " B"]
    before: Float[Tensor, " B"]
    with_plain: Float[Tensor, " B"]
    after: Float[Tensor, " B"]
    goal: Goal
    warnings: tuple[str, ...]
    torque: TorqueLimits | None = None

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
    if goal not in ("a_optimal", "d_optimal"):
        raise TorchidError("unknown criterion.", got=goal, available=["a_optimal", "d_optimal"])
    settings: dict[str, Any] = {"usage": usage, "harmonics": harmonics, "duration": duration}
    limits = motion_limits(robot, usage=usage)
    torque = identified_torque_limits(robot, prior, usage=usage)
    plain = excite(
        robot, effects=prior.effects, seed=seed, restarts=restarts, iterations=iterations,
        torque=torque, basis=prior.base.basis, clearance=clearance, **settings,
    )  # fmt: skip
    # The plain design is a start too: the result is never worse than it.
    random = random_trajectory(robot, seed, count=restarts, fill=True, **settings)
    start = _with_last(random, plain.trajectory)
    kept = restricted(torque, clearance)
    targets = least_known(prior) if goal == "a_optimal" else torch.ones(len(prior.base)).bool()

    def cost(trajectory: FourierTrajectory, t: Tensor) -> Tensor:
        return _cost(prior, information(robot, prior, trajectory, t), targets, goal)

    t = _times(prior, duration)
    _, best, _ = improved(start, limits, cost, t, iterations, progress, kept)
    return InformedDesign(
        best,
        plain.trajectory,
        prior,
        targets,
        torch.where(prior.known, prior.std, math.inf),
        predicted_std(robot, prior, [plain.trajectory]),
        predicted_std(robot, prior, [best]),
        goal,
        limits.warnings,
        torque,
    )


def least_known(prior: Prior) -> Bool[Tensor, " B"]:
    """Parameters whose relative standard deviation exceeds 30 %, or that are not known at all; all
    where there are none."""
    relative = 100 * prior.std / prior.values.abs().clamp(min=1e-300)
    out = ~prior.known | (relative > LEAST_KNOWN)
    return out if bool(out.any()) else torch.ones_like(out)


def predicted_std(
    robot: Robot, prior: Prior, motions: Sequence[FourierTrajectory]
) -> Float[Tensor, " B"]:
    """Standard deviations (B,) after the log and these motions."""
    added = torch.zeros_like(prior.information)
    for motion in motions:
        t = _times(prior, motion.duration)
        added = added + information(robot, prior, motion, t)
    return prior.inflation * _white_variance(prior, added).sqrt()


def information(
    robot: Robot, prior: Prior, trajectory: FourierTrajectory, t: Float[Tensor, " T"]
) -> Float[Tensor, "*batch B B"]:
    """N of a motion, from its rows at times t, as many as the fit would have. Differentiable."""
    y = base_regressor(robot, prior.base, trajectory.at(t), effects=prior.effects)
    batch = trajectory.q0.shape[:-1]
    y = y.reshape(*batch, len(t), robot.n, len(prior.base))
    y = (prior.whitening @ y).flatten(-3, -2)
    rows = prior.per_second * trajectory.duration
    return y.transpose(-1, -2) @ y * (rows / len(t))


def _cost(prior: Prior, added: Tensor, targets: Tensor, goal: Goal) -> Float[Tensor, " K"]:
    if goal == "a_optimal":
        return _white_variance(prior, added)[..., targets].log().mean(-1) / 2
    root, size = _root(prior, added)
    return -(root.diagonal(dim1=-2, dim2=-1).log() + size.log()).mean(-1)


def _white_variance(prior: Prior, added: Tensor) -> Tensor:
    """diag (R'R + N)^-1; infinite-like where nothing determines."""
    root, size = _root(prior, added)
    eye = torch.eye(root.shape[-1], dtype=root.dtype).expand_as(root)
    inverse = torch.linalg.solve_triangular(root, eye, upper=False)
    return inverse.square().sum(-2) / size.square()


def _root(prior: Prior, added: Tensor) -> tuple[Tensor, Tensor]:
    """Cholesky factor of R'R + N, columns scaled to length one, and their lengths."""
    whole = prior.information + added
    size = whole.diagonal(dim1=-2, dim2=-1).clamp(min=1e-300).sqrt()
    eye = torch.eye(whole.shape[-1], dtype=whole.dtype)
    scaled = whole / size.unsqueeze(-1) / size.unsqueeze(-2)
    return torch.linalg.cholesky_ex(scaled + 1e-14 * eye)[0], size


def _times(prior: Prior, duration: float) -> Float[Tensor, " T"]:
    count = max(200, round(duration * min(50.0, prior.per_second)))
    return (torch.arange(count, dtype=torch.float64) + 0.5) * (duration / count)


def _with_last(many: FourierTrajectory, one: FourierTrajectory) -> FourierTrajectory:
    """A batch whose last trajectory is another."""
    a, b, q0 = (
        torch.cat([x[:-1], y.unsqueeze(0)])
        for x, y in ((many.a, one.a), (many.b, one.b), (many.q0, one.q0))
    )
    return replace(many, a=a, b=b, q0=q0)
