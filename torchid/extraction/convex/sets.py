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

from torchid.design.bodies import triangle
from torchid.effects.base import JointEffect
from torchid.extraction.convex.conic import Rows, Solution, minimise
from torchid.extraction.problem import Problem
from torchid.feasibility.bounds import Bounds
from torchid.feasibility.conditions import Conditions
from torchid.feasibility.sets import ParameterSets
from torchid.robot.inertia import InertialParameters, pseudo_inertia_basis
from torchid.robot.model import Robot
from torchid.typing import Float

AXES = "xyz"
ENTRIES = ("xx", "xy", "xz", "yy", "yz", "zz")
_DIAGONAL = {"xx": (1, 2), "yy": (0, 2), "zz": (0, 1)}
"""Diagonal entries of I and the axes whose m c^2 they lose against J."""
_MIXED = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}

REACH = 100.0
"""Inertia of a link at most, over its largest mass and `length_scale` squared, in a proof that
needs some bound."""


def link_columns(n: int, link: int) -> np.ndarray:
    """Where the 10 parameters of link `link` (from 0) are in x."""
    moment, inertia = n + 3 * link, 4 * n + 6 * link
    return np.array([link, *range(moment, moment + 3), *range(inertia, inertia + 6)])


def length_scale(robot: Robot) -> float:
    """A third of the longest step between two joints [m], and at least 1 cm."""
    steps = (robot.before @ robot.after)[:, :3, 3].norm(dim=-1)
    return max(0.01, float(steps.max()) / 3)


