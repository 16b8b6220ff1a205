"""From rows to a corrected model: search, take the columns anew at what was found, fit, repeat.

Some columns depend on the model (torque-dependent friction, compliance, delay), and some are
secants of something nonlinear (an encoder's offset); both are taken again at the estimate until the
model settles.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import torch

from torchid.effects.base import Effect, JointEffect
from torchid.effects.registry import KINDS, Valued
from torchid.gap.candidates import Bank, Evaluator, all_banks, composite
from torchid.gap.select import BASE, FRICTION, LINK, Problem, Search, Term, term_of
from torchid.identification.base_parameters import BaseParameters
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters, paper_order
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Tensor

PASSES = 2
"""Times the columns are taken anew and the search goes on."""

CHANGED = 0.02
"""Relative change of the model's torque from which the columns that depend on it are taken anew."""

DETERMINED = 1e-7
"""Eigenvalue of the scaled Gram matrix, relative to the largest, below which a direction is left
at zero."""


@dataclass(frozen=True)
class Fit:
    """Coefficients of terms, fitted together.

    Attributes:
        values: per term (C,).
        std: per term (C,), from the spread of block scores.
        loss: sum of squares left.
    """

    values: tuple[Float[Tensor, " C"], ...]
    std: tuple[Float[Tensor, " C"], ...]
    loss: float


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


