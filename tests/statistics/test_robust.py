"""Scales that a few wild samples do not move."""

import pytest
import torch

from torchid.statistics.robust import column_quantile, white_variance


@pytest.mark.parametrize("samples", [1, 2, 5, 1001])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.9, 0.99, 1.0])
def test_a_quantile_is_that_of_torch_to_the_bit(samples, share) -> None:
    g = torch.Generator().manual_seed(samples)
    x = torch.randn(samples, 4, generator=g, dtype=torch.float64)
    assert torch.equal(column_quantile(x, share), torch.quantile(x, share, dim=0))
    x[0, 1] = torch.nan
    assert column_quantile(x, share).isnan().tolist() == [False, True, False, False]


def test_white_noise_is_told_from_what_changes_slowly() -> None:
    g, t = torch.Generator().manual_seed(3), torch.linspace(0, 20, 4000, dtype=torch.float64)
    std = torch.tensor([1e-3, 0.2], dtype=torch.float64)
    slow = torch.stack([torch.sin(3 * t), 40 * t], 1)
    noisy = slow + std * torch.randn(4000, 2, generator=g, dtype=torch.float64)
    torch.testing.assert_close(white_variance([noisy]).sqrt(), std, rtol=0.05, atol=0)
    halves = white_variance([noisy[:2000], noisy[2000:]]).sqrt()
    torch.testing.assert_close(halves, std, rtol=0.05, atol=0)
    assert white_variance([noisy[:3]]).tolist() == [0.0, 0.0]
