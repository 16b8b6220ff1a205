"""Blocks of neighbouring rows: what statistics take as independent in the place of rows.

Within a block of several correlation times rows are as dependent as they like; between blocks they
nearly are not. The sums over blocks then behave as independent observations do (Kuensch 1989).
"""

import math
from collections.abc import Sequence

import torch

from torchid.typing import Float, Int, Tensor

CORRELATION_TIMES = 8.0
"""Length of a block in integrated autocorrelation times of the residual. What neighbouring blocks
share at their border is missing from their spread: with L correlation times 1/(2 L) of the variance
of the slowest column, so 3 % of its standard deviation."""

FEWEST_BLOCKS = 20
"""Student's 95 % quantile of fewer blocks exceeds 2.1, and soon grows fast."""

MOST_BLOCKS = 120
"""More blocks narrow an interval by less than 1 %, and a jackknife solves one problem a block."""


def block_length(rows: int, correlation: float) -> int:
    """Rows of a block: eight correlation times, as far as that leaves 20 to 120 blocks.

    Args:
        rows: in all.
        correlation: integrated autocorrelation time of the residual [rows].
    """
    wanted = max(1, math.ceil(CORRELATION_TIMES * correlation), math.ceil(rows / MOST_BLOCKS))
    return min(wanted, max(1, rows // FEWEST_BLOCKS))


def block_numbers(bounds: Sequence[slice], length: int) -> Int[Tensor, " N"]:
    """Block (N,) of each row: contiguous stretches of about `length` rows, alike to one row within
    a trajectory, that do not cross trajectories.

    Args:
        bounds: the rows of each trajectory, one after the other.
        length: see `block_length` [rows].
    """
    out, first = [], 0
    for rows in bounds:
        held = rows.stop - rows.start
        count = max(1, round(held / length))
        out.append(torch.arange(held) * count // max(1, held) + first)
        first += count
    return torch.cat(out)


def block_sums(x: Float[Tensor, "*batch N"], block: Int[Tensor, " N"]) -> Float[Tensor, "*batch K"]:
    """Sums (..., K) over the rows of each block."""
    return x.new_zeros(*x.shape[:-1], int(block.max()) + 1).index_add_(-1, block, x)


def block_products(
    a: Float[Tensor, "R P"], b: Float[Tensor, "R Q"], block: Int[Tensor, " R"], count: int
) -> Float[Tensor, "K P Q"]:
    """a'b (count, P, Q) over the rows of each block: one product of matrices a block, so that no
    array of R P Q numbers is ever made."""
    if bool((block.diff() < 0).any()):
        order = block.argsort(stable=True)
        same, a, block = a is b, a[order], block[order]
        b = a if same else b[order]
    out = a.new_zeros(count, a.shape[1], b.shape[1])
    names, sizes = block.unique_consecutive(return_counts=True)
    pieces = zip(names.tolist(), a.split(sizes.tolist()), b.split(sizes.tolist()), strict=True)
    for name, left, right in pieces:
        out[name] = left.T @ right
    return out
