"""Least squares on the triangular factor: ordinary, weighted, robust; with physical signs.

    ols     minimises ||tau - Y x||^2;
    wls     weighs each joint's rows by the inverse of its residual's standard deviation, or whitens
            them with the residuals' covariance between joints;
    huber   wls with Huber's weights (c = 1.345), by iteration, the scale being 1.4826 MAD.

The problem enters only through its factor R of [A b], so a pass over the data costs a factor's
worth of memory. Coefficients that physics forbids to be negative are bounded at zero (bounded
least squares on R), and are reported by the caller.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import lsq_linear

from torchid.errors import IdentificationError
from torchid.identification.base_parameters import independent_columns
from torchid.identification.rows import RowBlock, RowSource
from torchid.identification.settings import Covariance, Method
from torchid.statistics.robust import HUBER, MAD_TO_SIGMA
from torchid.typing import Bool, Float, Int, Tensor


class TriangularFactor:
    """Accumulates rows (m, c) into an upper triangular R (c, c) with R'R = A'A.

    The one mutable object of this room: a tall matrix arrives in pieces and is never stored. R of
    what has come is one more piece, so the state has a few rows a column whatever comes. R of [A b]
    holds everything least squares needs: ||A x - b||^2 = ||R (x, -1)||^2.
    """

    def __init__(self, columns: int):
        self._waiting = [torch.zeros(columns, columns, dtype=torch.float64)]

    def add(self, rows: Float[Tensor, "m c"]) -> None:
        """Take in m rows."""
        self._waiting.append(rows)
        # 16: rows a column that wait before R takes them in: the factor of R alone is then no
        # matter
        if sum(map(len, self._waiting)) > 16 * rows.shape[1]:
            self._waiting = [self.factor()]

    def factor(self) -> Float[Tensor, "c c"]:
        """R with a non-negative diagonal; zero if no row came."""
        return stacked_factor(self._waiting)


def stacked_factor(factors: Sequence[Tensor]) -> Float[Tensor, "c c"]:
    """R of several matrices on top of each other, from their factors."""
    return _householder(torch.cat(tuple(factors)))


def block_factors(blocks: Sequence[Tensor]) -> Float[Tensor, "K c c"]:
    """R of each of K matrices of as many columns, in one call: rows of zeros, which no factor
    feels, make them equally long."""
    return _householder(torch.nn.utils.rnn.pad_sequence([*blocks], batch_first=True))


def combined_factor(
    factors: Sequence[Float[Tensor, "_ _"]], columns: Sequence[Sequence[int]], size: int
) -> Float[Tensor, "C C"]:
    """R of [A b] from the factors of its torque rows, each of its own columns of A and of b.

    Args:
        factors: a torque row's R, (c + 1, c + 1), b last.
        columns: the c columns of A, of `size` in all, that each has.
    """
    return stacked_factor([_placed(r, c, size) for r, c in zip(factors, columns, strict=True)])


def _placed(rows: Tensor, columns: Sequence[int], size: int) -> Float[Tensor, "m C"]:
    """Rows of some columns of A and of b, b last, as rows of all `size` columns and of b."""
    out = rows.new_zeros(len(rows), size + 1)
    out[:, [*columns, size]] = rows
    return out


def _householder(rows: Float[Tensor, "*batch _ c"]) -> Float[Tensor, "*batch c c"]:
    missing = max(0, rows.shape[-1] - rows.shape[-2])
    r = torch.linalg.qr(torch.nn.functional.pad(rows, (0, 0, 0, missing)), mode="r").R
    sign = torch.where(r.diagonal(dim1=-2, dim2=-1) < 0, -1.0, 1.0).to(r)
    return r * sign.unsqueeze(-1)


_MAX_ITERATIONS = 30
_CONVERGED = 0.05
"""Step of the reweighting, in standard deviations under white residuals, that counts as settled."""
_TINY = 1e-300


@dataclass(frozen=True)
class Fit:
    """Solution of one least-squares problem, columns in the layout's order.

    Attributes:
        x: (B,) coefficients; 0 where they are held at zero or undetermined.
        free: (B,) estimated; the others are bounded, undetermined or left out.
        bounded: (B,) held at zero because the data ask for the sign that physics forbids.
        undetermined: (B,) without effect in these data.
        factor: (B + 1, B + 1) R of the weighted [A b].
        unweighted_factor: (B + 1, B + 1) R of the kept rows, each row weighing one.
        whitening: (n, n) upper triangular W with W S W' = 1 for the residuals' covariance S.
        robust: (I, n) square root of Huber's weights; 0 for rows left out.
        residual: (I, n) unweighted residual.
        kept: (I, n) rows that took part.
        iterations: of the reweighting.
    """

    x: Float[Tensor, " B"]
    free: Bool[Tensor, " B"]
    bounded: Bool[Tensor, " B"]
    undetermined: Bool[Tensor, " B"]
    factor: Float[Tensor, "C C"]
    unweighted_factor: Float[Tensor, "C C"]
    whitening: Float[Tensor, "n n"]
    robust: Float[Tensor, "I n"]
    residual: Float[Tensor, "I n"]
    kept: Bool[Tensor, "I n"]
    iterations: int

    @property
    def condition_number(self) -> float:
        """Condition number of the regressor of the free columns, rows unweighted (as published
        condition numbers are)."""
        return _condition(self.unweighted_factor[:-1, :-1][:, self.free])

    @property
    def scaled_condition_number(self) -> float:
        """The condition number with columns scaled to length one: what the choice of units cannot
        change."""
        r = self.unweighted_factor[:-1, :-1][:, self.free]
        return _condition(r / torch.linalg.vector_norm(r, dim=0))


def _condition(r: Tensor) -> float:
    return float(torch.linalg.cond(r)) if r.shape[1] else 1.0


def fit(
    source: RowSource,
    *,
    method: Method = "huber",
    covariance: Covariance = "diagonal",
    non_negative: Bool[Tensor, " B"] | None = None,
    left_out: Bool[Tensor, " B"] | None = None,
) -> Fit:
    """Solve tau = A x over all rows of `source`.

    Args:
        method: `ols`, `wls` or `huber`.
        covariance: `diagonal` or `full`, for wls and huber.
        non_negative: (B,) coefficients bounded at zero.
        left_out: (B,) coefficients held at zero from the start.

    Raises:
        IdentificationError: no row to fit.
    """
    none = torch.zeros(source.layout.size, dtype=torch.bool)
    signs = none if non_negative is None else non_negative
    excluded = none if left_out is None else left_out
    kept = torch.cat([block.keep for block in source])
    if not bool(kept.any()):
        raise IdentificationError(
            "no row is left to fit.",
            got="no joint ever moves" if source.moving_only else "no sample",
            hint='use `rows="all"`',
        )
    robust, whitening = kept.double(), torch.eye(source.layout.robot.n, dtype=torch.float64)
    plain = weighted = factor(source, robust, whitening)
    undetermined = undetermined_columns(plain, excluded)
    held = excluded | undetermined
    x, bounded = solve(plain, signs, held)
    residual = residuals(source, x)
    # 1e-10: noise that rounding of the torque makes, over it
    rounding = 1e-10 * float(torch.linalg.vector_norm(plain[:, -1])) / int(kept.sum()) ** 0.5
    iterations, step = 0, torch.inf
    # Residuals that are rounding say nothing about noise: exact data stay with equal weights.
    exact = float(residual.square().mean().sqrt()) <= rounding
    while method != "ols" and not exact and step > _CONVERGED and iterations < _MAX_ITERATIONS:
        iterations += 1
        whitening, robust = _weights(residual, kept, robust, method, covariance, rounding)
        weighted, previous = factor(source, robust, whitening), x
        x, bounded = solve(weighted, signs, held)
        residual = residuals(source, x)
        step = float(torch.linalg.vector_norm(weighted[:-1, :-1] @ (x - previous)))
    return Fit(
        x, ~(held | bounded), bounded, undetermined, weighted, plain, whitening, robust,
        residual, kept, iterations,
    )  # fmt: skip


def residuals(source: RowSource, x: Float[Tensor, " B"]) -> Float[Tensor, "I n"]:
    """tau - A x of all rows."""
    return torch.cat([block.residual(source.layout, x) for block in source])


def factor(
    source: RowSource, robust: Float[Tensor, "I n"], whitening: Float[Tensor, "n n"]
) -> Float[Tensor, "C C"]:
    """R (B + 1, B + 1) of the weighted rows [W A, W b], one pass over the data."""
    columns, size, scale = source.layout.columns, source.layout.size, whitening.diagonal()
    if torch.equal(whitening, torch.diag(scale)):
        factors = [TriangularFactor(len(c) + 1) for c in columns]
        for block in source:
            weight = robust[block.instant] * scale
            for i, rows in enumerate(block.augmented):
                seen = weight[:, i] != 0
                factors[i].add(rows[seen] * weight[seen, i : i + 1])
        return combined_factor([f.factor() for f in factors], columns, size)
    total = TriangularFactor(size + 1)
    for block in source:
        for rows in whitened_rows(source, block, robust, whitening):
            total.add(rows)
    return total.factor()


def whitened_rows(
    source: RowSource, block: RowBlock, robust: Tensor, whitening: Tensor
) -> list[Float[Tensor, "m C"]]:
    """Per joint the dense weighted rows (m, B + 1) of [A b]. Huber's weights act on the whitened
    rows; rows left out are zero before they are mixed."""
    each = zip(block.augmented, source.layout.columns, block.keep.T, strict=True)
    dense = torch.stack([_placed(a, c, source.layout.size) * k.unsqueeze(1) for a, c, k in each])
    mixed = torch.tensordot(whitening, dense, 1) * robust[block.instant].T.unsqueeze(-1)
    return list(mixed)


def _weights(
    residual: Tensor,
    kept: Tensor,
    robust: Tensor,
    method: Method,
    covariance: Covariance,
    rounding: float,
) -> tuple[Tensor, Tensor]:
    """Whitening matrix, and square roots of the robust weights, from residuals (I, n)."""
    if covariance == "full":
        whitening = _whitening(residual * kept, robust, rounding)
        scale = _scales((residual * kept) @ whitening.T, kept, method, 0.01)
        whitening = whitening / scale.unsqueeze(-1)
    else:
        whitening = torch.diag(1 / _scales(residual, kept, method, rounding))
    if method != "huber":
        return whitening, kept.double()
    size = ((residual * kept) @ whitening.T).abs().clamp(min=_TINY)
    return whitening, (HUBER / size).clamp(max=1.0).sqrt() * kept


def _scales(residual: Tensor, kept: Tensor, method: Method, floor: float) -> Float[Tensor, " n"]:
    """Noise level per joint, at least `floor`."""
    # A joint without rows has one residual, zero.
    of_joints = [
        r[k] if bool(k.any()) else r.new_zeros(1) for r, k in zip(residual.T, kept.T, strict=True)
    ]
    if method == "huber":
        levels = [MAD_TO_SIGMA * r.abs().median() for r in of_joints]
    else:
        levels = [r.square().mean().sqrt() for r in of_joints]
    return _at_least(torch.stack(levels), floor)


def _at_least(sigma: Tensor, floor: float) -> Tensor:
    """Levels no smaller than `floor` and a millionth of the largest: a joint that can be fitted
    exactly must not gain weight without end."""
    # 1e-6: noise of a joint over that of the noisiest, at least
    return sigma.clamp(min=max(floor, 1e-6 * float(sigma.max()), _TINY))


def _whitening(residual: Tensor, robust: Tensor, rounding: float) -> Float[Tensor, "n n"]:
    """Upper triangular W with W S W' = 1. Upper, so that row i mixes only rows j >= i and keeps
    its zeros for the links before i."""
    weighted = residual * robust / torch.linalg.vector_norm(robust, dim=0).clamp(min=_TINY)
    sigma = _at_least(torch.linalg.vector_norm(weighted, dim=0), rounding)
    weighted = weighted / sigma
    correlation = weighted.T @ weighted
    # Ones on the diagonal also where the floor, not the residual, is the level; a little more keeps
    # apart residuals that are combinations of each other.
    correlation += torch.diag((1 - correlation.diagonal()).clamp(min=0) + 1e-9)
    upper = torch.linalg.cholesky(correlation.flip(0, 1)).flip(0, 1)
    return torch.linalg.solve_triangular(upper, torch.diag(1 / sigma), upper=True)


def solve(
    r: Float[Tensor, "C C"], non_negative: Bool[Tensor, " B"], held: Bool[Tensor, " B"]
) -> tuple[Float[Tensor, " B"], Bool[Tensor, " B"]]:
    """Least squares from R of [A b]: (x, bounded), with x = 0 where held.

    Unconstrained first; if a non-negative coefficient comes out negative, bounded-variable least
    squares (Stark and Parker 1995) on the factor.
    """
    x, bounded, free = r.new_zeros(len(held)), torch.zeros_like(held), ~held
    if not bool(free.any()):
        return x, bounded
    a, y, signs = r[:, :-1][:, free], r[:, -1], non_negative[free]
    scale = torch.linalg.vector_norm(a, dim=0)
    scaled = a / scale
    q, triangle = torch.linalg.qr(scaled)
    z = torch.linalg.solve_triangular(triangle, (q.T @ y).unsqueeze(-1), upper=True).squeeze(-1)
    if bool((z[signs] < 0).any()):
        lower = np.where(signs.numpy(), 0.0, -np.inf)
        bounded_fit = lsq_linear(scaled.numpy(), y.numpy(), (lower, np.inf), method="bvls")
        z = torch.from_numpy(np.where(bounded_fit.active_mask == -1, 0.0, bounded_fit.x))
        bounded[free] = signs & (z == 0)
    x[free] = z / scale
    return x, bounded


def orthonormal(factor: Float[Tensor, "C C"], free: Int[Tensor, " F"]) -> Float[Tensor, "F F"]:
    """Combinations (F, F) of the free columns of a triangular factor that are orthonormal."""
    triangle = torch.linalg.qr(factor[:, free], mode="r").R
    return torch.linalg.solve_triangular(triangle, torch.eye(len(free)).to(triangle), upper=True)


def undetermined_columns(r: Float[Tensor, "C C"], held: Bool[Tensor, " B"]) -> Bool[Tensor, " B"]:
    """Columns that are combinations of earlier ones in these data, or zero; from left to right."""
    kept = torch.zeros_like(held)
    # 1e-7: share of a column below which it is the others'
    kept[~held], _ = independent_columns(r[:, :-1][:, ~held], 1e-7)
    return ~kept & ~held


def contaminated_columns(
    columns: Float[Tensor, "C B"], undetermined: Bool[Tensor, " B"]
) -> Bool[Tensor, " B"]:
    """Estimates that are of a sum with an undetermined parameter, as far as these data show.

    Args:
        columns: of the triangular factor.
        undetermined: those that were not estimated.
    """
    size = torch.linalg.vector_norm(columns, dim=0)
    lost, known = undetermined & (size > 0), ~undetermined
    out = torch.zeros_like(undetermined)
    if bool(lost.any()) and bool(known.any()):
        parts = columns[:, known] / size[known], columns[:, lost] / size[lost]
        # 0.03: share of an undetermined column that lies along an estimated one, above which the
        # estimate is of their sum
        out[known] = ~(torch.linalg.lstsq(*parts).solution.abs() <= 0.03).all(1)
    return out
