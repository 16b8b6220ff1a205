"""What searches on parts of the data confirm."""

from torchid.gap.case import EVENTS, Case, FoldModels
from torchid.gap.findings import Findings, findings
from torchid.gap.problem import Term
from torchid.gap.solve import Solution, settled


def stable(
    case: Case, whole: Solution, found: Findings, models: FoldModels
) -> tuple[Solution, Findings, list[str]]:
    """What searches on parts of the data find too (Meinshausen and Buehlmann 2010, stability
    selection): an effect accepted on all data stays if it, or one that cannot be told from it, was
    accepted at the same place in at least half of the folds. The others leave, and that is said."""
    if not models.terms or not whole.terms:
        return whole, found, []
    names = {
        id(term): {term.name, *accepted.ambiguous_with}
        for term, accepted in zip(found.terms, found.of_terms, strict=True)
    }
    kept, doubts = [], []
    for term in whole.terms:
        hits = sum(any(_alike(t, term, names[id(term)]) for t in fold) for fold in models.terms)
        if 2 * hits >= len(models.terms):
            kept.append(term)
            continue
        joints = term.effects[0].joints if term.effects else ()
        place = f" of joint {joints[0] + 1}" if joints else ""
        doubts.append(
            f"{term.name}{place} was found on all data, but only in {hits} of {len(models.terms)} "
            "searches on parts of it: not accepted"
        )
    if not doubts:
        return whole, found, []
    whole = settled(case.plain, whole.problem, kept, case.task)
    return whole, findings(whole), doubts


def unconfirmed(whole: Solution) -> list[str]:
    """What stood out on the data fitted and closes nothing on others."""
    return [
        f"{t.name} stands out on the data fitted, but the gap does not shrink on others"
        for t in whole.terms
        if t.name not in EVENTS
    ]


def _alike(one: Term, two: Term, names: set[str]) -> bool:
    """Whether a fold's term is the same as `two`, or one of its alternatives at the same place."""
    if one.name not in names:
        return False
    return one.place == two.place or one.place is None or two.place is None
