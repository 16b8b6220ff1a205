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

_RENEW_AT = 1e3
"""Mean square of a preconditioned column (1 if rows are like those of the guess) that calls for a
new guess."""
_FLOOR = 1e-6
"""Diagonal entry of the guess, relative to its column, below which the direction is unseen."""
_ENOUGH = 4
"""Rows a column before the first guess: fewer make one that the rest does not resemble."""


class TriangularFactor:
    """Accumulates rows (m, c) into an upper triangular R (c, c) with R'R = A'A.

    The one mutable object of this room: a tall matrix arrives in pieces and is never stored, and
    the state is a c x c factor whatever the number of rows. R of [A b] holds everything least
    squares needs: ||A x - b||^2 = ||R (x, -1)||^2. It is built by preconditioned Cholesky QR: rows
    are multiplied by the inverse of a first guess R0, their Gram matrix G stays well conditioned,
    and R = chol(G)' R0 has the accuracy of Householder QR without its cost (Yamamoto et al. 2015,
    shifted and preconditioned CholeskyQR). R0 is renewed whenever the rows it was made from no
    longer represent the rest.
    """

    def __init__(self, columns: int):
        self._guess: Tensor | None = None
        self._inverse: Tensor | None = None
        self._gram = torch.zeros(columns, columns, dtype=torch.float64)
        self._rows = 0
        self._columns = columns
        self._waiting: list[Tensor] = []

    def add(self, rows: Float[Tensor, "m c"]) -> None:
        """Take in m rows."""
        if rows.shape[0] == 0:
            return
        if self._guess is None:
            self._waiting = [torch.cat([*self._waiting, rows])]
            if self._waiting[0].shape[0] < _ENOUGH * self._columns:
                return
            rows = self._waiting.pop()
            self._precondition(_householder(rows))
        assert self._guess is not None
        assert self._inverse is not None
        z = rows @ self._inverse
        self._gram.addmm_(z.T, z)
        self._rows += rows.shape[0]
        spread = self._gram.diagonal() / self._rows
        if float(spread.max()) > _RENEW_AT * float(spread.mean().clamp(max=1.0)):
            exact = _root(self._gram) @ self._guess
            self._precondition(_householder(exact / self._rows**0.5))
            z = exact @ self._inverse
            self._gram = z.T @ z

    def factor(self) -> Float[Tensor, "c c"]:
        """R with a non-negative diagonal; zero if no row came."""
        if self._guess is None:
            return _householder(torch.cat([torch.zeros_like(self._gram), *self._waiting]))
        # Both are upper triangular already; this makes the diagonal non-negative.
        return _householder(_root(self._gram) @ self._guess)

    def _precondition(self, guess: Tensor) -> None:
        """Use R0 = `guess`. A direction it has not seen gets its column's size: a small size there
        would make the inverse large, and its rounding would spoil the columns that were seen."""
        size = torch.linalg.vector_norm(guess, dim=0)
        size = torch.where(size > 0, size, size.max().clamp(min=1.0))
        diagonal = guess.diagonal()
        lifted = torch.where(diagonal.abs() > _FLOOR * size, diagonal, size)
        self._guess = guess - torch.diag(diagonal) + torch.diag(lifted)
        eye = torch.eye(self._columns, dtype=guess.dtype, device=guess.device)
        # Solved from the right: what must hold to rounding is inverse x R0 = 1, the way it is used.
        self._inverse = torch.linalg.solve_triangular(self._guess, eye, upper=True, left=False)


def stacked_factor(factors: list[Tensor]) -> Float[Tensor, "c c"]:
    """R of several matrices on top of each other, from their factors."""
    return _householder(torch.cat(factors))


def block_factors(blocks: Sequence[Tensor]) -> Float[Tensor, "K c c"]:
    """R of each of K matrices of as many columns, in one call: rows of zeros, which no factor
    feels, make them equally long."""
    columns = blocks[0].shape[1]
    longest = blocks[0].new_zeros(max(columns, *(len(b) for b in blocks)), columns)
    padded = torch.nn.utils.rnn.pad_sequence([longest, *blocks], batch_first=True)
    return _householder(padded[1:])


def combined_factor(
    factors: Sequence[Float[Tensor, "_ _"]], columns: Sequence[Sequence[int]], size: int
) -> Float[Tensor, "C C"]:
    """R of [A b] from the factors of its torque rows, each of its own columns of A and of b.

    Args:
        factors: a torque row's R, (c + 1, c + 1), b last.
        columns: the c columns of A, of `size` in all, that each has.
    """
    wide = []
    for r, c in zip(factors, columns, strict=True):
        embedded = r.new_zeros(r.shape[0], size + 1)
        embedded[:, [*c, size]] = r
        wide.append(embedded)
    return stacked_factor(wide)


