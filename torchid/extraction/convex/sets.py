"""The feasible sets as a convex body, in the variables in which the loss is convex.

x = (m, mc, J about the link frames) of all links in the paper's order, then the coefficients of
the effects (`ParameterSets.vector`). Torque is linear in x, and these conditions are convex:

- physical consistency: the pseudo-inertia of each link is positive semidefinite (P. Wensing,
  S. Kim, J.-J. Slotine, "Linear Matrix Inequalities for Physically-Consistent Inertial Parameter
  Identification", IEEE RA-L 3(1), 2018);
- bounds of masses and coefficients, total mass: linear;
- boxes of the centres of mass, m c_min <= mc <= m c_max: linear (C. Sousa, R. Cortesao, "Physical
  feasibility of robot base inertial parameter identification: a linear matrix inequality
  approach", IJRR 33(6), 2014);
- cylinders and spheres, |mc - m c_0| <= r m: second-order cones.

Bounds of the *barycentric* inertia I are not convex in x. They are replaced by convex conditions
that every set within them meets, so that a minimum over x is a lower bound for them: I_xx >= lb
is m (J_xx - lb) >= (mc_y)^2 + (mc_z)^2, exactly a cone; for I_xx <= ub, m c^2 is replaced by its
secant over the box of c; for I_xy, m c_x c_y by its McCormick envelope.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchid.effects.base import JointEffect
from torchid.extraction.convex.conic import Rows, Solution, minimise
from torchid.extraction.convex.rows import RowBuilder
from torchid.extraction.problem import Problem
from torchid.feasibility.bounds import Bounds
from torchid.feasibility.conditions import Conditions
from torchid.feasibility.sets import ParameterSets
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Float

_REACHED = 1e-2
"""Distance to such a condition, relative to it, at which it is reached."""
_ZERO = 1e-6
"""A least norm below this share of the offset's is not solved again in its own unit."""


@dataclass(frozen=True, eq=False)
class Nearest:
    """A least norm.

    Attributes:
        solution: of the solver; its multipliers end with those of the norm.
        x: (P,) where it is, nan unless solved.
        value: the norm there.
        bound: what the norm is at least.
    """

    solution: Solution
    x: np.ndarray
    value: float
    bound: float


