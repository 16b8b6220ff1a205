"""A model as a set of accepted effects, and what each candidate would add to it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from torchid.gap.bank import Place
from torchid.gap.evidence import significantly_better
from torchid.gap.problem import PENALTY, Candidate, Problem, Term, term_of
from torchid.gap.projection import ROUNDING, Gains, Projector, Scanner

FINEST = 7
"""Times a shape is searched around the best one, each time more closely."""

HALF = 0.5
"""Share of a gain that an effect must have to stand for another."""

SIMPLER = 0.01
"""While misfit remains a simpler law is kept if it loses less than this share of the gain."""
MISFIT = 1.12
"""Loss, relative to noise, above which misfit remains."""


@dataclass
class Terms:
    """A model that grows and shrinks over a fixed set of candidates.

    Attributes:
        problem: data, candidates, noise.
        terms: accepted effects.
    """

    problem: Problem
    terms: list[Term] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.left: set[tuple[str, Place, tuple[str, ...]]] = set()
        self.scanners = [Scanner(bank, self.problem.keep) for bank in self.problem.banks]

    def model(self, without: Sequence[Term] = ()) -> Projector:
        """The residual of the present model, some terms left out."""
        out = self._fixed.copy()
        left_out = {id(term) for term in without}
        for term in self.terms:
            if id(term) not in left_out:
                out.add(term.columns, term.place, visible=ROUNDING)
        return out

    @cached_property
    def _fixed(self) -> Projector:
        """The residual of the terms that are always there."""
        out = Projector(self.problem.y)
        for term in self.problem.fixed:
            out.add(term.columns, term.place, visible=ROUNDING)
        return out

    def candidates(
        self, model: Projector, scanners: Sequence[Scanner] | None = None
    ) -> list[Candidate]:
        """The best member of every bank that is not in the model yet, best score first."""
        present = {term.key for term in self.terms}
        out = []
        for scanner in self.scanners if scanners is None else scanners:
            found = best_member(scanner, model)
            if found is None or (found.term.key in present and found.term.effects):
                continue
            if found.term.key in self.left:  # or the search would go round in circles
                continue
            if found.gain > 0.5 * self.problem.threshold(found.df):
                found = replace(found, term=found.term.scaled(self.problem.keep))
            out.append(found)
        return sorted(out, key=lambda c: -c.score)

    def leave(self, term: Term) -> None:
        """A term leaves for good."""
        self.terms = [t for t in self.terms if t is not term]
        self.left.add(term.key)

    def misfits(self, loss: float) -> bool:
        """Whether more than noise is left."""
        return loss > MISFIT * self.problem.noise

    def simplest(self, best: Candidate, model: Projector) -> Candidate:
        """The simplest candidate that explains it as well: within 1 % while misfit remains, else
        not significantly worse."""
        misfit = self.misfits(model.loss - best.gain)
        for other in sorted(self.candidates(model), key=lambda c: c.simplicity):
            if other.simplicity >= best.simplicity:
                return best
            # Where few blocks hold the gain, their spread cannot tell the best from anything.
            least = max(self.problem.threshold(other.df), HALF * best.gain)
            if other.gain < least or other.term.is_inertial:
                continue
            loses_little = other.gain > (1 - SIMPLER) * best.gain
            # A secant is not taken at the estimate yet: it may lose that much.
            if loses_little and (misfit or _is_secant(other.term)):
                return other
            if not misfit and not significantly_better(self.problem, best.term, other.term, model):
                return other
        return best

    def refined(self, term: Term) -> Term:
        """The same term with its shape searched around the grid's best, until it gains no more."""
        if len(term.effects) != 1:
            return term
        model = self.model(without=[t for t in self.terms if t.key == term.key])
        gain = 0.0
        for level in range(FINEST):
            bank = self.problem.refine(term.effects[0], level)
            found = None if bank is None else best_member(Scanner(bank, self.problem.keep), model)
            if found is None:
                break
            term, last, gain = found.term.scaled(self.problem.keep), gain, found.gain
            if level > 1 and gain - last < 1.0:
                break
        return term

    def scanner_of(self, term: Term) -> Scanner | None:
        """All shapes of a term's effect on its joint; None where it has none."""
        if len(term.effects) != 1 or not term.effects[0].shapes:
            return None
        own = (s for s in self.scanners if (s.bank.name, s.bank.place) == (term.name, term.place))
        return next(own, None)


def best_member(scanner: Scanner, model: Projector) -> Candidate | None:
    """The member of a bank with the best score; None if none gains anything."""
    gains: Gains = scanner.gains(model)
    score = gains.gain - PENALTY * gains.df
    k = int(score.argmax())
    if float(gains.gain[k]) <= 0:
        return None
    return Candidate(term_of(scanner.bank, k), float(gains.gain[k]), int(gains.df[k]))


def _is_secant(term: Term) -> bool:
    return any(effect.linearised for effect in term.effects)
