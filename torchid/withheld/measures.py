"""What one diagnosis got right, beside what was planted: pure functions of both."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from torchid.withheld.rows import Claim, Planted, Row

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
        exact: whether it is all that was named, at its place.
        set_size: names of the top claim; None without one.
    """

    top1: bool
    in_set: bool
    anywhere: bool
    family: bool
    exact: bool
    set_size: int | None


def named(row: Row) -> Named:
    """How the effect of a row with one was named."""
    (planted,) = row.planted
    top = row.top
    if top is None:
        return Named(False, False, False, False, False, None)
    return Named(
        top1=top.name == planted.name,
        in_set=planted.name in top.names,
        anywhere=any(planted.name in c.names for c in row.claims),
        family=top.family == planted.family,
        exact=len(row.claims) == 1
        and top.name == planted.name
        and sorted(top.place) == sorted(planted.place),
        set_size=len(top.names),
    )


def joint_counts(row: Row) -> Counts:
    """(hits, too many, missed) of the joints pointed at: those an effect is on, and where it is on
    the whole arm those whose torque it changes."""
    true = {j for p in row.planted for j in p.located}
    everywhere = any(not p.place for p in row.planted)
    said = {j for c in row.claims for j in _pointed_at(c, everywhere)}
    return len(true & said), len(said - true), len(true - said)


def _pointed_at(claim: Claim, everywhere: bool) -> Sequence[int]:
    """A link's inertia is felt by all joints below it: beside an effect of the whole arm, such as
    a payload, from which the last link's inertia cannot be told, those count."""
    if everywhere and claim.name == "link_inertia" and claim.place:
        return range(1, max(claim.place) + 1)
    return claim.place or claim.joints


def f1(counts: Counts) -> float:
    """2 hits / (2 hits + too many + missed); 1 where there is nothing to find and to say."""
    hits, extra, missed = counts
    total = 2 * hits + extra + missed
    return 2 * hits / total if total else 1.0


def added(counts: Iterable[Counts]) -> Counts:
    """Sums, for micro-averages."""
    every = [*counts, (0, 0, 0)]
    hits, extra, missed = (sum(column) for column in zip(*every, strict=True))
    return hits, extra, missed


def matched(row: Row, strict: bool) -> Counts:
    """(hits, too many, missed) of (effect, joint), each claim for one planted effect at most.

    Args:
        row: any.
        strict: whether name and place must be the same; else the name may be among a claim's
            alternatives, on a common joint or where one of them is on the whole arm.
    """
    fits = [[_fits(p, c, strict) for c in row.claims] for p in row.planted]
    hits = largest_matching(fits)
    return hits, len(row.claims) - hits, len(row.planted) - hits


def _fits(planted: Planted, claim: Claim, strict: bool) -> bool:
    here, there = set(planted.place), set(claim.place)
    if strict:
        return planted.name == claim.name and here == there
    same = not here or not there or bool(here & there)
    return planted.name in claim.names and same


def largest_matching(fits: Sequence[Sequence[bool]]) -> int:
    """Most pairs (i, j) with fits[i][j], each i and each j in one pair (augmenting paths)."""
    owner: dict[int, int] = {}

    def place(i: int, seen: set[int]) -> bool:
        for j, good in enumerate(fits[i]):
            if good and j not in seen:
                seen.add(j)
                if j not in owner or place(owner[j], seen):
                    owner[j] = i
                    return True
        return False

    return sum(place(i, set()) for i in range(len(fits)))


def verdict(row: Row, families: Mapping[str, str], *, every: bool) -> Verdict:
    """What is said of a cause that the library lacks.

    `right_family`: what is named is acceptable or of the planted family; `hedged`: something else
    is, an acceptable one among the alternatives; `confident_wrong`: something else, for sure;
    `missed`: nothing is said to be there.

    Args:
        row: with one planted effect or more.
        families: family of every effect.
        every: whether one wrong claim is enough; else the top one speaks for all.
    """
    if row.status in ("detected_unexplained", "not_testable"):
        return row.status  # type: ignore[return-value]
    if not row.claims:
        return "missed"
    judged = row.claims if every else row.claims[:1]
    ranks = [_rank(row.planted, claim, families) for claim in judged]
    return max(ranks, key=("right_family", "hedged", "confident_wrong").index)


def _rank(planted: Sequence[Planted], claim: Claim, families: Mapping[str, str]) -> Verdict:
    if any(p.allows(claim.name, claim.family) for p in planted):
        return "right_family"
    hedged = any(p.allows(n, families.get(n)) for p in planted for n in claim.ambiguous)
    return "hedged" if hedged else "confident_wrong"


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
        listed = bool(row.planted) and all(_listed(p, row) for p in row.planted)
        return "not_testable" if listed else "missed"
    true = {p.name for p in row.planted}
    if all(true & claim.names for claim in row.claims):
        alone = all(len(claim.names) == 1 for claim in row.claims)
        return "right" if alone else "hedged"
    return "confident_wrong"


def _listed(planted: Planted, row: Row) -> bool:
    """Whether an effect is said to be invisible, at one of its joints."""
    places = {joint for name, joint in row.not_testable if name == planted.name}
    return bool(places & {None, *planted.place}) if planted.place else bool(places)


def inside(value: float, std: float, true: float, z: float = 1.96) -> bool:
    """Whether an interval holds the truth."""
    return abs(value - true) <= z * std


def coefficient_coverage(row: Row) -> list[bool]:
    """Whether 95 % intervals hold the true coefficients, for an effect found by name and place."""
    if len(row.planted) != 1:
        return []
    (planted,) = row.planted
    same = [
        c for c in row.claims if c.name == planted.name and sorted(c.place) == sorted(planted.place)
    ]
    if len(same) != 1:
        return []
    return [
        inside(*same[0].coefficients[name], true)
        for name, true in planted.coefficients.items()
        if name in same[0].coefficients
    ]
