"""How large noise is, from what differs between repeats."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.statistics.autocorrelation import integrated_time
from torchid.statistics.blocks import block_numbers, block_sums
from torchid.statistics.proportion import HALF_90
from torchid.typing import Bool, Float, Int, Tensor


@dataclass(frozen=True, eq=False)
class NoiseLevel:
    """RMS of noise.

    Attributes:
        low, high: (n,) its 90 % interval; NaN of a series of which nothing counts.
        uneven: (n,) series of which it is the median of blocks, as some blocks differ more than
            chance makes them.
        variance: (n, B) of blocks.
        block: (N,) which block each sample is in.
        freedom: (n,) independent differences [1].
    """

    low: Float[Tensor, " n"]
    high: Float[Tensor, " n"]
    uneven: Bool[Tensor, " n"]
    variance: Float[Tensor, "n B"]
    block: Int[Tensor, " N"]
    freedom: Float[Tensor, " n"]


def noise_level(
    differences: Float[Tensor, "n N"],
    counting: Bool[Tensor, "n N"],
    bounds: Sequence[slice],
    length: int,
) -> NoiseLevel:
    """RMS of noise from what differs between repeats, over sqrt(2).

    Args:
        differences: of n series, stretches one after the other.
        counting: which samples count.
        bounds: of the stretches.
        length: of the blocks of which mean and median are compared [samples].
    """
    # Mean square of the difference, over all samples and block by block.
    block = block_numbers(bounds, length)
    squares = differences.square() * counting
    counts = block_sums(counting.to(differences), block)
    total = counts.sum(-1).clamp(min=1)
    mean = squares.sum(-1) / total
    variance = block_sums(squares, block) / counts.clamp(min=1)
    variance = variance.where(counts > 0.2 * length, torch.nan)
    # Degrees of freedom of a sum of squares of correlated samples; the median of chi^2 lies below
    # its mean (Wilson and Hilferty 1931).
    # What happens once must not make the noise look as slow as itself: of the usual samples.
    # 4.5: times the median of absolute values: 3 standard deviations of a normal variable
    top = 4.5 * differences.abs().median(-1, keepdim=True).values
    freedom = total / integrated_time(differences.clamp(-top, top), bounds).clamp(min=1.0)
    each = (freedom * length / total).clamp(min=1.0)
    median = variance.nanmedian(-1).values / (1 - 2 / (9 * each)) ** 3
    chance = 1 + 2 * ((math.pi / freedom).sqrt() + (2 / freedom).sqrt())
    # Uneven: the mean far above the median, by more than chance makes it.
    # 1.5: mean over median of the blocks' variance from which noise is not the same everywhere; the
    # median is then the noise, and the difference is said. Chance alone makes 1.2 of twenty blocks.
    uneven = (mean > 1.5 * median) & (mean > chance * median)
    rms = torch.where(uneven, median, mean).sqrt()
    # The interval of a variance with so many degrees of freedom, in logarithms.
    half = HALF_90 / (2 * freedom).sqrt()
    return NoiseLevel(
        rms * torch.exp(-half), rms * torch.exp(half), uneven, variance, block, freedom
    )
