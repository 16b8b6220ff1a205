"""Resampling of independent units (blocks, chains, cases): which units each draw holds.

Draws are indices, one row a draw, so that a statistic of many draws is one product of arrays.
Intervals are percentiles (Davison and Hinkley 1997, section 5.3).
"""

import numpy as np

Array = np.ndarray

LEVEL = 0.95
"""Of an interval, if nothing else is said."""


DRAWS = 1000
"""Samples of a bootstrap, where nothing else is said: ends of a 95 % interval then vary by 5 % of
its width."""


def bootstrap(units: int, draws: int, rng: np.random.Generator) -> Array:
    """Units (draws, units) of samples drawn with replacement, from 0."""
    return rng.integers(0, units, (draws, units))


def bootstrap_weights(units: int, draws: int, rng: np.random.Generator) -> Array:
    """How often (draws, units) each unit is in a sample drawn with replacement, as floats: a
    statistic that is a sum over units is this times the units' parts."""
    chosen = bootstrap(units, draws, rng) + units * np.arange(draws)[:, None]
    counts = np.bincount(chosen.ravel(), minlength=draws * units)
    return counts.reshape(draws, units).astype(float)


def nested_weights(groups: Array, draws: int, rng: np.random.Generator) -> Array:
    """How often (draws, units) each unit is in a sample of groups drawn with replacement, of whose
    units as many are drawn again: what a statistic may be of other groups (Davison and Hinkley
    1997, section 3.8).

    Args:
        groups: (units,) number of each unit's group.
        draws: of samples.
        rng: that draws them.
    """
    names, own = np.unique(groups, return_inverse=True)
    weights = bootstrap_weights(len(names), draws, rng)[:, own]
    for k in range(len(names)):
        weights[:, own == k] *= bootstrap_weights(int((own == k).sum()), draws, rng)
    return weights


def falling_share(falls: Array, weights: Array) -> Array:
    """Share of samples in which an error falls: how far data that were not fitted confirm what was
    found on others, whose probability is times that.

    Args:
        falls: (units, ...) by which the squared error of each unit falls.
        weights: (draws, units) how often each is in a sample.
    """
    return (weights @ falls > 0).mean(0)


def percentile_interval(values: Array, level: float = LEVEL) -> tuple[float, float]:
    """Two-sided percentile interval of a statistic's draws (D,); nan where fewer than nine in ten
    of the draws are finite."""
    defined = values[np.isfinite(values)]
    # 0.9: share of the draws in which a statistic must be defined for its interval to be given
    if len(defined) < max(1, 0.9 * len(values)):
        return float("nan"), float("nan")
    low, high = np.quantile(defined, tails(level))
    return float(low), float(high)


def tails(level: float = LEVEL) -> tuple[float, float]:
    """Quantiles at the ends of a two-sided interval."""
    return 0.5 * (1 - level), 0.5 * (1 + level)
