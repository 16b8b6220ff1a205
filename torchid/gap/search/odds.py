"""How sure a cause is: one probability, from one calculation.

In the place of a cause there may be nothing, another effect of the library, or something that is in
no library. The odds of each against the cause are exp of half of a rise:

- nothing, or another effect: the rise of the evidence without the cause or with the other one in
  its place, where `EXPECTED` causes are expected among all that were looked at. Blocks of samples
  may disagree by more than dependent samples do; the likelihood then counts as much less as their
  spread says (a power of it, Grünwald and van Ommen 2017), the cost of coefficients stays.
- an unknown effect: its regimes are thirds of travel, speed, load and time, both directions, and
  motions (see `torchid.statistics.odds`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.effects.registry import EVENTS
from torchid.gap.search.evidence import (
    Fitted,
    Question,
    active_share,
    comparable,
    cost,
    log_likelihood_ratio,
)
from torchid.gap.search.replication import OwnTorque, motions, regimes
from torchid.gap.search.solve import Solution
from torchid.gap.search.terms import BASE, LINK, Term
from torchid.statistics.criteria import EXPECTED, WRONG_FILE
from torchid.statistics.odds import Factors, probability, unknown_rise
from torchid.typing import Float, Tensor


@dataclass(frozen=True, eq=False)
class Misfit:
    """What an explanation leaves without a name.

    Attributes:
        squares: (n,) mean squares of what it leaves in the fit's band and is no noise.
        share: (n,) of the squares of each joint's error, on data that was not fitted.
    """

    squares: Float[Tensor, " n"]
    share: Float[Tensor, " n"]

    def less(self, fall: Float[Tensor, " n"]) -> "Misfit":
        """With a cause more, by which mean squares fall by (n,)."""
        return replace(self, squares=(self.squares - fall).clamp(min=0))


@dataclass(frozen=True)
class Odds:
    """Twice the logarithms of the odds of what may be there in the place of a cause.

    Attributes:
        nothing: that nothing is there.
        others: effects of the library, each with its name.
        unknown: that something is there that is not in the library.
    """

    nothing: float
    others: tuple[tuple[float, str], ...] = ()
    unknown: float = -math.inf

    @property
    def sure(self) -> float:
        """Probability of the cause."""
        return probability([self.nothing, self.unknown, *(rise for rise, _ in self.others)])

    @property
    def set_sure(self) -> float:
        """Probability that the cause is there or one of the others in its place."""
        return probability([self.nothing, self.unknown])


def odds(
    question: Question,
    fits: tuple[Fitted, Fitted],
    solution: Solution,
    k: int,
    own: OwnTorque,
    misfit: Misfit,
    others: Sequence[tuple[float, Term]] = (),
) -> Odds:
    """What may be there in the place of a term.

    Args:
        question: of the search.
        fits: with the term, and of the others without it.
        solution: with all terms; the k-th is asked.
        own: torque of it that no other term makes.
        misfit: that the model leaves.
        others: terms that may stand in its place, with the rise of the evidence.
    """
    now, then = comparable(question, *fits)
    term = solution.terms[k]
    rest = question.own(then)

    def price(terms: Sequence[Term]) -> float:
        return cost(question, terms, now.effective, EXPECTED)

    mine = price(question.own(now))
    gain = (
        float(log_likelihood_ratio(now.effective, then.losses, now.losses).sum())
        + then.known
        - now.known
    )
    # What happened once lies in one block, and what acts beyond a limit in few: no others can speak
    # for it.
    local = any(e.event or e.at_ends for e in term.effects)
    power = 1.0 if local or gain <= 0 else min(1.0, wald_size(solution, k) / gain)
    each = []
    for rise, other in others:
        if other.name == BASE and not question.known:
            each.append((2 * math.log(WRONG_FILE), LINK))
            continue
        cheaper = mine - price([*rest, other])
        each.append((power * (rise - cheaper) + cheaper, other.name))
    beyond = -math.inf if question.shows(term) else unknown(question, fits, own, term, misfit)
    return Odds(mine - price(rest) - power * gain, tuple(each), beyond)


def wald_size(solution: Solution, k: int) -> float:
    """Squared size of a term's coefficients in standard deviations between blocks (Wald 1943)."""
    values, own = solution.values[k], solution.at(k)
    covariance = solution.covariance[own, own]
    size = covariance.diagonal().clamp(min=1e-300).sqrt()
    spread, axes = torch.linalg.eigh(covariance / size / size.unsqueeze(1))
    there = spread > 1e-9 * spread[-1]
    along = (axes.T @ (values / size))[there]
    return float((along.square() / spread[there]).sum())


def unknown(
    question: Question,
    fits: tuple[Fitted, Fitted],
    own: OwnTorque,
    term: Term,
    misfit: Misfit,
) -> float:
    """Twice the logarithm of the odds that something else than the library's is in a term's
    place."""
    fall = question.fall(*fits) / active_share(question, [term])
    ratio = fall / misfit.squares.clamp(min=1e-12 * float(fall.max()) + 1e-300)
    # Where it acts, or shows most.
    places = term.joints
    joint = places[0] if len(places) == 1 else int(ratio.argmax())
    ways: list[Factors] = []
    if not any(e.name in EVENTS or e.at_ends for e in term.effects):
        columns = question.candidates.columns
        ways = [own.factors(w) for w in regimes(columns, joint, question.candidates.keep[joint])]
        several = motions(columns.samples)
        ways += [own.factors([part for _, part in several])] if len(several) > 1 else []
    return unknown_rise(float(ratio.sum()), float(misfit.share[joint]), ways)
