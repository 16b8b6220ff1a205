"""One number for how good an explanation is.

    E(S) = sum_j n_j log(L_j(0) / L_j(S)) - prior(x) - sum_k log n_k - 2 log(looks / alpha) c

L_j(S) is the sum of squares that the terms S leave on joint j, n_j the effective number of samples
there: of two explanations as many as tell their torques apart in noise as slow as what the better
one leaves, which hides slow torques and hardly fast ones. Every coefficient and every shape that
was searched costs log n (Schwarz 1978), every cause the logarithm of all that were looked at; the
prior is what is known of coefficients beforehand. What L leaves is the noise: while something is
missing E is careful by itself.

A cause is one term; or the same effect on most joints, where arms have it (dry friction, say).
"""

import math
from collections import Counter
from collections.abc import Iterable, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
import torch

from torchid.design.bodies import Prior, together
from torchid.design.gram import VISIBLE, Normal, Solved, Subset
from torchid.effects.registry import KINDS
from torchid.effects.transient import Contact
from torchid.gap.search.dissipation import Dissipation
from torchid.gap.search.terms import Candidates, Term, term_columns
from torchid.gap.settings import GapSettings
from torchid.statistics.autocorrelation import autocorrelation, time_of
from torchid.statistics.criteria import FORBIDDEN_STD
from torchid.typing import Bool, Float, Tensor

SET_ODDS = 20.0
"""Odds against an alternative from which no more of its kind are looked at [1]."""

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
        residuals, slow: what fits leave, and its autocorrelations; as long as the fits are there.
        left: (n,) torque that the model has been seen to leave unexplained, RMS [N m; N]; None
            where that is not known.
    """

    candidates: Candidates
    normal: Normal
    settings: GapSettings
    rows: dict[int, Tensor] = field(default_factory=dict, repr=False)
    seen: dict[int, int] = field(default_factory=dict, repr=False)
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
) -> Fitted:
    """The maximum of the likelihood over the coefficients of terms, and its evidence.

    Args:
        question: what is explained.
        terms: beside the fixed ones, which come first.
        effective: (n,) numbers of samples.
        weight: (n,) of the joints' squares at the start.
        rounds: how often the joints are weighted anew by what they leave. Two are enough to rank;
            ten for what is told, where columns that all joints share pull the weights apart.
    """
    every = (*question.fixed, *terms)
    prior, subset, limits = prior_of(every), subset_of(question.normal, every), limits_of(every)
    optional = torch.cat([torch.zeros(0, dtype=torch.bool), *(t.optional for t in every)])
    gone = torch.zeros_like(optional)
    if weight is None:
        weight = effective / question.squares.clamp(min=1e-300)
    while True:
        # Each joint's weight is what it leaves; every round gains.
        equations = question.normal.of(subset)
        for _ in range(rounds):
            solved = prior.solve_of(equations, weight)
            losses = equations.losses(solved.x)
            weight = effective / losses.clamp(min=1e-300)
        x = torch.where(gone, 0.0, solved.x)
        known = prior.value(x)
        fit = Fitted(every, subset, x, solved.root, losses, known, -math.inf, effective)
        wrong = out_of_bounds(limits, Solved(x, solved.root))
        if not bool(wrong.any()):
            break
        # At its bound of zero a coefficient is none; the others are fitted without it.
        if bool((wrong & ~optional).any()):
            return fit
        gone |= wrong
        subset = replace(subset, at=torch.where(gone, -1, subset.at))
    if question.dissipation.driving(every, x, solved.root):
        return fit
    return with_evidence(question, fit)


def refit(question: Question, fit: Fitted, terms: Sequence[Term], rounds: int = 2) -> Fitted:
    """What `fit_terms` gives with the numbers of samples and the first weights of another fit."""
    return fit_terms(question, terms, fit.effective, fit.weight, rounds)


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
