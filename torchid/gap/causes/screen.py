"""Candidates in the order of what they promise: the rise of the evidence to first order.

Beside a fit with noise as it leaves it, a candidate with columns X and slab S raises the evidence
by

    1/2 z'z - 1/2 log|I + S^1/2 H S^1/2|,   H = X'W X - X'W A C A'W X

A being the columns of the fit and C their covariance. Products of candidates with each other are
never needed; those with a term of the fit are made once.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchid.design.columns import Place
from torchid.gap.causes.candidates import Pack, Term
from torchid.gap.causes.evidence import Evidence, Fit


@dataclass(frozen=True, eq=False)
class Stack:
    """Candidates with equally many coefficients, of single joints, joint by joint, or of the arm.

    Attributes:
        terms: M of them.
        places: (M C,) joint of each column; none of the arm's.
        columns: by joint (m C, N), of those that are on it; of the arm's all, (M C, N).
        own: (n, M, C, C) products of each one's columns; n is 1 of single joints.
        spread, low: (M, C, C) and (M, C) of each one's slab.
        paid: (M,) price of its shapes and forms, less what another sensor tells of it [nats].
    """

    terms: tuple[Term, ...]
    places: np.ndarray
    columns: dict[int, np.ndarray]
    own: np.ndarray
    spread: np.ndarray
    low: np.ndarray
    paid: np.ndarray

    @classmethod
    def of(cls, pack: Pack, evidence: Evidence) -> "Stack":
        """Of candidates side by side."""
        terms, each = pack
        size, places = terms[0].count, np.zeros(0, int)
        flat = each.reshape(len(each), len(terms) * size, -1)
        if terms[0].place is None:
            columns = dict(enumerate(flat))
        else:
            places = np.repeat([t.place or 0 for t in terms], size)
            joints, first = np.unique(places, return_index=True)
            columns = dict(zip(joints.tolist(), np.split(flat[0], first[1:]), strict=True))
        own = each @ each.transpose(0, 1, 3, 2)
        spread, low = np.stack([t.spread for t in terms]), np.stack([t.low for t in terms])
        forms = (t.shapes * evidence.forms.get(t.cause, 1) for t in terms)
        paid = np.array([math.log(f) - t.extra for f, t in zip(forms, terms, strict=True)])
        return cls(tuple(terms), places, columns, own, spread, low, paid)

    @property
    def of_joints(self) -> bool:
        """Whether they are of single joints."""
        return bool(len(self.places))

    def with_rows(self, rows: np.ndarray, place: Place) -> np.ndarray:
        """Products (n, K, M C) of the columns with rows (n, K, N), or with those (K, N) of one
        joint; n is 1 where either are of single joints."""
        out = np.zeros((1, rows.shape[-2], len(self.places)))
        if not self.of_joints:
            if place is not None:
                return (rows @ self.columns[place].T)[None]
            return np.stack([rows[j] @ x.T for j, x in self.columns.items()])
        for j, x in self.columns.items():
            if place is None or j == place:
                out[0][:, self.places == j] = (rows[j] if place is None else rows) @ x.T
        return out

    def weighted(self, products: np.ndarray, weight: np.ndarray, place: Place) -> np.ndarray:
        """Sum (K, M C) over the joints of products `with_rows`, with weights (n,) of the joints."""
        if self.of_joints:
            return products[0] * weight[self.places]
        if place is not None:
            return products[0] * weight[place]
        return (weight @ products.reshape(len(weight), -1)).reshape(products.shape[1:])

    def squares(self, weight: np.ndarray) -> np.ndarray:
        """The same of each one's columns with themselves, (M, C, C)."""
        if not self.of_joints:
            return np.tensordot(weight, self.own, 1)
        return self.own[0] * weight[self.places].reshape(*self.low.shape, 1)


OF_A_PLACE = 3
"""Candidates of one joint, or of one effect on the whole arm, that are looked at before others."""


