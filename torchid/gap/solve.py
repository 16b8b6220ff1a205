"""From rows to a corrected model: search, take the columns anew at what was found, fit, repeat.

Some columns depend on the model (torque-dependent friction, compliance, delay), and some are
secants of something nonlinear (an encoder's offset); both are taken again at the estimate until the
model settles.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch

from torchid.effects.base import Effect, JointEffect
from torchid.effects.registry import Valued
from torchid.effects.transient import Contact
from torchid.gap.bank import Bank
from torchid.gap.candidates import Evaluator
from torchid.gap.fit import Fit, fitted, huber_weights
from torchid.gap.problem import BASE, FRICTION, LINK, Problem, Term, term_of
from torchid.gap.projection import in_all_rows
from torchid.gap.select import Search
from torchid.gap.task import Task, fixed_terms
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Bool, Tensor

PASSES = 2
"""Times the columns are taken anew and the search goes on."""

CHANGED = 0.02
"""Relative change of the model's torque from which the columns that depend on it are taken anew."""

SIGNIFICANT = 2.5
"""Standard deviations from zero that a coefficient of an accepted effect has at least."""

SETTLING = 4
SETTLED = 1e-4
"""Gauss-Newton steps at most, and the share of the loss that one must gain."""


@dataclass(frozen=True)
class Solution:
    """A corrected model.

    Attributes:
        problem: the last rows and candidates.
        terms: what was accepted, `fixed` ones not among them.
        fit: of the fixed terms and the terms, in this order.
        robot, effects: the corrected model.
    """

    problem: Problem
    terms: tuple[Term, ...]
    fit: Fit
    robot: Robot
    effects: tuple[Valued, ...]

    def values_of(self, term: Term) -> tuple[Tensor, Tensor]:
        """A term's coefficients and their standard deviations."""
        position = len(self.problem.fixed) + next(
            k for k, other in enumerate(self.terms) if other is term
        )
        return self.fit.values[position], self.fit.std[position]


def solve(
    start: Evaluator,
    plain: Evaluator,
    keep: Bool[Tensor, "n N"],
    task: Task,
    banks: Sequence[Bank],
    folds: Bool[Tensor, " N"] | None = None,
) -> Solution:
    """Search on whitened rows, fit on plain ones.

    Whitening makes tests honest. But where a model is wrong at low frequencies it looks away: it
    weighs the high ones, in which an autocorrelated misfit is small. So the coefficients are those
    that make the gap itself small.

    Args:
        start: at the model as given.
        plain: the same with rows that are only divided by their noise.
        keep: (n, N) rows that count, which both evaluators know.
        task: what to look for.
        banks: candidates at the model as given (from `banks_of`).
        folds: (N,) rows to search and fit on; all if None.
    """
    count = int((keep if folds is None else keep & folds).sum())
    keep = (torch.ones_like(keep[0]) if folds is None else folds).expand_as(keep)
    y = start.residual() * keep
    evaluator = start
    fixed = tuple(t.scaled(keep) for t in fixed_terms(start, task))
    terms: list[Term] = []
    for attempt in range(PASSES + 1):
        problem = Problem(
            y,
            keep,
            count,
            tuple(banks),
            fixed,
            start.rows.bounds,
            start.rows.interval,
            _refiner(evaluator),
            task.whitened,
            task.alpha,
            task.seed,
        )
        terms = Search(problem, terms).run(task.most)
        if attempt == PASSES or not terms:
            break
        fit = fitted(problem, terms)
        latest = start.with_model(*corrected(start, problem.fixed, terms, fit, task))
        change = _change(evaluator, latest, len(start.effects))
        if not change and attempt > 0:
            break
        evaluator = latest
        terms = _all_retaken(terms, evaluator, fit.values[len(fixed) :], keep)
        banks = _renewed(banks, evaluator, change)
    return settled(plain, problem, terms, task)


def settled(plain: Evaluator, problem: Problem, terms: list[Term], task: Task) -> Solution:
    """The corrected model of given terms, fitted on plain rows; terms that this fit does not
    confirm leave, the weakest first: one that imitates another makes both uncertain."""
    while True:
        found = _settled(plain, problem, terms, fitted(problem, terms), task)
        sizes = {id(t): _significance(found, t) for t in found.terms}
        weakest = min(terms, key=lambda t: sizes[id(t)], default=None)
        if weakest is None or sizes[id(weakest)] >= SIGNIFICANT:
            return found
        terms = [t for t in terms if t is not weakest]


