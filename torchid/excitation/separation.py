"""The motion that best tells explanations of a gap apart.

Two explanations a, b have columns X_a, X_b along a motion; what else the model fits has columns Z
(base parameters, refitted). If a is true with coefficients c_a, b can imitate all of X_a c_a but

    D_ab = ||(I - P_[Z X_b]) X_a c_a||^2 / sigma^2,

twice the logarithm of the likelihood ratio that the motion is expected to give. The design
maximises the smallest D over all pairs, both ways. Directions of friction and the like jump, so
there is no gradient to follow: CMA-ES (Hansen 2016) moves the trajectory's coefficients, its
centre, and how much of the limits each joint uses, for slow motion tells as much as fast.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cma
import numpy as np
import torch

from torchid.dynamics.regressor import regressor
from torchid.effects.base import Effect, Motion
from torchid.effects.registry import Valued, model_torque
from torchid.errors import TorchidError
from torchid.excitation.fourier import FourierTrajectory
from torchid.excitation.limits import MotionLimits, largest_scale, motion_limits
from torchid.excitation.trajectories import random_trajectory
from torchid.identification.base_parameters import BaseParameters
from torchid.log.filtering import ZeroPhaseFilter
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

RATE = 40.0
"""[Hz] at which columns are evaluated before the filter: they jump."""

SLOWEST = 0.03
"""Share of the limits that a joint uses at least."""

POPULATION = 16
_SPREAD = 0.3
_FULL = -4.0  # where the search of the joints' shares starts: nearly the whole of the limits
_RANDOM_SHARE = 0.2  # of the evaluations, before the search

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Setting:
    """What explanations are told apart on.

    Attributes:
        robot: the model, with parameters.
        given: effects that are in the model.
        base: base parameters that are refitted, or None where they are trusted.
        noise: (n,) standard deviation of the torque in `band` [N m; N].
        band: of the noise [Hz]: a second holds 2 band independent values.
        cutoff: of the fit's filter [Hz].
    """

    robot: Robot
    given: tuple[Valued, ...]
    base: BaseParameters | None
    noise: Float[Tensor, " n"]
    band: float
    cutoff: float


@dataclass(frozen=True)
class Rival:
    """An explanation that is true, and what it must not be taken for.

    Attributes:
        truth: effect and coefficients.
        others: shapes of the other effect, any of which may be fitted; or its several instances.
            Empty: the model alone (is the effect seen at all?).
        name: of the other.
    """

    truth: Valued
    others: tuple[Effect, ...]
    name: str


@dataclass(frozen=True, eq=False)
class Separation:
    """A motion and what it separates.

    Attributes:
        trajectory: the best found.
        plain: what it is compared with, of the same length.
        rivals: the pairs, in order.
        with_plain, after: (R,) D of each pair for the two motions.
        hopeless: rivals that no motion tried separates, not part of the design.
        warnings: sentences for the user.
    """

    trajectory: FourierTrajectory
    plain: FourierTrajectory
    rivals: tuple[Rival, ...]
    with_plain: tuple[float, ...]
    after: tuple[float, ...]
    hopeless: tuple[Rival, ...]
    warnings: tuple[str, ...]


HOPELESS = 1e-3
"""D below which two explanations are the same."""


def design_separation(
    setting: Setting,
    rivals: Sequence[Rival],
    plain: FourierTrajectory,
    *,
    seed: int,
    evaluations: int = 600,
    usage: float = 1.0,
    progress: Progress | None = None,
) -> Separation:
    """The motion, of the length and harmonics of `plain`, whose smallest D is largest.

    Args:
        setting: model and noise.
        rivals: pairs to separate.
        plain: where the search starts, and what the result is compared with.
        seed: of the search.
        evaluations: trajectories tried.
        usage: share of the limits that may be used.
        progress: called with (evaluations done, all).

    Raises:
        RobotError: the limits are incomplete, or the robot has no parameters.
        TorchidError: no motion tried separates any pair.
    """
    limits = motion_limits(setting.robot, usage=usage)
    tried = [plain, *_random(setting.robot, plain, seed, usage, evaluations)]
    tries = [separations(setting, rivals, x) for x in tried]
    seen = list(zip(*tries, strict=True))
    kept = [k for k, own in enumerate(seen) if max(own) > HOPELESS]
    hopeless = tuple(r for k, r in enumerate(rivals) if k not in kept)
    if not kept:
        raise TorchidError(
            "no motion tried separates these explanations: they are the same by physics, or "
            "beyond the robot's limits.",
            got="; ".join(f"{r.truth[0].name} and {r.name}" for r in rivals),
        )
    wanted = [rivals[k] for k in kept]

    def score(x: FourierTrajectory) -> float:
        return min(separations(setting, wanted, x))

    start = tried[int(np.argmax([min(seen[k][i] for k in kept) for i in range(len(tried))]))]
    best = _search(start, limits, score, seed, evaluations, progress)
    return Separation(
        best,
        plain,
        tuple(wanted),
        tuple(seen[k][0] for k in kept),
        tuple(separations(setting, wanted, best)),
        hopeless,
        limits.warnings,
    )


def _random(
    robot: Robot, plain: FourierTrajectory, seed: int, usage: float, evaluations: int
) -> list[FourierTrajectory]:
    """Random trajectories, every joint of each with its own share of the limits."""
    count = max(4, round(_RANDOM_SHARE * evaluations))
    drawn = random_trajectory(
        robot, seed, count=count, fill=True, usage=usage, harmonics=plain.harmonics,
        duration=plain.duration, ramp=plain.ramp,
    )  # fmt: skip
    generator = torch.Generator().manual_seed(seed)
    share = SLOWEST ** (torch.rand(count, robot.n, generator=generator, dtype=torch.float64) ** 2)
    mixed = drawn.scaled(share)
    return [drawn.select(k) if k % 2 else mixed.select(k) for k in range(count)]


def separations(
    setting: Setting, rivals: Sequence[Rival], trajectory: FourierTrajectory
) -> list[float]:
    """D of every pair along a trajectory: the smallest over the other's shapes."""
    rows = Rows(setting, trajectory)
    return [_separation(rows, rival) for rival in rivals]


