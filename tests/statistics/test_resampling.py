"""Draws of units, and intervals of shares and of draws."""

import numpy as np
import pytest
from scipy.stats import binomtest, norm

from torchid.statistics.proportion import clopper_pearson, wilson
from torchid.statistics.resampling import (
    bootstrap,
    bootstrap_weights,
    falling_share,
    nested_weights,
    percentile_interval,
)


def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def test_weights_count_the_draws_of_the_same_seed():
    chosen, weights = bootstrap(7, 50, rng()), bootstrap_weights(7, 50, rng())
    x = np.arange(7) ** 2
    assert weights @ x == pytest.approx(x[chosen].sum(1))
    assert set(weights.sum(1)) == {7.0}


def test_what_falls_in_all_units_falls_in_all_draws():
    weights = bootstrap_weights(30, 400, rng())
    falls = rng().standard_normal((30, 3)) * [0.1, 0.1, 1.0] + [1.0, -1.0, 0.0]
    always, never, half = falling_share(falls, weights)
    assert (always, never) == (1.0, 0.0)
    # Of what falls in some units the normal law of the mean says it.
    mean, std = falls[:, 2].mean(), falls[:, 2].std() / 30**0.5
    assert half == pytest.approx(norm.cdf(mean / std), abs=0.06)


def test_groups_are_drawn_with_their_units():
    """The variance of a mean: that of the groups' means, and of units within groups."""
    groups = np.repeat([4, 1, 7, 2], 6)
    x = np.array([0.0, 1.0, 3.0, 8.0])[np.repeat(range(4), 6)] + rng().standard_normal(24)
    weights = nested_weights(groups, 40_000, rng())
    assert weights.sum(1).min() == weights.sum(1).max() == 24
    parts = x.reshape(4, 6)
    expected = parts.mean(1).var() / 4 + parts.var(1).mean() / 24
    assert (weights @ x / 24).var() == pytest.approx(expected, rel=0.03)


def test_one_group_is_a_sample_of_its_units():
    assert (nested_weights(np.zeros(9), 30, rng()).sum(1) == 9).all()


def test_percentiles_of_what_is_defined():
    x = np.linspace(0, 1, 1001)
    assert percentile_interval(x) == pytest.approx((0.025, 0.975))
    assert percentile_interval(x, 0.5) == pytest.approx((0.25, 0.75))
    x[:90] = np.nan
    assert np.isfinite(percentile_interval(x)).all()
    x[:110] = np.nan
    assert np.isnan(percentile_interval(x)).all()
    assert np.isnan(percentile_interval(np.array([]))).all()


@pytest.mark.parametrize(("hits", "total"), [(0, 5), (5, 5), (3, 20), (97, 100)])
def test_shares_against_scipy(hits, total):
    test = binomtest(hits, total)
    for ours, name in ((wilson, "wilson"), (clopper_pearson, "exact")):
        expected = test.proportion_ci(0.9, name)
        assert ours(hits, total, 0.9) == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert wilson(0, 0) == clopper_pearson(0, 0) == (0.0, 1.0)
