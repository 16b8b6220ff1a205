"""Integrated autocorrelation time: how many rows hold as much as one independent row."""

import math
from collections.abc import Sequence

import torch

from torchid.typing import Float, Tensor

CORRELATION_TIMES = 4.0
"""Correlation times of the residual in the shortest block whose sum is nearly independent of its
neighbours'."""


def correlation_instants(
    residual: Float[Tensor, "I n"], bounds: Sequence[slice] | None = None
) -> float:
    """Integrated autocorrelation time [instants] of the joint whose residual is slowest."""
    return float(integrated_time(residual.T, bounds).amax())


def integrated_time(
    x: Float[Tensor, "*batch N"],
    bounds: Sequence[slice] | None = None,
    *,
    centred: bool = True,
    along: Float[Tensor, "*batch N"] | None = None,
) -> Float[Tensor, "*batch"]:
    """Integrated autocorrelation time 1 + 2 sum_k rho_k (...) [rows] of each series, 1 at least.

    The autocovariances are summed over trajectories before they are divided, so a short trajectory
    counts by what it holds. The sum over lags ends where the lag first exceeds five times the sum
    (Sokal 1997, section 3). A mean that was taken from the series lowers every autocovariance, for
    which the sum is raised by (2 M + 1) / N after M lags (Wolff 2004, eq. 49). A series that holds
    fewer than ten correlation times never shows its own; the largest partial sum is taken then,
    which is a lower bound in all likelihood.

    What rows tell of a coefficient depends on its column c, too: noise r of variance s^2 gives c'r
    the variance s^2 c'c (1 + 2 sum_k rho_k rho_k(c)) (Newey and West 1987). Slow noise hides a slow
    column, and hardly a fast one.

    Args:
        x: (..., N) series, trajectories one after the other.
        bounds: the rows of each trajectory; one trajectory if None.
        centred: whether to take off the mean over all trajectories; else x is known to have
            mean zero.
        along: (..., N) the columns; None for constant ones.
    """
    if centred:
        x = x - x.mean(-1, keepdim=True)
    rho = autocorrelation(x, bounds)
    if along is not None:
        rho = rho * autocorrelation(along, bounds)
    return time_of(rho, centred=x.shape[-1] if centred else None)


def autocorrelation(
    x: Float[Tensor, "*batch N"], bounds: Sequence[slice] | None = None
) -> Float[Tensor, "*batch L"]:
    """Autocorrelations (..., L) at lags from 0 of series of mean zero, summed over trajectories;
    zeros of a series of zeros."""
    parts = [slice(0, x.shape[-1])] if bounds is None else bounds
    longest = max(b.stop - b.start for b in parts)
    # Zeros for as long as the series; lengths of few small factors are fast.
    least = 2 * max(1, longest)
    size = min(k * 2 ** max(0, math.ceil(math.log2(least / k))) for k in (1, 3, 5))
    spectra = (torch.fft.rfft(x[..., b], n=size) for b in parts)
    power = sum(f.real.square() + f.imag.square() for f in spectra)
    covariance = torch.fft.irfft(power, n=size)[..., :longest]
    return covariance / covariance[..., :1].clamp(min=1e-300)


def time_of(
    rho: Float[Tensor, "*batch L"], *, centred: int | None = None
) -> Float[Tensor, "*batch"]:
    """Integrated autocorrelation time of autocorrelations; see `integrated_time`.

    Args:
        rho: at lags from 0.
        centred: number of rows from which a mean was taken; None where none was.
    """
    longest = rho.shape[-1]
    constant = rho[..., :1] <= 0
    # Most sums end early: further lags are looked at where one does not.
    # 200: lags that are looked at first; most sums end within
    for count in (min(200, longest), longest):
        sums = 2 * rho[..., :count].cumsum(-1) - 1  # over lags 0 to M of each M
        lags = torch.arange(count, device=rho.device)
        # 5.0: correlation times after which the sum over lags ends (Sokal 1997): what is left of an
        # exponential correlation is 1 %, and further lags add only their noise
        enough = (lags >= 5.0 * sums) & (2 * lags < longest)
        if bool(enough.any(-1).all()):
            break
    last = enough.to(torch.int8).argmax(-1, keepdim=True)
    correction = 1 + (2 * last + 1) / centred if centred else 1.0
    windowed = sums.gather(-1, last) * correction
    time = torch.where(enough.any(-1, keepdim=True), windowed, sums.amax(-1, keepdim=True))
    return torch.where(constant, 1.0, time.clamp(min=1.0)).squeeze(-1)
