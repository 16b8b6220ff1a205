"""Feasible sets of equal torque: exactly, of nearly the least loss, or within the confidence."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import stats

from torchid.errors import TorchidError
from torchid.extraction.convex.certificate import loss_matrix
from torchid.extraction.convex.sets import ConvexSets
from torchid.extraction.problem import Problem
from torchid.typing import Tensor

Kind = Literal["exact", "least loss", "confidence"]

EXACT = 1e-8
"""Least norm of the residual, relative to the target's, that counts as reproduced exactly."""


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
    if not least.solution.usable or least.value <= EXACT * float(np.linalg.norm(offset)):
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
    radius = float(np.sqrt(stats.chi2.ppf(level, int(free.sum()))))
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