def _separation(rows: "Rows", rival: Rival) -> float:
    effect, values = rival.truth
    left = rows.beside_base(rows.columns(effect) @ torch.tensor(values, dtype=torch.float64))
    if not rival.others:
        return float(left.square().sum())
    return min(
        float(_left(left, rows.beside_base(rows.columns(other))).square().sum())
        for other in rival.others
    )


def imitation(
    setting: Setting, truth: Valued, others: Sequence[Effect], trajectory: FourierTrajectory
) -> Valued | None:
    """The shape and coefficients with which another effect is most like a true one along a
    motion; None where none of its columns says anything beside the base parameters."""
    rows = Rows(setting, trajectory)
    own = rows.columns(truth[0]) @ torch.tensor(truth[1], dtype=torch.float64)
    left = rows.beside_base(own)
    found: tuple[float, Valued] | None = None
    for other in others:
        columns = rows.beside_base(rows.columns(other))
        size = torch.linalg.vector_norm(columns, dim=0)
        if float(size.max()) < HOPELESS:
            continue
        safe = size.clamp(min=1e-12)
        x = torch.linalg.lstsq(columns / safe, left.unsqueeze(-1), driver="gelsd").solution
        x = x.flatten() / safe
        rest = float((left - columns @ x).square().sum())
        if found is None or rest < found[0]:
            found = rest, (other, x.tolist())
    return None if found is None else found[1]


