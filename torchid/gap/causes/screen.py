"""Candidates in the order of what they promise: the rise of the evidence to first order.

Beside a fit with noise as it leaves it, a candidate with columns X and slab S raises the evidence
by

    1/2 z'z - 1/2 log|I + S^1/2 H S^1/2|,   H = X'W X - X'W A C A'W X

A being the columns of the fit and C their covariance. Products of candidates with each other are
never needed; those with a term of the fit are made once.
"""

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from torchid.design.columns import Place
from torchid.gap.causes.candidates import Term
from torchid.gap.causes.evidence import Evidence, Fit


@dataclass(frozen=True, eq=False)
class Stack:
    """Candidates of one place with equally many coefficients.

    Attributes:
        terms: M of them.
        columns: (M, C, N), or (n, M C, N) of all joints.
        own: (n, M, C, C) products of each one's columns; n is 1 of one joint.
    """

    place: Place
    terms: tuple[Term, ...]
    columns: np.ndarray
    own: np.ndarray
    spread: np.ndarray
    low: np.ndarray
    paid: np.ndarray

    @classmethod
    def of(cls, place: Place, terms: list[Term], evidence: Evidence) -> "Stack":
        """Of candidates of a place."""
        count, size = len(terms), terms[0].count
        if place is None:
            every = np.stack([t.columns for t in terms])  # (M, C, n, N)
            flat = np.ascontiguousarray(every.transpose(2, 0, 1, 3))
            own = flat @ flat.transpose(0, 1, 3, 2)
            columns = flat.reshape(len(flat), count * size, -1)
        else:
            columns = np.stack([t.columns for t in terms])
            own = (columns @ columns.transpose(0, 2, 1))[None]
        spread, low = np.stack([t.spread for t in terms]), np.stack([t.low for t in terms])
        forms = (t.shapes * evidence.forms.get(t.cause, 1) for t in terms)
        paid = np.array([math.log(f) - t.extra for f, t in zip(forms, terms, strict=True)])
        return cls(place, tuple(terms), columns, own, spread, low, paid)

    def with_gap(self, gap: np.ndarray) -> np.ndarray:
        """Products (n, M C) of the columns with samples (n, N); n is 1 of one joint."""
        if self.place is None:
            return (self.columns @ gap[..., None])[..., 0]
        return (self.columns @ gap[self.place]).reshape(1, -1)

    def with_term(self, columns: np.ndarray) -> np.ndarray:
        """Products (n, K, M C) with columns (n, K, N) of a term; n is 1 of one joint."""
        if self.place is None:
            return columns @ self.columns.transpose(0, 2, 1)
        flat = self.columns.reshape(-1, self.columns.shape[-1])
        return (columns[self.place] @ flat.T)[None]


OF_A_PLACE = 3
"""Candidates of one joint, or of one effect on the whole arm, that are looked at before others."""


class Screen:
    """All candidates of a library beside any fit.

    Args:
        evidence: of the library.
    """

    def __init__(self, evidence: Evidence):
        self.evidence = evidence
        groups: dict[tuple[Place, int], list[Term]] = {}
        for t in evidence.library.terms:
            groups.setdefault((t.place, t.count), []).append(t)
        self.stacks = [Stack.of(place, terms, evidence) for (place, _), terms in groups.items()]
        self._with_gap = [s.with_gap(evidence.gap) for s in self.stacks]
        self._with_term: dict[int, list[np.ndarray]] = {}

    def add(self, terms: list[Term]) -> None:
        """Candidates that are looked at from now on."""
        groups: dict[tuple[Place, int], list[Term]] = {}
        for t in terms:
            groups.setdefault((t.place, t.count), []).append(t)
        new = [Stack.of(place, some, self.evidence) for (place, _), some in groups.items()]
        self.stacks += new
        self._with_gap += [s.with_gap(self.evidence.gap) for s in new]
        self._with_term.clear()

    def products(self, term: Term) -> list[np.ndarray]:
        """Products of a term's columns with those of every stack."""
        if term.serial not in self._with_term:
            columns = self.evidence.columns([term])
            self._with_term[term.serial] = [s.with_term(columns) for s in self.stacks]
        return self._with_term[term.serial]

    def best(
        self, fit: Fit, samples: np.ndarray, count: int, without: frozenset[object] = frozenset()
    ) -> list[tuple[float, Term]]:
        """Candidates that raise the evidence most to first order. Of a joint, and of an effect on
        the whole arm, more than three come only where others leave room for them.

        Args:
            fit: beside which.
            samples: (n,) with which they are ranked.
            count: of them; beside an earlier log half of them are new and half in both.
            without: keys that are not looked at.
        """
        of_place = Counter[object]()
        within, beyond = list[tuple[float, Term]](), list[tuple[float, Term]]()
        for gain, term in self.ranked(fit, samples, without):
            place = term.since, term.name if term.place is None else term.place
            of_place[place] += 1
            (within if of_place[place] <= OF_A_PLACE else beyond).append((gain, term))
        some = [*within, *beyond]
        kinds = dict.fromkeys(t.since for _, t in some)
        each = math.ceil(count / max(len(kinds), 1))
        return [p for kind in kinds for p in [p for p in some if p[1].since == kind][:each]]

    def ranked(
        self, fit: Fit, samples: np.ndarray, without: frozenset[object] = frozenset()
    ) -> list[tuple[float, Term]]:
        """All candidates, the best shape of each key, by how much they raise the evidence to first
        order; arguments as for `best`."""
        evidence = self.evidence
        every = (*evidence.nuisance, *fit.terms)
        weight = samples / fit.losses
        white = evidence.white(every, weight)
        best: dict[object, tuple[float, Term]] = {}
        for k, stack in enumerate(self.stacks):
            own_weight = weight if stack.place is None else weight[[stack.place]]
            m, c = stack.low.shape
            right = own_weight @ self._with_gap[k]
            g = np.tensordot(own_weight, stack.own, 1)
            if every:
                parts = [np.tensordot(own_weight, self.products(t)[k], 1) for t in every]
                cross = np.concatenate(parts)
                right = right - fit.x @ cross
                u = (white @ cross).reshape(-1, m, c)
                g = g - np.einsum("kmc,kmd->mcd", u, u, optimize=True)
            a = stack.spread.transpose(0, 2, 1) @ g @ stack.spread + np.eye(c)
            b = (right.reshape(m, 1, c) @ stack.spread)[:, 0]
            if c == 1:
                z, size = b / a[:, 0], np.log(np.maximum(a[:, 0, 0], 1e-300))
                gains = 0.5 * (b * z).sum(1) - 0.5 * size
                gains[(z * stack.spread[:, 0] < stack.low)[:, 0]] = -np.inf
            else:
                z = np.linalg.solve(a, b[..., None])[..., 0]
                gains = 0.5 * (b * z).sum(1) - 0.5 * np.linalg.slogdet(a)[1]
            for term, gain in zip(stack.terms, (gains - stack.paid).tolist(), strict=True):
                if gain > best.get(term.key, (-math.inf, term))[0]:
                    best[term.key] = gain, term
        there = {t.key for t in fit.terms} | without
        return sorted((p for key, p in best.items() if key not in there), key=lambda p: -p[0])
