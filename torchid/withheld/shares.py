"""Shares, F1 and medians with 95 % intervals, as data; of nothing they are None."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from torchid.statistics.proportion import wilson
from torchid.statistics.resampling import bootstrap, percentile_interval
from torchid.withheld.measures import Counts, added, f1

DRAWS = 1000


def rate(flags: Iterable[bool]) -> dict[str, Any]:
    """A share with its interval; `share` is None of nothing."""
    known = list(flags)
    hits, total = sum(known), len(known)
    share = hits / total if total else None
    return {"hits": hits, "total": total, "share": share, "ci95": list(wilson(hits, total))}


def micro_f1(counts: Sequence[Counts]) -> dict[str, Any]:
    """F1 of all cases together, with an interval over cases; None of nothing."""
    if not counts:
        return {"f1": None, "ci95": None, "hits": 0, "extra": 0, "missed": 0, "cases": 0}
    table = np.array(counts)
    draws = table[_draws(len(table))].sum(1)
    values = [f1((int(h), int(e), int(m))) for h, e, m in draws]
    hits, extra, missed = added(counts)
    return {
        "f1": f1((hits, extra, missed)),
        "ci95": list(percentile_interval(np.array(values))),
        "hits": hits,
        "extra": extra,
        "missed": missed,
        "cases": len(counts),
    }


def median(values: Sequence[float]) -> dict[str, Any]:
    """A median with an interval over cases; None of nothing."""
    if not values:
        return {"median": None, "ci95": None, "cases": 0}
    drawn = np.median(np.array(values)[_draws(len(values))], axis=1)
    interval = list(percentile_interval(drawn))
    return {"median": float(np.median(values)), "ci95": interval, "cases": len(values)}


def _draws(count: int) -> np.ndarray:
    """Cases of each draw, the same in every score of as many cases."""
    return bootstrap(count, DRAWS, np.random.default_rng(0))
