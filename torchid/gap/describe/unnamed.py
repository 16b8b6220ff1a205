"""What the evidence has and gets no name: causes that are too small, and those that are not sure
enough, the suspects."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec import structs

from torchid.gap.cause_records import body_cause, effect_cause
from torchid.gap.causes.candidates import Term
from torchid.gap.causes.evidence import Fit
from torchid.gap.causes.explain import Explained
from torchid.gap.causes.judge import judged
from torchid.gap.describe.claims import Claim, at_an_end
from torchid.gap.describe.model import STEPS, Explanation, solve
from torchid.gap.describe.replication import replication
from torchid.results.cause import Cause, Role
from torchid.results.replication import of_few_runs
from torchid.statistics.criteria import LIKELY

PLACES_ASKED, ASKED_OF_EACH, LIKELIEST = 6, 2, 60
"""Places, and the likeliest candidates of each, that are asked run by run; of so many."""


def small_effects(found: Explanation, explained: Explained) -> tuple[Cause, ...]:
    """Causes that the evidence has beside what is told, each likelier there than not, the largest
    first; bodies are none of them.

    Args:
        found: what is named.
        explained: with what was not worth it.
    """
    search, evidence = found.search, found.search.evidence
    named = {t.key for t in found.terms}
    some = {t.key: t for t in explained.found.small if t.key not in named and not t.parametric}
    whole = search.again(evidence.fit([*found.terms, *some.values()], found.fit.samples))
    # Causes that stand for each other: the least needed leaves first.
    while own := [t for t in whole.terms if some.get(t.key) is t]:
        tried = [search.without(whole, t) for t in own]
        rises = [evidence.over(f, whole) for f in tried]
        if max(rises) < 0:
            break
        whole = search.again(tried[int(np.argmax(rises))])
    if not own:
        return ()
    # Their sizes, fitted together with what is told.
    beside = Explanation.of(found.problem, search, whole)
    sure = {t: judged(search, whole, t, explained.left, found.problem.draws).own for t in own}
    every = [_entry(beside, t, p, "small") for t, p in sure.items() if p >= LIKELY]
    return tuple(sorted(every, key=lambda e: -e.closes_rms))


def causes_of_few_runs(found: Explanation, explained: Explained) -> tuple[Cause, ...]:
    """The likeliest causes beside an explanation that a few runs have and most have none of: as a
    law of all they are unlikely. Of each place the one that removes most.

    Args:
        found, explained: as for `small_effects`.
    """
    search, problem, library = found.search, found.problem, found.search.library
    # 3: of which one can be the odd one
    if len({s.name for s in library.samples.segments}) < 3:
        return ()
    places: dict[object, list[Term]] = {}
    for _, term in search.screen.ranked(found.fit, library.rows)[:LIKELIEST]:
        if len(places) == PLACES_ASKED and term.place not in places:
            continue
        near = places.setdefault(term.place, [])
        # Asked last, for it is of every shape.
        if len(near) < ASKED_OF_EACH and not (term.parametric or at_an_end(library, term)):
            near.append(term)
    asked = [term for near in places.values() for term in near]
    fits = [search.evidence.fit([*found.terms, t], found.fit.samples) for t in asked]
    # What physics refuses is none.
    pairs = [p for p in zip(asked, fits, strict=True) if p[1].allowed]

    def entry(term: Term, fit: Fit, steps: int) -> Cause:
        beside = Explanation(problem, search, fit, solve(problem, search, fit, steps))
        return _entry(beside, term, 0.0)

    # By the search's coefficients first; what few runs have then by those of the corrected model.
    entries = [entry(*pair, steps=0) for pair in pairs]
    for k in _of_few(entries):
        entries[k] = entry(*pairs[k], steps=STEPS)
    best: dict[tuple[int, ...], Cause] = {}
    for k in sorted(_of_few(entries), key=lambda k: entries[k].closes_rms):
        term, fit = pairs[k]
        sure = judged(search, fit, term, explained.left, problem.draws).own
        best[entries[k].at] = structs.replace(entries[k], how_sure=sure)
    return tuple(sorted(best.values(), key=lambda e: -(e.how_sure or 0.0)))


def _of_few(entries: Sequence[Cause]) -> list[int]:
    """Numbers of those that a few runs have and most have none of."""
    few = of_few_runs(entries)
    return [k for k, e in enumerate(entries) if (e.effect, e.at) in few]


def without_name(
    found: Explanation, claims: Sequence[Claim], shares: Sequence[float]
) -> tuple[Cause, ...]:
    """Causes of an explanation that are less likely there than not, and possible, the surest first.

    Args:
        found: what is answered, or was before all of it lost its names.
        claims: its causes.
        shares: of the error that each takes; NaN where the corrected model does not hold it.
    """
    # 0.005: probability below which a cause, at 0 %, is no suspect
    every = (
        structs.replace(_entry(found, one.term, one.alone_sure), share=share)
        for one, share in zip(claims, shares, strict=True)
        if one.unnamed and one.alone_sure >= 0.005
    )
    return tuple(sorted(every, key=lambda e: -(e.how_sure or 0.0)))


def _entry(found: Explanation, term: Term, sure: float, role: Role = "suspect") -> Cause:
    """A cause of an explanation; of bodies only how sure is said."""
    solution, samples = found.solution, found.problem.data.samples
    fall = np.maximum(found.without(term).losses - found.fit.losses, 0.0)
    closes = np.sqrt(fall / found.search.library.rows)
    k = solution.number(term)
    part, values = solution.parts[k], solution.values[k].tolist()
    more: dict[str, Any] = {
        "role": role, "how_sure": sure, "closes_rms": float(closes.max()),
        "replication": replication(solution, k, samples),
    }  # fmt: skip
    if term.parametric:
        return body_cause(term.joints, **more)
    effect, std = part.effects[0], solution.std[k].tolist() if solution.std else [0.0] * len(values)
    return effect_cause(
        (effect, values), std, solution.start, solution.model, solution.main(k),
        solution.of_shapes(k),
        joints=part.joints or (int(closes.argmax()),), located=part.joints,
        common=len(part.effects) > 1, remedy=effect.experiment, **more,
    )  # fmt: skip
