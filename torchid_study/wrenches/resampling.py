"""Statistics of clustered samples: rank correlation, effect sizes, and their bootstrap intervals.

Sets that come from one chain or one direction are not independent, so the bootstrap draws whole
clusters with replacement (Davison and Hinkley 1997, section 3.8). The intervals are percentiles.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy import stats

from torchid.results.record import Real
from torchid.statistics.resampling import Array, bootstrap, percentile_interval
from torchid.typing import Float, Tensor

Statistic = Callable[[Array], float]
"""Of the chosen samples' indices, repeats included; nan where it is not defined."""

LEAST_SETS = 5
"""Sets with a usable value that a class or a correlation needs."""
LEAST_CLUSTERS = 5
"""Clusters that an interval needs: with fewer, resampling shows little of the spread."""


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

    def __str__(self) -> str:
        """Value and interval."""
        if math.isnan(self.value):
            return "-"
        if math.isnan(self.low):
            return f"{self.value:.2f} (too few chains)"
        return f"{self.value:.2f} [{self.low:.2f}, {self.high:.2f}]"


NO_ESTIMATE = Estimate(float("nan"), float("nan"), float("nan"), 0)


@dataclass(frozen=True)
class Sample:
    """Errors of K sets, and which of them are independent.

    Attributes:
        errors: (K,).
        cluster: (K,) whole numbers.
        resamples: of the bootstrap.
        rng: source of randomness.
    """

    errors: Array
    cluster: Array
    resamples: int
    rng: np.random.Generator

    def estimate(self, statistic: Statistic, members: Sequence[Array]) -> Estimate:
        """A statistic of several groups of sets together, and its cluster-bootstrap interval.

        Args:
            statistic: of indices into the whole sample.
            members: the groups' indices. Clusters are drawn from all those that have a member in
                any group, so a cluster with members in two groups stays together. A group of fewer
                than `LEAST_SETS` gives no estimate, one of fewer than `LEAST_CLUSTERS` clusters no
                interval, which would rest on one or two of them.
        """
        if min(len(m) for m in members) < LEAST_SETS:
            return NO_ESTIMATE
        chosen = np.concatenate(list(members))
        scarce = min(len(np.unique(self.cluster[m])) for m in members) < LEAST_CLUSTERS
        names, which = np.unique(self.cluster[chosen], return_inverse=True)
        low = high = float("nan")
        with np.errstate(invalid="ignore"):
            value = statistic(chosen)
            if not scarce and np.isfinite(value):
                order = np.argsort(which, kind="stable")
                by_cluster = np.split(chosen[order], np.cumsum(np.bincount(which))[:-1])
                draws = bootstrap(len(names), self.resamples, self.rng)
                drawn = [statistic(np.concatenate([by_cluster[c] for c in d])) for d in draws]
                low, high = percentile_interval(np.array(drawn))
        return Estimate(value, low, high, len(names))

    def against(self, function: Callable[[Array, Array], float], a: Array, b: Array) -> Estimate:
        """A statistic of the errors of two groups, the first against the second."""
        inside = np.isin(np.arange(len(self.errors)), a)
        return self.estimate(
            lambda k: function(self.errors[k[inside[k]]], self.errors[k[~inside[k]]]), [a, b]
        )


def quartiles(values: Tensor) -> Tensor:
    """Lower quartile, median and upper quartile (..., 3) over the first axis of (K, ...)."""
    shares = values.new_tensor([0.25, 0.5, 0.75])
    return torch.quantile(values, shares, dim=0).movedim(0, -1)


def quartile_words(three: Float[Tensor, "3"]) -> str:
    """`4.9 (3.2 - 7.7)`: median and quartiles."""
    low, middle, high = three.tolist()
    return f"{middle:.3g} ({low:.3g} - {high:.3g})"


def spearman(x: Array, y: Array) -> float:
    """Spearman's rank correlation, ties at their mean rank; nan when one of them is constant."""
    with np.errstate(invalid="ignore"):
        return float(np.corrcoef(stats.rankdata(x), stats.rankdata(y))[0, 1])


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
    # 20_000: pairs that memory bears at once
    if len(a) * len(b) <= 20_000:
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
