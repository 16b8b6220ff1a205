"""Normal equations of many columns at once, joint by joint and part by part; columns are not kept.

A column acts on one joint or on all. Joint j's matrix holds the columns of all joints first, then
its own, then the target y; G_j[f] = A_j A_j' over the samples of part f that count. From these a
fit of any subset of columns, its loss on any part of the data, and what any other column would add
to it follow without a second look at the log (Golub and Van Loan 2013, 5.3).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.typing import Bool, Float, Int, Tensor

DETERMINED = 1e-7
"""Eigenvalue of normal equations with a unit diagonal below which a direction is left at zero: more
would be rounding, for the equations square the condition number."""

EXACT = 1e-13
"""The same where what is known beforehand determines it, which has no rounding but the sum's."""


def inverse_root(
    matrix: Float[Tensor, "K K"],
    least: float = DETERMINED,
    known: Float[Tensor, "K K"] | None = None,
) -> Float[Tensor, "K r"]:
    """A root of the inverse of normal equations, along the directions that they determine.

    Args:
        matrix: products of the columns with each other, and what is known beforehand.
        least: eigenvalue relative to the largest, columns in units of their own size, below which a
            direction is not determined by the columns.
        known: of the matrix what is known beforehand, which is no rounding however small it is.
    """
    # A column that is nowhere in these samples determines nothing.
    size = torch.where(matrix.diagonal() > 0, matrix.diagonal().sqrt(), torch.inf)
    values, vectors = torch.linalg.eigh(matrix / size / size.unsqueeze(1))
    kept = values > least * values[-1:]
    if known is not None:
        own = (vectors * ((known / size / size.unsqueeze(1)) @ vectors)).sum(0)
        kept |= (own > 0.5 * values) & (values > EXACT * values[-1:])
    return vectors[:, kept] / values[kept].sqrt() / size.unsqueeze(1)


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
    left: Float[Tensor, "*M C C"],
    square: Float[Tensor, "*M C"],
    free: Float[Tensor, "*M C C"] | None = None,
) -> Float[Tensor, "*M C C"]:
    """A root of the inverse of what a model leaves of columns, zero where it leaves too little.

    Args:
        left: products of what it leaves of them.
        square: of the columns themselves; 0 of those that are nowhere.
        free: what it would leave of them if nothing were known of it beforehand, where something
            is: what that alone leaves is no rest of two large things that cancel.
    """
    size = torch.where(square > 0, square.sqrt(), torch.inf)
    scale = size.unsqueeze(-1) * size.unsqueeze(-2)
    values, vectors = torch.linalg.eigh(left / scale)
    seen = values > VISIBLE
    if free is not None:
        by_data = (vectors * ((free / scale) @ vectors)).sum(-2)
        seen |= (values - by_data > 0.5 * values) & (values > EXACT)
    safe = torch.where(seen, values, torch.ones_like(values))
    return vectors * (seen / safe.sqrt()).unsqueeze(-2) / size.unsqueeze(-1)


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
        for p in part.unique().tolist():
            own = torch.cat([x[:, keep & (part == p)] for x in rows])
            self.g[joint][p] += own @ own.T
            self.rows[p, joint] += own.shape[1]

    def folds(self) -> "list[tuple[Normal, Normal]]":
        """(Fitted on, judged on) of every part but 0; part 0 is in neither."""
        every = range(1, self.parts)
        return [(self.over([p for p in every if p != k]), self.over([k])) for k in every]

    def over(self, parts: Sequence[int] | None = None) -> "Normal":
        """The sums over some parts; over all if None."""
        chosen = list(range(self.parts)) if parts is None else list(parts)
        return Normal(tuple(g[chosen].sum(0) for g in self.g), self.rows[chosen].sum(0))


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations of one part of the data.

    Attributes:
        g: per joint (c + o + 1, c + o + 1): common columns, own columns, y.
        rows: (n,) samples.
    """

    g: tuple[Float[Tensor, "_ _"], ...]
    rows: Float[Tensor, " n"]

    def of(self, subset: "Subset") -> "Equations":
        """Those of a subset of K columns."""
        parts = []
        for g, s in zip(self.g, subset.joints, strict=True):
            there = s.target.nonzero().flatten()
            y = s.target[there]
            rows = g[s.at]
            square = y @ g[there.unsqueeze(1), there] @ y
            parts.append((s.of, rows[:, s.at], rows[:, there] @ y, square))
        return Equations(subset.count, tuple(parts))


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of K columns.

    Attributes:
        count: K.
        joints: per joint, which of the K columns it feels (k,), their products with each other
            (k, k) and with the target (k,), and the target's square.
    """

    count: int
    joints: tuple[tuple[Int[Tensor, " _"], Float[Tensor, "_ _"], Float[Tensor, " _"], Tensor], ...]

    @property
    def squares(self) -> Float[Tensor, " n"]:
        """Sums of squares (n,) of the target."""
        return torch.stack([square for *_, square in self.joints])

    def losses(self, x: Float[Tensor, " K"]) -> Float[Tensor, " n"]:
        """Sums of squares (n,) that coefficients leave."""
        out = []
        for of, a, b, square in self.joints:
            own = x[of]
            out.append(square - 2 * (own @ b) + own @ a @ own)
        return torch.stack(out).clamp(min=0)

    def weighted(
        self, weight: Float[Tensor, " n"]
    ) -> tuple[Float[Tensor, "K K"], Float[Tensor, " K"]]:
        """Matrix and right side of all joints together."""
        matrix = torch.zeros(self.count, self.count, dtype=torch.float64)
        right = torch.zeros(self.count, dtype=torch.float64)
        for w, (of, a, b, _) in zip(weight.tolist(), self.joints, strict=True):
            matrix[of.unsqueeze(1), of] += w * a
            right[of] += w * b
        return matrix, right

    def solve(self, weight: Float[Tensor, " n"]) -> "Solved":
        """Least squares with these weights of the joints' squares."""
        matrix, right = self.weighted(weight)
        root = inverse_root(matrix)
        return Solved(root @ (root.T @ right), root)


@dataclass(frozen=True, eq=False)
class OnJoint:
    """Where a subset's columns are in one joint's matrix.

    Attributes:
        of: which of the K columns.
        at: their rows in the matrix.
        target: what they are fitted to: y, plus columns with given coefficients.
    """

    of: Int[Tensor, " k"]
    at: Int[Tensor, " k"]
    target: Float[Tensor, " c"]


@dataclass(frozen=True, eq=False)
class Subset:
    """K columns, as each joint's matrix has them."""

    count: int
    joints: tuple[OnJoint, ...]


@dataclass(frozen=True, eq=False)
class Solved:
    """Coefficients (K,), and a root (K, r) of the inverse of the normal equations."""

    x: Float[Tensor, " K"]
    root: Float[Tensor, "K r"]
