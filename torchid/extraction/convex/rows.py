"""The conditions on feasible sets as rows of cones, in x = (m, mc, J, coefficients).

See `torchid.extraction.convex.sets` for what they are.
"""

from collections.abc import Sequence

import numpy as np

from torchid.design.bodies import triangle
from torchid.effects.base import JointEffect
from torchid.extraction.convex.conic import Rows
from torchid.feasibility.bounds import Bounds
from torchid.feasibility.conditions import Conditions
from torchid.robot.inertia import pseudo_inertia_basis
from torchid.robot.model import Robot

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

    def interval(self, name: str, entries: dict[int, float], low: float, high: float) -> None:
        """low <= entries'x <= high."""
        size = high - low if np.isfinite(high - low) else 1.0
        size = max(size, 0.0)
        if np.isfinite(low):
            self._linear(name, [entries], [-low], size)
        if np.isfinite(high):
            self._linear(name, [{k: -v for k, v in entries.items()}], [high], size)

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
            name, moment = f"com_{link + 1}{AXES[axis]}", self.n + 3 * link + axis
            # Tightened by a share of the box's side times a kilogram.
            size = max(high - low, 0.0) if np.isfinite(high - low) else 0.0
            if np.isfinite(low):
                self._linear(name, [{moment: 1.0, link: -low}], [0.0], size)
            if np.isfinite(high):
                self._linear(name, [{moment: -1.0, link: high}], [0.0], size)

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

    def barycentric(self, link: int, box: np.ndarray, bounds: np.ndarray) -> None:
        """Conditions that every set within the bounds (6, 2) of the barycentric inertia meets."""
        for k, entry in enumerate(ENTRIES):
            low, high = bounds[k].tolist()
            if entry in _DIAGONAL:
                self._diagonal_from_below(link, entry, low, high)
                own = box[list(_DIAGONAL[entry])]
                # m c^2 <= its secant over the box.
                self._diagonal_from_above(link, entry, own.sum(-1), own.prod(-1), high, high - low)
            else:
                self._envelope(link, entry, box[list(_MIXED[entry])], low, high)

    def barycentric_inside(self, link: int, com: np.ndarray, bounds: np.ndarray) -> None:
        """Conditions that only sets within the bounds (6, 2) meet: the concave parts are replaced
        by their tangents at a centre of mass (3,)."""
        for k, entry in enumerate(ENTRIES):
            low, high = bounds[k].tolist()
            if entry in _DIAGONAL:
                self._diagonal_from_below(link, entry, low, high)
                own = com[list(_DIAGONAL[entry])]
                self._diagonal_from_above(link, entry, 2 * own, own * own, high, high - low)
            else:
                self._product(link, entry, com[list(_MIXED[entry])], 1.0, high, high - low)
                self._product(link, entry, com[list(_MIXED[entry])], -1.0, -low, high - low)

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