class Rows:
    """Whitened rows along a trajectory: of base parameters and of effects.

    Columns are evaluated at 40 Hz, filtered as the fit does, and decimated by two.
    """

    def __init__(self, setting: Setting, trajectory: FourierTrajectory):
        self._setting = setting
        sampled = trajectory.sample(RATE)
        motion = Motion(*sampled.motion.state, t=sampled.t)
        torque = model_torque(setting.robot, setting.given, motion)
        self.motion = motion._replace(torque=torque)
        # What 2 band independent values a second of this noise are worth, at RATE / 2 rows.
        per_row = 2 * setting.band / (RATE / 2)
        self._weight = per_row**0.5 / setting.noise.clamp(min=1e-12)
        self._filter = ZeroPhaseFilter(RATE, min(setting.cutoff, 0.22 * RATE))
        self._basis = self._base_basis()

    def columns(self, effect: Effect) -> Float[Tensor, "R C"]:
        """Of one effect (rows, C), joints and instants stacked."""
        return self._whitened(effect.torque_columns(self.motion, self._setting.robot))

    def _whitened(self, x: Float[Tensor, "T n C"]) -> Float[Tensor, "R C"]:
        low = self._filter.apply(x.permute(2, 1, 0).contiguous())[..., ::2]
        return (low * self._weight.unsqueeze(-1)).flatten(1).T

    def beside_base(self, columns: Tensor) -> Tensor:
        """What base parameters cannot explain of a column (R,), or of several (R, C)."""
        if self._basis is None:
            return columns
        return columns - self._basis @ (self._basis.T @ columns)

    def _base_basis(self) -> Tensor | None:
        base, robot = self._setting.base, self._setting.robot
        if base is None:
            return None
        y = regressor(robot, *self.motion.state)[..., list(base.independent[: base.n_rigid])]
        y = self._whitened(y)
        size = torch.linalg.vector_norm(y, dim=0)
        q, r = torch.linalg.qr(y[:, size > 0] / size[size > 0])
        return q[:, r.diagonal().abs() > 1e-9]


def _left(own: Float[Tensor, " R"], columns: Float[Tensor, "R C"]) -> Float[Tensor, " R"]:
    """What columns cannot explain of `own`."""
    size = torch.linalg.vector_norm(columns, dim=0)
    if float(size.max()) < 1e-9:
        return own
    q, s, _ = torch.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    q = q[:, s > 1e-6]
    return own - q @ (q.T @ own)


def _search(
    start: FourierTrajectory,
    limits: MotionLimits,
    score: Callable[[FourierTrajectory], float],
    seed: int,
    evaluations: int,
    progress: Progress | None,
) -> FourierTrajectory:
    """CMA-ES on the logarithm of the score; the start competes too."""
    n = start.n
    reach = 0.9 * limits.half_range
    size = torch.linalg.vector_norm(start.coefficients, dim=-1, keepdim=True).clamp(min=1e-12)
    shape = (start.coefficients / size * start.harmonics**0.5).flatten()
    place = torch.atanh(((start.q0 - limits.middle) / reach).clamp(-0.95, 0.95))
    first = torch.cat([shape, place, torch.full((n,), _FULL, dtype=torch.float64)])

    def trajectory(x: Tensor) -> FourierTrajectory:
        a, b = x[: -2 * n].reshape(n, -1).chunk(2, -1)
        q0 = limits.middle + reach * torch.tanh(x[-2 * n : -n])
        raw = replace(start, a=a, b=b, q0=q0)
        share = torch.exp(math.log(SLOWEST) * torch.sigmoid(x[-n:]))
        return raw.scaled(largest_scale(raw, limits) * share)

    best, highest, done = start, score(start), round(_RANDOM_SHARE * evaluations)
    options = {"seed": seed + 1, "popsize": POPULATION, "verbose": -9, "CMA_diagonal": True}
    search = cma.CMAEvolutionStrategy(first.numpy(), _SPREAD, options)
    while done < evaluations and not search.stop():
        asked = search.ask()
        costs = []
        for x in asked:
            candidate = trajectory(torch.from_numpy(np.asarray(x)))
            value = score(candidate)
            costs.append(-math.log(max(value, 1e-300)))
            if value > highest:
                best, highest = candidate, value
        search.tell(asked, costs)
        done += len(asked)
        if progress is not None:
            progress(min(done, evaluations), evaluations)
    return best
