"""What one diagnosis got right, beside what was planted: pure functions of both.

Shares, F1 and medians come with 95 % intervals, as data; of nothing they are None.
"""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

from torchid.effects.registry import KINDS
from torchid.statistics.proportion import HALF_95, wilson
from torchid.statistics.resampling import bootstrap, percentile_interval
from torchid_bench.withheld.rows import Claim, Planted, Row

Counts = tuple[int, int, int]
"""(hits, too many, missed)."""

Verdict = Literal[
    "right_family", "hedged", "detected_unexplained", "confident_wrong", "missed", "not_testable"
]


@dataclass(frozen=True)
class Named:
    """How one planted effect was named.

    Attributes:
        top1: whether the top claim has its name.
        in_set: whether it is among the top claim's names.
        anywhere: whether it is among any claim's names.
        family: whether the top claim is of its family.
        branch: whether a claim of its branch of the tree of causes is at its place: of friction,
            whichever detail of the joint's law is named.
        exact: whether it is all that was named, at its place.
        set_size: names of the top claim; None without one.
    """

    top1: bool
    in_set: bool
    anywhere: bool
    family: bool
    branch: bool
    exact: bool
    set_size: int | None


def how_named(row: Row) -> Named:
    """How the effect of a row with one was named."""
    (planted,) = row.planted
    top = row.top
    if top is None:
        return Named(False, False, False, False, False, False, None)
    return Named(
        top1=top.name == planted.name,
        in_set=planted.name in top.names,
        anywhere=any(planted.name in c.names for c in row.claims),
        family=top.family == planted.family,
        branch=any(_same_branch(planted, c) for c in row.claims),
        exact=len(row.claims) == 1
        and top.name == planted.name
        and sorted(top.place) == sorted(planted.place),
        set_size=len(top.names),
    )


def _same_branch(planted: Planted, claim: Claim) -> bool:
    """Whether a claim is of a cause's branch, at its place."""
    branches = {BRANCH_OF.get(name, name) for name in (planted.name, claim.name)}
    return len(branches) == 1 and claim.near(planted)


def joint_counts(row: Row) -> Counts:
    """(hits, too many, missed) of the joints pointed at: those an effect is on, and where it is on
    the whole arm those whose torque it changes."""
    true = {j for p in row.planted for j in p.located}
    everywhere = any(not p.place for p in row.planted)
    said: set[int] = set()
    for c in row.claims:
        # A link's inertia is felt by all joints below it: beside an effect of the whole arm, such
        # as a payload, from which the last link's inertia cannot be told, those count.
        all_below = everywhere and c.name == "link_inertia" and c.place
        said |= set(range(1, max(c.place) + 1) if all_below else c.place or c.joints)
    return len(true & said), len(said - true), len(true - said)


def f1(counts: Counts) -> float:
    """2 hits / (2 hits + too many + missed); 1 where there is nothing to find and to say."""
    hits, extra, missed = counts
    total = 2 * hits + extra + missed
    return 2 * hits / total if total else 1.0


def added_counts(counts: Iterable[Counts]) -> Counts:
    """Sums, for micro-averages."""
    every = [*counts, (0, 0, 0)]
    hits, extra, missed = (sum(column) for column in zip(*every, strict=True))
    return hits, extra, missed


def matching_counts(row: Row, strict: bool) -> Counts:
    """(hits, too many, missed) of (effect, joint), each claim for one planted effect at most.

    Args:
        row: any.
        strict: whether name and place must be the same; else the name may be among a claim's
            alternatives, on a common joint or where one of them is on the whole arm.
    """

    def fits(planted: Planted, claim: Claim) -> bool:
        if strict:
            return planted.name == claim.name and set(planted.place) == set(claim.place)
        return planted.name in claim.names and claim.near(planted)

    hits = largest_matching([[fits(p, c) for c in row.claims] for p in row.planted])
    return hits, len(row.claims) - hits, len(row.planted) - hits


def largest_matching(fits: Sequence[Sequence[bool]]) -> int:
    """Most pairs (i, j) with fits[i][j], each i and each j in one pair."""
    if not fits or not fits[0]:
        return 0
    table = np.array(fits)
    return int(table[linear_sum_assignment(table, maximize=True)].sum())


