"""Probabilities of causes from the odds of what may be there instead.

Odds are given as rises, twice their logarithms (Kass and Raftery 1995). Beside nothing, and other
causes of a library, there may be something that is in no library: a misfit that is no noise. An
unknown effect as large as the misfit U is as large as the torque or error t that a cause takes away
by chance with odds of exp(-t^2 / 2 U^2). A law wants the same factor in all regimes, to a tenth or
so; what stands in for something else wants another one in some of them. And where a share of the
squares has no name, what has one may belong to it: the odds are no less than in proportion to that.
"""

import math
from collections.abc import Sequence

import torch

from torchid.statistics.criteria import LAW_STD, PROXY_STD

UNNAMED = 4 / 9
"""Odds of an unknown effect in the place of a cause, over the share of the squares that has no name
[1]: with half of the RMS left a cause is 90 % sure at most."""

Factors = list[tuple[float, float]]
"""By which factors parts of the data want a cause, each with its standard deviation."""


def unknown_rise(ratio: float, share: float, ways: Sequence[Factors] = ()) -> float:
    """That something unknown is there in the place of a cause.

    Args:
        ratio: squares that the cause takes away, over those of the misfit.
        share: of the squares before anything was named, the misfit's.
        ways: factors of the parts of the data, in each way of parting it: it is not known
            beforehand in which of them an unknown effect varies.
    """
    rise = -ratio
    if ways:
        each = torch.tensor([stands_in(factors) for factors in ways], dtype=torch.float64)
        rise += 2 * (float(each.logsumexp(0)) - math.log(len(each)))
    return max(rise, 2 * math.log(max(UNNAMED * share, 1e-300)))


def stands_in(factors: Factors) -> float:
    """Logarithm of how much likelier factors are of what stands in for something else than of a
    law."""
    x, std = torch.tensor(factors, dtype=torch.float64).reshape(-1, 2).unbind(1)
    law, proxy = std.square() + LAW_STD**2, std.square() + PROXY_STD**2
    each = 0.5 * ((law / proxy).log() + (x - 1).square() * (1 / law - 1 / proxy))
    return float(each.nan_to_num().sum())
