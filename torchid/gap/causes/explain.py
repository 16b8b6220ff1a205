"""From a problem to its causes: search, columns at the model found, and how sure each cause is."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchid.design.columns import Model
from torchid.gap.causes.candidates import Library, Term
from torchid.gap.causes.earlier import NEW, TwoLogs
from torchid.gap.causes.evidence import Fit
from torchid.gap.causes.judge import NEARLY, Judged, judge
from torchid.gap.causes.misfit import foreseen
from torchid.gap.causes.search import Found, Search
from torchid.gap.problem import Problem
from torchid.parallel.pace import Pace
from torchid.robot.inertia import InertialParameters
from torchid.statistics.criteria import LIKELY

WITH_BODIES, TIMES = "with other bodies", 2
"""The stage in which columns are made anew for bodies that have joined, and how often at most."""

CHANGED_SHARE = 0.02
"""Relative change of a joint's model torque from which columns are taken anew [1]; at double
load-dependent friction is 1 % off."""


@dataclass(frozen=True, eq=False)
class Explained:
    """Causes of a gap, and how far they close it.

    Attributes:
        search, found: of which.
        judged: terms of the explanation.
        left: (n + 1,) share of the squares of each joint's gap that is no noise and left on motions
            left out, and of the arm's as a whole.
    """

    search: Search
    found: Found
    judged: list[Judged]
    left: np.ndarray


def explain(
    problem: Problem,
    watch: Callable[[Search, Fit], None] | None = None,
    pace: Pace | None = None,
) -> Explained:
    """Which causes make the gap of a model on a log.

    Args:
        problem: the gap, and what is looked for.
        watch: called with the search and each fit that it goes on from, the first without a cause.
        pace: says how much time there is.
    """
    pace = pace or Pace(None, {})
    pace("what effects do")
    # Beside an earlier log each candidate is asked twice: whether it is new, and whether it was
    # there already.
    kind = Library if problem.asked is None else TwoLogs
    library = kind(problem)
    search = Search(library, watch, pace)
    # The first answer so far: the gap alone, before anything is looked for.
    search.watch(search, search.empty())

    fit = search.joined()
    for _ in range(TIMES):
        # What turns or scales the model does so to the bodies that have joined, too.
        at = with_bodies(problem.given.model, fit)
        if not _changed(library.columns.model, at, problem):
            break
        if not pace.has_time("effects with other bodies", WITH_BODIES):
            break
        pace(WITH_BODIES)
        # Candidates that were made on the way, as windows of pushes are, are no part of a new
        # library; they are handed to it, and the search goes on from what was there.
        events = [t.effect for t in fit.terms if t.effect is not None and t.effect.event]
        library = kind(problem, events, at)
        start = [library.same(t) for t in fit.terms]
        search = Search(library, watch, pace)
        fit = search.joined([t for t in start if t is not None])
    found = search.completed(fit)
    pace("judging")
    refused = () if problem.asked is None else found.small
    fit = search.again(found.fit)
    left = left_of(search, fit)
    judged = judge(search, fit, left, problem.draws, refused)
    likelier = with_likeliest(search, fit, judged)
    if likelier is not None:
        found, left = replace(found, fit=likelier), left_of(search, likelier)
        judged = judge(search, likelier, left, problem.draws, refused)
    return Explained(search, found, judged, left)


def with_likeliest(search: Search, fit: Fit, judged: Sequence[Judged]) -> Fit | None:
    """An explanation with what is likely by itself in the place of terms that are less so: on logs
    that might have been the evidence is another than on this one. None where all stay.

    Args:
        search: of the explanation.
        fit: the explanation.
        judged: its terms, with their rivals.
    """
    evidence, terms = search.evidence, list(fit.terms)
    for k, one in enumerate(judged):
        (likeliest, *others), sure = one.members[0] if one.members else ((one.term,), one.own)
        # Of what is nearly as likely, or the same torque, the search's own stays.
        if others or sure < LIKELY or one.own >= NEARLY * sure or likeliest in terms:
            continue
        then = evidence.fit((*fit.terms[:k], likeliest, *fit.terms[k + 1 :]), fit.samples)
        if not search.alike(then, fit, search.without(fit, one.term)):
            terms[k] = likeliest
    if terms == list(fit.terms):
        return None
    then = search.again(evidence.fit(terms, fit.samples))
    return then if then.allowed else None


def left_of(search: Search, fit: Fit) -> np.ndarray:
    """Share (n + 1,) of the squares of each joint's gap that an explanation leaves on motions left
    out and that is no noise, and of the arm's as a whole.

    Args:
        search: of the explanation.
        fit: the explanation.
    """
    library, problem = search.library, search.library.problem
    # Whole motions left out say how far the gap closes; noise is what repeats, or a flexible
    # predictor, leave of that.
    after = search.left_out(fit, search.shared(fit, problem.folds.fold.numpy()))
    before = library.rms(library.gap)
    # What a predictor of the state foresees is no noise; without repeats all the rest is.
    left = torch.from_numpy(search.evidence.left(fit))
    share = foreseen(problem, left).share.clamp(min=0).numpy()
    noise = np.minimum(library.noise, after)
    noise = np.where(np.isnan(noise), after * np.sqrt(1 - share), noise)
    # Squares add up where RMS values do not, for noise and misfit are independent.
    rest = np.maximum(after**2 - noise**2, 0.0)
    shares = rest / np.maximum(before**2, 1e-300)
    # Of the whole arm each joint counts in units of its torque: newtons and newton metres have no
    # sum.
    unit = library.torque**2
    whole = float((rest / unit).sum() / max((before**2 / unit).sum(), 1e-300))
    return np.minimum(np.append(shares, whole), 1.0)


def of_asked_log(explained: Explained, problem: Problem) -> Explained:
    """What was explained beside an earlier log, on the log that is asked alone, as it is described;
    without an earlier one as it is.

    Args:
        explained: over both logs.
        problem: of the log that is asked.
    """
    both = explained.search.library
    if not isinstance(both, TwoLogs):
        return explained
    # What is known of the model gives way for what it lacked already.
    wanted = replace(problem.wanted, knowledge=both.known(explained.found.fit))
    terms = explained.found.fit.terms
    events = [t.effect for t in terms if t.effect is not None and t.effect.event]
    library = Library(replace(problem, wanted=wanted), events, both.columns.model)
    search, of = Search(library), dict[Term, Term]()

    def same(term: Term) -> Term | None:
        if term not in of:
            alone = library.same(replace(term, key=term.form, since=""))
            if alone is not None:
                of[term] = next((t for t in of.values() if t.key == alone.key), alone)
        return of.get(term)

    def every(some: Iterable[Term]) -> tuple[Term, ...]:
        return tuple(dict.fromkeys(t for t in map(same, some) if t is not None))

    fit = search.empty()
    fit = search.again(search.evidence.fit(every(terms), fit.samples))
    judged = {}
    # Of what was in both and has changed since, the change is told.
    for one in sorted(explained.judged, key=lambda one: one.when == NEW):
        term, name = same(one.term), same(one.name)
        if term is None or name is None:
            continue
        members = tuple((own, p) for ts, p in one.members if (own := every(ts)))
        judged[term] = replace(one, term=term, name=name, members=members)
    found = Found(fit, every(explained.found.small))
    told = [judged[t] for t in fit.terms if t in judged]
    return Explained(search, found, told, explained.left)


def with_bodies(model: Model, fit: Fit) -> Model:
    """A model with the bodies of an explanation."""
    robot = model.robot
    pi = robot.require_parameters("bodies").pi.double().clone()
    for term, x in zip(fit.terms, fit.values(), strict=True):
        if not term.inertial:
            continue
        if term.change is not None:
            pi += float(x[0]) * torch.from_numpy(term.change)
            continue
        change = torch.from_numpy(x).reshape(-1, pi.shape[1])
        if term.effect is None:
            pi[robot.bodies[0] :] += change
        else:
            pi[robot.own_links[term.joints[0]] if term.joints else -1] += change[0]
    return Model(robot.with_parameters(InertialParameters(pi)), model.effects)


def _changed(old: Model, new: Model, problem: Problem) -> bool:
    """Whether the torque that effects see is another one at a new model."""
    for segment in problem.data.segments:
        a, b = old.load(segment.motion), new.load(segment.motion)
        if bool(((a - b).square().mean(0) > CHANGED_SHARE**2 * b.square().mean(0)).any()):
            return True
    return False