def verdict(row: Row, *, every: bool) -> Verdict:
    """What is said of a cause that the library lacks.

    `right_family`: what is named is acceptable or of the planted family; `hedged`: something else
    is, an acceptable one among the alternatives, or it is said not to be all; `confident_wrong`:
    something else, for sure; `missed`: nothing is said to be there.

    Args:
        row: with one planted effect or more.
        every: whether one wrong claim is enough; else the top one speaks for all.
    """
    if row.status in ("detected_unexplained", "not_testable"):
        return row.status  # type: ignore[return-value]
    if not row.claims:
        return "missed"
    judged = row.claims if every else row.claims[:1]
    worst: Verdict = "right_family"
    for claim in judged:
        if any(p.allows(claim.name, claim.family) for p in row.planted):
            continue
        among = any(p.allows(n, row.families.get(n)) for p in row.planted for n in claim.ambiguous)
        # An answer that says that there is more than it names is not sure.
        if not among and row.status != "partly_explained":
            return "confident_wrong"
        worst = "hedged"
    return worst


PoorVerdict = Literal["not_testable", "hedged", "right", "confident_wrong", "missed"]


def poor_verdict(row: Row) -> PoorVerdict:
    """What is said of a log that excites too little.

    `not_testable`: by its status, or the planted effect is listed as invisible and nothing is
    named; `hedged`: unexplained, or the planted effect is one of several names; `right`: its name
    alone; `missed`: no gap, without a word that it could not have been seen.
    """
    if row.status == "not_testable":
        return "not_testable"
    if row.status == "detected_unexplained":
        return "hedged"
    if not row.claims:
        # Whether every effect is said to be invisible, at one of its joints.
        listed = []
        for p in row.planted:
            places = {joint for name, joint in row.not_testable if name == p.name}
            listed.append(bool(places & {None, *p.place} if p.place else places))
        return "not_testable" if listed and all(listed) else "missed"
    true = {p.name for p in row.planted}
    if all(true & claim.names for claim in row.claims):
        alone = all(len(claim.names) == 1 for claim in row.claims)
        return "right" if alone else "hedged"
    return "confident_wrong"


def coefficient_errors(row: Row) -> list[float]:
    """Errors of coefficients in their standard deviations, for effects found by name and place."""
    errors = []
    for planted in row.planted:
        here = sorted(planted.place)
        same = [c for c in row.claims if c.name == planted.name and sorted(c.place) == here]
        if len(same) == 1:
            known = same[0].coefficients
            pairs = ((*known[n], x) for n, x in planted.coefficients.items() if n in known)
            errors += [abs(value - true) / max(std, 1e-300) for value, std, true in pairs]
    return errors


def coefficient_coverage(row: Row) -> list[bool]:
    """Whether 95 % intervals hold the true coefficients, of a case with one effect."""
    return [e <= HALF_95 for e in coefficient_errors(row)] if len(row.planted) == 1 else []


def stated_probabilities(row: Row) -> list[tuple[float, bool]]:
    """The probability that each name was given with, and whether the effect is there."""
    return [
        (
            c.how_sure,
            any(
                p.name == c.name and (not p.place or bool(set(p.place) & set(c.place or c.joints)))
                for p in row.planted
            ),
        )
        for c in row.claims
        if c.how_sure is not None
    ]


SURENESS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Ends of the ranges of probabilities that are compared with shares."""


def reliability(pairs: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """How often names are right that were given with probabilities alike, and the mean square of
    probability less truth (Brier 1950); None of nothing."""
    curve = []
    for low, high in itertools.pairwise(SURENESS):
        own = [(p, right) for p, right in pairs if low < p <= high]
        if own:
            mean = sum(p for p, _ in own) / len(own)
            curve.append({"from": low, "to": high, "mean": mean, **rate(r for _, r in own)})
    brier = sum((p - right) ** 2 for p, right in pairs) / len(pairs) if pairs else None
    return {"brier": brier, "names": len(pairs), "curve": curve}


BRANCH_OF = {name: kind.branch for name, kind in KINDS.items()}
"""Of every effect of torques."""

DRAWS = 1000
"""Of the bootstrap over cases."""


def rate(flags: Iterable[bool]) -> dict[str, Any]:
    """A share with its interval; `share` is None of nothing."""
    known = list(flags)
    hits, total = sum(known), len(known)
    share = hits / total if total else None
    return {"hits": hits, "total": total, "share": share, "ci95": list(wilson(hits, total))}


def micro_f1(counts: Sequence[Counts]) -> dict[str, Any]:
    """F1 of all cases together, with an interval over cases; None of nothing."""
    total, value, interval = added_counts(counts), None, None
    if counts:
        draws = np.array(counts)[drawn_cases(len(counts))].sum(1).tolist()
        interval = list(percentile_interval(np.array([f1((h, e, m)) for h, e, m in draws])))
        value = f1(total)
    numbers = dict(zip(("hits", "extra", "missed"), total, strict=True))
    return {"f1": value, "ci95": interval, **numbers, "cases": len(counts)}


def drawn_cases(count: int) -> np.ndarray:
    """Cases of each draw, the same in every score of as many cases."""
    return bootstrap(count, DRAWS, np.random.default_rng(0))
