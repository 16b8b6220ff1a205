"""The whole search: events, laws from several starts, shapes refined, columns taken anew."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchid.design.columns import Columns, Model, Place, on_joint
from torchid.design.gram import Folds, visible_root
from torchid.design.repeats import counterparts
from torchid.design.segments import Samples
from torchid.effects.base import Effect, JointEffect, ModelEffect
from torchid.effects.motion import Motion
from torchid.effects.surroundings import PlaneContact
from torchid.effects.transient import Contact
from torchid.gap.data import Data
from torchid.gap.problem import Problem
from torchid.gap.search.climb import (
    LIKELIEST,
    candidate_moves,
    climb_from,
    drop_unphysical,
    drop_worthless,
    fit_anew,
    held_out_losses,
    moves_beside_each,
    signature,
    swap_term,
)
from torchid.gap.search.events import Counterparts, contacts, hidden_contacts, planes
from torchid.gap.search.evidence import (
    Fitted,
    Question,
    active_share,
    common_names,
    comparable,
    refit,
    refit_each,
    residual,
    rows_of,
    span_of,
)
from torchid.gap.search.solve import STEPS, Solution, at_estimate, corrected_model, solve_terms
from torchid.gap.search.terms import BASE, PAYLOAD, Candidates, Term, candidates_of, excluding
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

PASSES = 2
"""Times the columns are taken at the model found and the search goes on."""

CHANGED_SHARE = 0.02
"""Relative change of a joint's model torque from which columns are taken anew; at half of it more
diagnoses take a second pass, at double load-dependent friction is 1 % off."""

LONGEST = 120.0
"""Length of a log beyond which one trajectory shows how impacts are [s]."""

FINEST = 5
"""Times a shape is searched around the best one, each time three times more closely."""


Watch = Callable[[Question, Fitted], None]
"""Called with each fit that the search goes on from."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """What a search has found.

    Attributes:
        question: candidates at the last model, and what they explain.
        empty: the model as given, with what is always fitted.
        fit: what is told; its terms beside the fixed ones.
        unworthy: terms that the evidence has, which are not worth a name.
        solution: the corrected model.
    """

    question: Question
    empty: Fitted
    fit: Fitted
    unworthy: tuple[Term, ...]
    solution: Solution

    @property
    def terms(self) -> tuple[Term, ...]:
        """What is told."""
        return self.question.own(self.fit)


def explain_gap(problem: Problem, watch: Watch | None = None) -> Explanation:
    """Which effects explain the gap between a log and a model.

    Args:
        problem: gap, log, and what is looked for.
        watch: called with each fit that the search goes on from.
    """
    given, data, wanted = problem.given, problem.data, problem.wanted
    # The gap is always that of the model as given; columns are taken at the model found so far.
    model = at = given.model
    extra: list[Effect] = []
    start: tuple[Term, ...] = ()
    gap = given.gap
    repeated = counterparts(given.samples, problem.repeats)

    def asked(columns: Columns) -> Question:
        """Candidates at a model, for the gap of the model as given."""
        candidates = candidates_of(columns, gap, data, wanted, problem.folds.parts, model, extra)
        normal = candidates.gram.over()
        left = None if wanted.knowledge is None else wanted.knowledge.left
        return Question(candidates, normal, problem.settings, left=left)

    for attempt in range(PASSES):
        columns = given.at(at) if attempt else given
        question = asked(columns)
        # Events first: no law may explain a push.
        if attempt == 0:
            found: list[Effect] = []
            if Contact.name in wanted.names:
                found += contacts(question, repeated)
            if PlaneContact.name in wanted.names:
                found += planes(question)
            if found:
                extra += found
                question = asked(columns)
        # Laws, from the last model's or from several starts.
        start = tuple(t for t in (_again(question.candidates, s) for s in start) if t is not None)
        fit = best_explanation(question, start)
        if watch is not None:
            watch(question, fit)
        # Shapes between those of the grid, secants of rivals, and the search once more with both.
        finer = [
            *refine_shapes(question, fit),
            *at_their_size(question, fit),
            *sharpen_shapes(question, fit, problem),
        ]
        if finer:
            extra += finer
            again = question.own(fit)
            question = asked(columns)
            again = tuple(_finest(question.candidates, t, finer) or t for t in again)
            fit = climb_from(question, again)
        question, fit, left = worth_naming(question, fit, repeated, watch)
        # Once more with the columns of the model found, if they are others.
        latest = corrected_model(model, fit.terms, fit.values(), wanted)
        # What scales with the torque must not see the friction that it is to be told from; what
        # turns or scales the model does so to a load, too.
        kept = [p for p in latest.effects if p in model.effects or p[0].linearised or p[0].inertial]
        latest = Model(latest.robot, tuple(kept))
        if attempt + 1 == PASSES or not _changed(at, latest, data):
            break
        at = latest
        # Secants at the estimate stand beside those at the usual place, and all of them are there
        # again, whatever of their grid is.
        pairs = zip(fit.terms, fit.values(), strict=True)
        moved = [at_estimate(t, v) for t, v in pairs]
        start = tuple(t for t in moved[len(question.fixed) :] if t.name != BASE)
        extra += [t.alone for t in start if t.alone and hasattr(t.alone, "at")]
    folds = question.candidates.gram.folds()
    # The search ends without what vanishes at the model found.
    while True:
        fit = fit_to_convergence(question, fit.terms, fit)
        solution = solve(problem, fit)
        gone = terms_without_torque(question, solution)
        if not gone:
            return Explanation(question, fit_anew(question), fit, tuple(left), solution)
        question = replace(question, barred=question.barred | {t.key for t in gone})
        rest = [t for t in question.own(fit) if t.key not in question.barred]
        fit = drop_unphysical(question, refit(question, fit, rest))
        fit, left = improve_by_swaps(question, folds, fit, left)


def worth_naming(
    question: Question, fit: Fitted, repeated: Counterparts, watch: Watch | None
) -> tuple[Question, Fitted, list[Term]]:
    """What is worth a name on data that was not fitted, bodies beside it last; the terms that are
    not worth one, and the question without events that do not stand out."""
    folds = question.candidates.gram.folds()
    fit, left = drop_worthless(question, folds, fit)
    # Where a cause has left or bodies have joined, another one may say the rest better.
    fit, left = settle(question, folds, fit, left)
    if watch is not None:
        watch(question, fit)
    # Without the events that do not stand out any more, the search goes on from the laws.
    while gone := events_not_standing_out(question, fit, left, repeated):
        question = replace(question, barred=question.barred | {t.key for t in gone})
        laws = excluding(question.own(fit), gone)
        fit, left = drop_worthless(question, folds, climb_from(question, laws))
        fit, left = improve_by_swaps(question, folds, fit, left)
    whole = with_bodies(question, folds, fit, left)
    if whole is not fit:
        fit, left = improve_by_swaps(question, folds, whole, left)
    return question, fit, left


def terms_without_torque(question: Question, solution: Solution) -> list[Term]:
    """Causes that make less torque at the corrected model than is worth a name, whatever they made
    at the model that their columns were taken at: no error falls by more than the torque that is
    added to a model. What most joints have may be small on one of them."""
    rows, first = question.normal.rows.clamp(min=1.0), len(question.fixed)
    least = question.least(solution.left.square().sum(1) / rows)
    common = common_names(solution.terms[first:], question.joints)
    columns = solution.a.split([len(v) for v in solution.values])
    every = list(zip(solution.terms, solution.values, columns, strict=True))
    gone = []
    for term, values, a in every[first:]:
        there = rows * active_share(question, [term])
        torque = (torch.tensordot(values, a, 1).square().sum(1) / there).sqrt()
        small = bool((torque < least).all()) and term.name not in common
        if small and not question.shows(term):
            gone.append(term)
    return gone


def fit_to_convergence(question: Question, terms: Sequence[Term], fit: Fitted) -> Fitted:
    """What is told: terms, the fixed ones first, fitted until the joints' weights settle, without
    those that physics then refuses; samples and first weights are those of a fit."""
    return drop_unphysical(question, refit(question, fit, terms[len(question.fixed) :], 10), 10)


def best_explanation(question: Question, start: Sequence[Term]) -> Fitted:
    """The best of what is found from several starts: nothing, dry and viscous friction on all
    joints, and, where more than one body was blamed, all base parameters in their place."""
    friction = [
        t
        for t in question.candidates.terms
        if t.name in ("viscous_friction", "coulomb_friction") and not t.instead
    ]
    starts = [start] if start else [(), friction] if friction else [()]
    found = [climb_from(question, s) for s in starts]
    best = most_evident(question, found)
    # Several bodies at once: all base parameters may say it with less.
    own = question.own(best)
    bodies = [t for t in own if t.inertial or t.name == PAYLOAD]
    base = [t for t in question.candidates.terms if t.name == BASE]
    if len(bodies) > 1 and base:
        others = excluding(own, bodies)
        found.append(climb_from(question, [*base, *others]))
    return most_evident(question, found)


def most_evident(question: Question, found: Sequence[Fitted]) -> Fitted:
    """Of several explanations that of most evidence; in doubt the first."""
    best = found[0]
    for other in found[1:]:
        its, mine = comparable(question, other, best)
        best = other if its.evidence > mine.evidence else best
    return best


def improve_by_swaps(
    question: Question,
    folds: Folds,
    fit: Fitted,
    left: Sequence[Term],
) -> tuple[Fitted, list[Term]]:
    """Swap causes for others while the evidence rises, also beside those that are too small for a
    name: without them a body's ten numbers take what they hold, and stand for the causes beside it.
    Also return those that are too small."""
    out, whole, seen = list(left), beside_small(question, fit, left), set()
    while (other := swap_term(question, fit, every=True)) is not None:
        other, more = drop_worthless(question, folds, other)
        then = beside_small(question, other, [*out, *more])
        visited = signature(other, [*out, *more])
        # Evidence is of the samples that tell two fits apart, so that some go round.
        if most_evident(question, [whole, then]) is whole or visited in seen:
            break
        fit, whole, out = other, then, [*out, *more]
        seen.add(visited)
    return fit, out


def beside_small(question: Question, fit: Fitted, small: Sequence[Term]) -> Fitted:
    """A fit with those of some terms that are too small for a name which the evidence has beside
    it."""
    own = question.own(fit)
    there = {t.key for t in own}
    rest = list({t.key: t for t in small if t.key not in there}.values())
    whole = refit(question, fit, [*own, *rest]) if rest else fit
    while rest:
        fewer = [excluding(rest, [t]) for t in rest]
        found = refit_each(question, whole, [[*own, *some] for some in fewer])
        k = max(range(len(found)), key=lambda k: found[k].evidence)
        if found[k].evidence <= whole.evidence:
            break
        whole, rest = found[k], fewer[k]
    return whole


def search_without_small(
    question: Question,
    folds: Folds,
    fit: Fitted,
    left: Sequence[Term],
) -> tuple[Fitted, list[Term]]:
    """Drop the small causes and continue the search; repeat while the evidence rises."""
    out = list(left)
    while out:
        barred = replace(question, barred=frozenset(t.key for t in out))
        more, gone = drop_worthless(barred, folds, climb_from(barred, question.own(fit)))
        if most_evident(question, [fit, more]) is fit:
            break
        fit, out = more, [*out, *gone]
        if not gone:
            break
    return fit, out


def settle(
    question: Question, folds: Folds, fit: Fitted, left: Sequence[Term]
) -> tuple[Fitted, list[Term]]:
    """Swap causes, and search on without the small ones, until neither raises the evidence."""
    seen = set()
    while True:
        swapped, left = improve_by_swaps(question, folds, fit, left)
        fit, left = search_without_small(question, folds, swapped, left)
        visited = signature(fit, left)
        if fit is swapped or visited in seen:
            return fit, left
        seen.add(visited)


def events_not_standing_out(
    question: Question, fit: Fitted, left: Sequence[Term], repeated: Counterparts
) -> list[Term]:
    """Events that do not stand out from what the laws leave elsewhere in the log: these laws, and
    those that have evidence but are not worth a name."""
    own = question.own(fit)
    small = [t for t in left if all(t.key != o.key for o in own)]
    beside = refit(question, fit, [*own, *small])
    gone = hidden_contacts(question, beside, repeated)
    return [t for t in own if any(t is g for g in gone)]


def with_small(found: Explanation, problem: Problem) -> Explanation:
    """The same explanation with those of the terms too small for a name that the evidence has
    beside it, behind its own."""
    fit = beside_small(found.question, found.fit, found.unworthy)
    if fit is found.fit:
        return found
    return replace(found, fit=fit, unworthy=(), solution=solve(problem, fit))


def with_bodies(question: Question, folds: Folds, fit: Fitted, left: Sequence[Term]) -> Fitted:
    """All base parameters beside what was found and what is too small for a name, if they are worth
    it: last, for they hold a share of every cause. They displace what the evidence does not need
    beside them."""
    own = question.own(fit)
    base = [t for t in question.candidates.terms if t.name == BASE]
    if not base or any(t.name == BASE for t in own):
        return fit
    # Beside the effects, but in the place of other bodies.
    beside = [*(t for t in own if not t.inertial), *base]
    more = refit(question, fit, beside, 10)
    whole = beside_small(question, fit, left)
    if most_evident(question, [whole, beside_small(question, more, left)]) is whole:
        return fit
    # They must be worth it on some joint, on data that was not fitted, and do no such harm on any.
    explanations = own, question.own(more)
    without, then = (question.mean(held_out_losses(question, folds, more, e)) for e in explanations)
    fall = (without.sqrt() - then.sqrt()) / question.least(without)
    if not bool((fall >= 1).any()) or bool((fall <= -1).any()):
        return fit
    # Beside them the causes that the evidence is better without leave, the least needed first; a
    # load stays, for they hold whatever it does.
    while True:
        kept = question.own(more)
        rest = [excluding(kept, [s]) for s in kept if s.name not in (BASE, PAYLOAD)]
        lighter = [drop_unphysical(question, refit(question, more, r, 10)) for r in rest]
        best = max(lighter, key=lambda f: f.evidence, default=more)
        one, other = comparable(question, more, best)
        if other.evidence <= one.evidence:
            return more
        more = best


def solve(problem: Problem, fit: Fitted, steps: int = STEPS) -> Solution:
    """The corrected model of a fit, by so many steps at most."""
    asked = problem.data, problem.wanted, problem.block, fit.effective
    return solve_terms(problem.given, fit.terms, fit.values(), *asked, steps)


def without_terms(found: Explanation, gone: Sequence[Term], problem: Problem) -> Explanation:
    """The same explanation without some terms."""
    question, fit = found.question, found.fit
    # The other terms are fitted anew.
    less = fit_to_convergence(question, excluding(fit.terms, gone), fit)
    return _with_fit(found, question, less, (), problem)


def _with_fit(
    found: Explanation,
    question: Question,
    fit: Fitted,
    unworthy: Sequence[Term],
    problem: Problem,
) -> Explanation:
    """An explanation with another fit, and with some more terms that are not worth a name."""
    unworthy, solution = (*found.unworthy, *unworthy), solve(problem, fit)
    return replace(found, question=question, fit=fit, unworthy=unworthy, solution=solution)


def search_again_without(
    found: Explanation, refused: Sequence[Term], problem: Problem
) -> Explanation:
    """Continue the search from an explanation that some terms have left, without them: what was
    refused a name may have held what another cause says."""
    fit, barred = found.fit, found.question.barred
    barred |= {t.key for t in (*refused, *found.unworthy)} - {t.key for t in found.terms}
    if barred == found.question.barred:  # nothing is looked for twice, so the search ends
        return found
    question = replace(found.question, barred=barred)
    folds = question.candidates.gram.folds()
    more, left = drop_worthless(question, folds, climb_from(question, found.terms))
    if most_evident(question, [fit, more]) is fit:
        return replace(found, question=question)
    more, left = improve_by_swaps(question, folds, more, left)
    return _with_fit(found, question, fit_to_convergence(question, more.terms, more), left, problem)


def refine_shapes(question: Question, fit: Fitted) -> list[Effect]:
    """Shapes between those of the grid, where they explain more: of the terms, and of the likeliest
    further cause of each joint, which may lack evidence at the grid's shapes alone."""
    columns = question.candidates.columns
    own = question.own(fit)
    further: dict[Place, Term] = {}
    for net, (term, *_) in candidate_moves(question, fit):
        if net > 0 and term.shapes > 0:
            further.setdefault(term.place, term)
    out: list[Effect] = []
    for term in (*own, *further.values()):
        # What another sensor shows already has its shape from there.
        effect = term.alone if term.seen is None else None
        if isinstance(effect, JointEffect):
            movable = term.shapes > 0
        else:
            interval = columns.samples.interval
            movable = isinstance(effect, ModelEffect) and bool(effect.around(0, interval))
        if effect is None or not movable:
            continue
        # The shape that leaves least, all coefficients fitted anew with it.
        best = _closest(question, fit, excluding(own, [term]), effect, columns)
        if best is not None and best != effect:
            out.append(best)
    return out


