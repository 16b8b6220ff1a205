"""How sure a cause is: one probability, from one calculation.

In the place of a cause there may be nothing, other effects of the library, or something that is in
no library:

- nothing: by the evidence of the explanation without the cause, where `EXPECTED` causes are
  expected among all that were looked at; on logs that might have been
  (`torchid.statistics.bagging`).
- others: as `torchid.gap.causes.judge` says.
- an unknown effect: its regimes are thirds of travel, speed, load and time, both directions, and
  motions (see `torchid.statistics.odds`).
"""

import math
from dataclasses import dataclass

from torchid.effects.registry import EVENTS
from torchid.gap.search.evidence import (
    Fitted,
    Question,
    active_share,
    comparable,
    cost,
    left_by,
    log_likelihood_ratio,
)
from torchid.gap.search.replication import OwnTorque, motions, regimes
from torchid.gap.search.terms import Term
from torchid.statistics.bagging import Alternative, Draws, bagged
from torchid.statistics.criteria import EXPECTED, SET_MASS
from torchid.statistics.odds import Factors, unknown_rise
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


@dataclass(frozen=True)
class Odds:
    """Probabilities of a cause and of what may be there in its place; they add up to one.

    Attributes:
        sure: of the cause.
        nothing: that nothing is there.
        others: of each rival.
        unknown: that something is there that is not in the library.
    """

    sure: float
    nothing: float
    unknown: float
    others: tuple[float, ...] = ()

    @property
    def set_sure(self) -> float:
        """Probability that the cause is there or one of the rivals in its place."""
        return self.sure + sum(self.others)

    def confirmed(self, share: float) -> "Odds":
        """The same where data that were not fitted confirm such a share of what is there, whichever
        it is."""
        masses = (self.sure, self.unknown, *self.others)
        sure, unknown, *others = (share * mass for mass in masses)
        return Odds(sure, 1 - share * (1 - self.nothing), unknown, tuple(others))

    @property
    def in_set(self) -> list[int]:
        """Which rivals belong to the smallest set that holds `SET_MASS` of what is in this place,
        the cause among it; the likeliest first."""
        order = sorted(range(len(self.others)), key=lambda k: -self.others[k])
        held, out = self.sure, []
        for k in order:
            if held >= SET_MASS * self.set_sure:
                break
            held += self.others[k]
            out.append(k)
        return out


@dataclass(frozen=True, eq=False)
class Place:
    """The place of a term.

    Attributes:
        question: of the explanation.
        fits: with the term, and of the others without it.
        term: which.
        own: torque of it that no other term makes.
        curve: whether its joint's law is told from no other smooth curve, and no part of it has a
            name.
    """

    question: Question
    fits: tuple[Fitted, Fitted]
    term: Term
    own: OwnTorque
    curve: bool = False

    def sure(self, misfit: Misfit, draws: Draws) -> float:
        """Probability of the term, against nothing, and something unknown, in its place.

        Args:
            misfit: that the model leaves.
            draws: logs that might have been.
        """
        # What happened once lies in one block, and what acts beyond a limit in few, so that no
        # other log can speak for it.
        rare = any(e.event or e.at_ends for e in self.term.effects)
        draws = draws.as_it_is if rare else draws
        beyond = -math.inf
        if not self.question.shows(self.term):
            beyond = unknown(self.question, self.fits, self.own, self.term, misfit)
        return bagged([self._nothing(draws), (None, beyond)], draws)[0]

    def _nothing(self, draws: Draws) -> Alternative:
        """The explanation without the term."""
        question = self.question
        now, then = comparable(question, *self.fits)
        if then.evidence == -math.inf:
            return None, -math.inf
        # Of the samples that count, and of the squares left, in each log.
        share = draws.sums(question.candidates.keep.double()) / question.normal.rows.clamp(min=1.0)
        squares = [draws.sums(left_by(question, f).square()) for f in self.fits]
        ratio = log_likelihood_ratio(now.effective * share, *squares).sum(1)
        mine, its = (cost(question, question.own(f), now.effective, EXPECTED) for f in (now, then))
        return ratio - (then.known - now.known), mine - its


def unknown(
    question: Question,
    fits: tuple[Fitted, Fitted],
    own: OwnTorque,
    term: Term,
    misfit: Misfit,
) -> float:
    """Twice the logarithm of the odds that something else than the library's is in a term's
    place."""
    fits = comparable(question, *fits)
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