class Screen:
    """All candidates of a library beside any fit.

    Args:
        evidence: of the library.
    """

    def __init__(self, evidence: Evidence):
        self.evidence = evidence
        self.stacks: list[Stack] = []
        self._with_gap: list[np.ndarray] = []
        self._with_term: dict[int, list[np.ndarray]] = {}
        self.refresh()

    def refresh(self) -> None:
        """Look at the candidates that the library has got."""
        new = [Stack.of(p, self.evidence) for p in self.evidence.library.packs[len(self.stacks) :]]
        self.stacks += new
        self._with_gap += [s.with_rows(self.evidence.gap[:, None], None) for s in new]
        self._with_term.clear()

    def cross(self, terms: Sequence[Term], weight: np.ndarray) -> list[np.ndarray]:
        """Products (K, M C) of the columns of terms with those of every stack, joints by weights
        (n,)."""
        parts = [self._products(t) for t in terms]
        return [
            np.concatenate(
                [s.weighted(p[k], weight, t.place) for p, t in zip(parts, terms, strict=True)]
            )
            for k, s in enumerate(self.stacks)
        ]

    def _products(self, term: Term) -> list[np.ndarray]:
        """Products of a term's columns with those of every stack."""
        if term.serial not in self._with_term:
            x = term.columns if term.place is not None else term.columns.transpose(1, 0, 2)
            self._with_term[term.serial] = [s.with_rows(x, term.place) for s in self.stacks]
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
        return self.spread(self.ranked(fit, samples, without), count)

    @staticmethod
    def spread(ranked: Sequence[tuple[float, Term]], count: int) -> list[tuple[float, Term]]:
        """Of candidates in order those that `best` takes."""
        of_place = Counter[object]()
        # The likeliest ten of a joint with much friction are ten forms of one law, and a cause of
        # another joint would never be tried.
        within, beyond = list[tuple[float, Term]](), list[tuple[float, Term]]()
        for gain, term in ranked:
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
        # Evidence to first order is a ridge regression of what is left on each candidate, joints
        # weighted by what is left on them.
        weight = samples / fit.losses
        white = evidence.white(every, weight)
        # What a candidate has in common with the terms that are there is theirs: it is projected
        # out.
        crosses = self.cross(every, weight) if every else []
        best: dict[object, tuple[float, Term]] = {}
        for k, stack in enumerate(self.stacks):
            m, c = stack.low.shape
            right = stack.weighted(self._with_gap[k], weight, None)[0]
            g = stack.squares(weight)
            if every:
                right = right - fit.x @ crosses[k]
                u = white @ crosses[k]
                g = g - (_squares(u).reshape(m, 1, 1) if c == 1 else _blocks(u, c))
            # In units of how large a coefficient is beforehand, so that what is known adds the unit
            # matrix.
            a = stack.spread.transpose(0, 2, 1) @ g @ stack.spread + np.eye(c)
            b = (right.reshape(m, 1, c) @ stack.spread)[:, 0]
            if c == 1:
                # At its bound a coefficient that the model has is gone, which is a change; another
                # one is not there.
                least = stack.low / stack.spread[:, 0]
                z, size = np.maximum(b / a[:, 0], least), np.log(np.maximum(a[:, 0, 0], 1e-300))
                gains = (b * z - 0.5 * a[:, 0] * z**2).sum(1) - 0.5 * size
                gains[((z <= least) & (least >= 0))[:, 0]] = -np.inf
            else:
                z = np.linalg.solve(a, b[..., None])[..., 0]
                gains = 0.5 * (b * z).sum(1) - 0.5 * np.linalg.slogdet(a)[1]
            for term, gain in zip(stack.terms, (gains - stack.paid).tolist(), strict=True):
                if gain > best.get(term.key, (-math.inf, term))[0]:
                    best[term.key] = gain, term
        there = {t.key for t in fit.terms} | without
        return sorted((p for key, p in best.items() if key not in there), key=lambda p: -p[0])


def _squares(u: np.ndarray) -> np.ndarray:
    """Of columns (K, M), (M,)."""
    return np.einsum("km,km->m", u, u)


def _blocks(u: np.ndarray, size: int) -> np.ndarray:
    """Products (M, C, C) of each C columns of (K, M C) with one another."""
    some = u.T.reshape(-1, size, len(u))
    return some @ some.transpose(0, 2, 1)
