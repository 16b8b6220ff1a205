"""Roots of normal equations, whose directions may not all be determined."""

import numpy as np
import torch
from scipy.linalg.lapack import dpotrf, dtrtri

from torchid.typing import Float, Tensor

DETERMINED = 1e-7
"""Eigenvalue of normal equations with a unit diagonal below which a direction is left at zero: more
would be rounding, for the equations square the condition number."""

EXACT = 1e-13
"""The same where what is known beforehand determines it, which has no rounding but the sum's."""


def inverse_root(
    matrix: Float[Tensor, "*batch K K"],
    least: float = DETERMINED,
    known: Float[Tensor, "*#batch K K"] | None = None,
) -> Float[Tensor, "*batch K K"]:
    """Roots of the inverses of normal equations, along the directions that they determine; columns
    of zeros for all others.

    Args:
        matrix: products of the columns with each other, and what is known beforehand.
        least: eigenvalue relative to the largest, columns in units of their own size, below which a
            direction is not determined by the columns.
        known: of the matrix what is known beforehand, which is no rounding however small it is.
    """
    count = matrix.shape[-1]
    if not matrix.numel():
        return matrix.clone()
    if matrix.numel() == count * count:
        some = (matrix, matrix if known is None else known.expand_as(matrix))
        one, given = (x.reshape(count, count).numpy() for x in some)
        found = _root_of_one(one, least, None if known is None else given)
        return torch.from_numpy(found).view(matrix.shape)
    # A column that is nowhere in these samples determines nothing.
    diagonal = matrix.diagonal(dim1=-2, dim2=-1)
    there = diagonal > 0
    size = torch.where(there, diagonal.sqrt(), torch.inf)
    scale = size.unsqueeze(-1) * size.unsqueeze(-2)
    unit = matrix / scale + torch.diag_embed((~there).to(matrix))
    # Cholesky is ten times cheaper than eigenvectors, and as good where all is determined, which
    # two bounds say: 1 / trace(M^-1) of the least eigenvalue, the largest row sum of the largest.
    factor, failed = torch.linalg.cholesky_ex(unit)
    unity = torch.eye(count, dtype=matrix.dtype, device=matrix.device)
    root = torch.linalg.solve_triangular(factor, unity, upper=False).mT
    sure = root.square().sum((-2, -1)) * unit.abs().sum(-1).amax(-1) * least < 1.0
    sure &= failed == 0
    if not bool(sure.all()):
        root = root.clone()
        flat = root.view(-1, count, count)
        parts = None if known is None else (known / scale).expand_as(unit).reshape_as(flat)
        for k in (~sure.flatten()).nonzero().flatten().tolist():
            own = unit.view(-1, count, count)[k]
            flat[k] = _determined(own, least, None if parts is None else parts[k])
    return root / size.unsqueeze(-1)


def _root_of_one(matrix: np.ndarray, least: float, known: np.ndarray | None) -> np.ndarray:
    """Root of one matrix (K, K), by LAPACK itself: of a small one torch's calls would take
    longer than the work."""
    diagonal = matrix.diagonal()
    there = diagonal > 0
    size = np.where(there, np.sqrt(diagonal.clip(min=0)), np.inf)
    unit = matrix / size / size[:, None] + np.diag(~there)
    factor, failed = dpotrf(unit, lower=1)
    root = dtrtri(factor, lower=1)[0].T
    if failed or np.square(root).sum() * np.abs(unit).sum(1).max() * least >= 1.0:
        parts = None if known is None else torch.from_numpy(known / size / size[:, None])
        root = _determined(torch.from_numpy(unit), least, parts).numpy()
    return root / size[:, None]


def _determined(
    unit: Float[Tensor, "K K"], least: float, known: Float[Tensor, "K K"] | None
) -> Float[Tensor, "K K"]:
    """The root of one matrix with a unit diagonal, by its eigenvectors; see `inverse_root`."""
    values, vectors = torch.linalg.eigh(unit)
    kept = values > least * values[-1:]
    if known is not None:
        own = (vectors * (known @ vectors)).sum(0)
        kept |= (own > 0.5 * values) & (values > EXACT * values[-1:])
    return vectors * torch.where(kept, values, torch.inf).rsqrt()


def least_squares(
    a: Float[Tensor, "K R"], y: Float[Tensor, " R"], least: float = DETERMINED
) -> Float[Tensor, " K"]:
    """Coefficients; directions that the rows do not determine (see `inverse_root`) stay at zero."""
    root = inverse_root(a @ a.T, least)
    return root @ (root.T @ (a @ y))


VISIBLE = 0.01
"""Share of a column's square that must be left beside the model for it to be seen at all. Of less,
what is left is noise of the columns and the misfit of what is there: the coefficient would be large
and cancel against theirs. At half of it cancelling pairs appear, at double some offsets are
unseen."""