def _householder(rows: Float[Tensor, "*batch _ c"]) -> Float[Tensor, "*batch c c"]:
    c = rows.shape[-1]
    if rows.shape[-2] < c:
        rows = torch.cat([rows, rows.new_zeros(c - rows.shape[0], c)])
    r = torch.linalg.qr(rows, mode="r").R
    sign = torch.where(r.diagonal(dim1=-2, dim2=-1) < 0, -1.0, 1.0).to(r)
    return r * sign.unsqueeze(-1)


def _root(gram: Tensor) -> Tensor:
    """Upper triangular U with U'U = G, also for a singular G.

    G is scaled to a unit diagonal first: a direction the guess got wrong by a factor of a million
    then loses nothing.
    """
    size = gram.diagonal().sqrt()
    safe = torch.where(size > 0, size, torch.ones_like(size))
    scaled = gram / safe / safe.unsqueeze(-1)
    scaled.diagonal().fill_(1.0)
    upper, info = torch.linalg.cholesky_ex(scaled, upper=True)
    if int(info) != 0:
        values, vectors = torch.linalg.eigh(scaled)
        upper = _householder(values.clamp(min=0).sqrt().unsqueeze(-1) * vectors.T)
    return upper * size


_MAX_ITERATIONS = 30
_CONVERGED = 0.05
"""Step of the reweighting, in standard deviations under white residuals, that counts as settled."""
_UNDETERMINED = 1e-7
_ROUNDING = 1e-10
_LEAST_LEVEL = 1e-6


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
        """The same with columns scaled to length one: what the choice of units cannot change."""
        r = self.unweighted_factor[:-1, :-1][:, self.free]
        return _condition(r / torch.linalg.vector_norm(r, dim=0))


def _condition(r: Tensor) -> float:
    s = torch.linalg.svdvals(r)
    return float(s[0] / s[-1]) if len(s) else 1.0


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
    b = source.layout.size
    n = source.layout.robot.n
    signs = torch.zeros(b, dtype=torch.bool) if non_negative is None else non_negative
    excluded = torch.zeros(b, dtype=torch.bool) if left_out is None else left_out
    kept = torch.cat([block.keep for block in source])
    if not bool(kept.any()):
        raise IdentificationError(
            "no row is left to fit.",
            got="no joint ever moves faster than 0.02 rad/s" if source.moving_only else "no sample",
            hint='use `rows="all"`',
        )
    unit = kept.to(torch.float64)
    plain = factor(source, unit, torch.eye(n, dtype=torch.float64))
    undetermined = undetermined_columns(plain, excluded)
    held = excluded | undetermined
    x, bounded = solve(plain, signs, held)
    whitening, robust, weighted = torch.eye(n, dtype=torch.float64), unit, plain
    residual = residuals(source, x)
    rounding = _ROUNDING * float(torch.linalg.vector_norm(plain[:, -1])) / int(kept.sum()) ** 0.5
    iterations = 0
    # Residuals that are rounding say nothing about noise: exact data stay with equal weights.
    exact = float(residual.square().mean().sqrt()) <= rounding
    while method != "ols" and not exact and iterations < _MAX_ITERATIONS:
        iterations += 1
        whitening, robust = _weights(residual, kept, robust, method, covariance, rounding)
        weighted = factor(source, robust, whitening)
        previous = x
        x, bounded = solve(weighted, signs, held)
        residual = residuals(source, x)
        change = torch.linalg.vector_norm(weighted[:-1, :-1] @ (x - previous))
        if float(change) <= _CONVERGED:
            break
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
    columns, scale = source.layout.columns, whitening.diagonal()
    if bool((whitening - torch.diag(scale)).abs().max() == 0):
        factors = [TriangularFactor(len(c) + 1) for c in columns]
        for block in source:
            weight = robust[block.instant] * scale
            for i, rows in enumerate(block.augmented):
                factors[i].add(rows * weight[:, i : i + 1])
        return combined_factor([f.factor() for f in factors], columns, source.layout.size)
    total = TriangularFactor(source.layout.size + 1)
    for block in source:
        for rows in whitened_rows(source, block, robust, whitening):
            total.add(rows)
    return total.factor()