def sharpen_shapes(question: Question, fit: Fitted, problem: Problem) -> list[Effect]:
    """Causes with impacts or swings, each with the shape that explains most of the gap in the band
    of the report, where these show how they are; all other terms keep their coefficients."""
    start, data, wanted = problem.given.model, problem.data, problem.wanted
    own = list(zip(fit.terms, fit.values(), strict=True))
    some = data.segments[:1] if data.seconds > LONGEST else data.segments
    samples = Samples(some, data.band)
    out: list[Effect] = []
    for term, values in own[len(question.fixed) :]:
        effect = term.alone
        if term.seen is not None or not (isinstance(effect, ModelEffect) and effect.sharp()):
            continue
        # What all other terms leave.
        others = [(t, v) for t, v in own if t is not term]
        rest = corrected_model(start, [t for t, _ in others], [v for _, v in others], wanted)
        left = samples.of([(s.tau - rest.torque(s, data.samples)).T for s in some])
        motions = Columns(rest, samples).motions
        best = replace(effect, at=float(values[0]))  # type: ignore[call-arg]
        # Every joint's squares count by what the present shape leaves there.
        present = left - _torques_at_size([best], motions, samples, rest.robot)
        weight = 1 / present.square().mean((0, 2), keepdim=True)
        for level in range(-1, FINEST):
            tried = [best, *(best.sharp() if level < 0 else best.around(level, samples.interval))]
            misfit = left - _torques_at_size(tried, motions, samples, rest.robot)
            best = tried[int((misfit.square() * weight).sum((1, 2)).argmin())]
        if best != effect:
            out.append(best)
    return out