def fitted_on(
    plain: Evaluator, found: Solution, keep: Bool[Tensor, "n N"], task: Task
) -> tuple[Robot, tuple[Valued, ...]]:
    """The corrected model of the terms that were found, fitted on some of the rows. A term leaves
    only if they say nothing of it: a contact that was elsewhere, friction of a joint that rests."""
    problem = replace(
        found.problem,
        y=found.problem.y * keep,
        keep=keep,
        count=int(keep.sum()),
        fixed=tuple(t.scaled(keep) for t in found.problem.fixed),
    )
    terms = [t.scaled(keep) for t in found.terms]
    again = _settled(plain, problem, terms, fitted(problem, terms), task)
    pairs = zip(found.terms, terms, again.terms, strict=True)
    told = [own for whole, own, new in pairs if _told(found, whole, again, new)]
    if len(told) < len(terms):
        again = _settled(plain, problem, told, fitted(problem, told), task)
    return again.robot, again.effects


def _told(found: Solution, whole: Term, again: Solution, new: Term) -> bool:
    """Whether some coefficient is known to better than its size on all rows."""
    if whole.is_inertial:
        return True
    return bool((again.values_of(new)[1] < found.values_of(whole)[0].abs()).any())


def _significance(found: Solution, term: Term) -> float:
    """Standard deviations by which a term's coefficients differ from zero: of the clearest one, or
    of the one that makes the effect what it is; none where a sign is forbidden by physics."""
    if term.is_inertial:
        return torch.inf
    values, std = found.values_of(term)
    ratio = values.abs() / std.clamp(min=1e-300)
    signed = torch.tensor([c.non_negative for c in term.coefficients])
    known = values.new_tensor(term.known or (0.0,) * len(values))
    ratio = torch.where(signed & (values < -known), -ratio, ratio)
    needed = [float(ratio[k]) for k in term.effects[0].essential]
    if bool((ratio < -SIGNIFICANT).any()):
        needed.append(-torch.inf)
    return min([float(ratio.max()), *needed])


def _settled(
    plain: Evaluator, problem: Problem, terms: list[Term], fit: Fit, task: Task
) -> Solution:
    """Coefficients fitted on plain rows, by Gauss-Newton steps on the residual of the corrected
    model itself: what is nonlinear in several coefficients at once (a gain on refitted parameters)
    settles."""
    fixed = tuple(t.scaled(problem.keep) for t in fixed_terms(plain, task))
    own = replace(problem, fixed=fixed)
    evaluator = plain.with_model(*corrected(plain, fixed, terms, fit, task))
    taken = [_plain(t, evaluator, problem.keep, task) for t in terms]
    r = plain.residual() * problem.keep
    weight = torch.ones_like(r)
    values = tuple(torch.zeros_like(v) for v in fit.values)
    best: Solution | None = None
    for k in range(SETTLING):
        step = fitted(_weighted(own, r, weight), [t.scaled(weight) for t in taken])
        values = tuple(v + d for v, d in zip(values, step.values, strict=True))
        moved = Fit(values, step.std, step.loss)
        robot, effects = corrected(plain, fixed, taken, moved, task)
        evaluator = plain.with_model(robot, effects)
        left = evaluator.residual() * problem.keep
        losses = [float((weight * x).square().sum()) for x in (r, left)]
        if best is not None and losses[0] - losses[1] < SETTLED * losses[0]:
            break
        r, best = left, Solution(problem, tuple(terms), moved, robot, effects)
        if k == 0:
            weight = huber_weights(r)
        taken = _all_retaken(taken, evaluator, values[len(fixed) :], problem.keep)
    assert best is not None
    return best


def _weighted(problem: Problem, r: Tensor, weight: Tensor) -> Problem:
    fixed = tuple(t.scaled(weight) for t in problem.fixed)
    return replace(problem, y=weight * r, fixed=fixed)


def _plain(term: Term, evaluator: Evaluator, keep: Tensor, task: Task) -> Term:
    """A term's columns in rows that are not whitened."""
    if term.name == BASE:
        columns = term_of(evaluator.rigid_bank(BASE, (), task.independent)).columns
    elif term.name in (LINK, "payload"):
        link = term.effects[0].joints[0] if term.name == LINK else evaluator.n - 1
        columns = term_of(evaluator.link_bank(term.effects[0], link)).columns
    elif len(term.effects) > 1:
        columns = term_of(evaluator.shared_bank(type(term.effects[0]), term.effects)).columns  # type: ignore[arg-type]
    else:
        place, columns = evaluator.columns(term.effects[0])
        if place != term.place:
            columns = in_all_rows(columns, place, evaluator.n)
    return replace(term, columns=columns).scaled(keep)


