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


def visible_root(
    left: np.ndarray, square: np.ndarray, free: np.ndarray | None = None
) -> np.ndarray:
    """A root (*M, C, C) of the inverse of what a model leaves of columns, zero where it leaves too
    little.

    Args:
        left: (*M, C, C) products of what it leaves of them.
        square: (*M, C) of the columns themselves; 0 of those that are nowhere.
        free: (*M, C, C) what it would leave of them if nothing were known of it beforehand, where
            something is: what that alone leaves is no rest of two large things that cancel.
    """
    size = np.sqrt(np.where(square > 0, square, np.inf))
    scale = size[..., None] * size[..., None, :]
    unit = left / scale
    if unit.shape[-1] == 1:  # of most, which have one column
        values, vectors = unit[..., 0], np.ones_like(unit)
    else:
        values, vectors = np.linalg.eigh(unit)
    seen = values > VISIBLE
    if free is not None:
        by_data = (vectors * ((free / scale) @ vectors)).sum(-2)
        seen |= (values - by_data > 0.5 * values) & (values > EXACT)
    kept = np.where(seen, 1 / np.sqrt(np.where(seen, values, 1.0)), 0.0)
    return vectors * kept[..., None, :] / size[..., None]


class Gram:
    """Normal equations of n joints in P parts of the data; the one mutable value of this room.

    Args:
        common: number of columns that act on all joints.
        n: number of joints.
        parts: P.
    """

    def __init__(self, common: int, n: int, parts: int):
        self.common = common
        self.n = n
        self.parts = parts
        self.g = [torch.zeros(parts, 0, 0, dtype=torch.float64)] * n
        self.rows = torch.zeros(parts, n, dtype=torch.float64)

    def add(
        self,
        joint: int,
        columns: Sequence[Float[Tensor, "_ N"]],
        y: Float[Tensor, " N"],
        keep: Bool[Tensor, " N"],
        part: Int[Tensor, " N"],
    ) -> None:
        """Samples of one joint: its columns in pieces, the common ones first; all of them each
        time."""
        rows = [*columns, y.unsqueeze(0)]
        count = sum(map(len, rows))
        if not self.g[joint].numel():
            self.g[joint] = torch.zeros(self.parts, count, count, dtype=torch.float64)
        for p in part[keep].unique().tolist():
            chosen = (keep & (part == p)).nonzero().flatten()
            own = torch.cat([x.index_select(1, chosen) for x in rows])
            # All of a symmetric product: half of it, and its mirror image, take longer.
            self.g[joint][p].addmm_(own, own.T)
            self.rows[p, joint] += len(chosen)

    def folds(self) -> "Folds":
        """Every part but 0, judged by the others; part 0 is in neither."""
        return Folds(tuple(g[1:] for g in self.g), self.rows[1:])

    def over(self, parts: Sequence[int] | None = None) -> "Normal":
        """The sums over some parts; over all if None."""
        chosen = slice(None) if parts is None else list(parts)
        return Normal(tuple(g[chosen].sum(0) for g in self.g), self.rows[chosen].sum(0))


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
    """Normal equations of one part of the data.

    Attributes:
        g: per joint (c + o + 1, c + o + 1): common columns, own columns, y.
        rows: (n,) samples.
    """

    g: tuple[Float[Tensor, "_ _"], ...]
    rows: Float[Tensor, " n"]

    def of(self, subset: Subset) -> "Equations":
        """Those of a subset of K columns."""
        return self.of_each([subset])[0]

    def of_each(self, subsets: Sequence[Subset]) -> "Equations":
        """Those of B subsets, the smaller ones with zeros for the columns that they lack."""
        found = _gathered([g.unsqueeze(0) for g in self.g], subsets)
        return found[:, 0]


@dataclass(frozen=True, eq=False)
class Folds:
    """Normal equations of F parts of the data, each of which is judged by the others.

    Attributes:
        g: per joint, part by part, as those of `Normal`.
        rows: (F, n) samples of each part.
    """

    g: tuple[Float[Tensor, "F _ _"], ...]
    rows: Float[Tensor, "F n"]

    def __len__(self) -> int:
        return len(self.rows)

    def of_each(self, subsets: Sequence[Subset]) -> "tuple[Equations, Equations]":
        """Those of B subsets, (B, F, ...): of what each part is fitted on, which is all parts less
        its own, and of what it is judged on."""
        judged = _gathered(self.g, subsets)
        whole = judged.a.sum(1, True), judged.b.sum(1, True), judged.squares.sum(1, True)
        every = Equations(*whole)
        fitted = (every.a - judged.a, every.b - judged.b, every.squares - judged.squares)
        return Equations(*fitted), judged

    def of(self, subset: Subset) -> "tuple[Equations, Equations]":
        """The same of one subset: (F, ...)."""
        fitted, judged = self.of_each([subset])
        return fitted[0], judged[0]


def _gathered(g: Sequence[Float[Tensor, "F _ _"]], subsets: Sequence[Subset]) -> "Equations":
    """Normal equations (B, F, ...) of B subsets of the columns of joints' matrices."""
    count = max(s.count for s in subsets)
    at = torch.full((len(subsets), len(g), count), -1)
    for k, s in enumerate(subsets):
        at[k, :, : s.count] = s.at
    felt = (at >= 0).to(g[0])
    matrices, rights, squares = [], [], []
    for j, own in enumerate(g):
        rows = at[:, j]
        matrices.append(own[:, rows.unsqueeze(2), rows.unsqueeze(1)])
        right = own[:, rows, -1]
        square = own[:, -1, -1].unsqueeze(1).repeat(1, len(subsets))
        for k, s in enumerate(subsets):
            # The target is y and columns with given coefficients.
            there = [(r, v) for joint, r, v in s.instead if joint == j]
            if there:
                target = torch.cat([rows.new_tensor([-1]), *(r for r, _ in there)])
                values = torch.cat([own.new_ones(1), *(v for _, v in there)])
                right[:, k] = own[:, rows[k].unsqueeze(1), target] @ values
                square[:, k] = own[:, target.unsqueeze(1), target] @ values @ values
        rights.append(right)
        squares.append(square)
    # (n, F, B, ...) of all joints; a joint that does not feel a column has zeros.
    a = torch.stack(matrices).permute(2, 1, 0, 3, 4)
    b = torch.stack(rights).permute(2, 1, 0, 3)
    both = (felt.unsqueeze(-1) * felt.unsqueeze(-2)).unsqueeze(1)
    return Equations(a * both, b * felt.unsqueeze(1), torch.stack(squares).permute(2, 1, 0))


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

    def __getitem__(self, at: int | slice | tuple[int | slice, ...]) -> "Equations":
        """Those of a part of the batch."""
        return Equations(self.a[at], self.b[at], self.squares[at])

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
