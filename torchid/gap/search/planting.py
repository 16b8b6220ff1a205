"""What this log would show of a cause, and of others in its place: they are planted and sought.

The gap is made anew: what the other terms explain, the torque of one cause as it was fitted, and
blocks of what the answer leaves, drawn at random (Politis and Romano 1992, circular blocks). In
each draw the cause of most evidence is told, or none. So the confusion of causes, and the size from
which one is found, are those of this motion and of noise like what is left. They are the best that
can be hoped for: what is left of a real arm holds other causes, too.
"""

import itertools
import math
from collections.abc import Sequence

import torch

from torchid.design.gram import inverse_root
from torchid.gap.record import Planted
from torchid.gap.search.evidence import (
    Fitted,
    Question,
    cost,
    fit_each,
    prior_of,
    residual,
    rows_of,
    subset_of,
)
from torchid.gap.search.terms import Term
from torchid.statistics.autocorrelation import integrated_time
from torchid.statistics.blocks import block_length
from torchid.statistics.criteria import SET_ODDS
from torchid.typing import Float, Int, Tensor

DRAWS = 200
"""Draws of each: a share of 5 % is then known to 1.5 %."""

SAME = 1e-3
"""Difference of the evidence that is rounding."""

SIZES = tuple(2.0**k for k in range(-6, 1))
"""Sizes of the cause, as shares of the fitted one."""


class Planting:
    """Where causes are planted: beside one fit, in draws of what it leaves.

    Args:
        question: what was explained.
        fit: what is told.
    """

    def __init__(self, question: Question, fit: Fitted):
        self.question, self.fit = question, fit
        left, keep = residual(question, fit.terms, fit.x), question.candidates.keep
        draws = _draws(left, question.candidates.columns.samples.bounds, question.settings.seed)
        # On every joint the draws (N, B), and their squares (B,).
        self._drawn = [(own[draws] * k).T.contiguous() for own, k in zip(left, keep, strict=True)]
        self.noise = [x.square().sum(0) for x in self._drawn]
        self._pulled: dict[int, tuple[Term, Tensor]] = {}

    def pulled(self, term: Term) -> Float[Tensor, "n C B"]:
        """What draws add to the right side of a term's columns; zero on joints that do not feel
        it."""
        if id(term) not in self._pulled:
            rows = rows_of(self.question, term)
            out = rows.new_zeros(len(self._drawn), len(rows), self._drawn[0].shape[1])
            for j in range(len(out)) if term.place is None else (term.place,):
                own = rows[:, j if term.place is None else 0]
                # Draws hold zeros where no sample counts.
                out[j] = own @ self._drawn[j]
            self._pulled[id(term)] = term, out
        return self._pulled[id(term)][1]


def planted(planting: Planting, rivals: Sequence[Term]) -> Planted:
    """Plant a told term, and others in its place.

    Args:
        planting: beside what is told.
        rivals: the told term first; none that stands in the place of another.
    """
    question, fit, noise = planting.question, planting.fit, planting.noise
    rest = [t for t in fit.terms[len(question.fixed) :] if t is not rivals[0]]
    explanations = [*([*rest, t] for t in rivals), rest]
    fits = [f.x for f in fit_each(question, explanations[:-1], fit.effective, fit.weight)]
    # All their columns; of each explanation the numbers of its own.
    union = (*question.fixed, *rest, *rivals)
    ends = list(itertools.accumulate((len(t.at) for t in union), initial=0))
    of_rival = [torch.arange(a, b) for a, b in itertools.pairwise(ends[-len(rivals) - 1 :])]
    common = torch.arange(ends[-len(rivals) - 1])
    numbers = [*(torch.cat([common, r]) for r in of_rival), common]
    # On every joint: their products, and what draws of what is left add to the right side (k, B)
    # and to the target's square (B,).
    equations = question.normal.of(subset_of(question.normal, union))
    pulled = torch.cat([planting.pulled(t) for t in union], 1)
    # Each explanation's coefficients are linear in the right side.
    matrix, _ = equations.weighted(fit.weight)
    priors = [prior_of((*question.fixed, *e)) for e in explanations]
    roots = [
        inverse_root(matrix[own.unsqueeze(1), own] + p.squares, known=p.squares)
        for own, p in zip(numbers, priors, strict=True)
    ]
    paid = [cost(question, e, fit.effective) for e in explanations]

    def evidence(rival: int, size: float) -> Float[Tensor, "_ B"]:
        """Of every explanation, but for what all have, with one rival at this size."""
        x = torch.zeros(equations.count, dtype=torch.float64)
        x[numbers[rival]] = fits[rival]
        x[of_rival[rival]] *= size
        # Right sides and targets' squares of the draws.
        right, square, total = [], [], torch.zeros(len(x), DRAWS, dtype=torch.float64)
        for w, c, e, g in zip(fit.weight.tolist(), pulled, noise, equations.a, strict=True):
            right.append((g @ x).unsqueeze(1) + c)
            square.append(x @ g @ x + 2 * (x @ c) + e)
            total += w * right[-1]
        out = []
        for own, prior, root, price in zip(numbers, priors, roots, paid, strict=True):
            found = root @ (root.T @ (total[own] + prior.pull.unsqueeze(1)))
            y = torch.zeros_like(total).index_copy_(0, own, found)
            known = (found * (prior.squares @ found - 2 * prior.pull.unsqueeze(1))).sum(0)
            value = -known - price
            for n, b, s, g in zip(fit.effective.tolist(), right, square, equations.a, strict=True):
                loss = s + (y * (g @ y - 2 * b)).sum(0)
                value = value - n * loss.clamp(min=1e-300).log()
            out.append(value)
        return torch.stack(out)

    told = []
    for k in range(len(rivals)):
        # What has the same torque as the planted one is not told instead.
        values = evidence(k, 1.0)
        values[k] += SAME
        first = values.argmax(0)
        shares = first.bincount(minlength=len(explanations)).double() / DRAWS
        told.append(tuple(shares.tolist()))
    found = []
    for size in SIZES:
        # Told, alone or in a set: as good as any but for the odds, and better than none.
        values = evidence(0, size)
        there = values[0] > torch.maximum(values.amax(0) - 2 * math.log(SET_ODDS), values[-1])
        found.append((size, float(there.double().mean())))
    return Planted(tuple(t.name for t in rivals), tuple(told), tuple(found))


def _draws(left: Float[Tensor, "n N"], bounds: Sequence[slice], seed: int) -> Int[Tensor, "B N"]:
    """Which sample stands in the place of each: blocks as long as what is left is dependent."""
    count = left.shape[1]
    length = block_length(count, float(integrated_time(left, bounds, centred=False).max()))
    generator = torch.Generator().manual_seed(seed)
    starts = torch.randint(count, (DRAWS, -(-count // length)), generator=generator)
    index = (starts.unsqueeze(2) + torch.arange(length)) % count
    return index.flatten(1)[:, :count]
