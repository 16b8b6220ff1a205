"""Fitting torque with bodies that can exist, without nominal parameters.

Every link is a sum of point masses, each zero or more, on a grid around its frame: what such a sum
can be is (up to the grid) what a rigid body can be, since a rigid body is a sum of point masses.
With friction coefficients and rotor inertia zero or more and a free offset, the torque is linear in
unknowns that are not negative: one small non-negative least-squares problem (Lawson and Hanson
1974, chapter 23). A torque of the wrong sign needs negative masses and finds no fit at all, which
is what makes signs and the direction of gravity decidable from a log alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from torchid.robot.model import Robot

SIZES = (0.3, 0.12, 0.04)
"""Half the edges of the cubes whose corners, edges' and faces' middles and centre are a link's
points, as shares of the arm's reach."""
OWN = 4
"""Columns of a joint's own: dq, direction of motion, ddq, one."""
MODEL = 0.02
"""Error of the model itself, as a share of a torque's spread: friction is not quite Coulomb's, nor
a link a few points, and what is gained below this says nothing."""
_RIDGE = 1e-10
"""Beside columns of length one."""

Weights = np.ndarray | None
"""(n,) of the joints."""
Unknowns = Sequence[int] | np.ndarray
"""Numbers of those that may be more than zero."""


@dataclass(frozen=True)
class Normal:
    """Normal equations of each joint's rows, a block of time apart.

    Attributes:
        gram: (B, n, P, P).
        cross: (B, n, P) with the torque.
        square: (B, n) of the torque.
        count: (B, n) rows.
        spread: (n,) variance of the torque about its mean, 0 where it never changes.
    """

    gram: np.ndarray
    cross: np.ndarray
    square: np.ndarray
    count: np.ndarray
    spread: np.ndarray

    def part(self, blocks: np.ndarray) -> "Normal":
        """Normal equations of some blocks of time."""
        every = self.gram, self.cross, self.square, self.count
        gram, cross, square, count = (x[blocks] for x in every)
        return Normal(gram, cross, square, count, self.spread)

    def without(self, block: int) -> "Normal":
        """Normal equations of all blocks of time but one."""
        return self.part(np.arange(len(self.count)) != block)

    def apart(self, blocks: np.ndarray) -> "Normal":
        """Some blocks one after the other, then all others together: added up, since what a
        difference leaves of a joint that moves in these blocks alone is rounding."""
        every = self.gram, self.cross, self.square, self.count
        others = np.delete(np.arange(len(self.count)), blocks)
        gram, cross, square, count = (
            np.concatenate([x[blocks], [x[others].sum(0)]]) for x in every
        )
        return Normal(gram, cross, square, count, self.spread)

    def mean_square(self, x: np.ndarray) -> np.ndarray:
        """(B, n) mean squared error of parameters x (P,)."""
        error = self.gram @ x @ x - 2 * self.cross @ x + self.square
        return np.maximum(error, 0.0) / np.maximum(self.count, 1)


def cone(robot: Robot, own: int = OWN) -> np.ndarray:
    """(P, U) from unknowns that are not negative, point masses of every link and each joint's own
    coefficients, to parameters: P = 10 n in the paper's order, then `own` a joint."""
    n = robot.n
    # 0.5: reach of the smallest arm [m]
    reach = max(reach_of(robot), 0.5)
    axis = np.array([-1.0, 0.0, 1.0])
    cube = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3)
    points = np.unique(np.concatenate([size * cube for size in SIZES]), axis=0) * reach
    body = np.stack([_point(x) for x in points], 1)
    count = len(points)
    matrix = np.zeros(((own + 10) * n, n * count + (own + 1) * n))
    for link in range(n):
        columns = slice(link * count, (link + 1) * count)
        matrix[link, columns] = body[0]
        matrix[n + 3 * link : n + 3 * link + 3, columns] = body[1:4]
        matrix[4 * n + 6 * link : 4 * n + 6 * link + 6, columns] = body[4:]
        first, unknown = 10 * n + own * link, n * count + (own + 1) * link
        matrix[first : first + own, unknown : unknown + own] = np.eye(own)
        matrix[first + own - 1, unknown + own] = -1.0
    return matrix


def _point(x: np.ndarray) -> np.ndarray:
    """Mass, first moment and inertia about the origin of one kilogram at x."""
    j = x @ x * np.eye(3) - np.outer(x, x)
    return np.array([1.0, *x, j[0, 0], j[0, 1], j[0, 2], j[1, 1], j[1, 2], j[2, 2]])


def reach_of(robot: Robot) -> float:
    """Length of the stretched arm [m]: the links' offsets added up."""
    lengths = robot.before[:, :3, 3].norm(dim=-1).sum() + robot.after[:, :3, 3].norm(dim=-1).sum()
    return float(lengths)


@dataclass(frozen=True)
class Fit:
    """The best bodies for a set of rows.

    Attributes:
        x: (P,) parameters.
        variance: (n,) mean squared error of each joint's rows.
        weights: (n,) what each row counted, times the spread of its torque.
        used: the unknowns that are more than zero, among U.
    """

    x: np.ndarray
    variance: np.ndarray
    weights: np.ndarray
    used: Unknowns