def _all_retaken(
    terms: Sequence[Term], evaluator: Evaluator, values: Sequence[Tensor], keep: Tensor
) -> list[Term]:
    pairs = zip(terms, values, strict=True)
    return [_retaken(term, evaluator, v).scaled(keep) for term, v in pairs]


@dataclass(frozen=True)
class _Change:
    """What differs between two models' columns.

    Attributes:
        rigid: whether the rigid body's torque does.
        loads: joints whose torque does.
        secants: whether an effect of the new model is nonlinear in its coefficient.
    """

    rigid: bool
    loads: frozenset[int]
    secants: bool

    def __bool__(self) -> bool:
        return self.rigid or bool(self.loads) or self.secants


def _change(last: Evaluator, new: Evaluator, count: int) -> _Change:
    """Compare the evaluator of the present columns with the one of the corrected model, whose
    first `count` effects are not of the search."""
    pairs = ((last.rigid, new.rigid), (last.load, new.load))
    moved = []
    for a, b in pairs:
        size = b.square().mean(0)
        moved.append((a - b).square().mean(0) > CHANGED**2 * size + 1e-300)
    found = new.effects[count:]
    secants = any(e.linearised for e, _ in found)
    return _Change(bool(moved[0].any()), frozenset(moved[1].nonzero().flatten().tolist()), secants)


def _retaken(term: Term, evaluator: Evaluator, values: Tensor) -> Term:
    """A term's columns at the present model, secants at the estimate."""
    if not term.effects or term.is_inertial:
        return term
    effect = term.effects[0]
    if not effect.needs or isinstance(effect, Contact):
        return term
    if len(term.effects) > 1:
        shared = [e.at_estimate(values.tolist()) for e in term.effects]
        bank = evaluator.shared_bank(type(effect), shared)  # type: ignore[arg-type]
        return replace(term, effects=bank.members[0], columns=bank.columns[0])
    effect = effect.at_estimate(values.tolist())
    place, columns = evaluator.columns(effect)
    if place != term.place and term.place is None:
        return term
    return replace(term, effects=(effect,), columns=columns)


def _renewed(banks: Sequence[Bank], evaluator: Evaluator, change: _Change) -> list[Bank]:
    """Candidates, those that depend on what changed taken anew."""
    out = []
    for bank in banks:
        effect = bank.members[0][0] if bank.members[0] else None
        if effect is None or bank.name in (LINK, FRICTION, "payload"):
            out.append(bank)
            continue
        if isinstance(effect, Contact):
            out.append(evaluator.contact_bank(evaluator.residual()))
            continue
        involved = {*effect.joints, getattr(effect, "source_joint", -1)}
        stale = change.rigid and "robot" in effect.needs
        stale |= "torque" in effect.needs and bool(involved & change.loads)
        out.append(evaluator.renewed(bank) if stale else bank)
    return out


def _refiner(evaluator: Evaluator) -> Callable[[Effect, int], Bank | None]:
    """Shapes around an effect's own: within the grid's step, then a third of it, a ninth, ..."""

    def refine(effect: Effect, level: int) -> Bank | None:
        if isinstance(effect, Contact) and effect.start is not None:
            return evaluator.around(effect, level)
        if not isinstance(effect, JointEffect):
            return None
        shapes = effect.finer(evaluator.motions, level, evaluator.rows.cutoff)
        if shapes is None:
            return None
        return evaluator.joint_bank(type(effect), effect.joint, shapes)

    return refine


def corrected(
    start: Evaluator, fixed: Sequence[Term], terms: Sequence[Term], fit: Fit, task: Task
) -> tuple[Robot, tuple[Valued, ...]]:
    """The model with the fitted terms: other inertial parameters, further effects."""
    robot, effects = start.robot, list(start.effects)
    pi = robot.require_parameters("a diagnosis").pi.double().clone()
    flat = pi.reshape(-1)
    for term, values in zip((*fixed, *terms), fit.values, strict=True):
        if term.name == BASE:
            flat[task.independent] += values
        elif term.name == LINK:
            pi[term.effects[0].joints[0]] += values
        for effect in () if term.is_inertial else term.effects:
            effects = _with_effect(effects, effect, values.tolist())
    return robot.with_parameters(InertialParameters(pi)), tuple(effects)


def _with_effect(effects: list[Valued], effect: Effect, values: list[float]) -> list[Valued]:
    """Effects with one more; the same one, already there, grows by the values."""
    for k, (other, old) in enumerate(effects):
        if other == effect:
            sums = [a + b for a, b in zip(old, values, strict=True)]
            return [*effects[:k], (other, sums), *effects[k + 1 :]]
    return [*effects, (effect, values)]
