"""From terms to a corrected model: all coefficients together, columns taken anew at what was found.

Some columns depend on the model (friction that grows with load, compliance, delay), and some are
secants of something nonlinear (an encoder's offset). Gauss-Newton steps on the residual of the
corrected model itself settle both, and what is nonlinear in several coefficients at once.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch

from torchid.design.bodies import Prior
from torchid.design.columns import Columns, Model
from torchid.effects.base import Effect
from torchid.effects.registry import Valued
from torchid.gap.data import Data
from torchid.gap.search.evidence import prior_of
from torchid.gap.search.terms import BASE, LINK, PAYLOAD, Term, Wanted, term_columns
from torchid.robot.inertia import InertialParameters
from torchid.statistics.jackknife import DETERMINED, fit_statistics
from torchid.statistics.robust import huber_weights
from torchid.typing import Bool, Float, Int, Tensor

FORETOLD = 0.3
"""Share of a term's squares that the other folds must hold for its coefficients to be taken from
them [1]; of something that is there all the time four folds of five hold 0.8."""

OPEN = 1e-6
"""Squared part of a coefficient in what the columns leave open, from which it is open, too."""

STEPS = 4
SETTLED_SHARE = 1e-4
"""Gauss-Newton steps at most, and the share of the loss that one must gain to be followed by
another."""


@dataclass(frozen=True, eq=False)
class Solution:
    """A corrected model.

    Attributes:
        start: the model that is corrected.
        wanted: what was looked for.
        terms: fixed ones first, secants at the estimate.
        values, std: per term (C,): coefficients, and standard deviations by a block jackknife, of
            which `HALF_95` are the 95 % interval, however few blocks there are.
        covariance: (K, K) of all coefficients, term by term; std are the roots of its diagonal.
        model: corrected.
        weight: (n,) of the joints' squares.
        a: (K, n, N) columns at the corrected model; zero where no sample counts.
        left: (n, N) what the corrected model leaves; likewise.
    """

    start: Model
    wanted: Wanted
    terms: tuple[Term, ...]
    values: tuple[Float[Tensor, " _"], ...]
    std: tuple[Float[Tensor, " _"], ...]
    covariance: Float[Tensor, "K K"]
    model: Model
    weight: Float[Tensor, " n"]
    a: Float[Tensor, "K n N"]
    left: Float[Tensor, "n N"]

    def at(self, k: int) -> slice:
        """Places of the k-th term's coefficients among all."""
        first = sum(len(v) for v in self.values[:k])
        return slice(first, first + len(self.values[k]))

    def main(self, k: int) -> int:
        """Number of the k-th term's coefficient that makes most of its torque; the first, of a
        body, whose numbers make none apart."""
        if any(e.inertial for e in self.terms[k].effects):
            return 0
        squares = self.a[self.at(k)].square().sum((1, 2))
        return int((self.values[k].square() * squares).argmax())

    @cached_property
    def products(self) -> Float[Tensor, "K K"]:
        """Of the columns, joints by their weights."""
        flat = (self.a * self.weight.sqrt().unsqueeze(1)).flatten(1)
        return flat @ flat.T

    def without(self, fitted: Bool[Tensor, " N"]) -> Model:
        """The same terms, fitted on some of the samples only. What happened once cannot be
        predicted: a term that these samples hardly hold keeps the coefficients of all."""
        if not self.values:
            return self.model
        x = torch.cat(self.values)
        # Which terms these samples hold enough of.
        squares = self.a.square().sum(1).split([len(v) for v in self.values])
        held = [
            float((s * fitted).sum(-1).max()) >= FORETOLD * float(s.sum(-1).max()) for s in squares
        ]
        free = torch.cat([torch.full((len(v),), h) for v, h in zip(self.values, held, strict=True)])
        # One Gauss-Newton step of those from the solution, from what is known beforehand.
        weight = self.weight.sqrt().unsqueeze(1) * fitted
        y = ((self.left + torch.tensordot(x * free, self.a, 1)) * weight).flatten()
        a = (self.a * free[:, None, None] * weight).flatten(1)
        again = prior_of(self.terms).solve(a @ a.T, a @ y).x
        again = torch.where(free, again, x)
        parts = again.split([len(v) for v in self.values])
        return corrected_model(self.start, self.terms, parts, self.wanted)


