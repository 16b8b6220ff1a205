"""Scores that only a benchmark has: how far a diagnosis closes the gap beside one that is told, whether
its intervals hold the truth, what is named for what, and from which size on it is seen."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from torchid.statistics.resampling import percentile_interval
from torchid_bench.report.withheld import LINES, Line
from torchid_bench.withheld.measures import drawn_cases, how_named, rate
from torchid_bench.withheld.score import Scored

NOTHING = {
    "no_gap": "(no gap)",
    "detected_unexplained": "(unexplained)",
    "not_testable": "(not testable)",
    "error": "(error)",
}
"""What the confusion matrix says where nothing was named."""


ALL_LINES = (
    *LINES,
    Line("gap closed, of the oracle's", ("closing", "ratio", "median"), low=0.97),
    Line("intervals hold the closed share", ("closed_coverage", "share"), 0.9, 0.98),
)
"""Of the score's table, with what stands beside it."""


def beside(
    cases: Sequence[Scored],
    oracle: Mapping[str, float | None] | None = None,
    truly_closed: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """The further scores of one method.

    Args:
        cases: its answers.
        oracle: per case the closed share of the diagnosis that was told the effect and the joint.
        truly_closed: per case the closed share of the corrected model without any noise.
    """
    of = defaultdict(list)
    for case in cases:
        of[case.kind].append(case)
    return {
        "closing": _closing(of["single"], oracle or {}),
        "closed_coverage": _closed_coverage(cases, truly_closed or {}),
        "confusion": confusion(of["single"]),
        "confusion_outside": confusion(of["outside"]),
        "detection": detection(of["severity"]),
    }


def closed_by(answers: Mapping[str, Mapping[str, Any]]) -> dict[str, float | None]:
    """Closed shares, by case."""
    return {case: (a.get("how_far") or {}).get("closed") for case, a in answers.items()}


def _closing(cases: Sequence[Scored], oracle: Mapping[str, float | None]) -> dict[str, Any]:
    """How much of what could be closed is; cases in which the oracle closes next to nothing are
    left out, and counted."""
    known = [(c, oracle[c.case]) for c in cases if c.case in oracle]
    # 0.1: share that the oracle closes, below which a ratio to it says nothing
    ratios = [c.closed / best for c, best in known if best is not None and best >= 0.1]
    return {
        "closed": median([c.closed for c in cases]),
        "oracle": median([best or 0.0 for _, best in known]),
        "ratio": median(ratios),
        "oracle_closes_nothing": len(known) - len(ratios),
    }


def _closed_coverage(cases: Sequence[Scored], truly_closed: Mapping[str, float]) -> dict[str, Any]:
    """Whether 95 % intervals hold the closed share without noise."""
    return rate(
        c.closed_ci95[0] <= truly_closed[c.case] <= c.closed_ci95[1]
        for c in cases
        if c.closed_ci95 is not None and c.case in truly_closed
    )


def median(values: Sequence[float]) -> dict[str, Any]:
    """A median with an interval over cases; None of nothing."""
    if not values:
        return {"median": None, "ci95": None, "cases": 0}
    drawn = np.median(np.array(values)[drawn_cases(len(values))], axis=1)
    interval = list(percentile_interval(drawn))
    return {"median": float(np.median(values)), "ci95": interval, "cases": len(values)}


def confusion(cases: Iterable[Scored]) -> dict[str, dict[str, int]]:
    """Planted -> first named -> cases."""
    out: dict[str, Counter[str]] = defaultdict(Counter)
    for case in cases:
        top = case.row.top
        said = NOTHING.get(case.row.status, "(nothing)") if top is None else top.name
        out[case.cause][said] += 1
    return {name: dict(out[name]) for name in sorted(out)}


def detection(cases: Sequence[Scored]) -> dict[str, list[dict[str, Any]]]:
    """Shares detected and named over the size asked for: of all effects, and by family."""
    groups = {"all effects": list(cases)} if cases else {}
    for name in sorted({c.row.planted[0].family for c in cases}):
        groups[name] = [c for c in cases if c.row.planted[0].family == name]
    return {name: _curve(some) for name, some in groups.items()}


def _curve(cases: Sequence[Scored]) -> list[dict[str, Any]]:
    out = []
    for level in sorted({c.level for c in cases if c.level is not None}):
        own = [c for c in cases if c.level == level]
        out.append(
            {
                "level": level,
                "size": float(np.median([c.row.planted[0].size for c in own])),
                "detected": rate(c.row.alarm for c in own),
                "named": rate(how_named(c.row).in_set for c in own),
            }
        )
    return out
