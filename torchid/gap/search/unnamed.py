"""What the evidence has and gets no name: causes that are too small, and those that are not sure
enough, the suspects."""

import math
from collections.abc import Sequence

from msgspec import structs

from torchid.effects.base import Effect
from torchid.effects.registry import KINDS
from torchid.gap.diagnosis import INERTIA_REMEDY, unit_of
from torchid.gap.problem import Problem
from torchid.gap.record import UnnamedEffect
from torchid.gap.search.evidence import (
    Fitted,
    Question,
    comparable,
    fit_terms,
    refit,
)
from torchid.gap.search.explain import Explanation, drop_unphysical, solve
from torchid.gap.search.findings import Judged, at_an_end
from torchid.gap.search.odds import Misfit, Place
from torchid.gap.search.replication import own_torque, replication
from torchid.gap.search.solve import STEPS, Solution
from torchid.gap.search.terms import LINK, Term, excluding
from torchid.json_data import plain
from torchid.results.replication import of_few_runs
from torchid.statistics.criteria import LIKELY

FEWEST_RUNS = 3
"""Of which one can be the odd one."""
PLACES_ASKED, OF_A_PLACE = 6, 2
"""Places, and the likeliest candidates of each, that are asked run by run."""


def small_effects(
    found: Explanation, problem: Problem, misfit: Misfit
) -> tuple[UnnamedEffect, ...]:
    """Causes that the evidence has beside what is told, each likelier there than not, the largest
    first; bodies are none of them.

    Args:
        found: what is named, and what was not worth it.
        problem: of which it is an explanation.
        misfit: that the answer leaves.
    """
    question, fit = found.question, found.fit
    named = {t.key for t in found.terms}
    last = {t.key: t for t in found.unworthy if t.key not in named and not t.inertial}
    whole = drop_unphysical(
        question, fit_terms(question, [*found.terms, *last.values()], fit.effective)
    )
    # Causes that stand for each other: the least needed leaves first.
    without: dict[int, tuple[float, Fitted]] = {}
    while own := [t for t in question.own(whole) if t.key in last]:
        without = {id(t): _without(question, whole, t) for t in own}
        gone = max(own, key=lambda t: without[id(t)][0])
        if without[id(gone)][0] < 0:
            break
        rest = excluding(question.own(whole), [gone])
        whole = drop_unphysical(question, refit(question, whole, rest))
    if not own:
        return ()
    # Their sizes, fitted together with what is told.
    solution = solve(problem, whole)
    out = []
    for k, term in enumerate(whole.terms):
        if id(term) not in without:
            continue
        both = whole, without[id(term)][1]
        place = Place(question, both, term, own_torque(solution, k))
        sure = place.sure(misfit, problem.draws)
        if sure >= LIKELY:
            out.append(_entry(solution, k, place, sure))
    return tuple(sorted(out, key=lambda e: -e.closes_rms))


def causes_of_few_runs(
    found: Explanation, problem: Problem, misfit: Misfit, likely: Sequence[Term]
) -> tuple[UnnamedEffect, ...]:
    """The likeliest causes beside an explanation that a few runs have and most have none of: as a
    law of all they are unlikely. Of each place the one that removes most.

    Args:
        found, problem, misfit: as for `small_effects`.
        likely: candidates beside the explanation, the likeliest first.
    """
    question, fit = found.question, found.fit
    if len({s.name for s in question.candidates.columns.samples.segments}) < FEWEST_RUNS:
        return ()
    places: dict[object, list[Term]] = {}
    for term in likely:
        if len(places) == PLACES_ASKED and term.place not in places:
            continue
        near = places.setdefault(term.place, [])
        # Asked last, for it is of every shape.
        if len(near) < OF_A_PLACE and not (term.inertial or at_an_end(question, term)):
            near.append(term)
    asked = [term for near in places.values() for term in near]
    fits = [refit(question, fit, [*found.terms, t]) for t in asked]
    # What physics refuses is none.
    pairs = [p for p in zip(asked, fits, strict=True) if p[1].evidence > -math.inf]

    def entry(term: Term, with_it: Fitted, steps: int) -> UnnamedEffect:
        solution = solve(problem, with_it, steps)
        k = [id(t) for t in with_it.terms].index(id(term))
        place = Place(question, (with_it, fit), term, own_torque(solution, k))
        return _entry(solution, k, place, place.sure(misfit, problem.draws))

    # By the search's coefficients first; what few runs have then by those of the corrected model.
    entries = [entry(*pair, steps=0) for pair in pairs]
    for k in _of_few(entries):
        entries[k] = entry(*pairs[k], steps=STEPS)
    of_few = [entries[k] for k in _of_few(entries)]
    best = {e.joints: e for e in sorted(of_few, key=lambda e: e.closes_rms)}
    return tuple(sorted(best.values(), key=lambda e: -e.how_sure))


def _of_few(entries: Sequence[UnnamedEffect]) -> list[int]:
    """Numbers of those that a few runs have and most have none of."""
    few = of_few_runs((e.cause, e.replication) for e in entries)
    return [k for k, e in enumerate(entries) if (e.effect, e.joints) in few]


def terms_without_name(
    found: Explanation, judged: Sequence[Judged], shares: Sequence[float]
) -> tuple[UnnamedEffect, ...]:
    """Terms of an explanation that are less likely there than not, the surest first.

    Args:
        found: what is answered, or was before all of it lost its names.
        judged: its terms.
        shares: of the error that each takes; NaN where the corrected model does not hold it.
    """
    question, solution = found.question, found.solution
    out = []
    for k, one in enumerate(judged):
        if not one.unnamed:
            continue
        entry = _entry(solution, len(question.fixed) + k, one.place, one.odds.sure)
        out.append(structs.replace(entry, share=shares[k]))
    return tuple(sorted(out, key=lambda e: -e.how_sure))


def _without(question: Question, whole: Fitted, term: Term) -> tuple[float, Fitted]:
    """Rise of the evidence without a term, and the fit without it."""
    rest = excluding(question.own(whole), [term])
    without = refit(question, whole, rest)
    one, two = comparable(question, without, whole)
    return one.evidence - two.evidence, without


def _entry(solution: Solution, k: int, place: Place, sure: float) -> UnnamedEffect:
    """The k-th term of a solution, in its place."""
    closes = place.question.fall(*place.fits).sqrt()
    term, robot = solution.terms[k], solution.model.robot
    values, std = solution.values[k].tolist(), solution.std[k].tolist()
    felt = term.joints or (int(closes.argmax()),)
    # Of bodies only how sure is said; their numbers are the corrected model's.
    effect: Effect = KINDS[LINK](0) if term.inertial else term.effects[0]  # type: ignore[call-arg]
    coefficients = () if term.inertial else effect.coefficients
    names = [c.name for c in coefficients]
    shapes = dict(zip((s.name for s in effect.shapes), effect.shape_values, strict=True))
    return UnnamedEffect(
        effect=effect.name,
        family=effect.family,
        joints=term.joints,
        parameters=plain(dict(zip(names, values, strict=False)) | shapes),
        main=names[solution.main(k)] if names else "",
        std=plain(dict(zip(names, std, strict=False))),
        unit={c.name: unit_of(c.unit, felt, robot) for c in coefficients},
        closes_rms=float(closes.max()),
        how_sure=sure,
        settles=INERTIA_REMEDY if term.inertial else effect.experiment,
        replication=replication(place.own, solution, k, place.question.candidates.columns.samples),
    )