def _torques_at_size(
    effects: Sequence[ModelEffect], motions: Sequence[Motion], samples: Samples, robot: Robot
) -> Float[Tensor, "B n N"]:
    """Torques of B effects of one class, each of its own size `at`, on the samples."""
    kind = type(effects[0])
    every = kind.columns_along(effects, motions, robot)
    found = [torch.cat(x, -1) for x in zip(*every, strict=True)]
    sizes = torch.tensor([e.at for e in effects]).reshape(-1, 1, 1)  # type: ignore[attr-defined]
    return sizes * samples.of([x.permute(2, 1, 0) for x in found])


def at_their_size(question: Question, fit: Fitted) -> list[Effect]:
    """What is likeliest in the place of each term, with its secant at its own estimate: at any
    other place a large true cause leaves more than rivals that are linear."""
    moved: dict[object, Effect] = {}
    own = question.own(fit)
    rests = [excluding(own, [term]) for term in own]
    without = refit_each(question, fit, rests)
    for rest, offered in zip(rests, moves_beside_each(question, without, own), strict=True):
        for net, (rival, *_) in offered[:LIKELIEST]:
            effect = rival.alone
            if net > 0 and effect and effect.linearised and effect.identity not in moved:
                there = refit(question, fit, (*rest, rival))
                moved[effect.identity] = at_estimate(rival, there.values()[-1]).effects[0]
    return list(moved.values())


