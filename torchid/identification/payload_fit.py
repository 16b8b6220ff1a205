"""The ten parameters of a payload from a change of base parameters: models, estimator, consistency.

A payload moves with the last link, so it adds its ten parameters to that link's, and the rigid base
parameters change by G_n theta, G_n being the last link's columns of the grouping matrix (Gaz and
De Luca, IROS 2017).

The estimate is generalised least squares, weighted by the covariance that both fits' own rows
promise, or, where none is given, by that of random states of the arm. Its covariance is P C P',
with the block-robust covariance C of the change and the estimator P. Weighting by C's own inverse
would be far too sure of itself: a jackknife of some thirty blocks holds next to nothing of the
inverse of a 43 x 43 matrix (on the 7R with one trajectory, 71 % of the nominal 95 % intervals held
the truth).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import torch
from scipy.optimize import least_squares
from torch.autograd.functional import jacobian

from torchid.dynamics.regressor import regressor
from torchid.identification.base_parameters import RANK_TOLERANCE, BaseParameters, random_states
from torchid.robot.inertia import (
    PARAMETERS_PER_LINK,
    InertialParameters,
    move,
    paper_order,
    pseudo_inertia_basis,
)
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

Model = Literal["general", "symmetric", "point_mass"]

_VANISHES = 1e-9
"""Relative size below which a change along a direction, or a variance, counts as none."""

_LEAST = 1e-12
"""Smallest variance of a direction, relative to the largest, that a weighting believes."""

_SHARPEST = 1e8
_SHARPER = 10.0
_NEWTON_STEPS = 200
"""Path to the nearest consistent body: last weight of the distance, its growth, steps a weight."""


@dataclass(frozen=True)
class Fitted:
    """A payload in the last link's frame, and how it came from the change of base parameters.

    Attributes:
        free: (F,) the model's own parameters.
        covariance: (F, F) theirs.
        to_parameters: from (F,) to the ten parameters in the last link's frame.
        null: (F, D) directions of `free` that the change says nothing about.
        residual, residual_std: (R,) what the payload leaves of the change, a row a parameter used.
    """

    free: Float[Tensor, " F"]
    covariance: Float[Tensor, "F F"]
    to_parameters: Callable[[Tensor], Tensor]
    null: Float[Tensor, "F D"]
    residual: Float[Tensor, " R"]
    residual_std: Float[Tensor, " R"]

    def of(
        self, function: Callable[[Tensor], Tensor]
    ) -> tuple[Float[Tensor, " Q"], Float[Tensor, "Q Q"], Bool[Tensor, " Q"]]:
        """Value, covariance (delta method) and determinedness of a function of the ten parameters
        in the last link's frame."""

        def composed(free: Tensor) -> Tensor:
            return function(self.to_parameters(free))

        slope = jacobian(composed, self.free)
        moved = (slope @ self.null).abs()
        size = slope.abs() @ self.null.abs()
        determined = (moved <= _VANISHES * size.clamp(min=1e-300)).all(-1)
        return composed(self.free), slope @ self.covariance @ slope.T, determined


def last_link_columns(robot: Robot, base: BaseParameters) -> Float[Tensor, "B 10"]:
    """The last link's columns of the grouping matrix, in torchid's order of the ten."""
    order = paper_order(robot.n_links).argsort()
    return base.grouping[:, order[-PARAMETERS_PER_LINK:]]


def weighting(
    robot: Robot, base: BaseParameters, used: Bool[Tensor, " B"], std: Float[Tensor, " R"]
) -> Float[Tensor, "R R"]:
    """A root V of the weighting W = V'V of the rigid base parameters that are used.

    Args:
        robot, base: whose structure gives the correlations.
        used: which of the base parameters; rigid ones only.
        std: standard deviations of their changes.
    """
    # Random states up to half the limits, as an excitation has; +-2 and +-5 where there are none.
    # Gravity and inertia then enter the correlations in the proportion they have in a log.
    q, dq, ddq = random_states(robot).state
    limits = robot.limits
    if limits.velocity is not None and bool(torch.isfinite(limits.velocity).all()):
        dq = dq / 4 * limits.velocity.abs().amax(-1)
    if limits.acceleration is not None and bool(torch.isfinite(limits.acceleration).all()):
        ddq = ddq / 10 * limits.acceleration.abs().amax(-1)
    pi = torch.tensor(base.independent)[used]
    rows = regressor(robot, q, dq, ddq)[..., pi]
    root = torch.linalg.qr(rows.flatten(0, 1), mode="r").R
    structural = torch.linalg.inv(root).square().sum(-1).sqrt()
    ratio = std / structural
    typical = float(ratio.median())
    if typical == 0:
        return root
    return root / ratio.clamp(min=1e-6 * typical)