class RowBuilder:
    """Collects rows in x scaled to entries near 1: v = x / scale."""

    def __init__(
        self, robot: Robot, effects: Sequence[JointEffect], margin: float | Sequence[float]
    ):
        self.n = robot.n_links
        self.effects = tuple(effects)
        self.size = 10 * robot.n_links + sum(len(e.coefficients) for e in effects)
        self.length = length_scale(robot)
        self.margin = np.broadcast_to(np.asarray(margin, dtype=float), (robot.n_links,))
        unit = self.length
        per_link = [1.0, *([unit] * 3), *([unit * unit] * 6)]
        self.scale = np.ones(self.size)
        for link in range(self.n):
            self.scale[link_columns(self.n, link)] = per_link
        self.rows: list[Rows] = []
        self._pseudo = pseudo_inertia_basis().numpy()

    def _row(self, entries: dict[int, float]) -> np.ndarray:
        row = np.zeros(self.size)
        for k, value in entries.items():
            row[k] += value * self.scale[k]
        return row

    def _linear(
        self, name: str, entries: Sequence[dict[int, float]], offset: Sequence[float], size: float
    ) -> None:
        """Rows entries'x + offset >= 0, divided by their largest entry; `size` in their unit."""
        matrix = np.stack([self._row(e) for e in entries])
        unit = np.abs(matrix).max(-1)
        right = np.asarray(offset, dtype=float) / unit
        self.rows.append(Rows(name, "nonnegative", matrix / unit[:, None], right, size / unit))

    def interval(
        self, name: str, entries: dict[int, float], low: float, high: float, per: int | None = None
    ) -> None:
        """low <= entries'x <= high; or, per an entry of x, so many times it."""
        # Tightened by a share of the interval, or of it times a kilogram.
        size = high - low if np.isfinite(high - low) else float(per is None)
        for sign, limit in ((1.0, low), (-1.0, high)):
            if np.isfinite(limit):
                row, offset = {k: sign * v for k, v in entries.items()}, -sign * limit
                if per is not None:
                    row, offset = row | {per: offset}, 0.0
                self._linear(name, [row], [offset], max(size, 0.0))

    def consistency(self, link: int) -> None:
        """Pseudo-inertia >= margin E, in units of length so that its entries are alike."""
        d = np.array([*([1 / self.length] * 3), 1.0])
        alike = d[:, None] * d
        columns = link_columns(self.n, link)
        matrix = np.zeros((10, self.size))
        matrix[:, columns] = (triangle(self._pseudo * alike) * self.scale[columns, None]).T
        unit = triangle(np.eye(4) * alike)
        name = f"inertia_{link + 1}"
        self.rows.append(Rows(name, "semidefinite", matrix, -self.margin[link] * unit, 0 * unit))

    def com(self, link: int, box: np.ndarray) -> None:
        """m c_min <= mc <= m c_max, axis by axis."""
        for axis, (low, high) in enumerate(box.tolist()):
            name = f"com_{link + 1}{AXES[axis]}"
            self.interval(name, {self._moment(link, axis): 1.0}, low, high, per=link)

    def shape(self, link: int, conditions: Conditions) -> None:
        """|mc - m c_0| <= r m in the axes that count."""
        radius = float(conditions.round_radius[link])
        if not np.isfinite(radius):
            return
        rows = [self._row({link: radius})]
        for axis in range(3):
            if float(conditions.round_axes[link, axis]) != 0:
                centre = float(conditions.round_centre[link, axis])
                rows.append(self._row({self.n + 3 * link + axis: 1.0, link: -centre}))
        matrix = np.stack(rows) / self.length
        inward = np.zeros(len(rows))
        inward[0] = radius / self.length
        name = f"shape_{link + 1}"
        self.rows.append(Rows(name, "second_order", matrix, np.zeros(len(rows)), inward))

    def barycentric(
        self, link: int, box: np.ndarray, bounds: np.ndarray, com: np.ndarray | None = None
    ) -> None:
        """Conditions that every set within the bounds (6, 2) of the barycentric inertia meets; or,
        with a centre of mass (3,), that only such sets meet: the concave parts are replaced by
        their tangents there."""
        for entry, (low, high) in zip(ENTRIES, bounds.tolist(), strict=True):
            axes, size = list((_DIAGONAL | _MIXED)[entry]), high - low
            if entry in _DIAGONAL:
                self._diagonal_from_below(link, entry, low, high)
                # m c^2 <= its secant over the box, or >= its tangent.
                ends = box[axes].T if com is None else (com[axes], com[axes])
                self._diagonal_from_above(
                    link, entry, ends[0] + ends[1], ends[0] * ends[1], high, size
                )
            elif com is None:
                self._envelope(link, entry, box[axes], low, high)
            else:
                self._product(link, entry, com[axes], 1.0, high, size)
                self._product(link, entry, com[axes], -1.0, -low, size)

    def _entry(self, link: int, entry: str) -> int:
        return 4 * self.n + 6 * link + ENTRIES.index(entry)

    def _moment(self, link: int, axis: int) -> int:
        return self.n + 3 * link + axis

    def _rotated(
        self,
        name: str,
        a: np.ndarray,
        b: np.ndarray,
        squares: Sequence[np.ndarray],
        ends: tuple[float, float, float],
    ) -> None:
        """(a'v + ends[0]) (b'v + ends[1]) >= the sum of the squares; tightened in a by ends[2]."""
        offset, inward = np.zeros(2 + len(squares)), np.zeros(2 + len(squares))
        offset[:2] = ends[0] + ends[1], ends[0] - ends[1]
        inward[:2] = ends[2]
        matrix = np.stack([a + b, a - b, *(2 * s for s in squares)])
        self.rows.append(Rows(name, "second_order", matrix, offset, inward))

    def _diagonal_from_below(self, link: int, entry: str, low: float, high: float) -> None:
        """I_xx >= low: m (J_xx - low) >= (m c_y)^2 + (m c_z)^2, in units of length."""
        unit = self.length
        self._rotated(
            f"bound_{link + 1}{entry}",
            self._row({self._entry(link, entry): 1 / unit**2}),
            self._row({link: 1.0}),
            [self._row({self._moment(link, a): 1 / unit}) for a in _DIAGONAL[entry]],
            (-low / unit**2, 0.0, (high - low) / unit**2),
        )

    def _diagonal_from_above(
        self,
        link: int,
        entry: str,
        slope: np.ndarray,
        constant: np.ndarray,
        high: float,
        size: float,
    ) -> None:
        """J_xx <= high + sum over the two axes of (slope mc - constant m), in place of m c^2."""
        if not np.isfinite(constant).all():
            return
        row = {self._entry(link, entry): -1.0, link: -float(constant.sum())}
        row |= {
            self._moment(link, a): float(k) for a, k in zip(_DIAGONAL[entry], slope, strict=True)
        }
        self._linear(f"bound_{link + 1}{entry}", [row], [high], size)

    def _envelope(self, link: int, entry: str, box: np.ndarray, low: float, high: float) -> None:
        """low <= J_xy + w <= high for some w in the McCormick envelope of m c_x c_y over the box:
        w >= its tangents at two opposite corners, w <= those at the other two."""
        if not np.isfinite(box).all():
            return
        x, y = _MIXED[entry]
        rows, offsets = [], []
        for sign, limit, corners in ((-1.0, high, ((0, 0), (1, 1))), (1.0, -low, ((1, 0), (0, 1)))):
            for i, k in corners:
                cx, cy = float(box[0, i]), float(box[1, k])
                rows.append(
                    {
                        self._entry(link, entry): sign,
                        self._moment(link, y): sign * cx,
                        self._moment(link, x): sign * cy,
                        link: -sign * cx * cy,
                    }
                )
                offsets.append(limit)
        self._linear(f"bound_{link + 1}{entry}", rows, offsets, high - low)

    def _product(
        self, link: int, entry: str, com: np.ndarray, sign: float, limit: float, size: float
    ) -> None:
        """sign (J_xy + m c_x c_y) <= limit. With s, d = c_x +- sign c_y the product is, up to the
        sign, (m s^2 - m d^2) / 4: the first is a cone, the second is at least its tangent."""
        (x, y), unit = _MIXED[entry], self.length
        d = float(com[0] - sign * com[1])
        rest = {
            self._entry(link, entry): -4 * sign / unit**2,
            self._moment(link, x): 2 * d / unit**2,
            self._moment(link, y): -2 * d * sign / unit**2,
            link: -d * d / unit**2,
        }
        total = self._row({self._moment(link, x): 1 / unit, self._moment(link, y): sign / unit})
        self._rotated(
            f"bound_{link + 1}{entry}",
            self._row(rest),
            self._row({link: 1.0}),
            [total],
            (4 * limit / unit**2, 0.0, 4 * size / unit**2),
        )

    def reach(self, bounds: Bounds) -> np.ndarray:
        """Bound the inertias of links of bounded mass; (d,) what |v| then is at most."""
        radius = np.full(self.size, np.inf)
        for link in range(self.n):
            mass = max(1.0, float(bounds.mass[link].abs().max()))
            reach = float(bounds.com[link].abs().amax(-1).square().sum())
            allowed = float(bounds.inertia[link].abs().max()) + mass * reach
            limit = max(REACH * mass * self.length**2, 2 * allowed)
            columns = link_columns(self.n, link)
            for k in (4, 7, 9):
                self._linear(f"reach_{link + 1}", [{int(columns[k]): -1.0}], [limit], limit)
            # tr S = tr J / 2 bounds the entries of J and, with the mass, the first moment.
            moment = np.sqrt(1.5 * limit * mass)
            radius[columns] = [mass, *([moment] * 3), *([limit * 1.5] * 6)]
        radius[10 * self.n :] = bounds.box(self.effects)[10 * self.n :].abs().amax(-1).cpu().numpy()
        return radius / self.scale

    def coefficients(self, bounds: Bounds | None) -> None:
        """Bounds of the effects' coefficients, and their signs."""
        kinds = [(e, c) for e in self.effects for c in e.coefficients]
        box = None if bounds is None else bounds.box(self.effects)[10 * self.n :].tolist()
        for k, (effect, c) in enumerate(kinds):
            low, high = (-np.inf, np.inf) if box is None else box[k]
            low = max(low, 0.0) if c.non_negative else low
            self.interval(f"{c.name}_{effect.joint + 1}", {10 * self.n + k: 1.0}, low, high)


