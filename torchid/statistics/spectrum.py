"""Power densities of signals; `scipy.signal` has them too, and takes a second to load."""

import numpy as np

AT_ONCE = 1024
"""Pieces that are looked at together: bounds the memory of long logs."""


def density(x: np.ndarray, rate: float, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (F,) [Hz] and one-sided power densities (F, n) of signals (T, n) by Welch's
    method: Hann windows of a length [samples] that overlap by half, each less its mean."""
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    step = length - length // 2
    pieces = np.lib.stride_tricks.sliding_window_view(x, length, 0)[::step]
    power = np.zeros((x.shape[1], length // 2 + 1))
    for k in range(0, len(pieces), AT_ONCE):
        part = pieces[k : k + AT_ONCE]
        spectrum = np.fft.rfft((part - part.mean(-1, keepdims=True)) * window)
        power += (spectrum.real**2 + spectrum.imag**2).sum(0)
    power *= 2 / (len(pieces) * rate * (window**2).sum())
    # Zero, and half the rate where it is there, have no mirror image.
    power[:, [0] if length % 2 else [0, -1]] /= 2
    return np.fft.rfftfreq(length, 1 / rate), power.T