def root_of(nominal: Float[Tensor, "B B"], used: Bool[Tensor, " B"]) -> Float[Tensor, "R R"]:
    """A root V of the weighting W = V'V, the inverse of a covariance of the changes."""
    own = nominal[used][:, used]
    scale = own.diagonal().clamp(min=1e-300).sqrt()
    values, axes = torch.linalg.eigh(own / scale / scale.unsqueeze(-1))
    # Directions that the rows promise to know perfectly are rounding.
    inverse = values.clamp(min=_LEAST * float(values[-1])).rsqrt()
    return inverse.unsqueeze(-1) * axes.T / scale


def fit_payload(
    model: Model,
    robot: Robot,
    change: Float[Tensor, " R"],
    covariance: Float[Tensor, "R R"],
    columns: Float[Tensor, "R 10"],
    root: Float[Tensor, "R R"],
) -> Fitted:
    """Least squares for the model's parameters, with the directions left undetermined set aside."""
    # From the model's parameters to the ten, and where to linearise.
    to_parameters: Callable[[Tensor], Tensor] = torch.clone
    free = change.new_zeros(4 if model == "symmetric" else PARAMETERS_PER_LINK)
    if model == "symmetric":
        to_parameters = partial(_symmetric, robot)
    elif model == "point_mass":
        to_parameters = _point_mass
        general = _estimator(columns, root)[0] @ change
        free = _point_mass_solution(general, change, columns, root)
    slope = jacobian(to_parameters, free)
    estimator, null = _estimator(columns @ slope, root)
    if model != "point_mass":
        free = estimator @ change
    left = torch.eye(len(change), dtype=change.dtype) - columns @ slope @ estimator
    return Fitted(
        free,
        estimator @ covariance @ estimator.T,
        to_parameters,
        null,
        change - columns @ to_parameters(free),
        (left @ covariance @ left.T).diagonal().clamp(min=0).sqrt(),
    )


def _estimator(design: Tensor, root: Tensor) -> tuple[Tensor, Tensor]:
    """The linear estimator (F, R), least squares in the weighting and of least norm where the
    design leaves a choice; and the directions (F, D) it leaves undetermined."""
    norm = design.norm(dim=0)
    scale = 1 / torch.where(norm > 0, norm, torch.ones_like(norm))
    _, sizes, directions = torch.linalg.svd(design * scale, full_matrices=True)
    rank = int((sizes > RANK_TOLERANCE * sizes.max()).sum())
    seen, unseen = directions[:rank].T, directions[rank:].T
    basis = scale.unsqueeze(-1) * seen
    null = scale.unsqueeze(-1) * unseen
    return basis @ torch.linalg.pinv(root @ design @ basis, rtol=1e-14) @ root, null


def _symmetric(robot: Robot, free: Tensor) -> Tensor:
    """Symmetric about the tool's z axis: m, m cz, J across and J along the axis, tool frame."""
    m, h, across, along = free.unbind()
    none = torch.zeros_like(m)
    tool = torch.stack([m, none, none, h, across, none, none, across, none, along])
    return move(tool, robot.tool.to(free))


def _point_mass(free: Tensor) -> Tensor:
    """Mass and position in the last link's frame: all inertia is that of the offset."""
    mass, place = free[:1], free[1:].unsqueeze(0)
    return InertialParameters.from_com(mass, place, free.new_zeros(1, 6)).pi[0]


