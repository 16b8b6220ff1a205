"""What the evidence has and gets no name: causes that are too small, and those that are not sure
enough, the suspects."""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import torch
from msgspec import structs

from torchid.design.columns import Place
from torchid.gap.diagnosis import INERTIA_REMEDY, unit_of
from torchid.gap.problem import Problem
from torchid.gap.record import UnnamedEffect
from torchid.gap.search.climb import candidate_moves, drop_unphysical
from torchid.gap.search.evidence import (
    Fitted,
    Question,
    active_share,
    comparable,
    fit_terms,
    refit,
    refit_each,
)
from torchid.gap.search.explain import Explanation, solve
from torchid.gap.search.findings import Judged, at_an_end
from torchid.gap.search.odds import Misfit, Rival, place_of
from torchid.gap.search.replication import own_torque, replication
from torchid.gap.search.terms import LINK, Term, excluding
from torchid.identification.knowledge import known_names
from torchid.json_data import plain
from torchid.results.replication import of_few_runs
from torchid.robot.model import Robot
from torchid.statistics.criteria import LIKELY, UNLIKELY
from torchid.typing import Tensor

PLACES_LOOKED_AT, CANDIDATES_EACH = 8, 4
"""Places that are looked at for suspects beside what is named, and candidates of each."""

MOST_SUSPECTS = 5
"""Suspects that are listed at most."""


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
    without: dict[int, tuple[float, Tensor, Fitted]] = {}
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
        _, closes, other = without[id(term)]
        own_part = own_torque(solution, k)
        place = place_of(question, (whole, other), term, own_part, problem.draws)
        sure = place.odds(misfit).sure
        if sure >= LIKELY:
            own_values, std = solution.values[k], solution.std[k]
            again = replication(own_part, solution, k, question.candidates.columns.samples)
            one = _entry(solution.terms[k], own_values, std, closes, sure, problem.robot)
            out.append(structs.replace(one, replication=again))
    return tuple(sorted(out, key=lambda e: -e.closes_rms))


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
        at = len(question.fixed) + k
        closes = question.fall(found.fit, one.without).sqrt()
        numbers = solution.values[at], solution.std[at], closes, one.odds.sure
        entry = _entry(solution.terms[at], *numbers, solution.model.robot)
        again = replication(one.place.own, solution, at, question.candidates.columns.samples)
        out.append(structs.replace(entry, share=shares[k], replication=again))
    return tuple(sorted(out, key=lambda e: -e.how_sure))


def _without(question: Question, whole: Fitted, term: Term) -> tuple[float, Tensor, Fitted]:
    """Rise of the evidence without a term, the error (n,) that it takes away [N m; N], and the fit
    without it."""
    rest = excluding(question.own(whole), [term])
    without = refit(question, whole, rest)
    return _rise(question, without, whole), question.fall(whole, without).sqrt(), without


