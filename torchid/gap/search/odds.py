"""How sure a cause is: one probability, from one calculation.

In the place of a cause there may be nothing, other effects of the library, or something that is in
no library:

- nothing, or others: by the evidence of the explanation without the cause, or with them in its
  place, where `EXPECTED` causes are expected among all that were looked at; on logs that might have
  been (`torchid.statistics.bagging`).
- an unknown effect: its regimes are thirds of travel, speed, load and time, both directions, and
  motions (see `torchid.statistics.odds`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from torchid.effects.registry import EVENTS
from torchid.gap.search.evidence import (
    Fitted,
    Question,
    active_share,
    comparable,
    cost,
    effective_samples,
    left_by,
    log_likelihood_ratio,
)
from torchid.gap.search.replication import OwnTorque, motions, regimes
from torchid.gap.search.terms import BASE, Term
from torchid.statistics.bagging import Alternative, Draws, bagged
from torchid.statistics.criteria import EXPECTED, SET_MASS, WRONG_FILE
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

    def less(self, fall: Float[Tensor, " n"]) -> "Misfit":
        """With a cause more, by which mean squares fall by (n,)."""
        return replace(self, squares=(self.squares - fall).clamp(min=0))

    def more(self, fall: Float[Tensor, " n"]) -> "Misfit":
        """With what mean squares fall by (n,) as misfit, too."""
        return self.less(-fall)


@dataclass(frozen=True, eq=False)
class Rival:
    """Another explanation without a cause, beside the answered one.

    Attributes:
        weight: of the explanation, on logs that might have been.
        beside: of those that have the cause and the same elsewhere: what an explanation has
            elsewhere speaks neither for nor against the cause.
    """

    weight: Alternative
    beside: tuple[Alternative, ...] = ()


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
    """The place of a term: what may be there instead.

    Attributes:
        question: of the search.
        fits: with the term, and of the others without it.
        term: which.
        own: torque of it that no other term makes.
        instead: nothing, and rivals.
        draws: logs that might have been.
        free: a curve that is no effect of the library, in the place of its joint's law; or none.
    """

    question: Question
    fits: tuple[Fitted, Fitted]
    term: Term
    own: OwnTorque
    instead: tuple[Rival, ...]
    draws: Draws
    free: tuple[Alternative, ...] = ()

    def odds(self, misfit: Misfit) -> Odds:
        """Of all, and of something unknown, beside a misfit that the model leaves."""
        question, term = self.question, self.term
        beyond = -math.inf
        if not question.shows(term):
            beyond = unknown(question, self.fits, self.own, term, misfit)
        weights = [*(r.weight for r in self.instead), (None, beyond), *self.free]
        sure, nothing, *others = bagged(weights, self.draws, [r.beside for r in self.instead])
        known = len(self.instead) - 1
        return Odds(sure, nothing, sum(others[known:]), tuple(others[:known]))


@dataclass(frozen=True, eq=False)
class Against:
    """An explanation that others are weighed against, on logs that might have been.

    Attributes:
        question: of all.
        fit: of the explanation.
        draws: the logs.
    """

    question: Question
    fit: Fitted
    draws: Draws

    def asked_of(self, term: Term) -> "Against":
        """On the logs that a term is asked of: what happened once lies in one block, and what acts
        beyond a limit in few, so that no other log can speak for it."""
        rare = any(e.event or e.at_ends for e in term.effects)
        return self._as_it_is if rare else self

    @cached_property
    def _as_it_is(self) -> "Against":
        return replace(self, draws=self.draws.as_it_is)

    @cached_property
    def _share(self) -> Float[Tensor, "M n"]:
        """Of the samples that count, in each log."""
        keep, rows = self.question.candidates.keep.double(), self.question.normal.rows
        return self.draws.sums(keep) / rows.clamp(min=1.0)

    @cached_property
    def _squares(self) -> Float[Tensor, "M n"]:
        return self._squares_of(self.fit)

    def _squares_of(self, fit: Fitted) -> Float[Tensor, "M n"]:
        """Sums of squares of what a fit leaves, in each log."""
        return self.draws.sums(left_by(self.question, fit).square())

    def weight(self, other: Fitted, terms: Sequence[Term] = ()) -> Alternative:
        """Of another explanation, with terms in the place of one of this one's."""
        question = self.question
        if not question.known and any(t.name == BASE for t in terms):
            # A file that is wrong throughout has odds of its own, whatever its numbers cost.
            return None, 2 * math.log(WRONG_FILE)
        now, then = comparable(question, self.fit, other)
        if then.evidence == -math.inf:
            return None, -math.inf
        ratio = self._ratio(other, now.effective)
        mine, its = (cost(question, question.own(f), now.effective, EXPECTED) for f in (now, then))
        # The friction of a joint is one law, in how many terms ever; all else is several causes.
        one_law = all(e.branch == "friction" for t in terms for e in t.effects)
        more = max(len(terms) - 1, 0) * question.price(EXPECTED) if one_law else 0.0
        return ratio - (then.known - now.known), mine - its + more

    def free(self, curve: Fitted, instead: int) -> Alternative:
        """Of a fit with a curve in the place of several terms, whose coefficients cost nothing and
        have no limits: it is one cause."""
        question = self.question
        ratio = self._ratio(curve, effective_samples(question, curve, self.fit))
        return ratio, (instead - 1) * question.price(EXPECTED)

    def _ratio(self, other: Fitted, effective: Float[Tensor, " n"]) -> Float[Tensor, " M"]:
        squares = self._squares, self._squares_of(other)
        return log_likelihood_ratio(effective * self._share, *squares).sum(1)


def law_of(against: Against, without: Fitted, terms: Sequence[Term], own: OwnTorque) -> Place:
    """The place of a law of a joint, in several terms: one law, which is there or not."""
    place = place_of(against, without, terms[0], own)
    # However many terms it has, it is one cause.
    gain, paid = place.instead[0].weight
    fewer = (len(terms) - 1) * against.question.price(EXPECTED)
    return replace(place, instead=(Rival((gain, paid - fewer)),))


def place_of(
    against: Against,
    without: Fitted,
    term: Term,
    own: OwnTorque,
    rivals: Sequence[Rival] = (),
) -> Place:
    """The place of a term.

    Args:
        against: the explanation that has it.
        without: the fit of the others.
        term, own: as for `Place`.
        rivals: what may be in it beside nothing.
    """
    asked = against.asked_of(term)
    instead = (Rival(asked.weight(without)), *rivals)
    return Place(asked.question, (asked.fit, without), term, own, instead, asked.draws)


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
