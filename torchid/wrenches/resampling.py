"""Statistics of clustered samples: rank correlation, effect sizes, and their bootstrap intervals.

Sets that come from one chain or one direction are not independent, so the bootstrap draws whole
clusters with replacement (Davison and Hinkley 1997, section 3.8). The intervals are percentiles.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from torchid.results.record import Real
from torchid.statistics.resampling import Array, bootstrap, percentile_interval

Statistic = Callable[[Array], float]
"""Of the chosen samples' indices, repeats included; nan where it is not defined."""

_PAIRS_AT_ONCE = 20_000


@dataclass(frozen=True)
class Estimate:
    """A statistic with its interval.

    Attributes:
        value: on the sample; nan when it is not defined there.
        low, high: 95 % bootstrap interval; nan when it cannot be given.
        clusters: independent units that the interval rests on.
    """

    value: Real
    low: Real
    high: Real
    clusters: int


NO_ESTIMATE = Estimate(float("nan"), float("nan"), float("nan"), 0)


def estimate(
    statistic: Statistic,
    members: Sequence[Array],
    cluster: Array,
    *,
    resamples: int,
    rng: np.random.Generator,
    least_clusters: int,
) -> Estimate:
    """A statistic of several groups of samples together, and its cluster-bootstrap interval.

    Args:
        statistic: of indices into the whole sample.
        members: the groups' indices. Clusters are drawn from all those that have a member in any
            group, so a cluster with members in two groups stays together.
        cluster: (K,) whole numbers.
        resamples: how many.
        rng: source of randomness.
        least_clusters: fewer give no interval.
    """
    chosen = np.concatenate(list(members)) if members else np.zeros(0, dtype=int)
    value = statistic(chosen)
    names, which = np.unique(cluster[chosen], return_inverse=True)
    count = len(names)
    if count < least_clusters or not np.isfinite(value):
        return Estimate(value, float("nan"), float("nan"), count)
    order = np.argsort(which, kind="stable")
    by_cluster = np.split(chosen[order], np.cumsum(np.bincount(which))[:-1])
    drawn = np.array(
        [
            statistic(np.concatenate([by_cluster[c] for c in draw]))
            for draw in bootstrap(count, resamples, rng)
        ]
    )
    low, high = percentile_interval(drawn)
    return Estimate(value, low, high, count)


def spearman(x: Array, y: Array) -> float:
    """Spearman's rank correlation, ties at their mean rank; nan when one of them is constant."""
    rx, ry = (stats.rankdata(v) for v in (x, y))
    rx, ry = rx - rx.mean(), ry - ry.mean()
    scale = float(np.sqrt((rx @ rx) * (ry @ ry)))
    return float(rx @ ry) / scale if scale > 0 else float("nan")


def cliffs_delta(a: Array, b: Array) -> float:
    """P(a > b) - P(a < b) over all pairs (Cliff 1993): 1 when all of a exceed all of b."""
    if len(a) == 0 or len(b) == 0:
        return float("nan")
    ordered = np.sort(b)
    below = np.searchsorted(ordered, a, side="left")
    above = len(b) - np.searchsorted(ordered, a, side="right")
    return float((below.sum() - above.sum()) / (len(a) * len(b)))


def hodges_lehmann_ratio(a: Array, b: Array) -> float:
    """How many times larger a is than b: the median of a_i / b_j over all pairs, which is the
    exponential of Hodges and Lehmann's (1963) shift of the logarithms. Positive values only."""
    if len(a) == 0 or len(b) == 0 or min(a.min(), b.min()) <= 0:
        return float("nan")
    x, y = np.sort(np.log(a)), np.sort(np.log(b))
    if len(a) * len(b) <= _PAIRS_AT_ONCE:
        return float(np.exp(np.median(np.subtract.outer(x, y))))
    return float(np.exp(_median_difference(x, y)))


def _median_difference(x: Array, y: Array) -> float:
    """Median of x_i - y_j of sorted x and y, by bisection on the number of pairs below a value:
    to 1e-12 of the range, without the pairs."""
    half = len(x) * len(y) / 2
    low, high = x[0] - y[-1], x[-1] - y[0]
    for _ in range(40):
        middle = (low + high) / 2
        # x_i - y_j <= middle for the y_j from x_i - middle on.
        if len(x) * len(y) - np.searchsorted(y, x - middle, side="left").sum() < half:
            low = middle
        else:
            high = middle
    return (low + high) / 2
