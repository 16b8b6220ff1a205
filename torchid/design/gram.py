"""Normal equations of many columns at once, joint by joint and part by part; columns are not kept.

A column acts on one joint or on all. Joint j's matrix holds the columns of all joints first, then
its own, then the target y; G_j[f] = A_j A_j' over the samples of part f that count. From these a
fit of any subset of columns, its loss on any part of the data, and what any other column would add
to it follow without a second look at the log (Golub and Van Loan 2013, 5.3).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg.lapack import dpotrf, dtrtri

from torchid.typing import Bool, Float, Int, Tensor

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
    """The same of one matrix (K, K), by LAPACK itself: of a small one torch's calls would take
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


class Gram:
    """Normal equations of n joints; the one mutable value of this room.

    Args:
        common: number of columns that act on all joints.
        n: number of joints.
    """

    def __init__(self, common: int, n: int):
        self.common = common
        self.n = n
        self.g = [torch.zeros(0, 0, dtype=torch.float64)] * n
        self.rows = torch.zeros(n, dtype=torch.float64)

    def add(
        self,
        joint: int,
        columns: Sequence[Float[Tensor, "_ N"]],
        y: Float[Tensor, " N"],
        keep: Bool[Tensor, " N"],
    ) -> None:
        """Samples of one joint: its columns in pieces, the common ones first; all of them each
        time."""
        rows = [*columns, y.unsqueeze(0)]
        count = sum(map(len, rows))
        if not self.g[joint].numel():
            self.g[joint] = torch.zeros(count, count, dtype=torch.float64)
        chosen = keep.nonzero().flatten()
        own = torch.cat([x.index_select(1, chosen) for x in rows])
        # All of a symmetric product: half of it, and its mirror image, take longer.
        self.g[joint].addmm_(own, own.T)
        self.rows[joint] += len(chosen)

    @property
    def normal(self) -> "Normal":
        """The sums so far."""
        return Normal(tuple(self.g), self.rows)


@dataclass(frozen=True, eq=False)
class Subset:
    """K columns, as each joint's matrix has them.

    Attributes:
        at: (n, K) their rows in the joints' matrices; -1 of those that a joint does not feel.
        instead: what a joint's target has beside y: (joint, rows of columns, their coefficients).
    """

    at: Int[Tensor, "n K"]
    instead: tuple[tuple[int, Int[Tensor, " _"], Float[Tensor, " _"]], ...] = ()

    @property
    def count(self) -> int:
        """K."""
        return self.at.shape[1]


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations of some data.

    Attributes:
        g: per joint (c + o + 1, c + o + 1): common columns, own columns, y.
        rows: (n,) samples.
    """

    g: tuple[Float[Tensor, "_ _"], ...]
    rows: Float[Tensor, " n"]

    def of(self, subset: Subset) -> "Equations":
        """Those of a subset of K columns."""
        felt = (subset.at >= 0).to(self.g[0])
        matrices, rights, squares = [], [], []
        for j, (g, rows) in enumerate(zip(self.g, subset.at, strict=True)):
            # The target is y and columns with given coefficients.
            there = [(r, v) for joint, r, v in subset.instead if joint == j]
            target = torch.cat([rows.new_tensor([-1]), *(r for r, _ in there)])
            values = torch.cat([g.new_ones(1), *(v for _, v in there)])
            matrices.append(g[rows.unsqueeze(1), rows])
            rights.append(g[rows.unsqueeze(1), target] @ values)
            squares.append(g[target.unsqueeze(1), target] @ values @ values)
        # A joint that does not feel a column has zeros.
        both = felt.unsqueeze(2) * felt.unsqueeze(1)
        return Equations(
            torch.stack(matrices) * both, torch.stack(rights) * felt, torch.stack(squares)
        )


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of K columns, joint by joint; zeros where a joint does not feel one.

    Attributes:
        a: (*batch, n, K, K) products of the columns with each other.
        b: (*batch, n, K) those with the target.
        squares: (*batch, n) the target's sums of squares.
    """

    a: Float[Tensor, "*batch n K K"]
    b: Float[Tensor, "*batch n K"]
    squares: Float[Tensor, "*batch n"]

    @property
    def count(self) -> int:
        """K."""
        return self.b.shape[-1]

    def losses(self, x: Float[Tensor, "*batch K"]) -> Float[Tensor, "*batch n"]:
        """Sums of squares (*batch, n) that coefficients leave."""
        own = x.unsqueeze(-2)
        held = (self.a @ own.unsqueeze(-1)).squeeze(-1)
        return (self.squares + (own * (held - 2 * self.b)).sum(-1)).clamp(min=0)

    def weighted(
        self, weight: Float[Tensor, "*batch n"]
    ) -> tuple[Float[Tensor, "*batch K K"], Float[Tensor, "*batch K"]]:
        """Matrix and right side of all joints together."""
        n, k = self.b.shape[-2:]
        w = weight.unsqueeze(-2)
        flat = self.a.reshape(*self.a.shape[:-3], n, k * k)
        matrix = (w @ flat).reshape(*flat.shape[:-2], k, k)
        return matrix, (w @ self.b).squeeze(-2)

    def solve(self, weight: Float[Tensor, "*batch n"]) -> "Solved":
        """Least squares with these weights of the joints' squares."""
        matrix, right = self.weighted(weight)
        root = inverse_root(matrix)
        return Solved((root @ (root.mT @ right.unsqueeze(-1))).squeeze(-1), root)


@dataclass(frozen=True, eq=False)
class Solved:
    """Coefficients (*batch, K), and a root (*batch, K, K) of the inverse of the normal
    equations."""

    x: Float[Tensor, "*batch K"]
    root: Float[Tensor, "*batch K K"]
