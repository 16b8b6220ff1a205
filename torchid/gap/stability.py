"""What searches on parts of the data confirm."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from torchid.effects.registry import EVENTS, FAMILIES
from torchid.gap.case import Case, FoldModels
from torchid.gap.findings import Findings, findings
from torchid.gap.problem import Term
from torchid.gap.solve import Solution, settled


def stable(
    case: Case, whole: Solution, found: Findings, models: FoldModels
) -> tuple[Solution, Findings, list[str]]:
    """What searches on parts of the data find too (Meinshausen and Buehlmann 2010, stability
    selection): an effect accepted on all data stays if it, or something like it, was accepted at
    the same place in at least half of the folds. The others leave, and that is said. Where most
    folds give it another name, it cannot be told from that one.

    Returns:
        The solution and findings that are left, and a sentence for each that is not.
    """
    if not models.terms or not whole.terms:
        return whole, found, []
    kept, doubts = [], []
    rivals: dict[object, list[str]] = {}
    for term, entry in zip(found.terms, found.of_terms, strict=True):
        names = {term.name, *entry.ambiguous_with}
        seen = [{t.name for t in fold if _alike(t, term, names)} for fold in models.terms]
        hits = sum(bool(fold) for fold in seen)
        if 2 * hits < len(seen):
            doubts.append(_doubt(term, hits, len(seen)))
            continue
        kept.append(term)
        if 2 * sum(bool(fold & names) for fold in seen) < len(seen):
            rivals[term.key] = sorted(set().union(*seen) - names)
    if doubts:
        whole = settled(case.plain, whole.problem, kept, case.task)
        found = findings(whole)
    return whole, _with_rivals(found, rivals), doubts


def _doubt(term: Term, hits: int, folds: int) -> str:
    joints = term.effects[0].joints if term.effects else ()
    place = f" of joint {joints[0] + 1}" if joints else ""
    return (
        f"{term.name}{place} was found on all data, but only in {hits} of {folds} searches on "
        "parts of it: not accepted"
    )


def _with_rivals(found: Findings, rivals: Mapping[object, Sequence[str]]) -> Findings:
    """Findings that also cannot be told from their terms' rivals."""
    names = {
        id(entry): tuple(dict.fromkeys([*entry.ambiguous_with, *rivals.get(term.key, ())]))
        for term, entry in zip(found.terms, found.of_terms, strict=True)
    }
    return replace(
        found,
        effects=tuple(replace(e, ambiguous_with=names[id(e)]) for e in found.effects),
        parametric=tuple(replace(p, ambiguous_with=names[id(p)]) for p in found.parametric),
        of_terms=tuple(replace(e, ambiguous_with=names[id(e)]) for e in found.of_terms),
    )


def unconfirmed(whole: Solution) -> list[str]:
    """What stood out on the data fitted and closes nothing on others."""
    return [
        f"{t.name} stands out on the data fitted, but the gap does not shrink on others"
        for t in whole.terms
        if t.name not in EVENTS
    ]


def _alike(one: Term, two: Term, names: set[str]) -> bool:
    """Whether a fold's term is the same as `two`, one of its alternatives at the same place, or
    another member of its family on the same joint."""
    if one.name in names:
        return one.place == two.place or one.place is None or two.place is None
    family = FAMILIES.get(two.name)
    return one.place == two.place is not None and FAMILIES.get(one.name, "") == family
