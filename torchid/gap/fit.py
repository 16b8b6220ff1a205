"""Least squares of accepted terms together, with standard deviations from the spread of blocks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.gap.problem import BASE, Problem, Term
from torchid.gap.projection import VISIBLE, in_all_rows
from torchid.typing import Float, Tensor

DETERMINED = 1e-7
"""Eigenvalue of the scaled Gram matrix, relative to the largest, below which a direction is left
at zero."""

ROUNDED = 1e-12
"""Length of a column, relative to the longest, that is no more than rounding."""

FEW_BLOCKS = 4.0
"""Effective number of blocks that hold a term, (sum e)^2 / sum e^2 of their energies, below which
their spread is not known."""


@dataclass(frozen=True)
class Fit:
    """Coefficients of terms, fitted together.

    Attributes:
        values: per term (C,).
        std: per term (C,), from the spread of block scores.
        loss: sum of squares left, weighted as the fit was.
    """

    values: tuple[Float[Tensor, " _"], ...]
    std: tuple[Float[Tensor, " _"], ...]
    loss: float


def huber_weights(r: Float[Tensor, "n N"]) -> Float[Tensor, "n N"]:
    """Square roots of Huber's weights: rows far out, at reversals or in a collision, count as much
    as one at 1.345 robust standard deviations does (Huber 1981, section 7.8)."""
    size = torch.where(r == 0, torch.nan, r.abs()).nanmedian(1, keepdim=True).values
    limit = 1.345 * 1.4826 * torch.nan_to_num(size, nan=1.0).clamp(min=1e-12)
    return (limit / r.abs().clamp(min=1e-300)).clamp(max=1.0).sqrt()


def fitted(problem: Problem, terms: Sequence[Term]) -> Fit:
    """Least squares of all terms together, with block-robust standard deviations.

    Columns are scaled to length one; directions that the rows do not determine stay at zero. The
    covariance is G^-1 (sum_b s_b s_b') G^-1 over block scores s_b = sum_t x_t r_t (White 1980;
    blocks as clusters). Of what is there in a block or two only, a contact, that says nothing:
    its standard deviations are no smaller than those with independent residuals.
    """
    both = (*problem.fixed, *terms)
    n = problem.y.shape[0]
    bases = [_strong_directions(t) for t in both]
    if not any(len(basis) for basis in bases):  # nothing, or nothing that is in these rows
        zeros = tuple(t.columns.new_zeros(len(t.columns)) for t in both)
        return Fit(zeros, zeros, float(problem.y.square().sum()))
    a = torch.cat(
        [basis @ in_all_rows(t.columns, t.place, n) for t, basis in zip(both, bases, strict=True)]
    )
    size = _lengths(a)
    a = a / size.unsqueeze(1)
    values, vectors = torch.linalg.eigh(a @ a.T)
    kept = values > DETERMINED * values[-1]
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    y = problem.y.flatten()
    x = inverse @ (a @ y)
    r = y - x @ a
    block = problem.block.repeat(n)
    k = int(block.max()) + 1
    scores = a.new_zeros(len(a), k).index_add_(1, block, a * r)
    spread = inverse @ (scores @ scores.T) @ inverse * (k / max(1, k - 1))
    usual = inverse * (r.square().sum() / max(1, problem.count - len(a)))
    lengths = [len(basis) for basis in bases]
    values = [v @ basis for v, basis in zip((x / size).split(lengths), bases, strict=True)]
    both_ways = [_diagonal_blocks(c / size / size.unsqueeze(1), lengths) for c in (spread, usual)]
    stds = []
    parts = (x.unsqueeze(1) * a).split(lengths)
    for *covariances, basis, part in zip(*both_ways, bases, parts, strict=True):
        held = torch.zeros(k, dtype=a.dtype).index_add_(0, block, part.sum(0).square())
        few = float(held.sum().square()) < FEW_BLOCKS * float(held.square().sum())
        variances = torch.stack([(basis.T @ c @ basis).diagonal() for c in covariances])
        stds.append(variances[: 1 + few].amax(0).clamp(min=0).sqrt())
    return Fit(tuple(values), tuple(stds), float(r.square().sum()))


def _lengths(columns: Float[Tensor, "C R"]) -> Float[Tensor, " C"]:
    """Lengths of columns; infinite of what rounding leaves of one that is zero in these rows, so
    that it becomes no direction."""
    size = columns.norm(dim=1)
    return torch.where(size > ROUNDED * size.max(), size, math.inf)


def _strong_directions(term: Term) -> Float[Tensor, "D C"]:
    """Combinations (rows) of a term's coefficients that its own columns determine: a force at the
    tool has none along an axis that no joint feels. All of them for base parameters, which are
    independent by construction, and for one column."""
    c = len(term.columns)
    if c == 1 or term.name == BASE:
        return torch.eye(c, dtype=term.columns.dtype)
    size = _lengths(term.columns)
    scaled = term.columns / size.unsqueeze(1)
    values, vectors = torch.linalg.eigh(scaled @ scaled.T)
    return (vectors[:, values > VISIBLE].T) / size


def _diagonal_blocks(matrix: Tensor, lengths: Sequence[int]) -> list[Tensor]:
    starts = [sum(lengths[:k]) for k in range(len(lengths))]
    return [
        matrix[a : a + length, a : a + length] for a, length in zip(starts, lengths, strict=True)
    ]
