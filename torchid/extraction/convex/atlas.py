"""How far each physical parameter can go while the torque stays: the ranges of feasible sets.

The torque determines base parameters only; beyond them, feasibility is all that is known. For each
mass, centre of mass, entry of the inertia about the link frame and coefficient of an effect, this
finds the smallest and the largest value over all feasible sets that

- reproduce the identified base parameters exactly, where some feasible set does;
- or, where none does, have at most (1 + slack) times the least loss;
- or, with the covariance C of the base parameters beta, lie in their confidence ellipsoid

      (G x - beta)' C^-1 (G x - beta) <= chi2(B, level),

  with the quantile of chi squared for the B base parameters together, so that with that
  probability *all* ranges hold the true values at once, if these are feasible.

Each end is one semidefinite program. A centre of mass is a ratio, mc / m; with y = x / m it is
linear over { y : conditions homogenised by 1 / m, mass of y = 1 } (A. Charnes, W. Cooper,
"Programming with linear fractional functionals", Naval Research Logistics Quarterly 9, 1962).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Literal

import numpy as np
import torch
from scipy.special import gammaincinv

from torchid.errors import TorchidError
from torchid.extraction.convex.certificate import loss_matrix
from torchid.extraction.convex.conic import Rows, Status
from torchid.extraction.convex.sets import AXES, AskedSets, ConvexSets
from torchid.extraction.problem import Problem
from torchid.extraction.record import AtlasRange, AtlasRecord, problem_fields
from torchid.identification.result import Identification
from torchid.identification.values import BaseValues, identified_base
from torchid.results.record import Result
from torchid.robot.inertia import parameter_names, parameter_units
from torchid.robot.model import JointType
from torchid.tensors import as_tensor
from torchid.typing import Float, Numbers, Tensor

Kind = Literal["exact", "least loss", "confidence"]


@dataclass(frozen=True, eq=False)
class Region:
    """Feasible sets of equal torque.

    Attributes:
        sets: the feasible sets.
        kind: what equal torque means.
        radius: of the region, in units of its norm.
        widened: whether it was grown until it holds a feasible set.
    """

    sets: ConvexSets
    kind: Kind
    radius: float
    widened: bool = False


def least_loss_region(problem: Problem, body: ConvexSets, slack: float) -> Region:
    """Feasible sets with exactly the target's base parameters; where there are none, those with at
    most (1 + slack) times the least loss."""
    matrix, offset = loss_matrix(problem)
    least = body.least_norm(matrix, offset)
    # 1e-8: least norm of the residual, relative to the target's, that counts as reproduced exactly
    if not least.solution.usable or least.value <= 1e-8 * float(np.linalg.norm(offset)):
        # Without any feasible set the ends say so.
        return Region(_on_solutions(body, matrix, offset), "exact", 0.0)
    radius = float(np.sqrt(1 + slack) * least.value)
    ball = body.ball(matrix, offset, radius, "torque")
    return Region(body.plus([ball]), "least loss", radius)


def confidence_region(
    problem: Problem, body: ConvexSets, covariance: Tensor, level: float, slack: float
) -> Region:
    """Feasible sets in the confidence ellipsoid of the base parameters.

    Raises:
        TorchidError: a covariance of another size.
    """
    target = problem.target
    c = covariance.detach().cpu().double().numpy()
    if c.shape != (len(target.base), len(target.base)):
        raise TorchidError(
            "the covariance does not belong to the base parameters.",
            got=c.shape,
            expected=f"({len(target.base)}, {len(target.base)})",
        )
    grouping = target.base.grouping.cpu().double().numpy()
    values = target.values.cpu().double().numpy()
    variance = c.diagonal()
    known, free = variance == 0, np.isfinite(variance) & (variance > 0)
    if known.any():
        body = _on_solutions(body, grouping[known], -values[known])
    if not free.any():
        return Region(body, "confidence", 0.0)
    scale = np.sqrt(variance[free])
    eigenvalues, vectors = np.linalg.eigh(c[np.ix_(free, free)] / scale / scale[:, None])
    whiten = vectors.T / np.sqrt(np.maximum(eigenvalues, 1e-12))[:, None] / scale
    matrix, offset = whiten @ grouping[free], -whiten @ values[free]
    radius = float(np.sqrt(2 * gammaincinv(0.5 * free.sum(), level)))
    least = body.least_norm(matrix, offset)
    widened = least.solution.usable and least.value > radius
    radius = float(np.sqrt(1 + slack) * least.value) if widened else radius
    ball = body.ball(matrix, offset, radius, "torque")
    return Region(body.plus([ball]), "confidence", radius, widened)


def _on_solutions(body: ConvexSets, matrix: np.ndarray, offset: np.ndarray) -> ConvexSets:
    """The sets with matrix x + offset = 0, in coordinates of the solutions (least squares, where
    there is none): so every point meets the equations to rounding."""
    a, b = body.affine(matrix, offset)
    u, size, vh = np.linalg.svd(a)
    rank = int((size > 1e-10 * size[0]).sum())
    origin = -vh[:rank].T @ ((u[:, :rank].T @ b) / size[:rank])
    return body.on(vh[rank:].T, origin)


@dataclass(frozen=True, eq=False)
class Atlas(Result):
    """Ranges of Q physical parameters.

    Attributes:
        problem: target, bounds and conditions.
        names: (Q,) m1, c1x, J1xx (about the link frame), Fv1.
        units: (Q,).
        low, high: (Q,) the range over feasible sets of equal torque; infinite where there is no
            end, nan where none was found (see `status`).
        bounds_low, bounds_high: (Q,) the range over feasible sets of any torque.
        status: (Q, 2) of both ends: solved, inexact (to about 1e-6), unbounded, infeasible, failed.
        extremes: (Q, 2, P) sets at the ends, in the grouping's order; nan where there is none.
        kind: what equal torque means: exact, least loss or confidence.
        radius: of the region, in units of its norm: 0, sqrt((1 + slack) phi_min), or the square
            root of the quantile.
        widened: whether the confidence ellipsoid holds no feasible set and was grown until it does.
    """

    problem: Problem
    names: tuple[str, ...]
    units: tuple[str, ...]
    low: Float[Tensor, " Q"]
    high: Float[Tensor, " Q"]
    bounds_low: Float[Tensor, " Q"]
    bounds_high: Float[Tensor, " Q"]
    status: tuple[tuple[Status, Status], ...]
    extremes: Float[Tensor, "Q 2 P"]
    kind: Kind
    radius: float
    widened: bool

    def __repr__(self) -> str:
        return f"Atlas('{self.problem.robot.name}', {len(self.names)} parameters, {self.kind})"

    @cached_property
    def record(self) -> AtlasRecord:
        """As the JSON has it."""
        columns = (self.low, self.high, self.bounds_low, self.bounds_high, self.narrowed)
        rows = zip(self.names, self.units, *(x.tolist() for x in columns), self.status, strict=True)
        return AtlasRecord(
            **problem_fields(self.problem),
            kind=self.kind,
            radius=self.radius,
            parameters=tuple(
                AtlasRange(
                    name=name, unit=unit, low=low, high=high, bounds=(least, most),
                    share_of_bounds=share, status=status,
                )
                for name, unit, low, high, least, most, share, status in rows
            ),
        )  # fmt: skip

    @property
    def narrowed(self) -> Float[Tensor, " Q"]:
        """(Q,) width of the range over that of the bounds alone: 0 is known, 1 is not narrowed."""
        own, before = self.high - self.low, self.bounds_high - self.bounds_low
        ratio = own / before
        return torch.where(torch.isinf(before) & torch.isinf(own), 1.0, ratio).clamp(0.0, 1.0)


def atlas(
    problem: Problem,
    *,
    covariance: Numbers | BaseValues | Identification | None = None,
    level: float = 0.95,
    slack: float = 0.01,
    with_conditions: bool = True,
    com_bounds: bool = True,
    inertia_bounds: bool = True,
    only: Sequence[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Atlas:
    """The range of each physical parameter over feasible sets of equal torque.

    The bounds of barycentric inertias count by a convex relaxation, so with them a range can be
    wider than it is, never narrower.

    Args:
        problem: target, bounds and conditions.
        covariance: (B, B) of the target's values, or the identification that they are from; exact
            if None. A base parameter of zero variance keeps its value; one of infinite variance
            (its row and column are not read) is free.
        level: of the confidence ellipsoid.
        slack: beyond the least loss (see above).
        with_conditions, com_bounds, inertia_bounds: which conditions count, as in `certificate`.
        only: names of the parameters to do; all of them if None.
        progress: called with (ends done, ends in all).

    Raises:
        TorchidError: a covariance of another size, a level or slack out of range, an unknown name.

    >>> import torchid
    >>> from torchid.identification.values import nominal_base
    >>> robot = torchid.load_robot("3r")
    >>> problem, _ = torchid.problem_of(robot, nominal_base(robot))
    >>> found = atlas(problem, only=["m3"])
    >>> bool(found.low[0] <= robot.parameters.mass[2] <= found.high[0]), found.units
    (True, ('kg',))
    """
    if isinstance(covariance, Identification):
        covariance = identified_base(covariance)
    if isinstance(covariance, BaseValues):
        covariance = covariance.uncertainty
    if not 0 < level < 1 or not slack > 0:
        raise TorchidError("level lies in (0, 1), slack is positive.", got=f"{level}, {slack}")
    asked = AskedSets(problem, with_conditions, com_bounds, inertia_bounds)
    quantities = _quantities(problem, asked.box)
    if only is not None:
        named = {q.name: q for q in quantities}
        unknown = [name for name in only if name not in named]
        if unknown or not only:
            raise TorchidError(
                "no such parameters.", got=unknown or list(only), available=list(named)
            )
        quantities = [named[name] for name in only]
    body = asked.body()
    region = (
        least_loss_region(problem, body, slack)
        if covariance is None
        else confidence_region(problem, body, as_tensor(covariance, "covariance"), level, slack)
    )
    # Of each the least and the largest value, of equal torque and of any.
    ends: list[list[tuple[float, Status, np.ndarray]]] = [[] for _ in quantities]
    asked_for = product(range(len(quantities)), (region.sets, body), (1.0, -1.0))
    for done, (k, sets, sign) in enumerate(asked_for, start=1):
        ends[k].append(_end(sets, quantities[k], sign))
        if progress is not None:
            progress(done, 4 * len(quantities))
    values = torch.tensor([[e[0] for e in row] for row in ends], dtype=torch.float64)
    points = np.stack([np.stack([row[0][2], row[1][2]]) for row in ends])
    return Atlas(
        problem=problem,
        names=tuple(q.name for q in quantities),
        units=tuple(q.unit for q in quantities),
        low=values[:, 0],
        high=values[:, 1],
        bounds_low=values[:, 2],
        bounds_high=values[:, 3],
        status=tuple((row[0][1], row[1][1]) for row in ends),
        extremes=torch.as_tensor(points),
        kind=region.kind,
        radius=region.radius,
        widened=region.widened,
    )


@dataclass(frozen=True)
class _Quantity:
    """An entry of x within simple limits; over entry `mass` of x where that is given."""

    name: str
    unit: str
    column: int
    low: float
    high: float
    mass: int | None = None


def _quantities(problem: Problem, box: np.ndarray) -> list[_Quantity]:
    """All quantities that an atlas bounds, with the centres of mass in a box (n, 3, 2)."""
    n = problem.n
    quantities = []
    for k, (name, unit) in enumerate(zip(parameter_names(n), parameter_units(n), strict=True)):
        if n <= k < 4 * n:
            link, axis = divmod(k - n, 3)
            low, high = box[link, axis].tolist()
            quantities.append(_Quantity(f"c{link + 1}{AXES[axis]}", "m", k, low, high, link))
        elif k < n:
            quantities.append(_Quantity(name, unit, k, *problem.bounds.mass[k].tolist()))
        else:
            low = 0.0 if name[-1] == name[-2] else -np.inf
            quantities.append(_Quantity(name, unit, k, low, np.inf))
    limits = problem.box[10 * n :].tolist()
    for effect in problem.target.effects:
        prismatic = problem.robot.joint_types[effect.joint] is JointType.PRISMATIC
        for name, c in zip(effect.coefficient_names(), effect.coefficients, strict=True):
            low, high = limits[len(quantities) - 10 * n]
            low = max(low, 0.0) if c.non_negative else low
            quantities.append(_Quantity(name, c.unit_for(prismatic), len(quantities), low, high))
    return quantities


def _end(sets: ConvexSets, quantity: _Quantity, sign: float) -> tuple[float, Status, np.ndarray]:
    """The least value (sign 1) or the largest (-1): value, status, and the set x that has it."""
    nothing = np.full(len(sets.origin), np.nan)
    space = sets if quantity.mass is None else _over_mass(sets, quantity.mass)
    row = np.zeros(len(sets.origin))
    row[quantity.column] = sign
    # 1e-12: share of a parameter that the sets can change, below which it is the same for all
    if np.abs(row @ space.basis).max(initial=0.0) <= 1e-12 * np.abs(space.basis).max(initial=1.0):
        # The same for all: nothing to minimise, but some set must exist.
        row = 0.0 * row
    solution, _ = space.least(row)
    if solution.status == "unbounded":
        return -sign * np.inf, "unbounded", nothing
    if not solution.usable:
        return np.nan, solution.status, nothing
    v, inverse = (solution.point, 1.0) if quantity.mass is None else np.split(solution.point, [-1])
    v = v / inverse if inverse > 0 else 0.0 * v
    if sets.touches_reach(v):
        return -sign * np.inf, "unbounded", nothing
    value = float(space.origin[quantity.column])
    if row.any():
        # The bound of the minimum where it is close, else the value.
        gap, least = solution.value - solution.bound, solution.value + sign * value
        # 1e-5: gap between an end and its proof, relative to its size, up to which the proven value
        # is given
        close = 0 <= gap <= 1e-5 * max(abs(least), abs(solution.value), 1e-9)
        value += sign * (solution.bound if close else solution.value)
    value = float(np.clip(value, quantity.low, quantity.high))
    return value, solution.status, sets.x(v) if inverse > 0 else nothing


def _over_mass(sets: ConvexSets, mass: int) -> ConvexSets:
    """{ x / m : x in sets } in coordinates (v / m, 1 / m): the conditions are homogeneous in them,
    the mass of x / m is 1 and 1 / m is not negative."""
    rows = [
        replace(r, matrix=np.column_stack([r.matrix, r.offset]), offset=0.0 * r.offset)
        for r in sets.rows
    ]
    basis = np.column_stack([sets.basis, sets.origin])
    d = basis.shape[1]
    last = np.zeros((1, d))
    last[0, -1] = 1.0
    unit = Rows("unit_mass", "zero", basis[mass : mass + 1], np.array([-1.0]), np.zeros(1))
    positive = Rows("positive_mass", "nonnegative", last, np.zeros(1), np.zeros(1))
    return ConvexSets(
        (*rows, unit, positive), basis, np.zeros(len(sets.origin)), np.full(d, np.inf)
    )
