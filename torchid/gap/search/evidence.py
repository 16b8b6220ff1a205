"""One number for how good an explanation is, and what any candidate would add to it.

    E(S) = sum_j n_j log(L_j(0) / L_j(S)) - prior(x) - sum_k log n_k - 2 log(looks / alpha) c

L_j(S) is the sum of squares that the terms S leave on joint j, n_j the effective number of samples
there: of two explanations as many as tell their torques apart in noise as slow as what the better
one leaves, which hides slow torques and hardly fast ones. Every coefficient and every shape that
was searched costs log n (Schwarz 1978), every cause the logarithm of all that were looked at; the
prior is what is known of coefficients beforehand. What L leaves is the noise: while something is
missing E is careful by itself.

A cause is one term; or the same effect on most joints, where arms have it (dry friction, say).
"""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
import torch

from torchid.design.bodies import Prior, Priors, together
from torchid.design.columns import Place
from torchid.design.gram import (
    VISIBLE,
    Normal,
    Solved,
    Subset,
    inverse_root,
    visible_root,
)
from torchid.effects.registry import KINDS
from torchid.effects.transient import Contact
from torchid.gap.search.dissipation import Dissipation
from torchid.gap.search.terms import BASE, Batch, Candidates, Term, term_columns
from torchid.gap.settings import GapSettings
from torchid.statistics.autocorrelation import autocorrelation, time_of
from torchid.statistics.criteria import FORBIDDEN_STD
from torchid.typing import Bool, Float, Tensor

SET_ODDS = 20.0
"""Odds against an alternative from which no more of its kind are looked at [1]."""

LOOKED_AT = 24
"""Terms of one place and number of columns that are offered at most; more than all effects
there."""

TOGETHER = 32
"""Explanations that are fitted at once: of a hundred columns and seven joints 18 MB."""

FITTED_BEYOND_BEST = 3
"""Explanations beyond the best that are fitted at once: one more costs less than one by itself."""

TAIL_SHARE = 0.01
"""Share of a cause's largest torque that the fit's filter may leave where it does not act [1]."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """Terms, their coefficients, and what they leave.

    Attributes:
        terms: fixed ones first.
        x: (K,) coefficients, term by term.
        root: (K, K) root of their covariance, in units of the weights.
        losses: (n,) sums of squares left.
        known: the coefficients' distance from what is known beforehand, as `Prior.value`.
        evidence: E.
        effective: (n,) numbers of samples with which E was computed.
    """

    terms: tuple[Term, ...]
    subset: Subset
    x: Float[Tensor, " K"]
    root: Float[Tensor, "K K"]
    losses: Float[Tensor, " n"]
    known: float
    evidence: float
    effective: Float[Tensor, " n"]

    @property
    def weight(self) -> Float[Tensor, " n"]:
        """Of each joint's squares."""
        return self.effective / self.losses.clamp(min=1e-300)

    def values(self) -> list[Float[Tensor, " _"]]:
        """Coefficients, term by term."""
        return list(self.x.split([t.count for t in self.terms]))


