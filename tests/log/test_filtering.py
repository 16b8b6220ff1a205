"""The zero-phase filter against scipy's, decimated or not, whole or in chunks."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, sosfiltfilt

from torchid.errors import LogError
from torchid.log.filtering import ORDER, ZeroPhaseFilter, central_difference, extended


def noise(*shape: int, seed: int = 0) -> torch.Tensor:
    """Smooth motion with an offset, and white noise."""
    generator = torch.Generator().manual_seed(seed)
    t = torch.linspace(0, 7, shape[-1], dtype=torch.float64)
    white = torch.randn(shape, generator=generator, dtype=torch.float64)
    return 3 + 2 * torch.sin(t) + 0.3 * white


def scipy_filtered(x: torch.Tensor, rate: float, cutoff: float, pad: int) -> torch.Tensor:
    """A one-way filter whose amplitude at `cutoff` is 1/sqrt(2), run both ways."""
    sos = butter(ORDER, cutoff, fs=rate, output="sos")
    return torch.from_numpy(sosfiltfilt(sos, x.numpy(), padlen=pad).copy())


def relative(a: torch.Tensor, b: torch.Tensor) -> float:
    return float((a - b).abs().max() / b.abs().max())


CASES = [(1000.0, 8.0, 9000), (1000.0, 20.0, 4001), (100.0, 2.0, 2753), (50.0, 8.0, 1001)]


@pytest.mark.parametrize(("rate", "cutoff", "samples"), CASES)
def test_it_is_scipys_filter(rate, cutoff, samples):
    x = noise(2, samples)
    low_pass = ZeroPhaseFilter(rate, cutoff)
    got = low_pass.apply(x)
    expected = scipy_filtered(x, rate, cutoff, min(low_pass.tail, samples - 1))
    assert got.shape == x.shape
    assert relative(got, expected) < 1e-6
    inner = slice(low_pass.tail // 2, samples - low_pass.tail // 2)
    assert relative(got[:, inner], expected[:, inner]) < 1e-9


def test_rounding_of_the_rate_changes_no_step():
    """Or trajectories of one log would weigh differently."""
    for rate, cutoff in ((100.0, 5.0), (1000.0, 20.0), (500.0, 10.0)):
        steps = {ZeroPhaseFilter(r, cutoff).largest_step for r in (rate, rate * (1 - 1e-12))}
        assert steps == {int(rate / (10 * cutoff))}


@pytest.mark.parametrize("samples", [2, 5, 23, 50, 51, 150])
def test_signals_shorter_than_the_tail(samples):
    """Nothing to settle on but the ends: no drift of a constant, and scipy's answer from two
    periods on (shorter, its backward pass starts from the forward pass's transient)."""
    low_pass = ZeroPhaseFilter(100.0, 5.0)
    assert samples < low_pass.tail
    x = noise(3, samples)
    if samples > 40:
        assert relative(low_pass.apply(x), scipy_filtered(x, 100.0, 5.0, samples - 1)) < 1e-3
    constant = torch.full((samples,), 7.0, dtype=torch.float64)
    assert torch.allclose(low_pass.apply(constant), constant, rtol=1e-8)


def test_gains_at_zero_the_cutoff_and_beyond():
    rate, cutoff = 400.0, 10.0
    low_pass = ZeroPhaseFilter(rate, cutoff)
    f = torch.tensor([0.0, cutoff, rate / 2], dtype=torch.float64)
    assert torch.allclose(low_pass.response(f), torch.tensor([1.0, 0.5, 0.0], dtype=torch.float64))
    t = torch.arange(8000, dtype=torch.float64) / rate
    middle = slice(2000, 6000)
    for frequency, gain in ((0.5, 1.0), (cutoff, 0.5), (5 * cutoff, 0.0)):
        x = torch.sin(2 * math.pi * frequency * t)
        y = low_pass.apply(x)
        assert torch.allclose(y[middle], gain * x[middle], atol=2e-6), "zero phase, known gain"


@given(
    rate=st.sampled_from([50.0, 100.0, 997.0]),
    ratio=st.floats(12.0, 120.0),
    step_share=st.floats(0.0, 1.0),
    start=st.integers(0, 400),
    samples=st.integers(1, 600),
    extra=st.integers(0, 40),
)
@settings(max_examples=60, derandomize=True)
def test_decimated_is_filtered_then_sliced(rate, ratio, step_share, start, samples, extra):
    low_pass = ZeroPhaseFilter(rate, rate / ratio)
    step = 1 + round(step_share * (low_pass.largest_step - 1))
    before, after = low_pass.tail + start, low_pass.tail + extra
    x = noise(2, before + samples + after, seed=samples)
    got = low_pass.decimated(x, step, before, before + samples)
    whole = low_pass.apply(x)[:, before : before + samples : step]
    assert got.shape == whole.shape
    assert relative(got, whole) < 5e-6


@pytest.mark.parametrize("piece", [96, 250, 1000, 5000])
def test_chunks_with_tails_agree_with_the_whole(piece):
    low_pass = ZeroPhaseFilter(200.0, 6.0)
    x = noise(2, 2500)
    tail = low_pass.tail
    chunks = []
    for start in range(0, x.shape[-1], piece):
        stop = min(start + piece, x.shape[-1])
        lo, hi = max(0, start - tail), min(x.shape[-1], stop + tail)
        wide = extended(x[:, lo:hi], tail - (start - lo), tail - (hi - stop))
        chunks.append(low_pass.decimated(wide, 1, tail, tail + stop - start))
    assert relative(torch.cat(chunks, -1), low_pass.apply(x)) < 1e-7


@pytest.mark.parametrize("cutoff", [0.0, -3.0, 50.0, 51.0, math.nan])
def test_a_cutoff_out_of_band_is_refused(cutoff):
    with pytest.raises(LogError, match="outside the log's band"):
        ZeroPhaseFilter(100.0, cutoff)


def test_reflection_is_odd_and_goes_on_by_the_last_value_of_short_signals():
    x = torch.tensor([[1.0, 2.0, 4.0, 8.0]], dtype=torch.float64)
    assert extended(x, 2, 3).tolist() == [[-2.0, 0.0, 1.0, 2.0, 4.0, 8.0, 12.0, 14.0, 15.0]]
    assert torch.equal(extended(x, 0, 0), x)
    assert extended(x, 0, 4).tolist() == [[1.0, 2.0, 4.0, 8.0, 12.0, 14.0, 15.0, 15.0]]
    assert extended(x, 5, 1).tolist() == [[-6.0, -6.0, -6.0, -2.0, 0.0, 1.0, 2.0, 4.0, 8.0, 12.0]]


@given(samples=st.integers(5, 60), rate=st.floats(1.0, 1000.0), seed=st.integers(0, 99))
@settings(max_examples=40, derandomize=True)
def test_central_difference_is_exact_on_quartics(samples, rate, seed):
    """Five points: exact up to degree 4 inside; three points, degree 2, next to the ends."""
    t = torch.arange(samples, dtype=torch.float64) / samples
    degree4, degree2 = (noise(k, 1, seed=seed).flatten() for k in (5, 3))
    for coefficients, inside in ((degree4, slice(2, -2)), (degree2, slice(1, -1))):
        polynomial = np.polynomial.Polynomial(coefficients.numpy())
        got = central_difference(torch.from_numpy(polynomial(t.numpy())), float(samples))
        expected = torch.from_numpy(polynomial.deriv()(t.numpy()))
        assert torch.allclose(got[inside], expected[inside], rtol=1e-7, atol=1e-9)


@given(samples=st.integers(2, 60), rate=st.floats(1.0, 1000.0), seed=st.integers(0, 99))
@settings(max_examples=20, derandomize=True)
def test_central_difference_at_the_ends_is_numpys_gradient(samples, rate, seed):
    x = noise(2, samples, seed=seed)
    expected = torch.from_numpy(np.gradient(x.numpy(), 1 / rate, axis=-1))
    got = central_difference(x, rate)
    for rows in (slice(None, 2), slice(-2, None)) if samples > 4 else (slice(None),):
        if samples != 5 or rows == slice(None):
            assert torch.allclose(got[:, rows], expected[:, rows], rtol=1e-9, atol=1e-9)


def test_central_difference_of_a_fast_sine():
    """At a tenth of the sampling rate five points err by 0.5 %, three by 6.5 %."""
    t = torch.arange(400, dtype=torch.float64) / 100
    got = central_difference(torch.sin(2 * torch.pi * 10 * t), 100.0)
    expected = 2 * torch.pi * 10 * torch.cos(2 * torch.pi * 10 * t)
    assert float((got - expected)[2:-2].abs().max() / expected.abs().max()) < 0.006


def test_gradients_pass_through():
    x = noise(200).requires_grad_()
    ZeroPhaseFilter(100.0, 4.0).apply(x).square().sum().backward()
    assert bool(torch.isfinite(x.grad).all())
