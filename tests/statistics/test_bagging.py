"""Probabilities averaged over drawn logs and powers of the likelihood."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchid.statistics.bagging import DRAWN_SHARE, DRAWS, POWERS, Draws, bagged


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
    torch.testing.assert_close(draws.as_it_is.sums(x), x.sum(1).unsqueeze(0))


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.floats(-200, 200), st.floats(-50, 50)), min_size=1, max_size=5),
    st.integers(0, 100),
)
def test_probabilities_add_up_to_one(alternatives: list[tuple[float, float]], seed: int):
    draws = Draws.of(blocks(10), seed)
    g = torch.Generator().manual_seed(seed)
    noise = torch.randn(DRAWS, generator=g, dtype=torch.float64)
    found = bagged([(gain + noise, odds) for gain, odds in alternatives], draws)
    assert len(found) == len(alternatives) + 1
    assert sum(found) == pytest.approx(1.0)
    assert all(0 <= p <= 1 for p in found)


def test_one_log_and_one_power_are_plain_odds():
    draws = Draws.of(blocks(10)).as_it_is
    found = bagged([(torch.tensor([-6.0]).double(), 2.0)], draws)
    assert found[0] == pytest.approx(1 / (1 + math.exp(-2.0)))


def test_what_half_of_the_draws_want_is_half_sure():
    """One log would be sure of either."""
    draws = Draws.of(blocks(10))
    gain = torch.where(torch.arange(DRAWS) % 2 == 0, 500.0, -500.0).double()
    assert bagged([(gain, 0.0)], draws)[0] == pytest.approx(0.5, abs=1e-6)


@given(st.floats(-100, 100))
@settings(deadline=None)
def test_powers_change_how_sure_and_not_what_is_likelier(rise: float):
    draws = Draws.of(blocks(10))
    # Half of it by the data, half beforehand.
    found = bagged([(torch.full((DRAWS,), rise / 2).double(), rise / 2)], draws)
    right = sum(1 / (1 + math.exp(0.5 * rise * p)) for p in POWERS) / len(POWERS)
    assert found[0] == pytest.approx(right)
    assert abs(rise) < 1e-9 or (found[0] > 0.5) == (rise < 0)


def test_odds_that_ask_nothing_of_the_data_are_the_same_at_every_power():
    draws = Draws.of(blocks(10))
    assert bagged([(None, 2 * math.log(1 / 9))], draws)[0] == pytest.approx(0.9)
    assert bagged([(None, -math.inf)], draws) == [1.0, 0.0]
