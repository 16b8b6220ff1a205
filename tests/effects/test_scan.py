"""Scans along time against the plain loop."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from torchid.effects.scan import affine_scan

lengths = st.integers(0, 70)
seeds = st.integers(0, 10_000)
few = settings(max_examples=40)


def loop(step, x: Tensor, y: Tensor, initial: Tensor) -> Tensor:
    state, out = initial, []
    for k in range(x.shape[-2]):
        state = step(state, x[..., k, :], y[..., k, :])
        out.append(state)
    return torch.stack(out, -2) if out else torch.empty_like(x)


def affine(z: Tensor, a: Tensor, b: Tensor) -> Tensor:
    return a * z + b


@few
@given(length=lengths, seed=seeds)
def test_affine_scan_is_the_loop(length: int, seed: int) -> None:
    g = torch.Generator().manual_seed(seed)
    a = 2.2 * torch.rand(4, length, 3, generator=g, dtype=torch.float64) - 1.1
    a[0] = a[0].round()  # zeros forget, ones and minus ones keep
    b = torch.randn(4, length, 3, generator=g, dtype=torch.float64)
    z = torch.randn(4, 3, generator=g, dtype=torch.float64)
    torch.testing.assert_close(
        affine_scan(a, b, z), loop(affine, a, b, z), rtol=1e-12, atol=1e-12 * 1.1**length
    )


@pytest.mark.parametrize("length", [1, 2, 3, 8, 1000])
def test_long_and_short_sequences(length: int) -> None:
    a, b = torch.rand(length, 2, dtype=torch.float64), torch.randn(length, 2, dtype=torch.float64)
    z = torch.tensor([0.5, -2.0], dtype=torch.float64)
    torch.testing.assert_close(affine_scan(a, b, z), loop(affine, a, b, z), rtol=1e-12, atol=1e-12)


def test_a_mean_over_time_by_hand() -> None:
    """a = 1/2, b = 1 from 0: 1, 3/2, 7/4, .. -> 2."""
    found = affine_scan(
        torch.tensor(0.5, dtype=torch.float64),
        torch.ones(5, 1, dtype=torch.float64),
        torch.tensor(0.0, dtype=torch.float64),
    )
    assert found.flatten().tolist() == [1.0, 1.5, 1.75, 1.875, 1.9375]