def fit(normal: Normal, bodies: np.ndarray, given: Weights = None, used: Unknowns = ()) -> Fit:
    """Maximum likelihood with an unknown variance of each joint, by reweighting.

    Args:
        normal: rows.
        bodies: (P, U) what may be.
        given: (n,) weights of another fit, kept; None to find them.
        used: unknowns of another fit, from which the search for these begins.
    """
    gram, cross = normal.gram.sum(0), normal.cross.sum(0)
    total = np.maximum(normal.count.sum(0), 1)
    live = normal.spread > 0
    spread = np.where(live, normal.spread, 1.0)
    # 3: rounds, after which the weights hardly change
    rounds = 3 if given is None else 1
    w = live / spread if given is None else np.where(live, given, 0.0) / spread
    x = np.zeros(gram.shape[-1])
    variance = spread.copy()
    for _ in range(rounds):
        x, used = _solve(np.tensordot(w, gram, 1), w @ cross, bodies, used)
        square = normal.square.sum(0) - 2 * cross @ x + gram @ x @ x
        variance = np.maximum(square, 0.0) / total
        if given is None:
            w = live / (variance + MODEL**2 * spread)
    return Fit(x, variance, w * spread, used)


@dataclass(frozen=True, eq=False)
class Columns:
    """What the torque of each joint is linear in.

    Attributes:
        rows: (n, T, P) regressor with each joint's own columns.
    """

    rows: np.ndarray

    @cached_property
    def gram(self) -> np.ndarray:
        """(n, P, P) products."""
        return self.rows.transpose(0, 2, 1) @ self.rows

    @cached_property
    def _root(self) -> np.ndarray:
        return _root_of(self.gram)

    def least(self, normal: Normal) -> np.ndarray:
        """(n,) mean squared errors that no parameters go below, of each joint's rows by themselves;
        the rows are one block."""
        scaled = zip(self._root, normal.cross[0] / _sizes(self.gram), strict=True)
        known = [solve_triangular(root, c, lower=True, check_finite=False) for root, c in scaled]
        left = normal.square[0] - np.square(known).sum(-1)
        return np.maximum(left, 0.0) / np.maximum(normal.count[0], 1)


def _root_of(gram: np.ndarray) -> np.ndarray:
    """Lower triangular roots of products (.., P, P) of columns scaled to length one. What the rows
    do not show has no unique answer: the least one."""
    size = _sizes(gram)
    scaled = gram / (size[..., :, None] * size[..., None, :])
    return np.linalg.cholesky(scaled + _RIDGE * np.eye(gram.shape[-1]))


def _sizes(gram: np.ndarray) -> np.ndarray:
    """Lengths of columns (.., P); 1 of one that is zero."""
    size = np.sqrt(np.diagonal(gram, axis1=-2, axis2=-1))
    return np.where(size > 0, size, 1.0)


def _solve(
    gram: np.ndarray, cross: np.ndarray, matrix: np.ndarray, used: Unknowns
) -> tuple[np.ndarray, Unknowns]:
    """Parameters M u with u >= 0 that minimise x' G x - 2 c' x, and which u are not zero."""
    if not gram.any():
        return np.zeros(len(gram)), used
    size, root = _sizes(gram), _root_of(gram)
    rows = root.T * size @ matrix
    target = solve_triangular(root, cross / size, lower=True)
    norm = np.linalg.norm(rows, axis=0)
    # What hardly shows in these rows is rounding, and would be fitted with masses of any size.
    # 1e-6: columns below this share of the longest are rounding
    norm[norm < 1e-6 * norm.max(initial=0.0)] = np.inf
    u = _not_negative(rows / norm, target, used)
    return matrix @ (u / norm), u.nonzero()[0]


def _not_negative(a: np.ndarray, y: np.ndarray, used: Unknowns) -> np.ndarray:
    """Unknowns (U,), zero or more, with which columns (R, U) of length one come nearest to y (R,):
    found among a few of them, to which come those that would help most, until none would."""
    # 1e-11: part of the target along a column that is still left, from which on the column helps
    most, least = 50 * a.shape[1], 1e-11 * np.linalg.norm(y)
    u, helps = np.zeros(a.shape[1]), a.T @ y
    # 50: rounds at most
    for _ in range(50):
        # 20: unknowns that are taken up at a time
        some = np.union1d(used, np.argsort(helps)[-20:]).astype(int)
        u[:] = 0.0
        u[some], _ = nnls(a[:, some], y, maxiter=most)
        used = u.nonzero()[0]
        helps = a.T @ (y - a[:, used] @ u[used])
        helps[some] = 0.0
        if helps.max() <= least:
            return u
    return nnls(a, y, maxiter=most)[0]


def shares(variance: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Errors as shares of the torque's spread, the model's with them; 1 where it never changes."""
    safe = np.where(spread > 0, spread, 1.0)
    return np.where(spread > 0, np.sqrt(np.maximum(variance, 0.0) / safe + MODEL**2), 1.0)
