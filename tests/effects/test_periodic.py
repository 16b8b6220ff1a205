"""The ripple's period and phase."""

import math

import pytest
import torch

from torchid.effects.base import Motion
from torchid.effects.periodic import Cogging


def ripple(q: torch.Tensor, k: float, values: list[float]) -> torch.Tensor:
    q = q.unsqueeze(-1)
    return Cogging(0, k=k).torque(Motion(q, q, q), values)


@pytest.mark.parametrize("k", [0.5, 12.0, 1000.0])
def test_it_repeats_after_a_period_and_flips_after_half(k: float) -> None:
    q, period = torch.linspace(-6, 6, 101, dtype=torch.float64), 2 * math.pi / k
    here = ripple(q, k, [0.3, -0.4])
    torch.testing.assert_close(ripple(q + period, k, [0.3, -0.4]), here, rtol=0, atol=1e-11)
    torch.testing.assert_close(ripple(q + period / 2, k, [0.3, -0.4]), -here, rtol=0, atol=1e-11)


def test_sine_and_cosine_make_any_phase() -> None:
    q = torch.linspace(0, 1, 50, dtype=torch.float64)
    expected = 0.5 * torch.cos(9 * q - 0.8)
    found = ripple(q, 9.0, [0.5 * math.sin(0.8), 0.5 * math.cos(0.8)])
    torch.testing.assert_close(found, expected, rtol=1e-13, atol=1e-13)
