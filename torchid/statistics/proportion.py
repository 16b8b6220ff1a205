"""Half widths of normal intervals, and intervals of a share, from how many of how many."""

import math

from scipy.special import betaincinv, ndtri

HALF_95 = 1.96
"""Standard deviations in half of a 95 % interval of a normal variable."""

HALF_90 = 1.645
"""The same of a 90 % interval."""


def wilson(hits: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Two-sided interval of a share that holds the level on average over shares (Wilson 1927);
    (0, 1) where nothing was tried."""
    if total == 0:
        return 0.0, 1.0
    z = float(ndtri(0.5 + level / 2))
    p, zz = hits / total, z * z
    middle = (p + zz / (2 * total)) / (1 + zz / total)
    half = z / (1 + zz / total) * math.sqrt(p * (1 - p) / total + zz / (4 * total**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def clopper_pearson(hits: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Two-sided interval of a share that holds at least the level whatever the share (Clopper and
    Pearson 1934); (0, 1) where nothing was tried."""
    tail = 0.5 * (1 - level)
    low = 0.0 if hits == 0 else float(betaincinv(hits, total - hits + 1, tail))
    high = 1.0 if hits == total else float(betaincinv(hits + 1, total - hits, 1 - tail))
    return low, high