def _closest(
    question: Question, fit: Fitted, others: Sequence[Term], effect: Effect, columns: Columns
) -> Effect | None:
    """The shape of an effect that explains most beside the others."""
    # What the other terms leave, on the joints that the effect is felt on, weighted.
    keep = question.candidates.keep
    rest = refit(question, fit, others, 1)
    weight = fit.weight.sqrt().unsqueeze(1) * keep
    own = effect.joint if isinstance(effect, JointEffect) else None
    joints = slice(None) if own is None else slice(own, own + 1)
    weight = weight[joints]
    y = (residual(question, rest.terms, rest.x)[joints] * weight).flatten()
    # Their columns there, in units of their coefficients' covariance, which all joints determine.
    beside = [y.new_zeros(0, len(y))]
    for term in rest.terms:
        rows = rows_of(question, term)
        if term.place is not None:
            rows = on_joint(rows[:, 0], term.place, columns.n)
        beside.append((rows[:, joints] * weight).flatten(1))
    others_hold = rest.root.T @ torch.cat(beside)

    def gained(x: Tensor) -> float:
        """What columns (C, m, N) explain of it beside the other terms, which are fitted anew."""
        flat = (x * weight).flatten(1)
        gram, held = flat @ flat.T, flat @ others_hold.T
        root = visible_root((gram - held @ held.T).numpy(), gram.diagonal().numpy())
        return float(np.square((flat @ y).numpy() @ root).sum())

    # Each time the shapes around the best one are tried, three times more closely.
    best, most = effect, gained(columns.on_all_joints(effect)[:, joints])
    for level in range(FINEST):
        tried: Sequence[Effect]
        if isinstance(best, JointEffect):
            shapes = best.finer(columns.motions, level, columns.samples.cutoff)
            if shapes is None:
                return None
            names = [s.name for s in best.shapes]
            tried = [replace(best, **dict(zip(names, v, strict=True))) for v in shapes.tolist()]
            rows = columns.of_shapes(type(best), best.joint, shapes).unsqueeze(2)
        else:
            assert isinstance(best, ModelEffect)
            tried = best.around(level, columns.samples.interval)
            found = columns.of_several(tried)
            rows = torch.stack([x if p is None else on_joint(x, p, columns.n) for p, x in found])
        gains = [gained(x) for x in rows]
        k = max(range(len(gains)), key=gains.__getitem__)
        if gains[k] > most:
            best, most = tried[k], gains[k]
    if isinstance(best, JointEffect) and best.at_an_end(columns.motions):
        return None
    return best


