"""Signals of a motion at other instants: derivatives and delays. Time is the first axis."""

import torch
from torch import Tensor

from torchid.log.filtering import central_difference
from torchid.typing import Float


def interval(t: Float[Tensor, " T"]) -> float:
    """Seconds between samples of a uniform grid; 1 where there are fewer than two."""
    return float(t[-1] - t[0]) / (t.shape[0] - 1) if t.shape[0] > 1 else 1.0


def derivative(x: Float[Tensor, "T ..."], t: Float[Tensor, " T"]) -> Float[Tensor, "T ..."]:
    """Time derivative of signals, by five-point differences (three and two at the ends).

    It amplifies noise up to a quarter of the sampling rate. That is left in: effects use it
    linearly, so the filter that torque and columns share removes it; a filter here would delay or
    attenuate the columns alone.
    """
    if x.shape[0] < 2:
        return torch.zeros_like(x)
    return central_difference(x.movedim(0, -1), 1 / interval(t)).movedim(-1, 0)


def shifted(
    x: Float[Tensor, "T n"], t: Float[Tensor, " T"], by: Float[Tensor, "T n"] | float
) -> Float[Tensor, "T n"]:
    """x(t + by): signals at later (or earlier) instants, held at the ends of the record.

    Lagrange polynomials through the six nearest samples; a whole number of samples is exact.

    Args:
        x: signals.
        t: uniform grid [s].
        by: seconds, one for all or one a value.
    """
    total = x.shape[0]
    if total < 2:
        return x.clone()
    # 6: samples that a value between samples is interpolated from: at a delay of half a sample the
    # error at frequency f is about 5 (pi f / rate)^6 / 16 of the signal
    points = min(6, total)
    index = torch.arange(total, dtype=x.dtype, device=x.device).unsqueeze(-1)
    position = (
        (index + torch.as_tensor(by, dtype=x.dtype, device=x.device) / interval(t))
        .clamp(0, total - 1)
        .expand_as(x)
    )
    first = (position.floor().long() - (points // 2 - 1)).clamp(0, total - points)
    u = position - first
    out = torch.zeros_like(x)
    for k in range(points):
        weight = torch.ones_like(u)
        for other in range(points):
            if other != k:
                weight = weight * ((u - other) / (k - other))
        out = out + weight * x.gather(0, first + k)
    return out
