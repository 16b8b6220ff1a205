"""Scales and weights that a few wild samples, or slow changes, do not move."""

from collections.abc import Sequence

import numpy as np
import torch

from torchid.typing import Float, Tensor

MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal variable over its median absolute value."""

HUBER = 1.345
"""Robust standard deviations beyond which a sample counts less (Huber 1981, section 7.8): 95 %
efficient where the noise is normal."""


def column_quantile(x: Float[Tensor, "N n"], share: float) -> Float[Tensor, " n"]:
    """torch.quantile(x, share, dim=0) to the bit, without sorting what only has to be parted; nan
    where a column has one."""
    place = share * (len(x) - 1)
    low = int(place)
    two = [low, min(low + 1, len(x) - 1)]
    parted = np.partition(x.T.contiguous().cpu().numpy(), two, axis=1)[:, two]
    below, above = torch.from_numpy(parted).to(x).unbind(1)
    quantile = torch.lerp(below, above, place - low)
    return torch.where(x.isnan().any(0), torch.nan, quantile)


def robust_std(x: Float[Tensor, "n N"]) -> Float[Tensor, " n"]:
    """Robust standard deviation of each row about zero, from its samples that are not zero: zeros
    are samples that do not count. Nan where none is left."""
    return MAD_TO_SIGMA * torch.where(x == 0, torch.nan, x.abs()).nanmedian(1).values


def white_variance(signals: Sequence[Float[Tensor, "T ..."]]) -> Float[Tensor, "..."]:
    """Variance of the white noise in signals over time, whatever they do slowly: of white noise
    third differences have twenty times its own; zero of signals too short to tell."""
    third = torch.cat([x.double().diff(n=3, dim=0) for x in signals])
    return third.square().sum(0) / (20 * max(len(third), 1))


def huber_weights(x: Float[Tensor, "n N"]) -> Float[Tensor, "n N"]:
    """Square roots of Huber's weights of the samples of each row."""
    limit = HUBER * torch.nan_to_num(robust_std(x), nan=1.0).clamp(min=1e-12).unsqueeze(1)
    return (limit / x.abs().clamp(min=1e-300)).clamp(max=1.0).sqrt()