def _again(candidates: Candidates, term: Term) -> Term | None:
    """The same term among other candidates."""
    asked = term.name, term.wrong, term.effects
    return next((t for t in candidates.terms if (t.name, t.wrong, t.effects) == asked), None)


def _finest(candidates: Candidates, term: Term, finer: Sequence[Effect]) -> Term | None:
    """The term with its refined shape, where it has one."""
    alone = term.alone
    for effect in finer:
        if alone is not None and type(effect) is type(alone) and _near(effect, alone):
            return _again(candidates, replace(term, effects=(effect,)))
    return _again(candidates, term)


def _near(one: Effect, two: Effect) -> bool:
    if isinstance(one, Contact) and isinstance(two, Contact):
        # Of two pushes that overlap one is the other, refined.
        (a, b), (c, d) = span_of(one), span_of(two)
        return one.tip == two.tip and a < d and c < b
    return one.identity == two.identity


def _changed(old: Model, new: Model, data: Data) -> bool:
    """Whether columns are others at the new model: its torque has changed, or a secant has."""
    # A secant at another place is another column.
    if any(e.linearised for e, _ in new.effects if (e, _) not in old.effects):
        return True
    for segment in data.segments:
        # Columns scale with the model's torque: is it another?
        a, b = old.load(segment.motion), new.load(segment.motion)
        if bool(((a - b).square().mean(0) > CHANGED_SHARE**2 * b.square().mean(0) + 1e-300).any()):
            return True
    return False
