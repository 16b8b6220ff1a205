"""Tests that respect the autocorrelation of residuals: everything is summed over blocks first.

Within a block of several correlation times samples are as dependent as they like; between blocks
they are nearly not. So a test looks at sums over blocks: their signs are exchangeable where there
is nothing (Winkler et al. 2014, sign flipping), and their spread is an honest standard error.
"""

import math

import torch
from scipy.stats import f as fisher
from scipy.stats import t as student

from torchid.typing import Float, Int, Tensor

FLIPS = 999


def block_numbers(bounds: tuple[slice, ...], length: int) -> Int[Tensor, " N"]:
    """Block of each row: contiguous stretches of about `length` rows that do not cross
    trajectories."""
    out, first = [], 0
    for rows in bounds:
        count = max(1, round((rows.stop - rows.start) / length))
        local = torch.arange(rows.stop - rows.start) * count // max(1, rows.stop - rows.start)
        out.append(local + first)
        first += count
    return torch.cat(out)


def block_sums(x: Float[Tensor, "*batch N"], block: Int[Tensor, " N"]) -> Float[Tensor, "*batch K"]:
    """Sums over blocks."""
    out = x.new_zeros(*x.shape[:-1], int(block.max()) + 1)
    return out.index_add_(-1, block, x)


def sign_flip_p(scores: Float[Tensor, "K C"], seed: int) -> float:
    """p-value of block scores (K, C) having no common direction: T = s' V^-1 s with s the sum and V
    the sum of squares, against the same under random signs of whole blocks."""
    generator = torch.Generator().manual_seed(seed)
    signs = torch.randint(0, 2, (FLIPS, len(scores)), generator=generator).to(scores) * 2 - 1
    inner = torch.linalg.pinv(scores.T @ scores, rtol=1e-10, hermitian=True)
    sums = torch.cat([scores.sum(0, keepdim=True), signs @ scores])
    statistic = ((sums @ inner) * sums).sum(-1)
    return float((1 + (statistic[1:] >= statistic[0] * (1 - 1e-9)).sum()) / (1 + FLIPS))


def wald_p(
    columns: Float[Tensor, "C R"], r: Float[Tensor, " R"], block: Int[Tensor, " R"]
) -> float:
    """p-value of coefficients being zero: W = x' V^-1 x with the covariance V of a cluster-robust
    fit (Liang and Zeger 1986), against Hotelling's T^2 with as many degrees of freedom as blocks.

    Args:
        columns: projected on the complement of the model.
        r: residual.
        block: block of each row.
    """
    gram = columns @ columns.T
    inverse = torch.linalg.pinv(gram, rtol=1e-6, hermitian=True)
    x = inverse @ (columns @ r)
    scores = block_sums(columns * (r - x @ columns), block)
    k = scores.shape[1]
    spread = inverse @ (scores @ scores.T) @ inverse * (k / max(1, k - 1))
    rank = int(torch.linalg.matrix_rank(spread, rtol=1e-9, hermitian=True))
    if rank == 0 or k <= rank:
        return 1.0
    w = float(x @ torch.linalg.pinv(spread, rtol=1e-9, hermitian=True) @ x)
    return float(fisher.sf(w * (k - rank) / (rank * (k - 1)), rank, k - rank))


def mean_bound(x: Float[Tensor, " K"], confidence: float) -> float:
    """Lower bound of the sum of x over blocks, one-sided, from the spread between blocks."""
    k = len(x)
    if k < 3:
        return -math.inf
    spread = float(x.std()) * math.sqrt(k)
    return float(x.sum()) - float(student.ppf(confidence, k - 1)) * spread


def held_out_gain(
    columns: Float[Tensor, "C R"], r: Float[Tensor, " R"], block: Int[Tensor, " R"], folds: int = 5
) -> Float[Tensor, " K"]:
    """Fall of each block's sum of squares when the coefficients come from other folds.

    Args:
        columns: already projected on the complement of the model.
        r: residual.
        block: block of each row; a fold is a run of neighbouring blocks.
    """
    count = int(block.max()) + 1
    products = torch.stack([block_sums(c * columns, block) for c in columns])  # (C, C, K)
    grams = products.permute(2, 0, 1)
    pulls = block_sums(columns * r, block).T  # (K, C)
    fold = torch.arange(count) * folds // count
    out = r.new_zeros(count)
    for f in range(folds):
        own = fold == f
        gram, pull = grams[~own].sum(0), pulls[~own].sum(0)
        x = torch.linalg.pinv(gram, rtol=1e-8, hermitian=True) @ pull
        out[own] = 2 * pulls[own] @ x - (grams[own] @ x) @ x
    return out
