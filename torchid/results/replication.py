"""Whether a cause is the same in every motion.

A cause fitted to all motions at once may be what one of them wanted. Each motion, or part of one,
is asked by which factor it wants the whole cause: 1 is as it was fitted, 0 not at all. The factors
of n parts vary by more than their standard deviations where the law is another from motion to
motion; that spread (DerSimonian and Laird 1986) widens the prediction of the next motion.
"""

import math
from collections.abc import Iterable, Sequence

import torch
from scipy.special import chdtrc

from torchid.results.agreement import MotionScale, Replication, RunValue, Verdict, by_cause
from torchid.results.cause import Cause
from torchid.results.record import Rows
from torchid.robot.knowledge import BETWEEN
from torchid.statistics.criteria import SAME_FACTOR, TELLING_STD
from torchid.typing import Bool, Tensor


def replication_of(scales: Sequence[MotionScale]) -> Replication | None:
    """The factors of all parts together; None where fewer than two can tell."""
    telling = [s for s in scales if s.std <= TELLING_STD]
    if len(telling) < 2:
        return None
    x, v = _factors(telling)
    mean, mean_std, spread = _merged(x, v)
    # Motions that are asked: all parts of a trajectory are one.
    runs = _by_run(scales)
    if len(runs) > 1:
        of_runs = torch.tensor(list(runs.values()), dtype=torch.float64)
        x, v = of_runs[of_runs[:, 1] <= TELLING_STD**2].unbind(1)
    # The same sign and nearly the size of all, as far as the part can tell.
    slack = 2 * v.sqrt()
    same = (x > 0) & (x + slack >= mean / SAME_FACTOR) & (x - slack <= SAME_FACTOR * mean)
    return Replication(
        motions=tuple(scales),
        mean=mean,
        spread=spread,
        next_std=math.hypot(mean_std, spread),
        repeats=int(same.sum()),
        asked=len(x),
    )


def agreement_of(causes: Iterable[Cause]) -> Rows[RunValue]:
    """What each run alone wants of each cause, and which runs contradict most of the others.

    Runs agree as far as their standard deviations, and what friction varies by from session to
    session (`BETWEEN`), explain their factors: Cochran's Q, whose level is shared by all causes.
    Where they do not, the run without which the others agree best is taken out, and another one,
    while most remain; where these do not agree, all runs differ.

    Args:
        causes: of which only what two runs or more can tell has rows.
    """
    asked = []
    for cause in causes:
        runs = {} if cause.replication is None else _by_run(cause.replication.motions)
        telling = {name: (x, v) for name, (x, v) in runs.items() if v <= TELLING_STD**2}
        known = [s for s in cause.sizes if s.std and s.determined and s.value != s.was]
        if known and len(telling) > 1:
            best = max(known, key=lambda s: abs(s.value) / (s.std or math.inf))
            asked.append((cause, best, runs, telling))
    rows = []
    for cause, size, runs, telling in asked:
        x, v = torch.tensor(list(telling.values()), dtype=torch.float64).unbind(1)
        # 0.05: share of logs whose runs agree of which it is said that they do not
        apart = dict(zip(telling, _apart(x, v, 0.05 / len(asked)).tolist(), strict=True))
        mean, mean_std, spread = _merged(x, v)
        # A factor is of what was found beside what was known before.
        was = size.was or 0.0
        change = size.value - was
        for run in runs:
            factor, variance = telling.get(run, (math.nan, math.nan))
            std = math.sqrt(variance)
            odd: Verdict = "differs" if apart.get(run) else "agrees"
            rows.append(
                RunValue(
                    effect=cause.effect, joints=cause.at, parameter=size.name, unit=size.unit,
                    run=run, value=was + factor * change, std=std * abs(change),
                    wanted=abs(factor) > 2 * math.hypot(BETWEEN, std) if run in telling else None,
                    verdict=odd if run in telling else "cannot tell", merged=was + mean * change,
                    merged_std=mean_std * abs(change), spread=spread * abs(change),
                )
            )  # fmt: skip
    return Rows(rows)


def of_few_runs(
    causes: Iterable[Cause],
) -> set[tuple[str, tuple[int, ...]]]:
    """Effects and joints of causes that some runs want while most want none of them."""
    out = set()
    for runs in by_cause(agreement_of(causes)):
        odd = [r.wanted for r in runs if r.verdict == "differs"]
        rest = [r.wanted for r in runs if r.verdict == "agrees"]
        if odd and rest and all(odd) and not any(rest):
            out.add((runs[0].effect, runs[0].joints))
    return out


def _apart(x: Tensor, v: Tensor, level: float) -> Bool[Tensor, " R"]:
    """Which runs contradict most of the others, by factors and their variances (R,)."""
    v = v + BETWEEN**2

    def agree(rows: Tensor) -> float:
        return float(chdtrc(max(len(rows) - 1, 1), float(_cochran(x[rows], v[rows]))))

    every = kept = torch.arange(len(x))
    while 2 * len(kept) > len(x) and agree(kept) < level:
        kept = max((kept[kept != k] for k in kept), key=agree)
    return ~torch.isin(every, kept if 2 * len(kept) > len(x) else every[:0])


def _by_run(scales: Sequence[MotionScale]) -> dict[str, tuple[float, float]]:
    """Factor and variance of all parts of each trajectory together."""
    out = {}
    for name in dict.fromkeys(s.trajectory for s in scales):
        x, v = _factors([s for s in scales if s.trajectory == name])
        weight = (1 / v).sum()
        out[name] = float((x / v).sum() / weight), float(1 / weight)
    return out


def _factors(scales: Sequence[MotionScale]) -> tuple[Tensor, Tensor]:
    """Factors and their variances (K,)."""
    x, std = torch.tensor([(s.scale, s.std) for s in scales], dtype=torch.float64).unbind(1)
    return x, std**2


def _merged(x: Tensor, variances: Tensor) -> tuple[float, float, float]:
    """Mean of n quantities, its standard deviation, and what they vary by beyond their own."""
    spread = excess_std(x, variances)
    w = 1 / (variances + spread**2)
    return float((w * x).sum() / w.sum()), float(w.sum()) ** -0.5, spread


def excess_std(x: Tensor, variances: Tensor) -> float:
    """Standard deviation of n quantities beyond their own (DerSimonian and Laird 1986, eq. 8)."""
    w = 1 / variances
    excess = _cochran(x, variances) - (len(x) - 1)
    return float((excess / (w.sum() - w.square().sum() / w.sum())).clamp(min=0).sqrt())


def _cochran(x: Tensor, variances: Tensor) -> Tensor:
    """Sum of the squares of n quantities about their mean, in units of their variances."""
    w = 1 / variances
    return (w * (x - (w * x).sum() / w.sum()).square()).sum()
