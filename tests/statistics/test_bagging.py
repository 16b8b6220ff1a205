"""Probabilities averaged over drawn logs and powers of the likelihood."""

import torch

from torchid.statistics.bagging import DRAWN_SHARE, DRAWS, Draws


def blocks(count: int, length: int = 5) -> torch.Tensor:
    return torch.arange(count * length) // length


def test_draws_are_logs_of_half_as_many_blocks():
    draws = Draws.of(blocks(30), seed=3)
    assert draws.times.shape == (DRAWS, 30)
    assert draws.times.sum(1).tolist() == [round(DRAWN_SHARE * 30)] * DRAWS
    assert torch.equal(draws.times, Draws.of(blocks(30), seed=3).times)
    assert not torch.equal(draws.times, Draws.of(blocks(30), seed=4).times)


def test_sums_count_blocks_as_often_as_they_were_drawn():
    draws = Draws.of(blocks(8))
    x = torch.randn(2, 40, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    right = torch.stack([(x * times.repeat_interleave(5)).sum(1) for times in draws.times])
    torch.testing.assert_close(draws.sums(x), right)


def test_what_happened_once_is_in_every_log_by_half():
    """Block 3 of 8, in whose place are blocks of its own; all else is drawn as before."""
    draws, some = Draws.of(blocks(8, 16)), blocks(8, 16) == 3
    apart = draws.parting(some)
    within = apart.sums(some.double().unsqueeze(0))[:, 0]
    assert within.tolist() == [DRAWN_SHARE * 16] * DRAWS
    x = torch.where(some, 0.0, torch.arange(128.0).double()).unsqueeze(0)
    torch.testing.assert_close(apart.sums(x), draws.sums(x))
    halves = (torch.arange(128) % 16 < 8) & some
    assert len(apart.sums(halves.double().unsqueeze(0)).unique()) > 3