def suspects(
    found: Explanation,
    problem: Problem,
    misfit: Misfit,
    listed: Collection[object],
    moved: Collection[str] = (),
) -> tuple[UnnamedEffect, ...]:
    """The likeliest causes as large as is worth a name that have none, the most probable first: of
    every place the best, and what may be there instead. Those of one place, nothing and something
    else sum up to one.

    Args:
        found, problem, misfit: as for `small_effects`.
        listed: keys of effects that are listed elsewhere.
        moved: known coefficients that are others than they were, which are suspects at least.
    """
    question, fit = found.question, found.fit

    def is_moved(term: Term) -> bool:
        return any(name in moved for e in term.effects for name in known_names(e))

    best = [_fitted_beside(found, own) for own in _likely_places(found, listed, is_moved)]
    best = [pairs for pairs in best if pairs]
    if not best:
        return ()
    # The best of each place is asked how sure it is, all beside each other.
    every = (*fit.terms, *(pairs[0][1] for pairs in best))
    start = torch.cat([fit.x, *(pairs[0][0].values()[-1] for pairs in best)])
    solution = solve(problem, replace(fit, terms=every, x=start))
    # What was seen to be left unexplained before may hide a name, and no suspect.
    least = replace(question, left=None).least(question.mean(fit.losses))
    samples = question.candidates.columns.samples
    # Of two runs that contradict each other none is the odd one.
    several = len({s.name for s in samples.segments}) > 2
    out: list[tuple[bool, UnnamedEffect]] = []
    by_run: list[UnnamedEffect] = []
    for k, ((first, term), *others) in enumerate(best, len(fit.terms)):
        rivals = [Rival((t,), f) for f, t in others]
        left = misfit.less(question.fall(first, fit))
        own_part = own_torque(solution, k)
        place = place_of(question, (first, fit), term, own_part, problem.draws, rivals)
        here = place.odds(left)
        numbers = [(term, solution.values[k], solution.std[k], first, here.sure)]
        for (f, other), sure in zip(others, here.others, strict=True):
            values, std = f.values()[-1], f.root.norm(dim=1)[-len(other.at) :]
            numbers.append((other, values, std, f, sure))
        for one, values, std, f, sure in numbers:
            closes = question.fall(f, fit).sqrt()
            large = bool((closes / active_share(question, [one]) ** 0.5 >= least).any())
            if large or is_moved(one):
                entry = _entry(one, values, std, closes, sure, problem.robot)
                out.append((is_moved(one), entry))
                if several:
                    # Factors are of the value in the solution that they are asked of.
                    own = solution if one is term else solve(problem, f)
                    at = next(i for i, t in enumerate(own.terms) if t.key == one.key)
                    again = replication(own_torque(own, at), own, at, samples)
                    size = own.values[at], own.std[at], closes, sure, problem.robot
                    by_run.append(structs.replace(_entry(one, *size), replication=again))
    # What has moved is listed, however unlikely.
    kept = [pair for pair in out if pair[0] or pair[1].how_sure >= UNLIKELY]
    kept = sorted(kept, key=lambda pair: (not pair[0], -pair[1].how_sure))[:MOST_SUSPECTS]
    # So is of every place the largest that a few runs have: as a law of all of them it is unlikely.
    few = of_few_runs((e.cause, e.replication) for e in by_run)
    ones = [e for e in by_run if (e.effect, e.joints) in few]
    of_few = {e.joints: e for e in sorted(ones, key=lambda e: e.closes_rms)}.values()
    told = {(e.effect, e.joints) for e in of_few}
    entries = [*of_few, *(e for _, e in kept if (e.effect, e.joints) not in told)]
    return tuple(sorted(entries, key=lambda e: -e.how_sure))


def _likely_places(
    found: Explanation, listed: Collection[object], is_moved: Callable[[Term], bool]
) -> list[list[Term]]:
    """The likeliest candidates of every place, to first order, and all of what has moved; none
    whose shape is at the end of its range, where it has become another effect."""
    question = found.question

    places: dict[Place, dict[object, Term]] = {}
    for _, (term, *more) in candidate_moves(question, found.fit):
        if more or term.key in listed or at_an_end(question, term):
            continue
        own = places.setdefault(term.place, {})
        if is_moved(term) or (len(places) <= PLACES_LOOKED_AT and len(own) < CANDIDATES_EACH):
            own.setdefault(term.key, term)
    return [list(own.values()) for own in places.values()]


def _fitted_beside(found: Explanation, terms: list[Term]) -> list[tuple[Fitted, Term]]:
    """Each term by itself beside what is named, the best first; without those that physics
    refuses."""
    question, fit = found.question, found.fit
    each = [[*found.terms, t] for t in terms]
    fits = refit_each(question, fit, each) if each else []
    there = [pair for pair in zip(fits, terms, strict=True) if pair[0].evidence > -math.inf]
    return sorted(there, key=lambda pair: -_rise(question, pair[0], fit))


def _rise(question: Question, fit: Fitted, other: Fitted) -> float:
    """Of the evidence of a fit over another one."""
    one, two = comparable(question, fit, other)
    return one.evidence - two.evidence


def _entry(
    term: Term, values: Tensor, std: Tensor, closes: Tensor, sure: float, robot: Robot
) -> UnnamedEffect:
    felt = term.joints or (int(closes.argmax()),)
    if term.inertial:
        return UnnamedEffect(
            effect=LINK,
            family="inertia",
            joints=term.joints if term.name == LINK else (),
            parameters={},
            std={},
            unit={},
            closes_rms=float(closes.max()),
            how_sure=sure,
            settles=INERTIA_REMEDY,
        )
    effect = term.effects[0]
    names = [c.name for c in effect.coefficients]
    shapes = dict(zip((s.name for s in effect.shapes), effect.shape_values, strict=True))
    return UnnamedEffect(
        effect=effect.name,
        family=effect.family,
        joints=term.joints,
        parameters=plain(dict(zip(names, values.tolist(), strict=True)) | shapes),
        std=plain(dict(zip(names, std.tolist(), strict=True))),
        unit={c.name: unit_of(c.unit, felt, robot) for c in effect.coefficients},
        closes_rms=float(closes.max()),
        how_sure=sure,
        settles=effect.experiment,
    )