@dataclass(frozen=True, eq=False)
class Question:
    """What is to be explained, by which candidates.

    Attributes:
        candidates: with their normal equations.
        normal: of the samples that are explained.
        settings: how it is decided: the level, the least worth of a cause, the most causes.
        rows: columns of terms that were in a model, as samples.
        seen: directions of terms that were looked at.
        barred: causes that are not offered, by their keys.
        residuals, slow: what fits leave, and its autocorrelations; as long as the fits are there.
        left: (n,) torque that the model has been seen to leave unexplained, RMS [N m; N]; None
            where that is not known.
    """

    candidates: Candidates
    normal: Normal
    settings: GapSettings
    rows: dict[int, Tensor] = field(default_factory=dict, repr=False)
    seen: dict[int, int] = field(default_factory=dict, repr=False)
    barred: frozenset[object] = frozenset()
    left: Float[Tensor, " n"] | None = None
    residuals: MutableMapping[Fitted, Tensor] = field(default_factory=WeakKeyDictionary, repr=False)
    slow: MutableMapping[Fitted, Tensor] = field(default_factory=WeakKeyDictionary, repr=False)

    @property
    def fixed(self) -> tuple[Term, ...]:
        """Terms that are always in the model."""
        return self.candidates.fixed

    def mean(self, squares: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Sums of squares as means over the samples that count."""
        return squares / self.normal.rows.clamp(min=1.0)

    def fall(self, fit: Fitted, without: Fitted) -> Float[Tensor, " n"]:
        """By how much a fit leaves less than one without some of its terms, as mean squares."""
        return self.mean((without.losses - fit.losses).clamp(min=0))

    def own(self, fit: Fitted) -> tuple[Term, ...]:
        """Terms of a fit beside the fixed ones."""
        return fit.terms[len(self.fixed) :]

    @property
    def known(self) -> bool:
        """Whether the model as given knows how sure it is."""
        return any(t.information is not None for t in self.fixed)

    @cached_property
    def dissipation(self) -> Dissipation:
        """Of the friction of its joints."""
        return Dissipation(self.candidates.columns, self.candidates.given)

    @cached_property
    def looks(self) -> float:
        """Causes that are looked at: every effect at every place. Its shapes have a price of their
        own."""
        return float(max(1, len({t.key for t in self.candidates.terms})))

    @cached_property
    def offered(self) -> tuple[tuple[Batch, np.ndarray], ...]:
        """Batches of candidates, but for all base parameters, with the products of every term's own
        columns: (M, C, C) on its joint, or (n, M, C, C) on all."""
        out = []
        for batch in self.candidates.batches:
            if all(t.name == BASE for t in batch.terms):
                continue
            at = batch.at.unsqueeze(2), batch.at.unsqueeze(1)
            if batch.place is None:
                out.append((batch, torch.stack([g[at] for g in self.normal.g]).numpy()))
            else:
                out.append((batch, self.normal.g[batch.place][at].numpy()))
        return tuple(out)

    @cached_property
    def squares(self) -> Float[Tensor, " n"]:
        """Sums of squares (n,) of the gap."""
        return torch.stack([g[-1, -1] for g in self.normal.g])

    @cached_property
    def joints(self) -> int:
        """Number of joints of which samples count."""
        return int((self.normal.rows > 0).sum())

    @cached_property
    def torque(self) -> Float[Tensor, " n"]:
        """Mean square (n,) of the joints' measured torque."""
        return torch.cat([s.tau for s in self.candidates.columns.samples.segments]).square().mean(0)

    def least(self, error: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Torque (n,) from which on a cause is worth a name [N m; N], where the error without it is
        so large, as a mean square."""
        # The larger of a share of the gap and a share of the torque.
        root = error.clamp(min=0).sqrt()
        gap = self.settings.worthwhile * root
        least = torch.maximum(gap, self.settings.worthwhile_torque * self.torque.sqrt())
        if self.left is not None:
            # By so much the error falls with a cause that is as large as what the model has left
            # unexplained before; one that is smaller may be a part of that.
            beyond = error - self.left.square()
            by = torch.where(beyond > 0, root - beyond.clamp(min=0).sqrt(), self.left)
            least = torch.maximum(least, by)
        return least.clamp(min=1e-300)

    def shows(self, term: Term) -> bool:
        """Whether another sensor, or the torque above the fit's band, shows as much of a cause as
        is worth a name."""
        if term.seen is None or term.seen.size < self.settings.worthwhile_torque:
            return False
        return term.seen.explained >= self.settings.worthwhile

    def price(self, alpha: float | None = None) -> float:
        """Of a cause, at a level of a false one among all that are looked at; that of the settings
        if None. It is a prior, too: of so many causes that are expected among them."""
        return 2 * math.log(self.looks / (self.settings.alpha if alpha is None else alpha))


def subset_of(normal: Normal, terms: Sequence[Term]) -> Subset:
    """Where the columns of terms are in each joint's matrix."""
    at = np.full((len(normal.g), sum(t.count for t in terms)), -1)
    first = 0
    for term in terms:
        felt = slice(None) if term.place is None else term.place
        at[felt, first : first + term.count] = term.at.numpy()
        first += term.count
    # What is explained: the gap, and the model's own effect where a term replaces it.
    instead = [(j, own.at, values) for t in terms for j, own, values in t.instead]
    return Subset(torch.from_numpy(at), tuple(instead))


def prior_of(terms: Sequence[Term]) -> Prior:
    """What is known of the coefficients of terms beforehand."""
    none = torch.zeros(0, dtype=torch.float64)
    ridge, bodies, first = [none], [], 0
    information = [t.information for t in terms if t.information is not None]
    centre = torch.cat([none, *(t.centre for t in terms)]) if any(t.seen for t in terms) else None
    for term in terms:
        ridge.append(term.ridge if term.bodies is None else torch.zeros_like(term.ridge))
        if term.bodies is not None:
            bodies.append(term.bodies.shifted(first))
        first += term.count
    # What a model knows of itself stands first.
    known = torch.cat(information) if information else None
    return Prior(torch.cat(ridge), together(bodies), centre, known)


def rows_of(question: Question, term: Term) -> Float[Tensor, "C m N"]:
    """A term's columns as samples, on its joint or on all; kept for the next time."""
    rows = question.rows.get(id(term))
    if rows is None:
        rows = term_columns(question.candidates.columns, term)
        rows = rows if term.place is None else rows[:, term.place : term.place + 1]
        question.rows[id(term)] = rows
    return rows


def residual(
    question: Question, terms: Sequence[Term], x: Float[Tensor, " K"]
) -> Float[Tensor, "n N"]:
    """Samples that terms with these coefficients leave; zero where none counts."""
    # The gap less the columns; a term that stands for the model's own takes that out, too.
    left = question.candidates.gap.clone().numpy()
    for term, own in zip(terms, x.split([t.count for t in terms]), strict=True):
        rows = rows_of(question, term).numpy()
        if term.place is None:
            left -= np.tensordot(own.numpy(), rows, 1)
        else:
            left[term.place] -= own.numpy() @ rows[:, 0]
        for joint, effect, values in term.instead:
            left[joint] += values.numpy() @ rows_of(question, effect).numpy()[:, 0]
    return torch.from_numpy(left) * question.candidates.keep


def active_share(question: Question, terms: Sequence[Term]) -> float:
    """Share of the samples in which terms act: all, but for what acts in a window of time, or
    beyond a limit. How large such a cause is, is its torque while it acts."""
    t = question.candidates.columns.samples.t
    inside = torch.zeros(len(t), dtype=torch.bool)
    for term in terms:
        effect = term.effects[0] if term.effects else None
        if isinstance(effect, Contact):
            inside |= effect.window(t) > 0
        elif effect is not None and effect.at_ends:
            size = rows_of(question, term)[0].abs().amax(0)
            inside |= size > TAIL_SHARE * size.max()
        else:
            return 1.0
    return max(float(inside.double().mean()), 1 / len(t)) if terms else 1.0


def slack_torque(question: Question, fit: Fitted) -> Float[Tensor, "n N"]:
    """Samples of the torque of what the model as given leaves open of itself, as a fit takes it."""
    fixed = question.fixed
    taken = fit.terms[: len(fixed)]
    x = fit.x[: sum(t.count for t in taken)]
    return -residual(question, taken, x) + question.candidates.gap * question.candidates.keep


def correction_torque(
    question: Question, fit: Fitted, without: Fitted, gone: Sequence[Term]
) -> Float[Tensor, " n"]:
    """Torque (n,), RMS, that without some terms the model's own corrections make in their place
    [N m; N]; zero where these are as likely then: where what was known of the model does not speak
    for the terms by as much as they cost."""
    if without.known - fit.known <= cost(question, gone, fit.effective):
        return torch.zeros_like(fit.losses)
    moved = slack_torque(question, without) - slack_torque(question, fit)
    return question.mean(moved.square().sum(1)).sqrt()


def left_by(question: Question, fit: Fitted) -> Float[Tensor, "n N"]:
    """Samples that a fit leaves; kept for the next time."""
    if fit not in question.residuals:
        question.residuals[fit] = residual(question, fit.terms, fit.x)
    return question.residuals[fit]


def effective_samples(
    question: Question, fit: Fitted, other: Fitted | None = None
) -> Float[Tensor, " n"]:
    """Independent samples (n,) among those of each joint, if what a fit leaves there is noise: as
    many as tell of a constant torque; or of that by which another fit differs."""
    left, bounds = left_by(question, fit), question.candidates.columns.samples.bounds
    if fit not in question.slow:
        question.slow[fit] = autocorrelation(left, bounds)
    times = time_of(question.slow[fit])
    if other is not None:
        along = left_by(question, other) - left
        a, b = along.square(), left.square()
        # Where they differ by rounding alone they do not differ.
        there = a.sum(1) > torch.finfo(a.dtype).eps * b.sum(1)
        slow = time_of(question.slow[fit] * autocorrelation(along, bounds))
        # Noise that is larger where the two differ more tells less of it (White 1980).
        loud = (a * b).sum(1) * question.normal.rows / (a.sum(1) * b.sum(1)).clamp(min=1e-300)
        times = (slow * loud.clamp(min=1.0)).where(there, times)
    return (question.normal.rows / times.clamp(min=1.0)).clamp(min=1e-9)


def comparable(question: Question, fit: Fitted, other: Fitted) -> tuple[Fitted, Fitted]:
    """Both fits with the evidence of as many samples as tell their torques apart in noise like what
    the one leaves that leaves less: only so can they be compared."""
    weight = question.normal.rows / fit.losses.clamp(min=1e-300)
    less = float((weight * fit.losses).sum()) <= float((weight * other.losses).sum())
    n = effective_samples(question, *((fit, other) if less else (other, fit)))

    def again(f: Fitted) -> Fitted:
        if f.evidence == -math.inf:  # refused, beside noise of another size
            weight = n / f.losses.clamp(min=1e-300)
            return fit_terms(question, question.own(f), n, weight, 1)
        return with_evidence(question, replace(f, effective=n))

    return again(fit), again(other)


def with_evidence(question: Question, fit: Fitted) -> Fitted:
    """A fit with its E: what is gained, less the distance from what is known beforehand and the
    price of the terms beside the fixed ones."""
    gain = float(log_likelihood_ratio(fit.effective, question.squares, fit.losses).sum())
    price = cost(question, question.own(fit), fit.effective)
    return replace(fit, evidence=gain - fit.known - price)


def fit_terms(
    question: Question,
    terms: Sequence[Term],
    effective: Float[Tensor, " n"],
    weight: Float[Tensor, " n"] | None = None,
    rounds: int = 2,
    *,
    conic: bool = True,
) -> Fitted:
    """The maximum of the likelihood over the coefficients of terms, and its evidence.

    Args:
        question: what is explained.
        terms: beside the fixed ones, which come first.
        effective: (n,) numbers of samples.
        weight: (n,) of the joints' squares at the start.
        rounds: how often the joints are weighted anew by what they leave. Two are enough to rank;
            ten for what is told, where columns that all joints share pull the weights apart.
        conic: whether bodies must stay bodies; without, no less is left.
    """
    return _fit_each(question, [terms], effective, weight, rounds, conic=conic)[0][0]


def refit(
    question: Question, fit: Fitted, terms: Sequence[Term], rounds: int = 2, *, conic: bool = True
) -> Fitted:
    """What `fit_terms` gives with the numbers of samples and the first weights of another fit."""
    return fit_terms(question, terms, fit.effective, fit.weight, rounds, conic=conic)


def refit_each(
    question: Question, fit: Fitted, explanations: Sequence[Sequence[Term]]
) -> list[Fitted]:
    """What `refit` gives of each of several explanations, all at once."""
    out: list[Fitted] = []
    for k in range(0, len(explanations), TOGETHER):
        some = explanations[k : k + TOGETHER]
        out += _fit_each(question, some, fit.effective, fit.weight, 2)[0]
    return out


def best_fits(
    question: Question,
    fit: Fitted,
    explanations: Sequence[Sequence[Term]],
    count: int = 1,
    worth: Callable[[Fitted], float] = lambda fit: fit.evidence,
) -> list[tuple[int, Fitted]]:
    """Of several explanations those of most evidence, the best first, as `refit_each` fits them,
    each with its place among all. To stay bodies can only cost evidence, so the conic programs of
    those that would have too little without them are never solved.

    Args:
        question, fit, explanations: as for `refit_each`.
        count: of the best.
        worth: what ranks them in the place of evidence; bodies can only cost it, too.
    """
    bounds: list[tuple[Fitted, bool]] = []
    for k in range(0, len(explanations), TOGETHER):
        some = explanations[k : k + TOGETHER]
        found = _fit_each(question, some, fit.effective, fit.weight, 2, conic=False)
        bounds += zip(*found, strict=True)
    order = sorted(range(len(bounds)), key=lambda k: -worth(bounds[k][0]))
    best: list[tuple[int, Fitted]] = []
    for first in range(0, len(order), count + FITTED_BEYOND_BEST):
        near = order[first : first + count + FITTED_BEYOND_BEST]
        if len(best) == count and worth(bounds[near[0]][0]) <= worth(best[-1][1]):
            break
        incomplete = [k for k in near if not bounds[k][1]]
        again = refit_each(question, fit, [explanations[k] for k in incomplete])
        fits = {k: bounds[k][0] for k in near} | dict(zip(incomplete, again, strict=True))
        best = sorted([*best, *fits.items()], key=lambda pair: -worth(pair[1]))[:count]
    return best


def _fit_each(
    question: Question,
    explanations: Sequence[Sequence[Term]],
    effective: Float[Tensor, " n"],
    weight: Float[Tensor, " n"] | None,
    rounds: int,
    *,
    conic: bool = True,
) -> tuple[list[Fitted], list[bool]]:
    """Fits of explanations, and which of them are complete: without conic programs the evidence of
    the others is no less than what is left of it with them."""
    every = [(*question.fixed, *terms) for terms in explanations]
    subsets = [subset_of(question.normal, terms) for terms in every]
    priors = Priors([prior_of(terms) for terms in every])
    if weight is None:
        weight = effective / question.squares.clamp(min=1e-300)
    # Each joint's weight is what it leaves; every round gains.
    equations = question.normal.of_each(subsets)
    weight = weight.expand(len(every), -1)
    for _ in range(rounds):
        solved = priors.solve_of(equations, weight, conic=conic)
        losses = equations.losses(solved.x)
        weight = effective / losses.clamp(min=1e-300)
    known = priors.value(solved.x).tolist()
    complete = [True] * len(every) if conic else priors.leave_bodies(solved.x)
    # Bounds of all at once, none of the coefficients that the smaller ones lack.
    inside = torch.arange(solved.x.shape[1]) < torch.tensor([[s.count] for s in subsets])
    limits = torch.tensor([0.0, -math.inf, math.inf]).double().repeat(*inside.shape, 1)
    limits[inside] = limits_of([t for terms in every for t in terms])
    refusals = out_of_bounds(limits, solved)
    refusal = refusals.any(1).tolist()
    out = []
    for k, (terms, subset) in enumerate(zip(every, subsets, strict=True)):
        own = subset.count
        x, root = solved.x[k, :own], solved.root[k, :own, :own]
        fit = Fitted(terms, subset, x, root, losses[k], known[k], -math.inf, effective)
        wrong, any_wrong = refusals[k, :own], refusal[k]
        while complete[k] and any_wrong:
            # At its bound of zero a coefficient is none; the others are fitted without it.
            if bool((wrong & ~torch.cat([t.optional for t in terms])).any()):
                break
            fit = _without(question, fit, wrong, priors.each[k], rounds)
            wrong = out_of_bounds(limits[k, :own], Solved(fit.x, fit.root))
            any_wrong = bool(wrong.any())
        else:
            fit = with_evidence(question, fit)
            if complete[k] and question.dissipation.driving(fit.terms, fit.x, fit.root):
                fit = replace(fit, evidence=-math.inf)
        out.append(fit)
    return out, complete


def _without(
    question: Question, fit: Fitted, gone: Bool[Tensor, " K"], prior: Prior, rounds: int
) -> Fitted:
    """A fit with some more coefficients at zero; its evidence is still to be computed."""
    subset = replace(fit.subset, at=torch.where(gone, -1, fit.subset.at))
    equations = question.normal.of(subset)
    weight = fit.weight
    for _ in range(rounds):
        solved = prior.solve_of(equations, weight)
        losses = equations.losses(solved.x)
        weight = fit.effective / losses.clamp(min=1e-300)
    x = torch.where(gone, 0.0, solved.x)
    value = prior.value(x)
    return replace(fit, subset=subset, x=x, root=solved.root, losses=losses, known=value)


def log_likelihood_ratio(
    effective: Float[Tensor, " n"], before: Float[Tensor, " n"], after: Float[Tensor, "*batch n"]
) -> Float[Tensor, "*batch n"]:
    """Twice the rise (*batch, n) of each joint's logarithm of the likelihood between two sums of
    squares of what is left; none on a joint of which no sample counts."""
    return effective * (before.clamp(min=1e-300) / after.clamp(min=1e-300)).log()


def limits_of(terms: Sequence[Term]) -> Float[Tensor, "K 3"]:
    """The limits of all coefficients of terms, see `Term.limits`."""
    return torch.cat([torch.zeros(0, 3, dtype=torch.float64), *(t.limits for t in terms)])


def out_of_bounds(limits: Float[Tensor, "*batch K 3"], solved: Solved) -> Bool[Tensor, "*batch K"]:
    """Which coefficients have a sign that physics forbids, or are larger than on any arm, beyond
    what their own uncertainty explains: a friction that drives, a load of negative mass."""
    # The whole coefficient, with what the model has of it, is what physics bounds.
    known, least, largest = limits.unbind(-1)
    slack = FORBIDDEN_STD * solved.root.norm(dim=-1) + 1e-12
    return (solved.x + known < least - slack) | (solved.x.abs() > largest + slack)


def unphysical_terms(question: Question, fit: Fitted) -> list[Term]:
    """Terms of which physics forbids a coefficient, or that make friction drive their joint."""
    wrong = out_of_bounds(limits_of(fit.terms), Solved(fit.x, fit.root))
    parts = zip(fit.terms, wrong.split([t.count for t in fit.terms]), strict=True)
    refused = [t for t, own in parts if bool(own.any())]
    return refused or question.dissipation.driving(fit.terms, fit.x, fit.root)


def cost(
    question: Question,
    terms: Sequence[Term],
    effective: Float[Tensor, " n"],
    alpha: float | None = None,
) -> float:
    """Of the coefficients and shapes of terms, and of their causes at a level (see `price`)."""
    common = common_names(terms, question.joints)
    total = question.price(alpha) * (len(common) + sum(t.name not in common for t in terms))
    counts = effective.tolist()
    logs = [math.log(max(n, 2.0)) for n in (*counts, sum(counts))]
    for term in terms:
        log = logs[-1 if term.place is None else term.place]
        total += (directions(question, term) + term.shapes) * log
    return total


def directions(question: Question, term: Term) -> int:
    """Directions of a term's columns that the samples tell apart."""
    found = question.seen.get(id(term), 1 if term.count == 1 else 0)
    if not found:
        joints = range(len(question.normal.g)) if term.place is None else (term.place,)
        own = [question.normal.g[j][term.at.unsqueeze(1), term.at] for j in joints]
        gram = torch.stack(own).sum(0)
        # Eigenvalues of the columns' correlation: as many as are visible count.
        size = gram.diagonal().clamp(min=1e-300).sqrt()
        values = torch.linalg.eigvalsh(gram / size / size.unsqueeze(1))
        found = question.seen[id(term)] = max(1, int((values > VISIBLE).sum()))
    return found


def common_names(terms: Iterable[Term], n: int) -> set[str]:
    """Effects that arms have on all joints, and that terms have on most of n."""
    count = Counter(t.name for t in terms if t.place is not None)
    return {name for name, k in count.items() if KINDS[name].on_all and 2 * k > n}


def greedy_shares(question: Question, fit: Fitted, terms: Sequence[Term]) -> list[float]:
    """What each term closes of what all close, when at every turn the one joins that closes most:
    shares that add up to one."""
    weight = question.normal.rows / fit.losses.clamp(min=1e-300)
    # What is known beforehand counts as so many samples that are not independent.
    dependent = float(question.normal.rows.sum() / fit.effective.sum())

    def loss(one: Fitted) -> float:
        return float((weight * one.losses).sum()) + dependent * one.known

    left = [loss(refit(question, fit, ()))]
    order: list[int] = []
    while len(order) < len(terms):
        rest = [k for k in range(len(terms)) if k not in order]
        tried = [[terms[j] for j in (*order, k)] for k in rest]
        ((k, best),) = best_fits(question, fit, tried, worth=lambda one: -loss(one))
        order.append(rest[k])
        left.append(loss(best))
    if left[-1] >= left[0]:  # what another sensor alone shows closes nothing
        return [0.0] * len(terms)
    drops = [(a - b) / (left[0] - left[-1]) for a, b in itertools.pairwise(left)]
    return [drops[order.index(k)] for k in range(len(terms))]


def cause_groups(terms: Sequence[Term], n: int) -> list[list[Term]]:
    """Terms by cause: what most joints have of an effect that arms have is one."""
    common = common_names(terms, n)
    groups = {name: [t for t in terms if t.name == name] for name in sorted(common)}
    return [[t] for t in terms if t.name not in common] + list(groups.values())


@dataclass(frozen=True, eq=False)
class Offer:
    """What a term would add to a fit, to first order.

    Attributes:
        term: a candidate.
        gain: rise of the likelihood's part of E.
        paid: what its own coefficients and shapes cost.
    """

    term: Term
    gain: float
    paid: float

    @property
    def net(self) -> float:
        """Gain less the cost of its columns; without that of a cause."""
        return self.gain - self.paid


def offers_of_each(
    question: Question, fits: Sequence[Fitted], places: Sequence[Sequence[Place] | None]
) -> list[list[Offer]]:
    """Every candidate's gain beside each of several fits, all base parameters and those that
    physics refuses left out; of these places alone where some are given.

    Gains are those of independent samples, for what a candidate leaves may be as independent: what
    is dependent now may be the very effect that is missing.
    """
    if not fits:
        return []
    priors = Priors([prior_of(fit.terms) for fit in fits])
    equations = question.normal.of_each([fit.subset for fit in fits])
    losses = torch.stack([fit.losses for fit in fits])
    weight = question.normal.rows / losses.clamp(min=1e-300)
    solved = priors.solve_of(equations, weight)
    # Beside the root, that of a model of which nothing is known, where something is.
    free: Tensor | None = None
    if any(p.known is not None for p in priors.each):
        unknown = Priors([p.unknown for p in priors.each]).squares
        free = inverse_root(equations.weighted(weight)[0] + unknown, known=unknown)
    out = []
    for k, (fit, some) in enumerate(zip(fits, places, strict=True)):
        own = slice(fit.subset.count)
        roots = solved.root[k, own, own], None if free is None else free[k, own, own]
        out.append(
            _offers(question, fit, weight[k], Solved(solved.x[k, own], roots[0]), roots[1], some)
        )
    return out


def _offers(
    question: Question,
    fit: Fitted,
    weights: Float[Tensor, " n"],
    solved: Solved,
    free_root: Float[Tensor, "K K"] | None,
    places: Sequence[Place] | None,
) -> list[Offer]:
    """The same beside a fit with these weights, and root where nothing is known of the model."""
    normal, weight, common = question.normal, weights.numpy(), question.candidates.gram.common
    root, k = solved.root, solved.root.shape[1]
    inner = (root if free_root is None else torch.cat([root, free_root], 1)).numpy()
    x = solved.x.numpy()
    # Weighted rows of what the fit holds, in every joint's matrix, and of what it explains; rows
    # are columns, for the matrix is symmetric. Of a joint that is not asked of, only what all
    # joints feel.
    parts: list[tuple[np.ndarray, np.ndarray]] = []
    for j, (w, own, at) in enumerate(zip(weight, normal.g, fit.subset.at.numpy(), strict=True)):
        g = own.numpy()
        asked = slice(None) if places is None or j in places else slice(common)
        target = g[-1, asked]
        for joint, of_model, values in fit.subset.instead:
            if joint == j:
                target = target + values.numpy() @ g[of_model.numpy(), asked]
        parts.append((g[at, asked] * (w * (at >= 0))[:, None], w * target))
    # What the fit leaves and what it holds; of effects that all joints feel, the sum.
    pulls = [target - x @ rows for rows, target in parts]
    pull_common = np.sum([b[:common] for b in pulls], 0)
    held_common = np.sum([rows[:, :common] for rows, _ in parts], 0).T @ inner
    held = {j: parts[j][0].T @ inner for j in range(len(parts)) if places is None or j in places}
    # Each batch at once: squares, pulls and what is held of the candidates' columns.
    # What the model leaves open of its own effects is no change of these.
    present = {t.key for t in fit.terms if t.effects and t.information is None} | question.barred
    out: list[Offer] = []
    for batch, products in question.offered:
        if places is not None and batch.place not in places:
            continue
        at = batch.at.numpy()
        # Candidates that all joints feel sum over joints; those of one joint see its matrix alone.
        if batch.place is None:
            h, b = held_common[at], pull_common[at]
            gram, extra = np.tensordot(weight, products, 1), np.zeros(len(at))
        else:
            h, b = held[batch.place][at], pulls[batch.place][at]
            g, w = normal.g[batch.place].numpy(), weight[batch.place]
            gram, extra = w * products, np.zeros(len(at))
            for m, term in batch.standing_in:
                for _, model, values in term.instead:
                    # The target grows by the effect that is replaced: so does what is left of it.
                    rows, v = model.at.numpy(), values.numpy()
                    rest = held[batch.place][rows, :k].T @ v
                    grown = w * (v @ g[rows[:, None], rows] @ v) - rest @ rest
                    extra[m] += grown + 2 * v @ pulls[batch.place][rows]
                    b[m] += w * (g[term.at.numpy()[:, None], rows] @ v) - h[m, :, :k] @ rest
        # Gain of each candidate, less what is lost with the effect in whose place it stands.
        free = None if free_root is None else h[..., k:]
        gains, counts = _gains(batch, gram, h[..., :k], b, free)
        gains = gains - extra
        n = float(normal.rows.sum() if batch.place is None else normal.rows[batch.place])
        # What is gained on one joint cannot exceed what is there: n log(1 / (1 - share)).
        rise = -n * np.log1p(-(gains / max(n, 1e-9)).clip(0, 1 - 1e-9))
        paid = (counts + batch.shapes.numpy()) * math.log(max(n, 2.0))
        for m in np.argsort(paid - rise, kind="stable")[:LOOKED_AT].tolist():
            term = batch.terms[m]
            idle = gains[m] <= 0 or term.key in present or term.name == BASE
            if not (idle or _beside(term, fit.terms)):
                out.append(Offer(term, float(rise[m]), float(paid[m])))
    return sorted(out, key=lambda o: -o.net)


def span_of(push: Contact) -> tuple[float, float]:
    """Start and stop of a push [s], infinite where they are open."""
    start = -math.inf if push.start is None else push.start
    return start, math.inf if push.stop is None else push.stop


def _beside(term: Term, others: Sequence[Term]) -> bool:
    """Whether a term in a window of time stands in or next to another one's: one push is one."""
    if not term.effects or not isinstance(term.effects[0], Contact):
        return False
    start, stop = span_of(term.effects[0])
    pushes = (t.effects[0] for t in others if t.effects)
    there = [span_of(effect) for effect in pushes if isinstance(effect, Contact)]
    # Next to each other: nearer than half of the longer one.
    return any(
        start < b + 0.5 * max(stop - start, b - a) and a < stop + 0.5 * max(stop - start, b - a)
        for a, b in there
    )


def _gains(
    batch: Batch, gram: np.ndarray, held: np.ndarray, b: np.ndarray, free: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Gains (M,) and directions (M,) of terms beside a model that holds part of their columns; 0
    where physics forbids a coefficient.

    Args:
        batch: the terms.
        gram, b: (M, C, C), (M, C) products of their columns, and those with what is left.
        held: (M, C, k) what the model holds of the columns.
        free: (M, C, f) what it would hold if nothing were known of it.
    """
    # What the model leaves of the columns, in units of the columns themselves.
    ridge, known, largest = (x.numpy() for x in (batch.ridge, batch.known, batch.largest))
    signed, optional = batch.signed.numpy(), batch.optional.numpy()
    square = gram.diagonal(0, 1, 2)
    whole = gram + ridge[:, None] * np.eye(ridge.shape[1])
    left = whole - held @ held.transpose(0, 2, 1)
    rest = None if free is None else whole - free @ free.transpose(0, 2, 1)
    pull = (b + ridge * batch.centre.numpy())[:, None]
    # Least squares along the directions that are seen; the rest is noise of the columns.
    size = np.where(square > 1e-300, square + ridge, 0.0)
    while True:
        root = visible_root(left, size, rest)
        along = (pull @ root)[:, 0]
        gain = np.square(along).sum(1)
        x, std = (root * along[:, None]).sum(-1), np.sqrt(np.square(root).sum(-1))
        # A sign counts only where the coefficient is determined, and is no noise.
        sure = (root * (left @ root)).sum(-1) > 0.99
        low = sure & (x + known < -FORBIDDEN_STD * std) & signed
        high = sure & (np.abs(x) > largest + FORBIDDEN_STD * std)
        # A friction that drives, or a coefficient larger than on any arm, is no gain.
        wrong = (high | (low & ~optional)).any(-1)
        zero = low & ~wrong[:, None] & (size > 0)
        if not zero.any():
            return np.where(wrong, 0.0, gain), root.any(-2).sum(-1)
        # What may be zero is held there, and the term is asked what it gains without it.
        size = np.where(zero, 0.0, size)