@dataclass(frozen=True, eq=False)
class Nearest:
    """The point of a set with the least norm, and how it was reached.

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
        # 1e-2: distance to such a condition, relative to it, at which it is reached
        return any(
            bool((row.matrix @ v + row.offset <= 1e-2 * row.inward).any())
            for row in self.rows
            if row.name.startswith("reach_")
        )

    @property
    def reach_names(self) -> tuple[str, ...]:
        """Names of the conditions that only keep the sets bounded."""
        return tuple(name for name in self.names if name.startswith("reach_"))

    def without(self, names: Iterable[str]) -> "ConvexSets":
        """These sets with conditions left out. What bounded v may have gone: radius is unknown."""
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
        """These conditions for v = basis w + origin."""
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
        # 1e-6: a least norm below this share of the offset's is not solved again in its own unit
        if best.solution.usable and best.value > 1e-6 * unit:
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
        solution = minimise(cost, [*wide, norm], radius=np.append(self.radius, np.inf))
        x = self.x(solution.point[:-1])
        value = float(np.linalg.norm(matrix @ x + offset))
        return Nearest(solution, x, value, min(max(solution.bound, 0.0) * unit, value))

    def least(self, row: np.ndarray) -> tuple[Solution, np.ndarray]:
        """Minimise row'x; the constant row'origin is not in the solution's value."""
        solution = minimise(self.basis.T @ row, self.rows, radius=self.radius)
        return solution, self.x(solution.point)


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
        reach: whether diagonal entries of J are at most `REACH` times the bound of the
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
            com = None if inside is None else inside[link]
            builder.barycentric(link, box[link], bounds.inertia[link].cpu().numpy(), com)
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
        """The conditions that count."""
        return self.problem.conditions if self.with_conditions else None

    @property
    def box(self) -> Float[np.ndarray, "n 3 2"]:
        """The box of the centres of mass."""
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
