"""Zero-phase low-pass, and differentiation.

The filter is a Butterworth run forwards and backwards: amplitude 1 / (1 + (tan(pi f / fs) /
tan(pi fc / fs))^2N) at frequency f, no phase. It is applied in the frequency domain, which makes it
one batched torch operation on any device and lets the result be decimated on the way out, exactly
where a time-domain filter followed by picking samples would end up. Ends are extended by odd
reflection, as scipy.signal.sosfiltfilt does, and a time-domain tail of `settling_time` is kept on
both sides of a chunk, so that chunks of a long log agree with the whole.
"""

import math
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import torch
from torch import Tensor

from torchid.errors import LogError
from torchid.typing import Float, Signals

ORDER = 4


ALL_PASSES = 0.45
"""Cut-off, as a share of the sampling rate, from which a low-pass would take nothing away."""


@dataclass(frozen=True)
class ZeroPhaseFilter:
    """Forward-backward Butterworth low-pass of order 4.

    Attributes:
        rate: sampling rate [Hz].
        cutoff: [Hz], where the amplitude is one half.
        order: of the one-way filter.
        every: the signals given are every so many-th sample of those at `rate`.
    """

    rate: float
    cutoff: float
    order: int = ORDER
    every: int = 1

    def __post_init__(self) -> None:
        if not 0 < self.cutoff < self.rate / 2:
            raise LogError(
                "the cut-off frequency is outside the log's band.",
                got=f"{self.cutoff:g} Hz",
                expected=f"between 0 and {self.rate / 2:.4g} Hz, half the sampling rate",
            )

    @property
    def tail(self) -> int:
        """Samples after which the impulse response is below 1e-8 of its area."""
        # 8.0: length of the filter's tail in periods of the cut-off: the slowest pole of a
        # 4th-order Butterworth decays as exp(-0.38 wc t), to 1e-8 after eight periods
        return math.ceil(8.0 * self.rate / self.cutoff)

    def response(self, frequency: Float[Tensor, " F"]) -> Float[Tensor, " F"]:
        """Amplitude at frequencies [Hz] up to half the sampling rate."""
        warped = torch.tan(math.pi * frequency.clamp(max=self.rate / 2 * (1 - 1e-12)) / self.rate)
        ratio = warped / math.tan(math.pi * self.cutoff / self.rate)
        return 1 / (1 + ratio ** (2 * self.order))

    def apply(self, x: Signals) -> Signals:
        """Filtered signals (..., T), ends extended by odd reflection."""
        pad = self.tail
        return self.decimated(extended(x, pad, pad), 1, pad, pad + x.shape[-1])

    def decimated(self, x: Signals, step: int, start: int, stop: int) -> Float[Tensor, "*batch _"]:
        """Every `step`-th filtered sample in start..stop of signals (..., T) that already carry
        their tails on both sides.

        The spectrum is cut above the new Nyquist frequency, where the filter has left nothing:
        `step` must not exceed `largest_step`.
        """
        # An even multiple of the step whose factors the FFT likes.
        length = 2 * step * fast_length(math.ceil(x.shape[-1] / (2 * step)))
        spectrum = torch.fft.rfft(x, n=length)
        kept = length // step
        weights = _weights(self, length, step, start % step, dtype=x.dtype, device=x.device)
        out = torch.fft.irfft(spectrum[..., : kept // 2 + 1] * weights, n=kept) / step
        first = start // step
        count = max(0, math.ceil((stop - start) / step))
        return out[..., first : first + count]

    @property
    def largest_step(self) -> int:
        """Decimation that keeps the sampling rate at ten times the cut-off or above, where the
        amplitude has fallen below 3e-6; the same for rates that differ by rounding."""
        return max(1, int(self.rate / (10 * self.cutoff) * (1 + 1e-6)))


@lru_cache(maxsize=16)
def _weights(low_pass: ZeroPhaseFilter, length: int, step: int, offset: int, **like: Any) -> Tensor:
    """Gains and phases of the frequencies that a decimation keeps. Logs of a fleet are alike: made
    once for many."""
    rate = low_pass.rate / low_pass.every
    frequency = torch.arange(length // step // 2 + 1, **like) * (rate / length)
    response = low_pass.response(frequency)
    # The phase shift moves the first sample onto the decimated grid.
    phase = 2 * math.pi * frequency * (offset / rate)
    return torch.polar(response, phase) if offset else response


@cache
def fast_length(least: int) -> int:
    """The smallest product of twos, threes and fives that is `least` or more: lengths that a real
    FFT likes.

    >>> fast_length(1021)
    1024
    """
    best = 1 << max(0, least - 1).bit_length()
    fives = 1
    while fives < best:
        odd = fives
        while odd < best:
            # So many twos that it is enough.
            best = min(best, odd << max(0, -(-least // odd) - 1).bit_length())
            odd *= 3
        fives *= 5
    return best


def low_pass(rate: float, cutoff: float) -> ZeroPhaseFilter | None:
    """The filter of a cut-off [Hz]; None where it would take nothing away."""
    return ZeroPhaseFilter(rate, cutoff) if cutoff < ALL_PASSES * rate else None


def frequencies(rate: float) -> Float[Tensor, " F"]:
    """So many up to half the sampling rate [Hz] that sums over them are integrals."""
    return torch.linspace(0, rate / 2 * (1 - 1e-9), 4001, dtype=torch.float64)


def low_passed(x: Signals, rate: float, cutoff: float) -> Signals:
    """Signals (..., T) below a cut-off [Hz], ends extended by odd reflection."""
    chosen = low_pass(rate, cutoff)
    return x if chosen is None else chosen.apply(x).contiguous()


def extended(x: Signals, before: int, after: int) -> Float[Tensor, "*batch T+{before}+{after}"]:
    """Signals (..., T) extended by odd reflection, and where they are too short for that, further
    by their last value: a filter's tail always has something to settle on."""
    longest = x.shape[-1] - 1
    left, right = min(before, longest), min(after, longest)
    inner = torch.cat(
        [
            2 * x[..., :1] - x[..., 1 : left + 1].flip(-1),
            x,
            2 * x[..., -1:] - x[..., longest - right : longest].flip(-1),
        ],
        -1,
    )
    first = inner[..., :1].expand(*x.shape[:-1], max(0, before - longest))
    last = inner[..., -1:].expand(*x.shape[:-1], max(0, after - longest))
    return torch.cat([first, inner, last], -1)


def central_difference(x: Signals, rate: float) -> Signals:
    """Time derivative of signals (..., T): five-point central differences, whose error is
    (2 pi f / rate)^4 / 30 at frequency f; three-point ones next to the ends, one-sided at them."""
    inner = (x[..., 2:] - x[..., :-2]) * (rate / 2)
    if x.shape[-1] >= 5:
        wide = (x[..., 4:] - x[..., :-4]) * (rate / 4)
        inner[..., 1:-1] += (inner[..., 1:-1] - wide) / 3
    first = (x[..., 1:2] - x[..., :1]) * rate
    last = (x[..., -1:] - x[..., -2:-1]) * rate
    return torch.cat([first, inner, last], -1)


def lateness(
    reference: Signals, signal: Signals, rate: float, cutoff: float
) -> Float[Tensor, "4 ..."]:
    """By how much signals (..., T) are behind their references: to first order
    reference(t) = signal(t + lag), so that the least-squares lag is the first of these sums over
    the second, and the square root of the fourth over the third is what differs.

    Args:
        reference, signal: at `rate` [Hz].
        rate: of sampling.
        cutoff: under which both are low-passed [Hz]; its period is left out at either end.

    Returns:
        Sums along time of (reference - signal) slope, slope^2, reference^2 and
        (reference - signal)^2, the slope that of the signal.
    """
    low_pass = ZeroPhaseFilter(rate, cutoff)
    edge = min(round(rate / cutoff), reference.shape[-1] // 4)
    middle = slice(edge, reference.shape[-1] - edge)
    a, b = low_pass.apply(reference), low_pass.apply(signal)
    slope = central_difference(b, rate)[..., middle]
    a, gap = a[..., middle], (a - b)[..., middle]
    return torch.stack([x.sum(-1) for x in (gap * slope, slope**2, a**2, gap**2)])
