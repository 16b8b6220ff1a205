"""From a problem to its causes: search, columns at the model found, and how sure each cause is."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from torchid.design.columns import Model
from torchid.gap.causes.candidates import Library
from torchid.gap.causes.evidence import Fit
from torchid.gap.causes.judge import Judged, judge
from torchid.gap.causes.misfit import foreseen
from torchid.gap.causes.search import Found, Search
from torchid.gap.problem import Problem
from torchid.robot.inertia import InertialParameters

PASSES = 3
"""Times that the columns are taken at the model found and the search goes on, at most."""

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


def explain(problem: Problem, watch: Callable[[Search, Fit], None] | None = None) -> Explained:
    """Which causes make the gap of a model on a log.

    Args:
        problem: the gap, and what is looked for.
        watch: called with the search and each fit that it goes on from, the first without a cause.
    """
    say = watch or (lambda search, fit: None)
    library = Library(problem)
    search = Search(library, say)
    say(search, search.empty())
    found = search.explanation()
    for _ in range(PASSES - 1):
        # What turns or scales the model does so to the bodies that were found, too.
        at = with_bodies(problem.given.model, found.fit)
        if not _changed(library.columns.model, at, problem):
            break
        events = [t.effect for t in found.fit.terms if t.effect is not None and t.effect.event]
        library = Library(problem, events, at)
        start = [library.same(t) for t in found.fit.terms]
        search = Search(library, say)
        found = search.explanation([t for t in start if t is not None])
    evidence, rows = search.evidence, library.rows
    fit = search.again(found.fit)
    # Whole motions left out say how far the gap closes; noise is what repeats, or a flexible
    # predictor, leave of that.
    part = problem.folds.fold.numpy()
    after = np.sqrt(search.left_out(fit, part) / rows)
    before = np.sqrt((library.gap**2).sum(1) / rows)
    share = foreseen(problem, torch.from_numpy(evidence.left(fit))).share.clamp(min=0).numpy()
    noise = np.minimum(library.noise, after)
    noise = np.where(np.isnan(noise), after * np.sqrt(1 - share), noise)
    left = np.maximum(after**2 - noise**2, 0.0)
    shares = left / np.maximum(before**2, 1e-300)
    unit = library.torque**2
    whole = float((left / unit).sum() / max((before**2 / unit).sum(), 1e-300))
    shares = np.minimum(np.append(shares, whole), 1.0)
    return Explained(search, found, judge(search, fit, shares, problem.draws), shares)


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
