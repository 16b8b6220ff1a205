"""Scales that a few wild samples do not move."""

import pytest
import torch

from torchid.statistics.robust import column_quantile


@pytest.mark.parametrize("samples", [1, 2, 5, 1001])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.9, 0.99, 1.0])
def test_a_quantile_is_that_of_torch_to_the_bit(samples, share) -> None:
    g = torch.Generator().manual_seed(samples)
    x = torch.randn(samples, 4, generator=g, dtype=torch.float64)
    assert torch.equal(column_quantile(x, share), torch.quantile(x, share, dim=0))
    x[0, 1] = torch.nan
    assert column_quantile(x, share).isnan().tolist() == [False, True, False, False]
