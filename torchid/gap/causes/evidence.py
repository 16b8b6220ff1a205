"""One criterion for how good an explanation is: its marginal likelihood, with a price for looking.

    E(S) = -1/2 sum_j n_j log L_j - 1/2 x'P x - 1/2 log|I + P^-1/2 G P^-1/2|
           - sum_causes log(looks / EXPECTED) - sum_terms log(shapes)

S is a set of terms with coefficients x, P the inverse covariance of their Gaussian slabs, G the
normal matrix with each joint's squares in units of what is left, L_j the squares left on joint j.
Slabs make ten numbers of a body, or six of a law, pay for themselves (MacKay 1992, Neural
Computation 4(3); Zellner 1986). L_j is profiled over the size of the noise, which is no less than
what the model was seen to leave on the log that it was made from.

n_j belongs to a pair of explanations: the samples that tell them apart, rows over the correlation
time of (what the better one leaves) times (the difference of their torques) (Bayley and Hammersley
1946), fewer where the noise is louder where they differ (White 1980). So E is no function of S
alone, and two explanations are compared with the same samples, both fitted with them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np
import torch
from scipy.linalg import solve_triangular

from torchid.gap.causes.candidates import Library, Term
from torchid.gap.causes.clusters import Clusters
from torchid.gap.wanted import BASE
from torchid.statistics.autocorrelation import autocorrelation, time_of
from torchid.statistics.criteria import WRONG_FILE
from torchid.statistics.evidence import beside, in_slabs, price_of, root_of, solved

PINS = 3
"""Times that coefficients beyond what physics allows are held at their bound."""

KEPT = 64
"""Sets whose normal equations are kept, and fits whose remainders are."""

DIFFERENT = 1e-12
"""Share of the squares left from which on two explanations make another torque: rounding."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A set of terms, fitted with so many samples.

    Attributes:
        terms: beside what is always fitted.
        samples: (n,) that each joint's squares count as.
        x: coefficients, those of the nuisance first, then term by term.
        losses: (n,) sums of squares left [(N m)^2; N^2].
        known: half of the coefficients' distance from zero in units of their slabs, and of the log
            determinant: what they cost.
        allowed: whether every coefficient is one that an arm can have.
    """

    terms: tuple[Term, ...]
    samples: np.ndarray
    x: np.ndarray
    losses: np.ndarray
    known: float
    allowed: bool

    def values(self) -> list[np.ndarray]:
        """Coefficients, term by term."""
        out, first = [], len(self.x) - sum(t.count for t in self.terms)
        for t in self.terms:
            out.append(self.x[first : first + t.count])
            first += t.count
        return out


class Slabs(NamedTuple):
    """Terms in units of their slabs.

    Attributes:
        normal: (n, K + 1, K + 1) normal matrices, the gap last.
        spread: (K, K) root of the slabs' covariance.
        middle: (K,) where coefficients are expected, in units of their slabs.
        low, high: (K,) their bounds.
    """

    normal: np.ndarray
    spread: np.ndarray
    middle: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Evidence:
    """Fits of sets of a library's terms, and their comparison.

    Args:
        library: of the candidates.
    """

    def __init__(self, library: Library):
        self.library = library
        self.n, self.gap, self.rows = library.n, library.gap, library.rows
        self.floor = library.known_noise**2 * self.rows
        self.nuisance = () if library.nuisance is None else (library.nuisance,)
        self._pairs: dict[tuple[int, int], np.ndarray] = {}
        self._sets: dict[tuple[int, ...], Slabs] = {}
        self._left: dict[int, tuple[Fit, np.ndarray]] = {}
        self._slow: dict[int, torch.Tensor] = {}
        self.clusters = Clusters(library)
        self.refresh()

    def refresh(self) -> None:
        """Count the causes that are looked at; to be called when the library has more terms."""
        causes = {t.cause for t in self.library.terms}
        self.looks = max(1, len(causes))
        forms: dict[tuple[object, ...], set[tuple[object, ...]]] = {}
        for t in self.library.terms:
            forms.setdefault(t.cause, set()).add(t.form)
        self.forms = {cause: len(keys) for cause, keys in forms.items()}

    # ------------------------------------------------------------------ normal equations

    def columns(self, terms: Sequence[Term]) -> np.ndarray:
        """Columns (n, K, N) of terms on all joints."""
        total = sum(t.count for t in terms)
        out, k = np.zeros((self.n, total, self.gap.shape[1])), 0
        for t in terms:
            if t.place is None:
                out[:, k : k + t.count] = t.columns.transpose(1, 0, 2)
            else:
                out[t.place, k : k + t.count] = t.columns
            k += t.count
        return out

    def _pair(self, one: Term, other: Term) -> np.ndarray:
        """Products (n, C, D) of two terms' columns in units of their slabs, joint by joint."""
        key = one.serial, other.serial
        if key not in self._pairs:
            out = np.zeros((self.n, one.count, other.count))
            places = {one.place, other.place} - {None}
            if len(places) == 1:
                j = next(iter(places))
                a, b = (t.columns if t.place is not None else t.columns[:, j] for t in (one, other))
                out[j] = a @ b.T
            elif not places:
                a, b = one.columns.transpose(1, 0, 2), other.columns.transpose(1, 2, 0)
                out[:] = a @ b
            out = one.spread.T @ out @ other.spread
            self._pairs[key] = out
            self._pairs[key[::-1]] = out.transpose(0, 2, 1)
        return self._pairs[key]

    def _target(self, term: Term) -> np.ndarray:
        """The same (n, C) with the gap."""
        key = term.serial, -1
        if key not in self._pairs:
            out = np.zeros((self.n, term.count))
            if term.place is None:
                out[:] = np.einsum("cnN,nN->nc", term.columns, self.gap)
            else:
                out[term.place] = term.columns @ self.gap[term.place]
            self._pairs[key] = out @ term.spread
        return self._pairs[key]

    def slabs(self, terms: Sequence[Term]) -> Slabs:
        """Of terms, from the products of each two of them."""
        key = tuple(t.serial for t in terms)
        if key not in self._sets:
            if len(self._sets) >= KEPT:
                del self._sets[next(iter(self._sets))]
            # Most sets are another one and a term.
            before = self._sets.get(key[:-1]) if key else None
            self._sets[key] = self._assembled(terms, before)
        return self._sets[key]

    def _assembled(self, terms: Sequence[Term], before: Slabs | None = None) -> Slabs:
        """Of terms, all but the last of which are in `before`."""
        ends = np.cumsum([0, *(t.count for t in terms)])
        at = [slice(a, b) for a, b in pairwise(ends)]
        g, spread = np.zeros((self.n, ends[-1] + 1, ends[-1] + 1)), np.zeros((ends[-1], ends[-1]))
        g[:, -1, -1] = (self.gap**2).sum(1)
        own, first = np.zeros((3, ends[-1])), 0
        if before is not None:
            first, old = len(terms) - 1, ends[-2]
            g[:, :old, :old], spread[:old, :old] = before.normal[:, :-1, :-1], before.spread
            g[:, :old, -1] = g[:, -1, :old] = before.normal[:, :-1, -1]
            own[:, :old] = before.middle, before.low, before.high
        for i, one in enumerate(terms[first:], first):
            g[:, at[i], -1] = g[:, -1, at[i]] = self._target(one)
            spread[at[i], at[i]], own[1, at[i]], own[2, at[i]] = one.spread, one.low, one.high
            if one.centre.any():
                own[0, at[i]] = np.linalg.solve(one.spread, one.centre)
            for j, other in enumerate(terms[: i + 1]):
                g[:, at[j], at[i]] = products = self._pair(other, one)
                g[:, at[i], at[j]] = products.transpose(0, 2, 1)
        return Slabs(g, spread, *own)

    def white(self, terms: Sequence[Term], weight: np.ndarray) -> np.ndarray:
        """Whitened coordinates B' (K, K) of terms' columns, joints by weights (n,): B B' is the
        covariance of their coefficients."""
        g, spread, *_ = self.slabs(terms)
        h = np.tensordot(weight, g, 1)[:-1, :-1]
        return solve_triangular(root_of(h), spread.T, lower=True)

    # ------------------------------------------------------------------ fits

    def fit(self, terms: Sequence[Term], samples: np.ndarray) -> Fit:
        """Terms beside what is always fitted; coefficients that physics forbids are at their bound.

        Args:
            samples: (n,) that each joint's squares count as.
        """
        terms = tuple(terms)
        g, spread, middle, low, high = self.slabs((*self.nuisance, *terms))
        slack = 1e-9 * np.abs(spread).max(1, initial=0.0)
        centre = at = spread @ middle
        pinned, free = np.zeros(len(low), bool), None
        for _ in range(PINS):
            z, losses, known = solved(g, samples, self.floor, middle, free)
            x = np.where(pinned, at, spread @ z)
            below = (x < low - slack) & ~pinned
            if not below.any():
                break
            pinned |= below
            at = np.where(pinned, low, centre)
            middle, free = in_slabs(spread, at), beside(spread, pinned)
        return Fit(terms, samples, x, losses, known, self._allowed(terms, x, high, pinned))

    def _allowed(
        self, terms: Sequence[Term], x: np.ndarray, high: np.ndarray, pinned: np.ndarray
    ) -> bool:
        """Whether every cause is still there, and none larger than on any arm."""
        first = len(x) - sum(t.count for t in terms)
        if (x[first:] > 1.3 * high[first:]).any():
            return False
        for t in terms if pinned[first:].any() else ():
            own = slice(first, first + t.count)
            # What the model has and the arm has none of is a change, and is there.
            gone = pinned[own] & (t.low >= 0)
            essential = t.effect.essential if t.effect is not None else ()
            needed = list(essential) or list(range(t.count))
            if all(gone[k] for k in needed):
                return False
            first += t.count
        return True

    def left(self, fit: Fit) -> np.ndarray:
        """Samples (n, N) that a fit leaves [N m; N]."""
        if id(fit) not in self._left:
            out, k = self.gap.copy(), 0
            for t in (*self.nuisance, *fit.terms):
                x = fit.x[k : k + t.count]
                if t.place is None:
                    out -= np.tensordot(x, t.columns, 1)
                else:
                    out[t.place] -= x @ t.columns
                k += t.count
            if len(self._left) >= KEPT:
                oldest = next(iter(self._left))
                del self._left[oldest]
                self._slow.pop(oldest, None)
            self._left[id(fit)] = fit, out
        return self._left[id(fit)][1]

    def _correlation(self, fit: Fit) -> torch.Tensor:
        """Autocorrelations (n, L) of what a fit leaves."""
        left = self.left(fit)
        if id(fit) not in self._slow:
            self._slow[id(fit)] = autocorrelation(
                torch.from_numpy(left), self.library.samples.bounds
            )
        return self._slow[id(fit)]

    def independent(self, fit: Fit) -> np.ndarray:
        """Samples (n,) that tell of a constant torque in noise as a fit leaves it."""
        times = time_of(self._correlation(fit)).numpy()
        return np.maximum(self.rows / times, 1.0)

    def telling(self, one: Fit, other: Fit) -> np.ndarray:
        """Samples (n,) that tell two explanations apart in noise as the better one leaves it."""
        better = one if self._total(one) <= self._total(other) else other
        noise = self.left(better)
        apart = self.left(one) - self.left(other)
        both = self._correlation(better) * autocorrelation(
            torch.from_numpy(apart), self.library.samples.bounds
        )
        a, b = apart**2, noise**2
        loud = (a * b).sum(1) * self.rows / np.maximum(a.sum(1) * b.sum(1), 1e-300)
        times = np.maximum(time_of(both).numpy(), 1.0) * np.maximum(loud, 1.0)
        times = self._beside_misfit(one, other, apart, noise, times)
        # Where the two make the same torque no sample tells anything, and all may count.
        return np.where(a.sum(1) > DIFFERENT * b.sum(1), self.rows / times, self.rows)

    def _beside_misfit(
        self, one: Fit, other: Fit, apart: np.ndarray, noise: np.ndarray, times: np.ndarray
    ) -> np.ndarray:
        """Samples (n,) of which one tells as much as an independent one, where what is left differs
        between windows by more than samples that are so long alike."""
        there = {t.serial for t in one.terms} & {t.serial for t in other.terms}
        alone = [
            (t, sign * x)
            for fit, sign in ((one, 1.0), (other, -1.0))
            for t, x in zip(fit.terms, fit.values(), strict=True)
            if t.serial not in there
        ]
        # What happens once differs between windows by its nature, and what another sensor shows is
        # asked of no torque that is left.
        if any(t.rare or t.shown for t, _ in alone):
            return times
        new = [(t, x) for t, x in alone if t.before is not None]
        if not new:
            return self.clusters.same(apart, noise, times)
        before, touched = ~self.library.asked, np.zeros(self.n, bool)
        would = np.zeros((self.n, int(before.sum())))
        for t, x in new:
            own = slice(None) if t.place is None else t.place
            would[own] += np.tensordot(x, cast(np.ndarray, t.before), 1)
            touched[own] = True
        # On joints of other terms alone both logs have what is asked.
        torque = apart.copy()
        torque[np.ix_(touched, before)] = would[touched]
        more = self.clusters.new(torque, noise, times)
        return np.where(touched, more, self.clusters.same(apart, noise, times))

    def _total(self, fit: Fit) -> float:
        return float((self.rows * np.log(fit.losses)).sum())

    # ------------------------------------------------------------------ comparison

    def price(self, terms: Sequence[Term]) -> float:
        """Of looking: one for each cause, and the shapes and forms that were looked at."""
        # What was there already and has changed since is two.
        causes = {(t.cause, t.since) for t in terms}
        out = len(causes) * price_of(self.looks)
        for t in terms:
            out += math.log(t.shapes * self.forms.get(t.cause, 1))
            # A file that is wrong throughout is less likely than one cause.
            out -= math.log(WRONG_FILE) if t.name == BASE else 0.0
            out -= t.extra
        return out

    def value(self, fit: Fit) -> float:
        """E of a fit with its own samples [nats]."""
        if not fit.allowed:
            return -math.inf
        likelihood = -0.5 * float((fit.samples * np.log(fit.losses)).sum())
        return likelihood - fit.known - self.price(fit.terms)

    def over(self, one: Fit, other: Fit) -> float:
        """Evidence of one explanation over another [nats], both fitted with the samples that tell
        them apart."""
        if not one.allowed:
            return -math.inf
        samples = self.telling(one, other)
        a, b = self.fit(one.terms, samples), self.fit(other.terms, samples)
        if not b.allowed:
            return math.inf if a.allowed else 0.0
        return self.value(a) - self.value(b)