@dataclass(frozen=True)
class Task:
    """What a search is about; everything but the model.

    Attributes:
        base: rigid base parameters of the robot.
        names: effects to look for.
        background: effects that are always fitted, on every joint, with the base parameters.
        free: whether base parameters are always fitted.
        inertial: whether corrections of the links' parameters compete.
        own_velocity, age: what the log holds.
        most: effects at most.
        alpha, seed: as Problem's.
    """

    base: BaseParameters
    names: tuple[str, ...]
    background: tuple[str, ...]
    free: bool
    inertial: bool
    own_velocity: bool
    age: bool
    most: int
    alpha: float
    seed: int

    @property
    def independent(self) -> list[int]:
        """Numbers, link by link, of the parameters that stand for the base parameters."""
        order = paper_order(self.base.n_rigid_parameters // PARAMETERS_PER_LINK)
        return order[list(self.base.independent[: self.base.n_rigid])].tolist()


def banks_of(evaluator: Evaluator, task: Task) -> list[Bank]:
    """All candidates at a model."""
    names = [n for n in task.names if n not in (LINK, "payload")]
    banks = list(all_banks(evaluator, names, own_velocity=task.own_velocity, age=task.age))
    plain = {(b.name, b.place): b for b in banks}
    for j in range(evaluator.n):
        pair = [plain.get((name, j)) for name in FRICTION.split("+")]
        if all(pair):
            banks.append(composite(FRICTION, pair))  # type: ignore[arg-type]
    return banks + rigid_banks(evaluator, task)


def rigid_banks(evaluator: Evaluator, task: Task) -> list[Bank]:
    """Payload, links and all base parameters, from one regressor."""
    n, k = evaluator.n, PARAMETERS_PER_LINK
    links = [list(range(link * k, (link + 1) * k)) for link in range(n)]
    banks = []
    if "payload" in task.names:
        payload = evaluator.rigid_bank("payload", (KINDS["payload"](),), links[-1])
        signs = tuple(c.non_negative for c in KINDS["payload"].coefficients)
        banks.append(replace(payload, non_negative=signs))
    if task.inertial and not task.free:
        if LINK in task.names:
            banks += [
                evaluator.rigid_bank(LINK, (KINDS[LINK](link),), links[link])  # type: ignore[call-arg]
                for link in range(n)
            ]
        banks.append(evaluator.rigid_bank(BASE, (), task.independent))
    return banks


def masked(bank: Bank, keep: Bool[Tensor, "n N"]) -> Bank:
    """The bank with the rows that do not count at zero."""
    rows = keep.flatten() if bank.place is None else keep[bank.place]
    return replace(bank, columns=bank.columns * rows)


def fixed_terms(evaluator: Evaluator, task: Task) -> tuple[Term, ...]:
    """Terms that are always in the model."""
    if not task.free:
        return ()
    terms = [term_of(evaluator.rigid_bank(BASE, (), task.independent))]
    for name in task.background:
        for j in range(evaluator.n):
            terms.append(term_of(evaluator.joint_bank(KINDS[name], j)))  # type: ignore[arg-type]
    return tuple(terms)


def solve(
    start: Evaluator,
    keep: Bool[Tensor, "n N"],
    task: Task,
    banks: Sequence[Bank],
    progress: Callable[[int], None] | None = None,
) -> Solution:
    """Search and fit on the rows that count.

    Args:
        start: at the model as given.
        keep: (n, N) rows that count.
        task: what to look for.
        banks: candidates at the model as given (from `banks_of`), not masked.
        progress: called with the number of effects found.
    """
    y = start.residual() * keep
    evaluator = start
    fixed = tuple(_mask(t, keep) for t in fixed_terms(start, task))
    terms: list[Term] = []
    for attempt in range(PASSES + 1):
        problem = Problem(
            y,
            keep,
            tuple(masked(bank, keep) for bank in banks),
            fixed,
            start.rows.bounds,
            start.rows.interval,
            _refiner(evaluator, keep),
            task.alpha,
            task.seed,
        )
        search = Search(problem, terms)
        terms = search.run(task.most)
        fit = fitted(problem, terms)
        robot, effects = corrected(start, problem.fixed, terms, fit, task)
        if progress is not None:
            progress(len(terms))
        if attempt == PASSES or not _model_dependent(start, evaluator, robot, effects):
            break
        evaluator = start.with_model(robot, effects)
        terms = [_mask(_retaken(t, evaluator, fit.values[len(fixed) + k]), keep)
                 for k, t in enumerate(terms)]  # fmt: skip
        banks = _renewed(banks, evaluator, task)
    return Solution(problem, tuple(terms), fit, robot, effects)


def _mask(term: Term, keep: Tensor) -> Term:
    rows = keep.flatten() if term.place is None else keep[term.place]
    return replace(term, columns=term.columns * rows)


def _model_dependent(
    start: Evaluator, last: Evaluator, robot: Robot, effects: Sequence[Valued]
) -> bool:
    """Whether the corrected model's torque differs from that of the last columns enough to matter,
    or an effect is nonlinear in its coefficient."""
    if any(f.name == "at" for e, _ in effects[len(start.effects) :] for f in fields(e)):
        return True
    after = start.with_model(robot, effects)
    for a, b in zip(after.motions, last.motions, strict=True):
        assert a.torque is not None
        assert b.torque is not None
        difference = (a.torque - b.torque).square().mean(0)
        if bool((difference > CHANGED**2 * b.torque.square().mean(0) + 1e-300).any()):
            return True
    return False


def _retaken(term: Term, evaluator: Evaluator, values: Tensor) -> Term:
    """A term's columns at the present model, secants at the estimate."""
    if not term.effects or term.is_inertial:
        return term
    effect = term.effects[0]
    if not effect.needs:
        return term
    effect = at_estimate(effect, values)
    place, columns = evaluator.columns(effect)
    if place != term.place and term.place is None:
        return term
    return replace(term, effects=(effect,), columns=columns)


def at_estimate(effect: Effect, values: Tensor) -> Effect:
    """The effect with its secant taken at the estimate, where it is nonlinear."""
    names = [f.name for f in fields(effect)]
    if "at" not in names or not float(values[0].abs()) > 0:
        return effect
    return replace(effect, at=float(values[0]))  # type: ignore[call-arg]


def _renewed(banks: Sequence[Bank], evaluator: Evaluator, task: Task) -> list[Bank]:
    """Candidates, those that depend on the model taken anew."""
    stale = {name for name in task.names if KINDS[name].needs & {"torque", "robot"}}
    stale -= {LINK, "payload"}
    fresh = all_banks(
        evaluator,
        [name for name in task.names if name in stale],
        own_velocity=task.own_velocity,
        age=task.age,
    )
    return [bank for bank in banks if bank.name not in stale] + list(fresh)


def _refiner(evaluator: Evaluator, keep: Tensor) -> Callable[[JointEffect, int], Bank | None]:
    """Shapes around an effect's own: a third of the grid's step either side, then a tenth, ..."""

    def refine(effect: JointEffect, level: int) -> Bank | None:
        kind = type(effect)
        offsets = torch.linspace(-1, 1, 7, dtype=torch.float64)
        axes = []
        for shape, value in zip(kind.shapes, effect.shape_values, strict=True):
            scale = evaluator.scale(shape, effect.joint)
            if kind.name == "cogging":
                grid = evaluator.grid(kind, effect.joint).flatten()
                step = float(grid[1] - grid[0]) if len(grid) > 1 else 1.0
                tried = value + offsets * step / 3**level
            elif shape.logarithmic:
                ratio = _largest_ratio(shape.grid) ** (1 / 3**level)
                tried = value * ratio**offsets
            else:
                step = max(b - a for a, b in pairwise(shape.grid)) * scale
                tried = value + offsets * step / 3**level
            axes.append(tried.clamp(shape.low * scale, shape.high * scale))
        if not axes:
            return None
        bank = evaluator.joint_bank(
            kind, effect.joint, torch.cartesian_prod(*axes).reshape(-1, len(axes))
        )
        return masked(bank, keep)

    return refine


def _largest_ratio(grid: Sequence[float]) -> float:
    return max((b / a for a, b in pairwise(grid)), default=2.0)


def fitted(problem: Problem, terms: Sequence[Term]) -> Fit:
    """Least squares of all terms together, with block-robust standard deviations.

    Columns are scaled to length one; directions that the rows do not determine stay at zero. The
    covariance is G^-1 (sum_b s_b s_b') G^-1 over block scores s_b = sum_t x_t r_t (White 1980;
    blocks as clusters).
    """
    both = (*problem.fixed, *terms)
    n, count = problem.y.shape
    if not both:
        return Fit((), (), float(problem.y.square().sum()))
    frame = rows_of_all(n, count)
    a = torch.cat([frame(t) for t in both])
    size = a.norm(dim=1).clamp(min=1e-300)
    a = a / size.unsqueeze(1)
    values, vectors = torch.linalg.eigh(a @ a.T)
    kept = values > DETERMINED * values[-1]
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    y = problem.y.flatten()
    x = inverse @ (a @ y)
    r = y - x @ a
    block = problem.block.repeat(n)
    k = int(block.max()) + 1
    scores = a.new_zeros(len(a), k).index_add_(1, block, a * r)
    spread = inverse @ (scores @ scores.T) @ inverse * (k / max(1, k - 1))
    std = spread.diagonal().clamp(min=0).sqrt() / size
    lengths = [len(t.columns) for t in both]
    return Fit(tuple((x / size).split(lengths)), tuple(std.split(lengths)), float(r.square().sum()))


def rows_of_all(n: int, count: int) -> Callable[[Term], Tensor]:
    """From a term to its columns in the rows of all joints."""

    def full(term: Term) -> Tensor:
        if term.place is None:
            return term.columns
        out = term.columns.new_zeros(len(term.columns), n, count)
        out[:, term.place] = term.columns
        return out.flatten(1)

    return full


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
        else:
            effects = _with_effect(effects, term.effects[0], values.tolist())
    return robot.with_parameters(InertialParameters(pi)), tuple(effects)


def _with_effect(effects: list[Valued], effect: Effect, values: list[float]) -> list[Valued]:
    """Effects with one more; the same one, already there, grows by the values."""
    for k, (other, old) in enumerate(effects):
        if other == effect:
            sums = [a + b for a, b in zip(old, values, strict=True)]
            return [*effects[:k], (other, sums), *effects[k + 1 :]]
    return [*effects, (effect, values)]
