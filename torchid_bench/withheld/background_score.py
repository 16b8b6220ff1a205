"""Scores of sets with a background: whether what can be known is named, and what is named for the
background.

A claim is new unless the answer says that the model lacked it on the earlier log already. Names of
planted effects are right at their joints; where they are on the whole arm, anywhere.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

from torchid.effects.registry import FAMILIES
from torchid.json_data import plain
from torchid_bench.withheld.decidable import Classes
from torchid_bench.withheld.measures import coefficient_errors, rate
from torchid_bench.withheld.plant import background, servo_background
from torchid_bench.withheld.rows import Claim, Planted, Row
from torchid_bench.withheld.run import UNANSWERED
from torchid_bench.withheld.score import Scored, scored_case

WAYS = ("in_practice", "ideally")
"""In which the oracle is asked."""

SURE, LIKELY = 0.9, 0.5
"""Probabilities of a name itself from which on it is sure, and likelier than not."""


def background_scores(
    keys: Sequence[Mapping[str, Any]],
    answers: Mapping[str, Mapping[str, Any]],
    classes: Classes,
) -> dict[str, Any]:
    """Scores of a set's answers.

    Args:
        keys: opened, in order; cases without an answer are left out.
        answers: by case.
        classes: of the planted effects, by the oracle.
    """
    known = [(scored_case(key, answers[key["id"]]), bool(key["earlier"]))
             for key in keys if key["id"] in answers]  # fmt: skip
    answered = [(c, earlier) for c, earlier in known if c.row.status not in UNANSWERED]
    sure = [(c, earlier, x) for c, earlier in answered for x in new(c.row) if _own(x) >= SURE]
    wrong = [[_own(x) for x in new(c.row) if _false(c.row, x, earlier)] for c, earlier in answered]
    nothing = [
        (c.row, max(own, default=0.0))
        for (c, _), own in zip(answered, wrong, strict=True)
        if c.kind == "none"
    ]
    errors = [z for c, _ in answered for z in _errors(c.row)]
    return plain({
        "classes": {how: dict(_classes(classes, how)) for how in WAYS},
        # Decidable effects that are named: first, first of what is no small thing that is there,
        # and in the set of one of these.
        "first": {how: _decidable(known, classes, how) for how in WAYS},
        # Of names that are sure: right ones, and those that are not false.
        "sure": rate(right(c.row, x) for c, _, x in sure),
        "sure_or_there": rate(not _false(c.row, x, earlier) for c, earlier, x in sure),
        "cases_with_false_sure": rate(max(own, default=0.0) >= SURE for own in wrong),
        # Of arms without an effect: whether something else is named, or an error is unexplained.
        "nothing": {
            "likely": rate(own > LIKELY for _, own in nothing),
            "sure": rate(own >= SURE for _, own in nothing),
            "unexplained": rate(row.status == "detected_unexplained" for row, _ in nothing),
        },
        "outside": rate(_honest(c.row, earlier) for c, earlier in answered if c.kind == "outside"),
        # Of effects named at their joints, but for those of which the arm has some in any case:
        # whether a number is within so many deviations.
        "within": {f"{z:g}": rate(e <= z for e in errors) for z in (1.0, 1.96)},
        "names_a_case": sum(len(c.row.claims) for c, _ in answered) / max(len(answered), 1),
    })  # fmt: skip


def new(row: Row) -> list[Claim]:
    """Claims that are new, or may be."""
    return [claim for claim in row.claims if claim.new]


def right(row: Row, claim: Claim) -> bool:
    """Whether a claim names something that was planted, at its joint."""
    return any(_names(p, claim) for p in row.planted)


def _names(planted: Planted, claim: Claim, *, in_set: bool = False) -> bool:
    names = claim.names if in_set else {claim.name}
    family = {claim.family} if planted.family == "outside" else set()
    right = (planted.name, *planted.acceptable)
    return claim.near(planted) and not (names | family).isdisjoint(right)


def _own(claim: Claim) -> float:
    return claim.own or 0.0


def _errors(row: Row) -> list[float]:
    """Errors of numbers of effects that the background has none of."""
    small = _of(row).NAMES
    alone = tuple(p for p in row.planted if p.name not in small)
    return coefficient_errors(Row(row.status, alone, row.claims))


def _honest(row: Row, earlier: bool) -> bool:
    """Whether an answer on what no library has says so, or names what is alike, and nothing else
    for sure."""
    claims = new(row)
    if any(_own(x) >= SURE and _false(row, x, earlier) for x in claims):
        return False
    said = row.status in ("detected_unexplained", "partly_explained")
    return said or any(_names(p, x, in_set=True) for p in row.planted for x in claims)


def _of(row: Row) -> ModuleType:
    """Background of torques or of servos."""
    return background if row.families is FAMILIES else servo_background


def _small(row: Row, claim: Claim) -> bool:
    """Whether a claim names a small thing that every arm has, of torques or of servos."""
    return claim.name in _of(row).NAMES


def _false(row: Row, claim: Claim, earlier: bool) -> bool:
    """Whether a new claim is wrong: it names nothing that was planted, nor, where no earlier log
    tells what was there, a small thing."""
    return not right(row, claim) and (earlier or not _small(row, claim))


def _decidable(cases: Sequence[tuple[Scored, bool]], classes: Classes, how: str) -> dict[str, Any]:
    """Of each decidable effect whether it is named; of two effects there are two first names."""
    out: dict[str, list[bool]] = {"strictly": [], "beside_small": [], "in_set": []}
    for case, earlier in cases:
        row, count = case.row, len(case.row.planted)
        every = new(row)
        first = [x for x in every if right(row, x) or _false(row, x, earlier)][:count]
        for planted, known in zip(row.planted, classes.get(case.case, ()), strict=True):
            # What no library has can be told from nothing, but not be named.
            if known[how]["class"] == "decidable" and planted.family != "outside":
                out["strictly"].append(any(_names(planted, x) for x in every[:count]))
                out["beside_small"].append(any(_names(planted, x) for x in first))
                out["in_set"].append(any(_names(planted, x, in_set=True) for x in first))
    return {name: rate(hits) for name, hits in out.items()}


def _classes(classes: Classes, how: str) -> Mapping[str, int]:
    return Counter(one[how]["class"] for effects in classes.values() for one in effects)