def _point_mass_solution(general: Tensor, change: Tensor, columns: Tensor, root: Tensor) -> Tensor:
    """Nonlinear least squares from the general payload's mass and centre of mass."""
    mass = float(general[0])
    place = general[1:4] / mass if mass > 0 else torch.zeros_like(general[1:4])

    def residual(x: object) -> object:
        return (root @ (columns @ _point_mass(torch.as_tensor(x)) - change)).numpy()

    def slope(x: object) -> object:
        return (root @ columns @ jacobian(_point_mass, torch.as_tensor(x))).numpy()

    start = torch.cat([general[:1], place.clamp(-1, 1)]).numpy()
    found = least_squares(residual, start, slope, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return torch.from_numpy(found.x)


def nearest_consistent(
    parameters: Float[Tensor, "10"], covariance: Float[Tensor, "10 10"], null: Float[Tensor, "10 D"]
) -> tuple[Float[Tensor, "10"], float, int]:
    """The physically consistent payload nearest in the metric of the covariance.

    Consistent bodies are those of positive definite pseudo-inertia P, which is linear in the ten
    parameters (Wensing et al. 2018), so the problem is convex. Newton's method follows the central
    path of t distance^2 - log det P + trace P; the last term keeps directions that the distance
    does not weigh from running away. The body found is strictly inside, its squared distance
    within about 1e-7 of the least.

    Args:
        parameters: the estimate, in any frame.
        covariance: theirs.
        null: directions that are not determined: free to move along, at no distance.

    Returns:
        The parameters (10,), the squared distance, and in how many directions it was measured.
    """
    # Combinations of the parameters that do not feel `null`, of unit covariance (R, 10).
    std = covariance.diagonal().clamp(min=0).sqrt()
    scale = torch.where(std > 0, std, torch.ones_like(std))
    directions = torch.linalg.svd(null / scale.unsqueeze(-1), full_matrices=True).U
    seen = directions[:, null.shape[1] :].T / scale
    sizes, vectors = torch.linalg.eigh(seen @ covariance @ seen.T)
    kept = sizes > _VANISHES * sizes.max().clamp(min=1e-300)
    whiten = (vectors[:, kept] / sizes[kept].sqrt()).T @ seen
    # P's entries by parameter (10, 4, 4), in units that make them of order one; and a consistent
    # body near the given parameters, with eigenvalues raised.
    unit = pseudo_inertia_basis().to(parameters)
    p = torch.einsum("k,kab->ab", parameters, unit)
    size = p.diagonal().abs().sqrt()
    size = size.clamp(min=1e-2 * float(size.max())).clamp(min=1e-9)
    entries = unit / size / size.unsqueeze(-1)
    values, axes = torch.linalg.eigh(p / size / size.unsqueeze(-1))
    raised = ((axes * values.clamp(min=1e-2)) @ axes.T).flatten().unsqueeze(-1)
    x = torch.linalg.lstsq(entries.flatten(1).T, raised, driver="gelsd").solution.squeeze(-1)

    def distance(x: Tensor) -> float:
        return float((whiten @ (x - parameters)).square().sum())

    t = 1 / max(1.0, distance(x))
    while t < _SHARPEST:
        t = min(_SHARPER * t, _SHARPEST)
        for _ in range(_NEWTON_STEPS):
            x, decrement = _newton_step(x, parameters, whiten, entries, t)
            if decrement < 1e-6:
                break
    return x, distance(x), len(whiten)


def _newton_step(
    x: Tensor, centre: Tensor, whiten: Tensor, entries: Tensor, t: float
) -> tuple[Tensor, float]:
    """One step on t |whiten (x - centre)|^2 - log det P(x) + trace P(x), damped so that P stays
    positive definite (Nesterov and Nemirovskii 1994); and Newton's decrement before it."""
    inverse = torch.linalg.inv(torch.linalg.cholesky(torch.einsum("k,kab->ab", x, entries)))
    scaled = inverse @ entries @ inverse.T
    gradient = (
        2 * t * whiten.T @ (whiten @ (x - centre))
        - scaled.diagonal(dim1=1, dim2=2).sum(-1)
        + entries.diagonal(dim1=1, dim2=2).sum(-1)
    )
    # The Hessian is rows' rows; by its QR factor, the condition number is not squared.
    rows = torch.cat([math.sqrt(2 * t) * whiten, scaled.flatten(1).T])
    unit = 1 / rows.norm(dim=0)
    r = torch.linalg.qr(rows * unit, mode="r").R
    half = torch.linalg.solve_triangular(r.T, (unit * gradient).unsqueeze(-1), upper=False)
    step = unit * torch.linalg.solve_triangular(r, half, upper=True).squeeze(-1)
    decrement = float(half.norm())
    step = step / (1 + decrement if decrement > 0.25 else 1.0)
    # Where the distance outweighs the barrier a billion times, rounding alone may leave the cone.
    while torch.linalg.cholesky_ex(torch.einsum("k,kab->ab", x - step, entries)).info > 0:
        step = step / 2
    return x - step, decrement
