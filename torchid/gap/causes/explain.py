"""From a problem to its causes: search, columns at the model found, and how sure each cause is."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchid.design.columns import Model
from torchid.gap.causes.candidates import Library, Term
from torchid.gap.causes.earlier import NEW, TwoLogs
from torchid.gap.causes.evidence import Fit
from torchid.gap.causes.judge import Judged, judge
from torchid.gap.causes.misfit import foreseen
from torchid.gap.causes.search import Found, Search
from torchid.gap.problem import Problem
from torchid.parallel.pace import Pace
from torchid.robot.inertia import InertialParameters

AGAIN = ("with the bodies found", "with the bodies found, again")
"""Stages in which the columns are taken at the model found and the search goes on, at most."""

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

    def grown(fit: Fit) -> None:
        """Whether effects will be taken anew with the bodies found."""
        given = problem.given.model
        pace.scale(AGAIN, float(_changed(given, with_bodies(given, fit), problem)))

    found = search.explanation(grown=grown)
    for stage in AGAIN:
        # What turns or scales the model does so to the bodies that were found, too.
        at = with_bodies(problem.given.model, found.fit)
        if not _changed(library.columns.model, at, problem):
            break
        pace.scale(AGAIN, 1.0)  # an exchange may have brought bodies
        if not pace.has_time("effects with the bodies found", stage):
            break
        pace(stage)
        # Candidates that were made on the way, as windows of pushes are, are no part of a new
        # library; they are handed to it, and the search begins with what was there.
        events = [t.effect for t in found.fit.terms if t.effect is not None and t.effect.event]
        library = kind(problem, events, at)
        start = [library.same(t) for t in found.fit.terms]
        search = Search(library, watch, pace)
        found = search.explanation([t for t in start if t is not None])
    pace("judging")
    evidence = search.evidence
    fit = search.again(found.fit)
    # Whole motions left out say how far the gap closes; noise is what repeats, or a flexible
    # predictor, leave of that.
    folds = np.where(library.asked, problem.folds.fold.numpy(), -1)
    after = search.left_out(fit, search.shared(fit, folds))
    before = library.rms(library.gap)
    # What a predictor of the state foresees is no noise; without repeats all the rest is.
    share = foreseen(problem, torch.from_numpy(evidence.left(fit))).share.clamp(min=0).numpy()
    noise = np.minimum(library.noise, after)
    noise = np.where(np.isnan(noise), after * np.sqrt(1 - share), noise)
    # Squares add up where RMS values do not, for noise and misfit are independent.
    left = np.maximum(after**2 - noise**2, 0.0)
    shares = left / np.maximum(before**2, 1e-300)
    # Of the whole arm each joint counts in units of its torque: newtons and newton metres have no
    # sum.
    unit = library.torque**2
    whole = float((left / unit).sum() / max((before**2 / unit).sum(), 1e-300))
    shares = np.minimum(np.append(shares, whole), 1.0)
    refused = () if problem.asked is None else found.small
    judged = judge(search, fit, shares, problem.draws, refused)
    return Explained(search, found, judged, shares)


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