def whitened_rows(
    source: RowSource, block: RowBlock, robust: Tensor, whitening: Tensor
) -> list[Float[Tensor, "m C"]]:
    """Per joint the dense weighted rows (m, B + 1) of [A b]. Huber's weights act on the whitened
    rows; rows left out are zero before they are mixed."""
    b = source.layout.size
    dense = []
    for i, (own, c) in enumerate(zip(block.augmented, source.layout.columns, strict=True)):
        rows = own.new_zeros(own.shape[0], b + 1)
        rows[:, [*c, b]] = own
        dense.append(rows * block.keep[:, i : i + 1])
    weight = robust[block.instant]
    mixed = []
    for i in range(len(dense)):
        terms = [whitening[i, j] * dense[j] for j in range(len(dense)) if whitening[i, j] != 0]
        mixed.append(torch.stack(terms).sum(0) * weight[:, i : i + 1])
    return mixed


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
        white = (residual * kept) @ whitening.T
        scale = _at_least(_scales(white, kept, method), 0.01)
        whitening = whitening / scale.unsqueeze(-1)
        white = white / scale
    else:
        sigma = _at_least(_scales(residual, kept, method), rounding)
        whitening = torch.diag(1 / sigma)
        white = residual / sigma
    size = white.abs().clamp(min=1e-300)
    huber = (HUBER / size).clamp(max=1.0).sqrt() if method == "huber" else torch.ones_like(size)
    return whitening, huber * kept


def _scales(residual: Tensor, kept: Tensor, method: Method) -> Float[Tensor, " n"]:
    """Noise level per joint; 0 for one without rows."""
    levels = []
    for r, k in zip(residual.unbind(-1), kept.unbind(-1), strict=True):
        own = r[k]
        if len(own) == 0:
            levels.append(torch.zeros((), dtype=r.dtype))
        elif method == "huber":
            levels.append(MAD_TO_SIGMA * own.abs().median())
        else:
            levels.append((own * own).mean().sqrt())
    return torch.stack(levels)


def _at_least(sigma: Tensor, floor: float) -> Tensor:
    """Levels no smaller than `floor` and a millionth of the largest: a joint that can be fitted
    exactly must not gain weight without end."""
    return sigma.clamp(min=max(floor, _LEAST_LEVEL * float(sigma.max()), 1e-300))


def _whitening(residual: Tensor, robust: Tensor, rounding: float) -> Float[Tensor, "n n"]:
    """Upper triangular W with W S W' = 1. Upper, so that row i mixes only rows j >= i and keeps
    its zeros for the links before i."""
    weighted = residual * robust / torch.linalg.vector_norm(robust, dim=0).clamp(min=1e-300)
    sigma = _at_least(torch.linalg.vector_norm(weighted, dim=0), rounding)
    weighted = weighted / sigma
    correlation = weighted.T @ weighted
    # Ones on the diagonal also where the floor, not the residual, is the level; a little more keeps
    # apart residuals that are combinations of each other.
    missing = (1 - correlation.diagonal()).clamp(min=0) + 1e-9
    correlation = correlation + torch.diag(missing)
    upper = torch.linalg.cholesky(correlation.flip(0, 1)).flip(0, 1)
    return torch.linalg.solve_triangular(upper, torch.diag(1 / sigma), upper=True)


def solve(
    r: Float[Tensor, "C C"], non_negative: Bool[Tensor, " B"], held: Bool[Tensor, " B"]
) -> tuple[Float[Tensor, " B"], Bool[Tensor, " B"]]:
    """Least squares from R of [A b]: (x, bounded), with x = 0 where held.

    Unconstrained first; if a non-negative coefficient comes out negative, bounded-variable least
    squares (Stark and Parker 1995) on the factor.
    """
    b = r.shape[0] - 1
    free = (~held).nonzero().flatten()
    x = torch.zeros(b, dtype=r.dtype)
    bounded = torch.zeros(b, dtype=torch.bool)
    if len(free) == 0:
        return x, bounded
    a, y = r[:, :-1][:, free], r[:, -1]
    scale = torch.linalg.vector_norm(a, dim=0)
    scaled = a / scale
    q, triangle = torch.linalg.qr(scaled)
    z = torch.linalg.solve_triangular(triangle, (q.T @ y).unsqueeze(-1), upper=True).squeeze(-1)
    signs = non_negative[free]
    if bool((z[signs] < 0).any()):
        lower = np.where(signs.numpy(), 0.0, -np.inf)
        found = lsq_linear(scaled.numpy(), y.numpy(), (lower, np.inf), method="bvls")
        at_bound = torch.from_numpy(np.asarray(found.active_mask) == -1)
        z = torch.where(at_bound, 0.0, torch.from_numpy(found.x))
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
    kept[~held], _ = independent_columns(r[:, :-1][:, ~held], _UNDETERMINED)
    return ~kept & ~held


CONTAMINATED = 0.03
"""Share of an undetermined column that lies along an estimated one, above which the estimate is of
their sum."""


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
        share = torch.linalg.lstsq(*parts).solution
        out[known] = ~(share.abs() <= CONTAMINATED).all(1)
    return out
