"""Scores of sets with a background: whether what can be known is named, and what is named for the
background.

A claim is new unless the answer says that the model lacked it on the earlier log already. Names of
planted effects are right at joints that have or feel them.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from torchid.json_data import plain
from torchid_bench.withheld.decidable import Classes
from torchid_bench.withheld.measures import coefficient_errors, rate, verdict
from torchid_bench.withheld.plant.background import NAMES
from torchid_bench.withheld.rows import Claim, Planted, Row
from torchid_bench.withheld.run import UNANSWERED
from torchid_bench.withheld.score import Scored, scored_case

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
    there = (key for key in keys if key["id"] in answers)
    cases = [scored_case(key, answers[key["id"]]) for key in there]
    answered = [c for c in cases if c.row.status not in UNANSWERED]
    decidable = {how: _decidable(cases, classes, how) for how in ("in_practice", "ideally")}
    sure = [(c.row, claim) for c in answered for claim in new(c.row) if _own(claim) >= SURE]
    wrong = [claim for row, claim in sure if not right(row, claim)]
    empty = [c.row for c in answered if c.kind == "none"]
    outside = [_of_new(c.row) for c in answered if c.kind == "outside"]
    errors = [z for c in answered for z in coefficient_errors(c.row)]
    return plain(
        {
            "classes": {how: dict(_classes(classes, how)) for how in ("in_practice", "ideally")},
            "first": {how: rate(hit for hit, _ in some) for how, some in decidable.items()},
            "in_set": {how: rate(hit for _, hit in some) for how, some in decidable.items()},
            # Of names that are sure: right ones; wrong ones that are of the background.
            "sure": rate(right(row, claim) for row, claim in sure),
            "wrong_of_background": rate(claim.name in NAMES for claim in wrong),
            "cases_with_false_sure": rate(
                any(_own(claim) >= SURE and not right(c.row, claim) for claim in new(c.row))
                for c in answered
            ),
            # Of arms without an effect: whether something new is named, or an error is unexplained.
            "nothing": {
                "likely": rate(any(_own(c) > LIKELY for c in new(row)) for row in empty),
                "sure": rate(any(_own(c) >= SURE for c in new(row)) for row in empty),
                "unexplained": rate(row.status == "detected_unexplained" for row in empty),
            },
            "outside": rate(
                verdict(row, every=False) in ("right_family", "hedged", "detected_unexplained")
                for row in outside
            ),
            # Of effects named at their joints: whether a number is within so many deviations.
            "within": {f"{z:g}": rate(e <= z for e in errors) for z in (1.0, 1.96)},
            "names_a_case": sum(len(c.row.claims) for c in answered) / max(len(answered), 1),
        }
    )


def new(row: Row) -> list[Claim]:
    """Claims that are new, or may be."""
    return [claim for claim in row.claims if claim.new]


def right(row: Row, claim: Claim) -> bool:
    """Whether a claim names something that was planted, at a joint that has or feels it."""
    return any(_names(p, claim) for p in row.planted)


def _names(planted: Planted, claim: Claim, *, in_set: bool = False) -> bool:
    names = claim.names if in_set else {claim.name}
    family = {claim.family} if planted.family == "outside" else set()
    here, there = {*planted.place, *planted.felt}, set(claim.place)
    near = not here or not there or bool(here & there)
    return near and not (names | family).isdisjoint((planted.name, *planted.acceptable))


def _own(claim: Claim) -> float:
    return claim.own or 0.0


def _of_new(row: Row) -> Row:
    """The answer as far as it is new."""
    return Row(row.status, row.planted, tuple(new(row)), row.not_testable, row.families)


def _decidable(cases: Sequence[Scored], classes: Classes, how: str) -> list[tuple[bool, bool]]:
    """Of each decidable effect whether it is named first, or one of the first names' sets has it:
    of two effects there are two first names."""
    out = []
    for case in cases:
        first = new(case.row)[: len(case.row.planted)]
        for planted, known in zip(case.row.planted, classes.get(case.case, ()), strict=True):
            # What no library has can be told from nothing, but not be named.
            if known[how]["class"] == "decidable" and planted.family != "outside":
                ways = ([_names(planted, c, in_set=x) for c in first] for x in (False, True))
                out.append(tuple(map(any, ways)))
    return out  # type: ignore[return-value]


def _classes(classes: Classes, how: str) -> Mapping[str, int]:
    return Counter(one[how]["class"] for effects in classes.values() for one in effects)