def solve_terms(
    columns: Columns,
    terms: Sequence[Term],
    x: Sequence[Float[Tensor, " _"]],
    data: Data,
    wanted: Wanted,
    block: Int[Tensor, " N"],
    effective: Float[Tensor, " n"] | None = None,
    steps: int = STEPS,
) -> Solution:
    """Fit terms together, from coefficients near the solution.

    Args:
        columns: at the model as given.
        terms: fixed ones first.
        x: per term (C,).
        data: which samples count.
        wanted: what was looked for.
        block: (N,) block of every sample, for the standard deviations.
        effective: (n,) independent samples, beside which counts what is known beforehand; as many
            as there are if None.
        steps: of Gauss and Newton at most; without any the coefficients are those given.
    """
    start, known = columns.model, prior_of(terms)
    rows = data.keep.sum(1).clamp(min=1).double()
    share = torch.ones_like(rows) if effective is None else (effective / rows).clamp(max=1.0)
    taken, values = list(terms), list(x)
    best: Solution | None = None
    weight = torch.ones_like(data.keep, dtype=torch.float64)
    last = torch.inf
    for step in range(steps + 1):
        # The corrected model at the estimate, and what it leaves.
        taken = [at_estimate(t, v) for t, v in zip(taken, values, strict=True)]
        model = corrected_model(start, taken, values, wanted)
        at = columns.at(model)
        left = at.gap * data.keep
        # Every joint in units of what it leaves; rows far out, at reversals, count as their limit.
        if step < 2:
            of_joint = share * rows / left.square().sum(1).clamp(min=1e-300)
            weight = huber_weights(left) * of_joint.sqrt().unsqueeze(1)
        # A step that does not lower the loss is not taken, and ends the search.
        whole = torch.cat([torch.zeros(0, dtype=torch.float64), *values])
        loss = float((weight * left).square().sum()) + known.value(whole)
        if best is not None and not loss < last:
            break
        parts = [term_columns(at, t) for t in taken]
        # Columns at the corrected model, for the next step and for the standard deviations.
        a = torch.cat(parts) * data.keep if parts else left.new_zeros(0, *left.shape)
        unknown = a.new_zeros(len(a), len(a))
        best = Solution(
            start, wanted, tuple(taken), tuple(values), (), unknown, model, of_joint, a, left
        )
        if (step > 1 and last - loss < SETTLED_SHARE * last) or step == steps or not len(a):
            break
        last = loss if step > 0 else torch.inf
        # Gauss-Newton: what the columns see in what is left, and what is known beforehand.
        flat = (a * weight).flatten(1)
        gram = flat @ flat.T
        whole = within_physics(taken, known, gram, flat @ (left * weight).flatten() + gram @ whole)
        values = list(whole.split([len(v) for v in values]))
    assert best is not None
    return _with_deviations(best, data, block, known, weight) if len(best.a) else best


def _with_deviations(
    best: Solution,
    data: Data,
    block: Int[Tensor, " N"],
    known: Prior,
    weight: Float[Tensor, "n N"],
) -> Solution:
    """A solution with the covariance of its coefficients; rows count by their weights."""
    # Standard deviations from the spread of whole blocks of samples, all joints together, and from
    # what is known beforehand. Few blocks tell little of a spread, and one alone nothing: rows are
    # in units of what an independent sample leaves.
    whole = torch.cat(best.values)
    found = fit_statistics(
        (best.a * weight).flatten(1).T, (best.left * weight).flatten(),
        block.repeat(len(best.left)), variance=1.0, known=known.squares,
    )  # fmt: skip
    covariance = found.widened()
    # With another scale of a joint's torque all coefficients of its effects have it, too; those of
    # the whole arm have that of all joints.
    places = [-1 if t.place is None else t.place for t in best.terms for _ in t.at]
    of_place = torch.tensor(places)
    together = of_place == of_place.unsqueeze(1)
    covariance = covariance + data.gain_std**2 * whole * whole.unsqueeze(1) * together
    # A coefficient that is estimated twice, by the columns' size or by another sensor, is not surer
    # than the two differ.
    twice = []
    for t, v in zip(best.terms, best.values, strict=True):
        unsure = t.effects[0].unsure(v.tolist()) if t.effects else [0.0] * len(v)
        differs = torch.zeros_like(v) if t.seen is None else v - t.centre
        twice.append(torch.tensor(unsure, dtype=torch.float64).square() + differs.square())
    covariance = covariance + torch.diag(torch.cat(twice))
    std = covariance.diagonal().clamp(min=0).sqrt()
    # What these columns leave open has the size that it can have on this robot, or more.
    most = torch.cat(
        [
            v.abs() if t.most is None else t.most
            for t, v in zip(best.terms, best.values, strict=True)
        ]
    )
    std = torch.where(
        undetermined(best.products + known.squares), torch.maximum(whole.abs(), most), std
    )
    parts = std.split([len(v) for v in best.values])
    return replace(best, std=tuple(parts), covariance=covariance)


