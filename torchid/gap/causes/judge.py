"""How sure a cause is: one probability, from one calculation.

In the place of a term there may be nothing, or another term of the library. On logs that might have
been, blocks of samples drawn again with replacement, half as many as there are (Huggins and Miller
2023, Bayesian Analysis 18(4)), each explanation has its evidence: the likelihood of the drawn samples,
and what its coefficients and the looking cost in proportion to the drawn samples. A probability is a
mean over the draws. What a rival adds beside the term speaks for neither.

What is left without a cause bounds how sure the others can be: odds against are at least `DOUBT` times
its share of the squares.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchid.gap.causes.candidates import Term
from torchid.gap.causes.evidence import Fit
from torchid.gap.causes.search import Search, excluding
from torchid.statistics.bagging import Draws
from torchid.statistics.criteria import SET_MASS

NEARLY = 0.8
"""Probability, over that of the likeliest, from which an explanation is nearly as likely [1]: the
simplest of these gives the name."""

DOUBT = 16 / 9
"""Odds against a cause, over the share of the squares that has no cause [1]: with a quarter of the RMS
left a cause is 90 % sure at most, with half of it 69 %."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A term, and what may be in its place.

    Attributes:
        term: of the explanation.
        name: the term that gives the name: the simplest of those nearly as likely.
        sure: probability of `name`.
        nothing: that nothing is there.
        members: smallest set that holds nine tenths of what may be there, the likeliest first, with
            their probabilities.
        law: probability of the joint's law that `name` is a form of; of `name` where it is no form.
        fall: (n,) mean squares that it takes away [(N m)^2; N^2].
    """

    term: Term
    name: Term
    sure: float
    nothing: float
    members: tuple[tuple[Term, float], ...]
    law: float
    fall: np.ndarray

    @property
    def there(self) -> float:
        """Probability that something is there."""
        return 1.0 - self.nothing


def judge(search: Search, fit: Fit, left: np.ndarray, draws: Draws) -> list[Judged]:
    """All terms of an explanation.

    Args:
        search: that found it.
        fit: the explanation.
        left: (n,) share of the squares of each joint's gap that is left without a cause, and the
            arm's as a whole behind them (n + 1,).
        draws: logs that might have been.
    """
    return [judged(search, fit, t, left, draws) for t in fit.terms]


def judged(search: Search, fit: Fit, term: Term, left: np.ndarray, draws: Draws) -> Judged:
    """One term of an explanation."""
    evidence, library = search.evidence, search.library
    others = excluding(fit.terms, [term])
    base = evidence.fit(others, fit.samples)
    likely = search.likely(base, frozenset({term.key}))
    tried = [(u, evidence.fit((*others, u), fit.samples)) for u in likely]
    # Evidence is of pairs: a rival must be likelier than nothing by itself.
    rivals = [(u, f) for u, f in tried if f.allowed and evidence.over(f, base) > 0]
    effect = term.effect
    rare = effect is not None and (effect.event or effect.at_ends)
    asked = draws.as_it_is if rare else draws
    masses = probabilities(search, fit, [base, *(f for _, f in rivals)], asked, _beside(search, fit, rivals))
    own, nothing, every = masses[0], masses[1], [(term, masses[0])]
    every += [(u, p) for (u, _), p in zip(rivals, masses[2:], strict=True)]
    every.sort(key=lambda pair: -pair[1])
    # The smallest set, and the simplest of those that are nearly as likely as the likeliest.
    members, held = list[tuple[Term, float]](), 0.0
    for pair in every:
        if held >= SET_MASS * (1 - nothing):
            break
        members.append(pair)
        held += pair[1]
    near = [t for t, p in every if p >= NEARLY * every[0][1]]
    name = min(near, key=lambda t: (t.count, t is not term))
    of = dict((id(t), p) for t, p in every)
    law = sum(p for t, p in every if t.cause == name.cause)
    fall = np.maximum(base.losses - fit.losses, 0.0) / library.rows
    bound = _bound(fall, left)
    return Judged(
        term, name, min(of[id(name)], bound), max(nothing, 0.0), tuple(members), min(law, bound), fall
    )


def _bound(fall: np.ndarray, left: np.ndarray) -> float:
    """How sure a cause can be beside what is left: by its joints' shares, and the whole arm's."""
    own = float((fall * left[:-1]).sum() / max(fall.sum(), 1e-300))
    return 1 / (1 + DOUBT * max(own, float(left[-1])))


def _beside(search: Search, fit: Fit, rivals: Sequence[tuple[Term, Fit]]) -> list[float]:
    """What each rival adds beside the term, on other joints say [nats]."""
    evidence = search.evidence
    both = [evidence.fit((*fit.terms, u), fit.samples) for u, _ in rivals]
    return [max(0.0, evidence.over(b, fit)) if b.allowed else 0.0 for b in both]


def probabilities(
    search: Search, fit: Fit, instead: Sequence[Fit], draws: Draws, beside: Sequence[float] = ()
) -> list[float]:
    """Probabilities of an explanation and of others in its place; they add up to one.

    Args:
        search: of all.
        fit: the explanation.
        instead: others; the first without anything in the place.
        draws: logs that might have been.
        beside: of all but the first, evidence that speaks for neither [nats].
    """
    evidence = search.evidence
    drawn = draws.times.sum(1).numpy() / draws.times.shape[1]
    rows = draws.sums(search.library.problem.data.keep.double()).numpy()
    share = rows / search.library.rows
    rises = [np.zeros(len(drawn))]
    for k, other in enumerate(instead):
        if not other.allowed:
            rises.append(np.full(len(drawn), -np.inf))
            continue
        samples = evidence.telling(fit, other)
        mine, its = (evidence.fit(f.terms, samples) for f in (fit, other))
        a, b = (_squares(search, f, draws) for f in (mine, its))
        ratio = -0.5 * (samples * share * np.log(b / a)).sum(1)
        paid = its.known - mine.known + evidence.price(its.terms) - evidence.price(mine.terms)
        more = beside[k - 1] if k and len(beside) else 0.0
        rises.append(ratio - drawn * (paid + more))
    found = np.stack(rises)
    weights = np.exp(found - found.max(0))
    return (weights / weights.sum(0)).mean(1).tolist()


def _squares(search: Search, fit: Fit, draws: Draws) -> np.ndarray:
    """Sums of squares (M, n) of what a fit leaves, in each drawn log."""
    import torch

    left = torch.from_numpy(search.evidence.left(fit))
    drawn = draws.sums(left.square()).numpy()
    share = draws.sums(search.library.problem.data.keep.double()).numpy() / search.library.rows
    return np.maximum(drawn, search.evidence.floor * np.maximum(share, 1e-3))
