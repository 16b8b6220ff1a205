"""The level of a residual's spectrum above the fit's cut-off, where little but noise is left."""

import math
from collections.abc import Sequence

import torch

from torchid.design.segments import Samples, Segment
from torchid.log.filtering import ALL_PASSES, frequencies, low_pass
from torchid.statistics.spectrum import density
from torchid.typing import Float, Tensor

_HANN = 2.0  # tapered, neighbouring frequencies are not independent


def white_level(
    segments: Sequence[Segment], residual: Sequence[Tensor], cutoff: float
) -> Float[Tensor, " n"]:
    """Spectral density (n,) [(N m)^2/Hz, one-sided] above the cut-off, as a lower bound: the
    smaller one of residual and measured torque (the model's acceleration has noise of its own,
    which grows with frequency), less two standard errors. Medians, for lines do not move them."""
    levels = []
    for signals in (residual, [p.tau for p in segments]):
        densities = [_densities(x, p, cutoff) for x, p in zip(signals, segments, strict=True)]
        every = torch.cat(densities, -1)
        error = _HANN**0.5 / math.log(2) / math.sqrt(max(1, every.shape[-1]))
        # The median of chi^2 with two degrees of freedom is ln 2 of its mean.
        levels.append(every.median(-1).values / math.log(2) * max(0.0, 1 - 2 * error))
    return torch.minimum(*levels)


def _densities(x: Tensor, p: Segment, cutoff: float) -> Float[Tensor, "n F"]:
    """Periodogram of a tapered signal between the cut-off and the wide band's edge. Without its
    straight line the taper's side lobes are small."""
    steps = torch.arange(len(x), dtype=x.dtype) - (len(x) - 1) / 2
    straight = steps.unsqueeze(1) * (steps @ x / steps.square().sum().clamp(min=1.0))
    frequency, power = density((x - straight).cpu().numpy(), p.rate, len(x))
    # From the cut-off of the fit to where the wide band ends, or the filter begins.
    last = min(p.band, ALL_PASSES * p.rate)
    inside = (frequency >= min(cutoff, 0.5 * last)) & (frequency <= last)
    return torch.from_numpy(power[inside].T)


def bandwidth(samples: Samples) -> float:
    """Integral of the filter's squared amplitude [Hz]: variance of noise of density 1."""
    nyquist = samples.rate / 2
    chosen = low_pass(samples.rate, samples.cutoff)
    if chosen is None:
        return nyquist
    frequency = frequencies(samples.rate)
    amplitude = chosen.response(frequency)
    return float(torch.trapezoid(amplitude.square(), frequency))