def undetermined(matrix: Float[Tensor, "K K"]) -> Bool[Tensor, " K"]:
    """Which of K coefficients normal equations leave open: those with a part in a direction that no
    column shows."""
    size = matrix.diagonal().sqrt()
    size = torch.where(size > 0, size, torch.inf)
    values, axes = torch.linalg.eigh(matrix / size / size.unsqueeze(1))
    return axes[:, values < DETERMINED * values[-1]].square().sum(1) > OPEN


def within_physics(
    terms: Sequence[Term],
    known: Prior,
    matrix: Float[Tensor, "K K"],
    right: Float[Tensor, " K"],
) -> Float[Tensor, " K"]:
    """The minimum beside normal equations, without coefficients that no file of a robot may hold:
    what lies beyond a bound by no more than its noise is put at the bound, all others anew.

    Args:
        terms: of the K coefficients.
        known: beforehand.
        matrix, right: normal equations.
    """
    x = known.solve(matrix, right).x
    least = torch.cat([torch.zeros(0, dtype=torch.float64), *(_least(t) for t in terms)])
    # A change of what the model leaves open itself: the two together are bounded.
    first = list(itertools.accumulate((len(t.at) for t in terms), initial=0))
    own = {t.effects: k for t, k in zip(terms, first, strict=False) if t.information is not None}
    both = [
        (k + c, own[t.effects] + c)
        for t, k in zip(terms, first, strict=False)
        if t.information is None and t.effects and t.effects in own
        for c in range(len(t.at))
    ]
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
        rise = 1e6 * (matrix.diagonal() + known.squares.diagonal()).clamp(min=1e-12) * held
        x = known.solve(matrix + torch.diag(rise), right + rise * at_bound).x
        x = torch.where(held, at_bound, x)


def _least(term: Term) -> Float[Tensor, " C"]:
    """Of each coefficient of a term the least that leaves the whole, with the model's own, where
    physics allows it; -inf where it allows any."""
    if not term.effects or term.name in (LINK, PAYLOAD):
        return torch.full((len(term.at),), -torch.inf, dtype=torch.float64)
    known = [0.0] * len(term.known) if term.instead else term.known
    every = zip(term.effects[0].ranges, known, strict=True)
    return torch.tensor([min(low, 0.0) - v for (low, _), v in every], dtype=torch.float64)


def at_estimate(term: Term, values: Float[Tensor, " C"]) -> Term:
    """The term with secants at the estimate."""
    return replace(term, effects=tuple(e.at_estimate(values.tolist()) for e in term.effects))


def corrected_model(
    start: Model, terms: Sequence[Term], values: Sequence[Float[Tensor, " _"]], wanted: Wanted
) -> Model:
    """The model with the fitted terms: other inertial parameters, further effects. An effect that
    it has already grows by the coefficients; another shape of it stands in its place."""
    # Inertial parameters grow; effects grow, are replaced, or join.
    nominal = start.robot.require_parameters("a diagnosis").pi.double()
    pi, effects = nominal.clone(), list[Valued](start.effects)
    for term, v in zip(terms, values, strict=True):
        if term.name == BASE:
            pi.view(-1)[term.at if term.bodies else wanted.base.by_link] += v
        elif term.change is not None:
            pi += float(v) * term.change
        elif term.name == LINK:
            pi[start.robot.own_links[term.effects[0].joints[0]]] += v
        else:
            for _, own, _ in term.instead:
                effects = [p for p in effects if p[0] != own.effects[0]]
            for effect in term.effects:
                effects = _grown(effects, effect, v.tolist())
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
