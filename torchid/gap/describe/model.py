"""From causes to a corrected model: all coefficients together, columns taken anew at the model.

Some columns depend on the model (friction that grows with load, compliance, delay), and some are
secants of something nonlinear (an encoder's offset). Gauss-Newton steps on the residual of the
corrected model itself settle both, and what is nonlinear in several coefficients at once; shapes
that the search has refined take part in them. Slabs are those of the search; links that are bodies
stay bodies.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import torch

from torchid.design.bodies import Bodies, Prior, links_near, some_body, together, usual_bodies
from torchid.design.columns import Columns, Model, Place, on_joint
from torchid.design.deflection import Compliance
from torchid.design.gram import inverse_root
from torchid.design.resonance import Swing
from torchid.effects.base import Coefficient, Effect, JointEffect
from torchid.effects.registry import KINDS, Valued
from torchid.gap.causes.candidates import Library, Term, columns_of, excluding
from torchid.gap.causes.evidence import Fit
from torchid.gap.causes.search import Search
from torchid.gap.data import Data
from torchid.gap.describe.discrepancy import Discrepancy, body_errors
from torchid.gap.describe.shapes import FreeShape, free_shapes, shaped
from torchid.gap.problem import Problem
from torchid.gap.wanted import BASE, Wanted
from torchid.identification.knowledge import known_names
from torchid.results.cause import LINK
from torchid.results.words import PAYLOAD
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.statistics.autocorrelation import integrated_time
from torchid.statistics.blocks import block_length, block_numbers
from torchid.statistics.criteria import BODY_STD
from torchid.statistics.evidence import CONVERGED
from torchid.statistics.jackknife import DETERMINED, fit_statistics
from torchid.statistics.robust import huber_weights
from torchid.typing import Bool, Float, Int, Tensor

A_BASE_PARAMETER = Coefficient("", "", False, "a base parameter")


STEPS = 12
"""Gauss-Newton steps at most, of which two to four are the rule: they end by the evidence."""

ROBUST = 2
"""Times that rows are weighed by what a fit leaves: more would take what one run of several has
for rows that are far out."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a corrected model: a cause, or what is always fitted.

    Attributes:
        name: of the effect, or `all_base`.
        effects: whose coefficients they are: one; several that share theirs; none of base
            parameters.
        place: the joint whose torque alone it changes, or None.
        coefficients: C of them; base parameters have one description for all.
        known: what the model as given has of each.
        precision: (C, C) inverse covariance of the coefficients before the log is seen.
        most: (C,) size that each can have on this robot.
        rows: (C,) places among the links' parameters, of a correction of these and of a load.
        change: (L, 10) of the links' parameters per unit of the one coefficient, of a mistake of
            the robot's file.
        instead: the model's own effect in whose place it stands: the same with another shape.
        seen: what another sensor tells of the coefficient.
        bodies: which are corrected, and stay bodies; None of none.
        term: the cause; None of what is always fitted.
    """

    name: str
    effects: tuple[Effect, ...]
    place: Place
    coefficients: tuple[Coefficient, ...]
    known: tuple[float, ...]
    precision: Float[Tensor, "C C"]
    most: Float[Tensor, " C"]
    rows: Int[Tensor, " C"] | None = None
    change: Float[Tensor, "L 10"] | None = None
    instead: Valued | None = None
    seen: Compliance | Swing | None = None
    bodies: Bodies | None = None
    term: Term | None = None

    @property
    def count(self) -> int:
        """C."""
        return len(self.coefficients)

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints, from 0, that it acts at; none of what belongs to the whole arm."""
        return self.effects[0].joints if len(self.effects) == 1 else ()

    @property
    def inertial(self) -> bool:
        """Whether it corrects the links' own parameters."""
        return self.name in (BASE, LINK)

    @property
    def links(self) -> list[int]:
        """Links whose parameters it corrects, one for each of them."""
        return [] if self.rows is None else (self.rows // PARAMETERS_PER_LINK).tolist()

    @cached_property
    def centre(self) -> Float[Tensor, " C"]:
        """Where the coefficients are expected: at what another sensor says, or the model has."""
        if self.instead is not None:
            return torch.tensor(self.instead[1], dtype=torch.float64)
        value = 0.0 if self.seen is None else self.seen.value - self.known[0]
        return torch.full((self.count,), value, dtype=torch.float64)

    @cached_property
    def least(self) -> Float[Tensor, " C"]:
        """The least correction that no physics forbids; -inf where it allows any."""
        free = torch.full((self.count,), -torch.inf, dtype=torch.float64)
        if not self.effects or self.rows is not None:
            return free
        known = [0.0] * self.count if self.instead else self.known
        pairs = zip(self.effects[0].ranges, known, strict=True)
        return torch.tensor([min(low, 0.0) - v for (low, _), v in pairs], dtype=torch.float64)

    def columns(self, at: Columns) -> Float[Tensor, "C n N"]:
        """Its columns on all joints, at the columns' model."""
        if self.rows is not None:
            return at.regressor.flatten(0, 1)[self.rows]
        if self.change is not None:
            return torch.tensordot(self.change, at.regressor, 2).unsqueeze(0)
        every = [columns_of(at, [e])[0] for e in self.effects]
        return sum(x if place is None else on_joint(x, place, at.n) for place, x in every)  # type: ignore[return-value]

    def shapes(self, k: int, values: Float[Tensor, " C"], at: Columns) -> Iterator[FreeShape]:
        """Its free shapes as the k-th part: of a cause on one joint, unless it is a change of what
        the model has of the same shape."""
        effect = self.effects[0] if len(self.effects) == 1 and self.term is not None else None
        if isinstance(effect, JointEffect) and effect.shapes and not any(self.known):
            yield from free_shapes(k, effect, values, at)

    def at_estimate(self, values: Float[Tensor, " C"]) -> "Part":
        """The part with secants at the estimate."""
        return replace(self, effects=tuple(e.at_estimate(values.tolist()) for e in self.effects))


# ---------------------------------------------------------------------- parts


def parts_of(library: Library, terms: Sequence[Term]) -> tuple[Part, ...]:
    """What is always fitted, and causes beside it."""
    return (*_always(library), *(_cause(library, t) for t in terms))


def free_parts(model: Model, wanted: Wanted) -> tuple[Part, ...]:
    """Base parameters, where they are free, and the background, of which nothing is known."""
    count = len(wanted.base.by_link)
    out = [_base(wanted, torch.zeros(count, count).double())] if wanted.free else []
    for name in wanted.background:
        effects = [KINDS[name](joint) for joint in range(model.robot.n)]  # type: ignore[call-arg]
        out += [_own(e, _known(e, model)) for e in effects]
    return tuple(out)


def _always(library: Library) -> tuple[Part, ...]:
    wanted, given = library.problem.wanted, library.problem.given.model
    if wanted.free or wanted.background:
        return free_parts(given, wanted)
    if wanted.knowledge is None:
        return ()
    # What the model leaves open of itself: base parameters first, then coefficients by name.
    own = [(e, v, known_names(e)) for e, v in given.effects if not e.event]
    own = [x for x in own if set(x[2]) <= set(wanted.knowledge.coefficients)]
    asked = wanted.knowledge.over([name for *_, names in own for name in names])
    at = torch.tensor([*wanted.base.by_link, *range(asked.rigid, len(asked.information))])
    known = asked.information[at.unsqueeze(1), at]
    # Together they have one precision, which the first of them holds.
    return (_base(wanted, known), *(_own(e, tuple(v)) for e, v, _ in own))


def _base(wanted: Wanted, known: Float[Tensor, "F F"]) -> Part:
    """Base parameters, with what is known of them and of all that follows."""
    count = len(wanted.base.by_link)
    rows, free = torch.tensor(wanted.base.by_link), torch.full((count,), torch.inf).double()
    return Part(BASE, (), None, (A_BASE_PARAMETER,) * count, (0.0,) * count, known, free, rows)


def _own(effect: Effect, values: tuple[float, ...]) -> Part:
    """An effect of the model itself, whose precision stands with the base parameters'."""
    count = len(effect.coefficients)
    none, free = torch.zeros(0, 0).double(), torch.full((count,), torch.inf).double()
    place = effect.joint if isinstance(effect, JointEffect) else None
    return Part(effect.name, (effect,), place, effect.coefficients, values, none, free)


def _cause(library: Library, term: Term) -> Part:
    """A cause, as part of a model."""
    given, effect, none = library.problem.given.model, term.effect, (0.0,) * term.count
    robot, root = given.robot, torch.from_numpy(np.linalg.inv(term.spread))
    coefficients = (A_BASE_PARAMETER,) * term.count if effect is None else effect.coefficients
    every = () if effect is None else (effect,)
    if term.common:
        kind: Any = KINDS[term.name]
        every = tuple((kind.candidates if term.change is None else kind.starts)(robot))
    make = partial(
        Part, term.name, every, term.place, coefficients, precision=root.T @ root,
        most=torch.from_numpy(term.high), term=term,
    )  # fmt: skip
    if term.change is not None:
        return make(known=none, change=torch.from_numpy(term.change))
    if effect is None or term.inertial:
        links = list(range(robot.bodies[0], robot.n_links))
        if effect is not None:
            links = [robot.own_links[term.joints[0]] if term.joints else links[-1]]
        pi = robot.require_parameters("a cause").pi.double()
        there = {LINK: tuple(pi[links[0]].tolist()), PAYLOAD: library.problem.load}
        return make(
            known=there.get(term.name, none),
            rows=torch.cat([torch.arange(10 * link, 10 * link + 10) for link in links]),
            bodies=_bodies(pi, links, there[PAYLOAD] if term.name == PAYLOAD else None),
        )
    known = none if term.common else _known(effect, given)
    # In the place of the model's own it is the whole of it.
    own = [v for v in given.effects if term.place is not None and v[0].identity == effect.identity]
    return make(known=known, instead=own[-1] if own and not any(known) else None, seen=term.seen)


def _known(effect: Effect, model: Model) -> tuple[float, ...]:
    """Coefficients that a model has of exactly this effect; zeros where it has none."""
    each = [torch.tensor(v).double() for e, v in model.effects if e == effect]
    return tuple(sum(each, torch.zeros(len(effect.coefficients)).double()).tolist())


def _bodies(
    pi: Float[Tensor, "L 10"], links: list[int], load: tuple[float, ...] | None
) -> Bodies | None:
    """Bodies that stay bodies: a load, of which no more is known, beside the one that the file has,
    or links that are bodies."""
    usual = usual_bodies(pi)
    if load is not None:
        return some_body(usual[-1], torch.tensor(load, dtype=torch.float64))
    near = links_near(pi, usual, BODY_STD)
    own = [near[link] for link in links] if near else []
    every = together([b.shifted(k * PARAMETERS_PER_LINK) for k, b in enumerate(own)])
    # How near to what they were stands in the precision.
    return None if every is None else replace(every, metric=torch.zeros_like(every.metric))


def prior_of(parts: Sequence[Part]) -> Prior:
    """What is known of the coefficients of parts before the log is seen."""
    total = sum(p.count for p in parts)
    known, zero = torch.zeros(total, total, dtype=torch.float64), torch.zeros(total).double()
    bodies, centre, first = [], [torch.zeros(0).double()], 0
    for part in parts:
        last = first + len(part.precision)
        known[first:last, first:last] += part.precision
        bodies += [] if part.bodies is None else [part.bodies.shifted(first)]
        centre.append(part.centre)
        first += part.count
    return Prior(zero, together(bodies), torch.cat(centre), known)


# ---------------------------------------------------------------------- the corrected model


@dataclass(frozen=True, eq=False)
class Solution:
    """A corrected model.

    Attributes:
        start: the model that is corrected.
        parts: what is always fitted first, secants at the estimate.
        values, std: per part (C,): coefficients, and standard deviations by a block jackknife, of
            which `HALF_95` are the 95 % interval, however few blocks there are.
        covariance: (K + S, K + S) of all coefficients, part by part, and of the free shapes; the
            roots of its diagonal are the standard deviations.
        columns: at the corrected model.
        weight: (n,) of the joints' squares.
        a: (K, n, N) columns at the corrected model; zero where no sample counts.
        left: (n, N) what the corrected model leaves; likewise.
        shapes: S free shapes.
        of_load: (n,) root mean squares that a load's body leaves, and any ten numbers in its place
            [N m; N]; None where these are a body's, too, or there is no load.
    """

    start: Model
    parts: tuple[Part, ...]
    values: tuple[Float[Tensor, " _"], ...]
    std: tuple[Float[Tensor, " _"], ...]
    covariance: Float[Tensor, "P P"]
    columns: Columns
    weight: Float[Tensor, " n"]
    a: Float[Tensor, "K n N"]
    left: Float[Tensor, "n N"]
    shapes: tuple[FreeShape, ...] = ()
    of_load: tuple[Float[Tensor, " n"], Float[Tensor, " n"]] | None = None

    @property
    def model(self) -> Model:
        """Corrected."""
        return self.columns.model

    def at(self, k: int) -> slice:
        """Places of the k-th part's coefficients among all."""
        first = sum(len(v) for v in self.values[:k])
        return slice(first, first + len(self.values[k]))

    def of_shapes(self, k: int) -> dict[str, float]:
        """Standard deviations of the k-th part's free shapes, by name."""
        every = self.covariance.diagonal()[len(self.a) :].clamp(min=0).sqrt().tolist()
        return {s.name: std for s, std in zip(self.shapes, every, strict=True) if s.part == k}

    def number(self, term: Term) -> int:
        """Number of the part that a cause is."""
        return next(k for k, p in enumerate(self.parts) if p.term is term)

    def torque(self, k: int) -> Float[Tensor, "n N"]:
        """Samples that the k-th part adds."""
        return torch.tensordot(self.values[k], self.a[self.at(k)], 1)

    def main(self, k: int) -> int:
        """Number of the k-th part's coefficient that makes most of its torque; the first, of a
        body, whose numbers make none apart."""
        if any(e.inertial for e in self.parts[k].effects):
            return 0
        squares = self.a[self.at(k)].square().sum((1, 2))
        return int((self.values[k].square() * squares).argmax())

    def largest(self, term: Term) -> tuple[float, float]:
        """A cause's coefficient that makes most of its torque, and its standard deviation."""
        k = self.number(term)
        main = self.main(k)
        return float(self.values[k][main]), float(self.std[k][main])

    def without(self, fitted: Bool[Tensor, " N"]) -> Model:
        """The same parts, fitted on some of the samples only. What happened once cannot be
        predicted: a part that these samples hardly hold keeps the coefficients of all."""
        if not self.values:
            return self.model
        x = torch.cat(self.values)
        # Which parts these samples hold enough of.
        squares = self.a.square().sum(1).split([len(v) for v in self.values])
        # 0.3: share of a part's squares that the other folds must hold for its coefficients to be
        # taken from them; of something that is there all the time four folds of five hold 0.8
        held = [float((s * fitted).sum(-1).max()) >= 0.3 * float(s.sum(-1).max()) for s in squares]
        free = torch.cat([torch.full((len(v),), h) for v, h in zip(self.values, held, strict=True)])
        # One Gauss-Newton step of those from the solution, from what is known beforehand.
        weight = self.weight.sqrt().unsqueeze(1) * fitted
        y = ((self.left + torch.tensordot(x * free, self.a, 1)) * weight).flatten()
        a = (self.a * free[:, None, None] * weight).flatten(1)
        again = prior_of(self.parts).solve(a @ a.T, a @ y)
        again = torch.where(free, again, x)
        return corrected_model(self.start, self.parts, again.split([len(v) for v in self.values]))


def solve(problem: Problem, search: Search, fit: Fit, steps: int = STEPS) -> Solution:
    """The corrected model of a fit, by so many steps at most."""
    parts = parts_of(search.library, fit.terms)
    values = [torch.zeros(p.count, dtype=torch.float64) for p in parts]
    first = len(parts) - len(fit.terms)
    for k, x in enumerate(fit.values(), first):
        own = parts[k].instead
        values[k] = torch.from_numpy(x) + (0.0 if own is None else torch.tensor(own[1]).double())
    samples = torch.from_numpy(fit.samples)
    return solve_parts(
        problem.given, parts, values, problem.data, problem.block, samples, steps, problem.as_cad
    )


def refitted(columns: Columns, data: Data, wanted: Wanted) -> Solution:
    """The columns' model with base parameters, and the background, fitted anew."""
    parts = free_parts(columns.model, replace(wanted, free=True))
    x = [torch.zeros(p.count, dtype=torch.float64) for p in parts]
    return solve_parts(columns, parts, x, data, blocks_of(data, None))


def blocks_of(data: Data, columns: Columns | None) -> Int[Tensor, " N"]:
    """Block (N,) of every sample: several times as long as what a model leaves is correlated."""
    bounds = data.samples.bounds
    time = 1.0
    if columns is not None:
        time = float(integrated_time(columns.gap * data.keep, bounds).median())
    return block_numbers(bounds, block_length(len(data.samples), time))


def solve_parts(
    columns: Columns,
    parts: Sequence[Part],
    x: Sequence[Float[Tensor, " _"]],
    data: Data,
    block: Int[Tensor, " N"],
    effective: Float[Tensor, " n"] | None = None,
    steps: int = STEPS,
    as_cad: bool = False,
) -> Solution:
    """Fit parts together, from coefficients near the solution.

    Args:
        columns: at the model as given.
        parts: what is always fitted first.
        x: per part (C,).
        data: which samples count.
        block: (N,) block of every sample, for the standard deviations.
        effective: (n,) independent samples, beside which counts what is known beforehand; as many
            as there are if None.
        steps: of Gauss and Newton at most; without any the coefficients are those given.
        as_cad: whether nobody vouches for the bodies' parameters.
    """
    start, prior = columns.model, prior_of(parts)
    rows = data.keep.sum(1).clamp(min=1).double()
    share = torch.ones_like(rows) if effective is None else (effective / rows).clamp(max=1.0)
    taken, values, none = list(parts), list(x), torch.zeros(0, dtype=torch.float64)
    best: Solution | None = None
    change, last, gain, weighed = _Step(none, none), torch.inf, torch.inf, 0
    far = weight = torch.ones_like(data.keep, dtype=torch.float64)
    for step in range(steps + 1):
        # The corrected model at the estimate, and what it leaves.
        taken = [p.at_estimate(v) for p, v in zip(taken, values, strict=True)]
        at = columns.at(corrected_model(start, taken, values))
        left = at.gap * data.keep
        whole = torch.cat([none, *values])
        far = far if steps else huber_weights(left)
        # Half of a step that does not lower the loss is taken.
        loss = float((weight * left).square().sum()) + prior.value(whole)
        if best is not None and not loss < last:
            change = change.half
            taken, values = change.of(best)
            continue
        # Every joint in units of what it leaves.
        of_joint = share * rows / left.square().sum(1).clamp(min=1e-300)
        each = [p.columns(at) for p in taken]
        # Columns at the corrected model, for the next step and for the standard deviations.
        a = torch.cat(each) * data.keep if each else left.new_zeros(0, *left.shape)
        free = tuple(
            replace(s, slope=s.slope * data.keep)
            for k, (p, v) in enumerate(zip(taken, values, strict=True))
            for s in p.shapes(k, v, at)
        )
        unknown = a.new_zeros(len(a) + len(free), len(a) + len(free))
        best = Solution(
            start, tuple(taken), tuple(values), (), unknown, at, of_joint, a, left, free
        )
        while True:
            weight = far * of_joint.sqrt().unsqueeze(1)
            if step == steps or not len(a):
                break
            change = _gauss_newton(best, prior, weight)
            now = float((weight * left).square().sum()) + prior.value(whole)
            then = float((weight * (left - change.torque(best))).square().sum())
            gain = now - then - prior.value(whole + change.x)
            # Coefficients to begin with may be none that physics allows: the first step may cost.
            last, gain = (now, gain) if step else (torch.inf, abs(gain))
            if gain >= 2 * CONVERGED or weighed == ROBUST:
                break
            # Rows far out of a fit of all, at reversals, count as their limit, as told from there:
            # so it does not matter where it began.
            far, weighed = huber_weights(left), weighed + 1
        if gain < 2 * CONVERGED or step == steps or not len(a):
            break
        taken, values = change.of(best)
    assert best is not None
    if not len(best.a):
        return best
    bodies = best.a[:0]
    if as_cad and all(p.name != BASE for p in taken):
        bodies = body_errors(columns, {k for p in taken if p.inertial for k in p.links}) * data.keep
    return _with_deviations(best, data, block, prior, weight, steps > 0, bodies)


@dataclass(frozen=True, eq=False)
class _Step:
    """A change (K,) of a solution's coefficients, and (S,) of its free shapes."""

    x: Float[Tensor, " K"]
    shapes: Float[Tensor, " S"]

    @property
    def half(self) -> "_Step":
        """Half as far."""
        return _Step(self.x / 2, self.shapes / 2)

    def torque(self, of: Solution) -> Float[Tensor, "n N"]:
        """Of the step, along the slopes."""
        return torch.tensordot(torch.cat([self.x, self.shapes]), _every(of), 1)

    def of(self, best: Solution) -> tuple[list[Part], list[Float[Tensor, " _"]]]:
        """Parts and coefficients after it."""
        parts = list(best.parts)
        for s, by in zip(best.shapes, self.shapes.tolist(), strict=True):
            part = parts[s.part]
            (effect,) = part.effects
            assert isinstance(effect, JointEffect)
            parts[s.part] = replace(part, effects=(shaped(effect, s.name, s.value + by),))
        steps = self.x.split([len(v) for v in best.values])
        return parts, [v + by for v, by in zip(best.values, steps, strict=True)]


def _every(best: Solution) -> Float[Tensor, "P n N"]:
    """Columns of coefficients, and slopes of free shapes."""
    return torch.cat([best.a, *(s.slope.unsqueeze(0) for s in best.shapes)])


def _gauss_newton(best: Solution, prior: Prior, weight: Float[Tensor, "n N"]) -> _Step:
    """What columns and slopes see in what is left, beside what is known beforehand: shapes go no
    farther than their ends, and coefficients stay within physics beside them."""
    flat, rest = (_every(best) * weight).flatten(1), (best.left * weight).flatten()
    gram, k, now = flat @ flat.T, len(best.a), torch.cat(best.values)
    right = flat @ rest + gram[:, :k] @ now
    known = torch.tensor([s.std**-2 for s in best.shapes], dtype=torch.float64)
    # Shapes first: what is left of the coefficients' equations beside them.
    own = torch.linalg.inv(gram[k:, k:] + torch.diag(known)) @ torch.cat(
        [gram[k:], right[k:].unsqueeze(1)], 1
    )
    inner = gram[:k, :k] - gram[:k, k:] @ own[:, :k]
    x = within_physics(best.parts, prior, inner, right[:k] - gram[:k, k:] @ own[:, -1])
    shapes = own[:, -1] - own[:, :k] @ x
    ends = torch.tensor([[e - s.value for e in s.ends] for s in best.shapes]).double().view(-1, 2)
    within = shapes.clamp(ends[:, 0], ends[:, 1])
    if not torch.equal(within, shapes):
        beside = right[:k] - gram[:k, k:] @ within
        x = within_physics(best.parts, prior, gram[:k, :k], beside)
    return _Step(x - now, within)


def _with_deviations(
    best: Solution,
    data: Data,
    block: Int[Tensor, " N"],
    prior: Prior,
    weight: Float[Tensor, "n N"],
    fitted: bool,
    bodies: Float[Tensor, "F n N"],
) -> Solution:
    """A solution with the covariance of its coefficients; rows count by their weights. Only a load
    that was fitted is held against any ten numbers; errors of `bodies` are part of what is left."""
    # Standard deviations from the spread of whole blocks of samples, all joints together, and from
    # what is known beforehand. Few blocks tell little of a spread, and one alone nothing: rows are
    # in units of what an independent sample leaves.
    k, whole = len(best.a), torch.cat(best.values)
    every = (_every(best) * weight).flatten(1)
    flat = every[:k]
    gram = flat @ flat.T
    right = flat @ (best.left * weight).flatten() + gram @ whole
    loose = _loose(best, gram, right) if fitted else None
    before = every.new_tensor([s.std**-2 for s in best.shapes])
    known = torch.block_diag(prior.squares, torch.diag(before))
    root, left = inverse_root(every @ every.T + known, known=known), (best.left * weight).flatten()
    wrong = Discrepancy.of(every, left, (bodies * weight).flatten(1), root @ root.T)
    found = fit_statistics(
        every.T, left - wrong.torque, block.repeat(len(weight)), variance=1.0, known=known
    )
    covariance = found.widened() + wrong.covariance
    own = covariance[:k, :k]
    # With another scale of a joint's torque all coefficients of its effects have it, too; those of
    # the whole arm have that of all joints.
    places = [-1 if p.place is None else p.place for p in best.parts for _ in range(p.count)]
    of_place = torch.tensor(places)
    together = of_place == of_place.unsqueeze(1)
    own += data.gain_std**2 * whole * whole.unsqueeze(1) * together
    # A coefficient that is estimated twice, by the columns' size, by another sensor, or beside a
    # load that need be no body, is not surer than the two differ.
    twice, most = [], []
    for p, v in zip(best.parts, best.values, strict=True):
        unsure = p.effects[0].unsure(v.tolist()) if p.effects else [0.0] * len(v)
        differs = torch.zeros_like(v) if p.seen is None else v - p.centre
        twice.append(torch.tensor(unsure, dtype=torch.float64).square() + differs.square())
        most.append(torch.where(p.most.isfinite(), p.most, v.abs()))
    own += torch.diag(torch.cat(twice))
    of_load = None
    if loose is not None:
        own += torch.diag((loose - whole).square())
        left = best.left - torch.tensordot(loose - whole, best.a, 1)
        rows = (weight * data.keep).square().sum(1).clamp(min=1e-300)
        body, numbers = ((weight * x).square().sum(1).div(rows).sqrt() for x in (best.left, left))
        of_load = body, numbers
    std = own.diagonal().clamp(min=0).sqrt()
    # What these columns leave open has the size that it can have on this robot, or more; of a load,
    # whatever a slab says of its ten numbers.
    open_ = undetermined(gram + prior.squares)
    for load in (best.at(i) for i, p in enumerate(best.parts) if p.name == PAYLOAD):
        open_[load] |= undetermined(flat[load] @ flat[load].T)
    std = torch.where(open_, torch.stack([std, whole.abs(), torch.cat(most)]).amax(0), std)
    parts = std.split([len(v) for v in best.values])
    return replace(best, std=tuple(parts), covariance=covariance, of_load=of_load)


def _loose(
    best: Solution, matrix: Float[Tensor, "K K"], right: Float[Tensor, " K"]
) -> Float[Tensor, " K"] | None:
    """Coefficients (K,) at the minimum beside normal equations where a load need be no body; None
    where it is one all the same, or there is none."""
    loads = [(best.at(k), p.bodies) for k, p in enumerate(best.parts) if p.name == PAYLOAD]
    parts = [replace(p, bodies=None) if p.name == PAYLOAD else p for p in best.parts]
    x = within_physics(parts, prior_of(parts), matrix, right) if loads else right
    return None if all(b is None or b.are(x[own]) for own, b in loads) else x


def undetermined(matrix: Float[Tensor, "K K"]) -> Bool[Tensor, " K"]:
    """Which of K coefficients normal equations leave open: those with a part in a direction that no
    column shows."""
    size = matrix.diagonal().sqrt()
    size = torch.where(size > 0, size, torch.inf)
    values, axes = torch.linalg.eigh(matrix / size / size.unsqueeze(1))
    # 1e-6: squared part of a coefficient in what the columns leave open, from which it is open, too
    return axes[:, values < DETERMINED * values[-1]].square().sum(1) > 1e-6


def within_physics(
    parts: Sequence[Part],
    prior: Prior,
    matrix: Float[Tensor, "K K"],
    right: Float[Tensor, " K"],
) -> Float[Tensor, " K"]:
    """The minimum beside normal equations, without coefficients that no file of a robot may hold:
    what lies beyond a bound is put at the bound, all others anew.

    Args:
        parts: of the K coefficients.
        prior: what is known beforehand.
        matrix, right: normal equations.
    """
    x = prior.solve(matrix, right)
    least = torch.cat([torch.zeros(0, dtype=torch.float64), *(p.least for p in parts)])
    # A change of what the model leaves open itself: the two together are bounded.
    first, own, both = 0, dict[tuple[Effect, ...], int](), list[tuple[int, int]]()
    for p in parts:
        if p.term is None and p.effects:
            own[p.effects] = first
        elif p.effects in own:
            both += [(first + c, own[p.effects] + c) for c in range(p.count)]
        first += p.count
    held = torch.zeros(len(x), dtype=torch.bool)
    while True:
        bound = least.clone()
        for change, slack in both:
            bound[change] -= x[slack]
        below = (x < bound) & ~held
        if not bool(below.any()):
            return x
        held |= below
        # As if the bound had been measured a million times as well as everything else.
        at_bound = torch.where(held, bound.clamp(min=-1e300), torch.zeros_like(x))
        rise = 1e6 * (matrix.diagonal() + prior.squares.diagonal()).clamp(min=1e-12) * held
        x = prior.solve(matrix + torch.diag(rise), right + rise * at_bound)
        x = torch.where(held, at_bound, x)


def corrected_model(
    start: Model, parts: Sequence[Part], values: Sequence[Float[Tensor, " _"]]
) -> Model:
    """The model with fitted parts: other inertial parameters, further effects. An effect that it
    has already grows by the coefficients; another shape of it stands in its place."""
    nominal = start.robot.require_parameters("a diagnosis").pi.double()
    pi, effects = nominal.clone(), list[Valued](start.effects)
    for part, v in zip(parts, values, strict=True):
        if part.inertial:
            pi.view(-1)[part.rows] += v
        elif part.change is not None:
            pi += float(v) * part.change
        else:
            if part.instead is not None:
                effects = [p for p in effects if p[0] != part.instead[0]]
            own = v
            if part.rows is not None:  # a load takes the place of the one in its link
                there = torch.tensor(part.known, dtype=torch.float64)
                pi.view(-1)[part.rows] -= there
                own = v + there
            for effect in part.effects:
                effects = _grown(effects, effect, own.tolist())
    same = torch.equal(pi, nominal)
    robot = start.robot if same else start.robot.with_parameters(InertialParameters(pi))
    return Model(robot, tuple(effects))


def _grown(effects: list[Valued], effect: Effect, values: list[float]) -> list[Valued]:
    """Effects with one more; the same one, already there, grows by the values."""
    for k, (other, old) in enumerate(effects):
        same = other.identity == effect.identity and other.shape_values == effect.shape_values
        if other == effect or (same and effect.linearised):
            sums = [a + b for a, b in zip(old, values, strict=True)]
            return [*effects[:k], (effect.at_estimate(sums), sums), *effects[k + 1 :]]
    return [*effects, (effect, values)]


# ---------------------------------------------------------------------- what is told


@dataclass(frozen=True, eq=False)
class Explanation:
    """Causes, what they leave, and the model that they correct.

    Attributes:
        problem: which they explain.
        search: that found them.
        fit: of them, beside what is always fitted.
        solution: the corrected model.
    """

    problem: Problem
    search: Search
    fit: Fit
    solution: Solution

    @classmethod
    def of(cls, problem: Problem, search: Search, fit: Fit) -> "Explanation":
        """Of a fit."""
        return cls(problem, search, fit, solve(problem, search, fit))

    @property
    def terms(self) -> tuple[Term, ...]:
        """The causes."""
        return self.fit.terms

    @cached_property
    def empty(self) -> Fit:
        """The explanation without a cause."""
        return self.search.empty()

    @property
    def fixed(self) -> int:
        """Number of parts that are always fitted."""
        return len(self.solution.parts) - len(self.terms)

    def without(self, *gone: Term) -> Fit:
        """The fit without some terms, with as many samples."""
        return self.search.evidence.fit(excluding(self.terms, gone), self.fit.samples)

    def instead(self, term: Term, other: Term) -> Fit:
        """The fit with another term in the place of one."""
        terms = (*excluding(self.terms, [term]), other)
        return self.search.evidence.fit(terms, self.fit.samples)

    def dropped(self) -> "Explanation":
        """None of the causes, and the model as it is then."""
        fit = self.search.again(self.search.evidence.fit((), self.fit.samples))
        return Explanation.of(self.problem, self.search, fit)

    def mean(self, squares: Float[Tensor, "n N"]) -> Float[Tensor, " n"]:
        """Means over the samples that count."""
        return squares.sum(1) / torch.from_numpy(self.search.library.rows)

    @cached_property
    def least(self) -> Float[Tensor, " n"]:
        """Torque (n,) from which on a cause is worth a name beside the gap [N m; N]."""
        library = self.search.library
        return self.worth(torch.from_numpy(self.empty.losses / library.rows))

    def worth(self, error: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """This question where the error without it has such mean squares: the larger of a share of
        the error and a share of the torque; and more than the model was seen to leave on its own
        log.

        Args:
            error: (n,) mean squares.
        """
        library, settings = self.search.library, self.problem.settings
        root, left = error.clamp(min=0).sqrt(), torch.from_numpy(library.known_noise)
        torque = settings.worthwhile_torque * torch.from_numpy(library.torque)
        # By so much the error falls with a cause that is as large as what the model has left
        # unexplained before; one that is smaller may be a part of that.
        beyond = error - left.square()
        by = torch.where(beyond > 0, root - beyond.clamp(min=0).sqrt(), left)
        every = torch.stack([settings.worthwhile * root, torque, by])
        return every.amax(0).clamp(min=1e-300)