@dataclass(frozen=True, eq=False)
class ConvexSets:
    """Conditions on x = basis v + origin, written in v.

    Attributes:
        rows: the conditions.
        basis, origin: (P, d), (P,).
        radius: (d,) bounds on |v|, infinite where none is known.
    """

    rows: tuple[Rows, ...]
    basis: np.ndarray
    origin: np.ndarray
    radius: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the conditions, each once."""
        return tuple(dict.fromkeys(r.name for r in self.rows))

    def touches_reach(self, v: np.ndarray) -> bool:
        """Whether v is at a condition that only keeps the sets bounded, and could go on."""
        return any(
            bool((row.matrix @ v + row.offset <= _REACHED * row.inward).any())
            for row in self.rows
            if row.name.startswith("reach_")
        )

    @property
    def reach_names(self) -> tuple[str, ...]:
        """Names of the conditions that only keep the sets bounded."""
        return tuple(name for name in self.names if name.startswith("reach_"))

    def without(self, names: Iterable[str]) -> "ConvexSets":
        """The same with conditions left out. What bounded v may have gone: radius is unknown."""
        out = set(names)
        kept = tuple(r for r in self.rows if r.name not in out)
        return replace(self, rows=kept, radius=np.full_like(self.radius, np.inf))

    def tightened(self, share: float) -> "ConvexSets":
        """The sets inside by a share of each condition's size."""
        return replace(self, rows=tuple(r.tightened(share) for r in self.rows))

    def plus(self, rows: Sequence[Rows]) -> "ConvexSets":
        """With more conditions, written in v."""
        return replace(self, rows=(*self.rows, *rows))

    def affine(self, matrix: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """matrix x + offset as a function of v: (m, d), (m,)."""
        return matrix @ self.basis, matrix @ self.origin + offset

    def ball(self, matrix: np.ndarray, offset: np.ndarray, radius: float, name: str) -> Rows:
        """The condition ||matrix x + offset|| <= radius."""
        a, b = self.affine(matrix, offset)
        rows = np.concatenate([np.zeros((1, a.shape[1])), a]) / radius
        right = np.concatenate([[1.0], b / radius])
        return Rows(name, "second_order", rows, right, np.zeros(len(right)))

    def x(self, v: np.ndarray) -> np.ndarray:
        """(P,) parameters."""
        return self.basis @ v + self.origin

    def on(self, basis: np.ndarray, origin: np.ndarray) -> "ConvexSets":
        """The same conditions for v = basis w + origin."""
        rows = tuple(
            replace(r, matrix=r.matrix @ basis, offset=r.matrix @ origin + r.offset)
            for r in self.rows
        )
        return ConvexSets(
            rows,
            self.basis @ basis,
            self.basis @ origin + self.origin,
            np.full(basis.shape[1], np.inf),
        )

    def least_norm(self, matrix: np.ndarray, offset: np.ndarray) -> "Nearest":
        """Minimise ||matrix x + offset||.

        Solved twice, the second time in units of the first answer: the solver's tolerance is then
        relative to the minimum.
        """
        unit = max(float(np.linalg.norm(offset)), 1e-300)
        best = self._least_norm(matrix, offset, unit)
        if best.solution.usable and best.value > _ZERO * unit:
            again = self._least_norm(matrix, offset, best.value)
            if again.solution.usable and again.bound >= best.bound:
                best = again
        return best

    def _least_norm(self, matrix: np.ndarray, offset: np.ndarray, unit: float) -> "Nearest":
        a, b = self.affine(matrix, offset)
        d = a.shape[1]
        norm = Rows(
            "norm",
            "second_order",
            np.block([[np.zeros((1, d)), np.ones((1, 1))], [a / unit, np.zeros((len(b), 1))]]),
            np.concatenate([[0.0], b / unit]),
            np.zeros(len(b) + 1),
        )
        wide = [replace(r, matrix=np.pad(r.matrix, ((0, 0), (0, 1)))) for r in self.rows]
        cost = np.zeros(d + 1)
        cost[-1] = 1.0
        found = minimise(cost, [*wide, norm], radius=np.append(self.radius, np.inf))
        x = self.x(found.point[:-1])
        value = float(np.linalg.norm(matrix @ x + offset))
        return Nearest(found, x, value, min(max(found.bound, 0.0) * unit, value))

    def least(self, row: np.ndarray) -> tuple[Solution, np.ndarray]:
        """Minimise row'x; the constant row'origin is not in the solution's value."""
        found = minimise(self.basis.T @ row, self.rows, radius=self.radius)
        return found, self.x(found.point)


def sets_of(
    x: np.ndarray, n: int, effects: Sequence[JointEffect], ids: Sequence[str]
) -> ParameterSets:
    """Vectors (K, P) as parameter sets."""
    full = torch.as_tensor(x, dtype=torch.float64)
    return ParameterSets(
        tuple(ids),
        InertialParameters.from_paper_order(full[:, : 10 * n]),
        tuple(effects),
        full[:, 10 * n :].clone(),
    )


def convex_sets(
    robot: Robot,
    effects: Sequence[JointEffect],
    conditions: Conditions | None,
    bounds: Bounds | None,
    *,
    com_bounds: bool = True,
    inertia_bounds: bool = True,
    margin: float | Sequence[float] = 0.0,
    reach: bool = False,
    inside: np.ndarray | None = None,
) -> ConvexSets:
    """The feasible sets of a robot, or the smallest convex relaxation known here.

    Names of conditions: mass_1 (bounds of the mass), inertia_1 (physical consistency), com_1x (box
    of the centre of mass: of the conditions and the bounds), shape_1, bound_1xx (bounds of the
    barycentric inertia), total_mass, Fv_6.

    Args:
        robot: number of links and a length.
        effects: whose coefficients are part of x. Physics keeps some from being negative, bounds
            or no bounds.
        conditions: boxes, shapes, total mass; not asked for if None.
        bounds: of the search variables; physics only if None.
        com_bounds, inertia_bounds: whether the bounds' boxes of the centres of mass and of the
            barycentric inertias count.
        margin: smallest eigenvalue of the links' pseudo-inertias [kg m^2, kg], of all or of each.
        reach: whether diagonal entries of J are at most `convex_rows.REACH` times the bound of the
            mass times the square of `length_scale`, or twice what the bounds allow if that is
            more: it makes sets of bounded masses bounded.
        inside: (n, 3) centres of mass. The bounds of the barycentric inertias are then not relaxed
            but made stricter, by linearisation about them: all sets are within the bounds, and
            those near these centres of mass are not lost.
    """
    builder = RowBuilder(robot, effects, margin)
    box = com_box(robot.n_links, conditions, bounds if com_bounds else None)
    for link in range(robot.n_links):
        builder.consistency(link)
        builder.com(link, box[link])
        if bounds is not None:
            builder.interval(f"mass_{link + 1}", {link: 1.0}, *bounds.mass[link].tolist())
        if bounds is not None and inertia_bounds:
            limits = bounds.inertia[link].cpu().numpy()
            if inside is None:
                builder.barycentric(link, box[link], limits)
            else:
                builder.barycentric_inside(link, inside[link], limits)
        if conditions is not None:
            builder.shape(link, conditions)
    if conditions is not None:
        builder.interval(
            "total_mass", dict.fromkeys(range(robot.n_links), 1.0), *conditions.total_mass.tolist()
        )
    builder.coefficients(bounds)
    unknown = np.full(builder.size, np.inf)
    radius = builder.reach(bounds) if reach and bounds is not None else unknown
    return ConvexSets(tuple(builder.rows), np.diag(builder.scale), np.zeros(builder.size), radius)


@dataclass(frozen=True, eq=False)
class AskedSets:
    """The feasible sets of a problem, of which some conditions count.

    Attributes:
        problem: target, bounds and conditions.
        with_conditions: whether the conditions of section 2.3 count; without, only bounds and
            physics do.
        com_bounds, inertia_bounds: whether the bounds' boxes do, see `convex_sets`.
    """

    problem: Problem
    with_conditions: bool = True
    com_bounds: bool = True
    inertia_bounds: bool = True

    @property
    def conditions(self) -> Conditions | None:
        """Those that count."""
        return self.problem.conditions if self.with_conditions else None

    @property
    def box(self) -> Float[np.ndarray, "n 3 2"]:
        """Of the centres of mass."""
        bounds = self.problem.bounds if self.com_bounds else None
        return com_box(self.problem.n, self.conditions, bounds)

    def body(self, margin: float = 0.0, inside: np.ndarray | None = None) -> ConvexSets:
        """The sets, with margin and centres of mass as in `convex_sets`."""
        return convex_sets(
            self.problem.robot,
            self.problem.target.effects,
            self.conditions,
            self.problem.bounds,
            com_bounds=self.com_bounds,
            inertia_bounds=self.inertia_bounds,
            margin=margin,
            reach=True,
            inside=inside,
        )


def com_box(n: int, conditions: Conditions | None, bounds: Bounds | None) -> np.ndarray:
    """(n, 3, 2) what the boxes of the centres of mass have in common [m]."""
    box = np.tile(np.array([-np.inf, np.inf]), (n, 3, 1))
    for given in (
        None if conditions is None else conditions.com_box,
        None if bounds is None else bounds.com,
    ):
        if given is not None:
            box[..., 0] = np.maximum(box[..., 0], given[..., 0].cpu().numpy())
            box[..., 1] = np.minimum(box[..., 1], given[..., 1].cpu().numpy())
    return box
