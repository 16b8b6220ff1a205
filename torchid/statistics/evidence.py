"""How likely one explanation is beside another: what every search for causes counts with.

    E = sum_j n_j log(L_j(0) / L_j) - sum_k log n_k - 2 log(looks / alpha) c

L_j is the sum of squares that an explanation leaves on joint j, n_j the number of rows there that
tell two explanations apart in noise like what the better one leaves. Every coefficient k costs
log n (Schwarz 1978), every cause the logarithm of all that were looked at.
"""

import math
from collections.abc import Sequence

import torch

from torchid.statistics.autocorrelation import autocorrelation, time_of
from torchid.typing import Float, Tensor

ODDS = 20.0
"""Odds against an alternative from which an answer leaves it out: exp of half the difference of the
evidence. Half and double of it change the mean set size by less than 0.1."""


def risen(
    effective: Float[Tensor, " n"], before: Float[Tensor, " n"], after: Float[Tensor, "*batch n"]
) -> Float[Tensor, "*batch n"]:
    """Twice the rise (*batch, n) of each joint's logarithm of the likelihood between two sums of
    squares of what is left; none on a joint of which no sample counts."""
    return effective * (before.clamp(min=1e-300) / after.clamp(min=1e-300)).log()


def price(looks: float, alpha: float) -> float:
    """What a cause costs, of so many that were looked at, at a family-wise level."""
    return 2 * math.log(looks / alpha)


def how_sure(rises: Sequence[float]) -> float:
    """Probability of a cause, from the rises of the evidence with none in its place and with each
    alternative: the odds are exp of half of them (Kass and Raftery 1995), for the evidence holds
    what was known beforehand and counts independent samples only."""
    return 1 / (1 + sum(math.exp(min(0.5 * rise, 500.0)) for rise in rises))


def telling_rows(
    left: Float[Tensor, "n N"],
    along: Float[Tensor, "n N"] | None,
    bounds: Sequence[slice],
    rows: Float[Tensor, " n"],
    correlation: Float[Tensor, "n L"] | None = None,
) -> Float[Tensor, " n"]:
    """Independent rows (n,) among those of each joint, if what is left there is noise: as many as
    tell of a constant; or of that by which another explanation differs.

    Args:
        left: what an explanation leaves, zero where no row counts.
        along: by how much another one differs; None of a constant.
        bounds: the rows of each stretch.
        rows: (n,) how many rows count.
        correlation: autocorrelation of `left`, where it is known already.
    """
    slow_as = autocorrelation(left, bounds) if correlation is None else correlation
    times = time_of(slow_as)
    if along is not None:
        a, b = along.square(), left.square()
        # Where they differ by rounding alone they do not differ.
        there = a.sum(1) > torch.finfo(a.dtype).eps * b.sum(1)
        slow = time_of(slow_as * autocorrelation(along, bounds))
        # Noise that is larger where the two differ more tells less of it (White 1980).
        loud = (a * b).sum(1) * rows / (a.sum(1) * b.sum(1)).clamp(min=1e-300)
        times = (slow * loud.clamp(min=1.0)).where(there, times)
    return (rows / times.clamp(min=1.0)).clamp(min=1e-9)
