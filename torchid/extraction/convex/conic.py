"""Linear objectives over intersections of cones: a thin layer over Clarabel.

A problem is  minimise cost'v  subject to  A_k v + b_k in K_k,  with K_k the zero cone, the
non-negative numbers, a second-order cone or the positive semidefinite symmetric matrices (upper
triangle by columns, off-diagonal entries times sqrt 2).

Every minimum comes with a lower bound that does not rest on the solver's word. For any z with
z_k in the dual cone of K_k, and r = cost - A'z,

    cost'v = r'v + z'(A v + b) - b'z  >=  -b'z - |r|'|v|,

so the solver's z, put into the cones and moved within them until r is rounding, bounds the cost
wherever |v| is bounded, however loosely.

Y. Chen, P. Goulart, "Clarabel: an interior-point solver for conic programs with quadratic
objectives", arXiv:2405.12762.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import clarabel  # type: ignore[import-untyped]
import numpy as np
from scipy import sparse

from torchid.design.bodies import triangle

Cone = Literal["zero", "nonnegative", "second_order", "semidefinite"]
Status = Literal["solved", "inexact", "infeasible", "unbounded", "failed"]

ATTEMPTS = ((1e-10, False), (1e-10, True), (1e-8, False), (1e-6, True))
"""Relative tolerance asked of the solver, and whether it scales the rows (they come well scaled):
one after the other while it fails."""


@dataclass(frozen=True, eq=False)
class Rows:
    """A condition A v + b in a cone.

    Attributes:
        name: of the condition, e.g. com_7z.
        cone: which.
        matrix, offset: A (m, d), b (m,).
        inward: (m,) a direction into the cone, in the size of the condition: `tightened` moves the
            condition along it. Zero where it has no interior.
    """

    name: str
    cone: Cone
    matrix: np.ndarray
    offset: np.ndarray
    inward: np.ndarray

    def tightened(self, share: float) -> "Rows":
        """A v + b - share inward in the cone."""
        return replace(self, offset=self.offset - share * self.inward)


@dataclass(frozen=True, eq=False)
class Solution:
    """What the solver found.

    Attributes:
        status: `inexact` is usable, to about 1e-6.
        point: (d,) v; nan unless solved.
        value: cost at the point.
        bound: lower bound of the cost, as in the module's text; -inf unless solved.
        multipliers: for each condition its z; a proof of infeasibility where that is the status.
    """

    status: Status
    point: np.ndarray
    value: float
    bound: float
    multipliers: tuple[np.ndarray, ...]

    @property
    def usable(self) -> bool:
        """Whether there is a point."""
        return self.status in ("solved", "inexact")


def minimise(
    cost: np.ndarray, rows: Sequence[Rows], *, radius: np.ndarray | None = None
) -> Solution:
    """Minimise cost'v subject to the rows.

    Args:
        cost: (d,).
        rows: conditions; at least one.
        radius: (d,) bounds on |v|; infinite where nothing is known: then a hundred times the
            largest entry of the solution is taken.
    """
    matrix = np.concatenate([r.matrix for r in rows])
    offset = np.concatenate([r.offset for r in rows])
    d = len(cost)
    quadratic, columns = sparse.csc_matrix((d, d)), sparse.csc_matrix(-matrix)
    cones = [
        getattr(clarabel, _CONES[r.cone])(
            order_of(len(r.offset)) if r.cone == "semidefinite" else len(r.offset)
        )
        for r in rows
    ]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_iter, settings.max_threads = False, 300, 1
    # Reached: worse than this is a failure, between the two `inexact`
    accepted = 1e-6
    settings.reduced_tol_feas = settings.reduced_tol_gap_abs = accepted
    settings.reduced_tol_gap_rel = accepted
    for tolerance, scaled in ATTEMPTS:
        settings.equilibrate_enable = scaled
        settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = tolerance
        raw = clarabel.DefaultSolver(quadratic, cost, columns, offset, cones, settings).solve()
        status = _STATUS.get(str(raw.status), "failed")
        if status != "failed":
            break
    ends = np.cumsum([len(r.offset) for r in rows])[:-1]
    multipliers = tuple(np.split(np.array(raw.z), ends))
    point = np.array(raw.x)
    if status not in ("solved", "inexact") or not np.isfinite(point).all():
        nothing = np.full(d, np.nan)
        return Solution(status, nothing, np.nan, -np.inf, multipliers)
    z = _dual_feasible(cost, rows, matrix, multipliers)
    # 100.0: bound on |v| where none is known, in units of the solution's largest entry
    far = np.full(d, 100.0 * max(1.0, float(np.abs(point).max())))
    limit = far if radius is None else np.where(np.isfinite(radius), radius, far)
    bound = -offset @ z - np.abs(cost - matrix.T @ z) @ limit
    return Solution(status, point, float(cost @ point), float(bound), multipliers)


_STATUS: dict[str, Status] = {
    "Solved": "solved",
    "AlmostSolved": "inexact",
    "PrimalInfeasible": "infeasible",
    "AlmostPrimalInfeasible": "infeasible",
    "DualInfeasible": "unbounded",
    "AlmostDualInfeasible": "unbounded",
}


_CONES: dict[Cone, str] = {
    "zero": "ZeroConeT",
    "nonnegative": "NonnegativeConeT",
    "second_order": "SecondOrderConeT",
    "semidefinite": "PSDTriangleConeT",
}


def order_of(size: int) -> int:
    """Order of the symmetric matrix with a triangle of `size` entries."""
    return int((np.sqrt(8 * size + 1) - 1) / 2)


def matrix_of(entries: np.ndarray) -> np.ndarray:
    """The symmetric matrix of a triangle."""
    k = order_of(len(entries))
    full = np.zeros((k, k))
    j, i = np.tril_indices(k)
    full[i, j] = full[j, i] = entries / np.where(i == j, 1.0, np.sqrt(2.0))
    return full


def _dual_feasible(
    cost: np.ndarray, rows: Sequence[Rows], matrix: np.ndarray, multipliers: Sequence[np.ndarray]
) -> np.ndarray:
    """z in the cones with A'z near the cost: the one with the smaller residual of the projected z
    and the z that was moved before.

    The move is the least in the local norm of the cones' barriers, which leaves a cone last.
    """
    z = best = _into_cones(rows, multipliers)
    ends = np.cumsum([len(r.offset) for r in rows])[:-1]
    for _ in range(2):
        missing = cost - matrix.T @ z
        pieces = np.split(z, ends)
        metric = np.concatenate(
            [_metric(r.cone, p, r.matrix) for r, p in zip(rows, pieces, strict=True)]
        )
        step, *_ = np.linalg.lstsq(matrix.T @ metric, missing, rcond=1e-15)
        z = _into_cones(rows, np.split(z + metric @ step, ends))
        if np.abs(cost - matrix.T @ z).sum() < np.abs(cost - matrix.T @ best).sum():
            best = z
    return best


def _metric(cone: Cone, z: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """The inverse Hessian of the cone's barrier at z, applied to columns (m, d)."""
    if cone == "zero":
        return columns * max(1.0, float(z @ z))
    if cone == "nonnegative":
        return columns * (z * z)[:, None]
    if cone == "second_order":
        mirrored = columns.copy()
        mirrored[1:] *= -1.0
        return 2 * np.outer(z, z @ columns) - (z[0] ** 2 - z[1:] @ z[1:]) * mirrored
    full = matrix_of(z)
    return triangle(full @ np.stack([matrix_of(c) for c in columns.T]) @ full).T


def _into_cones(rows: Sequence[Rows], multipliers: Sequence[np.ndarray]) -> np.ndarray:
    """The points of the dual cones next to z (all but the zero cone are their own duals)."""
    out = []
    for row, given in zip(rows, multipliers, strict=True):
        z = given
        if row.cone == "nonnegative":
            z = np.maximum(z, 0.0)
        elif row.cone == "second_order":
            z = np.concatenate([[max(z[0], float(np.linalg.norm(z[1:])))], z[1:]])
        elif row.cone == "semidefinite":
            values, vectors = np.linalg.eigh(matrix_of(z))
            z = triangle((vectors * np.maximum(values, 0.0)) @ vectors.T)
        out.append(z)
    return np.concatenate(out)
