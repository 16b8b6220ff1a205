"""Which effects: forward selection by group, with drops, swaps and refinement of shapes.

Sums of squares are of whitened rows: one unit a row is noise. A candidate's gain is compared with
PHI chi^2 at a level shared by all looks; a small one must also hold on blocks it was not fitted on,
or stand out against random signs of whole blocks. Thresholds are relative to what is left to
explain, so that a small effect beside a large one is not lost, nor the misfit of a large one named.
"""

from dataclasses import dataclass

import torch

from torchid.gap.bank import Place
from torchid.gap.evidence import holds_on_blocks
from torchid.gap.look_back import drop_doubtful, look_back, reshape
from torchid.gap.problem import FRICTION, Candidate, Term, term_of
from torchid.gap.projection import ROUNDING, Projector, Scanner
from torchid.gap.terms import MISFIT, Terms, best_member

TRIED = 30
"""Candidates, best first, that may be refused before a search ends."""

DOMINANT = 0.25
"""A gain above this share of what is left needs no test on blocks, for its energy may sit in few;
but only while misfit remains: at the floor everything is dominant."""

SMALL = 0.01
"""A gain below this share of what is left is not worth a name."""

MISFITTED = 0.01
"""Share of an accepted effect's gain that its own misfit can hold: no law of friction fits an arm
to a few per cent. A smaller gain on the same rows is not told from it."""
MISFITTED_BY_WINDOW = 0.03
"""The same for a contact: of hundreds of windows one is where the misfit is largest."""
TAIL = 0.05
"""Share of a window's largest column below which a row is outside: whitening leaves tails."""
LONG_WINDOW = 0.4
CONTRAST = 10.0
MOST = 0.4
"""Seconds from which a contact outlasts what a wrong law of friction does at a reversal. Then it
must explain this many times what the accepted effects' misfit elsewhere lets expect there, and that
share of all that is left."""
CLEAR_WINDOW = 150.0
"""Whitened sum of squares beyond noise that a contact must explain."""
WINDOWED = "contact"


@dataclass(frozen=True)
class _Pair:
    """Two effects on a joint that explain more than the one there.

    Attributes:
        old: the one.
        first: the same effect with another shape.
        second: the other effect.
        gain: what they explain more.
    """

    old: Term
    first: Term
    second: Term
    gain: float


@dataclass
class Search(Terms):
    """The search that builds the model."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._accepted: dict[tuple[str, Place, tuple[str, ...]], float] = {}

    def run(self, most: int) -> list[Term]:
        """Add the best candidate until none is convincing; then look back once more."""
        model = self.model()
        while len(self.terms) < most:
            chosen = self._choose(model)
            pair = self._pair(model, chosen)
            if pair is not None:
                self._divide(pair)
            elif chosen is None:
                break
            else:
                for term in self._parts(chosen):
                    self.terms.append(self.refined(term))
                    self._accepted[self.terms[-1].key] = chosen.gain
            reshape(self, self.terms[-1])
            look_back(self, newest=self.terms[-1])
            model = self.model()
        look_back(self, newest=None)
        drop_doubtful(self)
        return self.terms

    def _parts(self, chosen: Candidate) -> list[Term]:
        """A composite enters as its parts."""
        term = chosen.term
        if term.name != FRICTION:
            return [term]
        parts, first = [], 0
        for effect in term.effects:
            own = slice(first, first + len(effect.coefficients))
            first = own.stop
            parts.append(
                Term(
                    effect.name,
                    term.place,
                    (effect,),
                    term.columns[own],
                    term.coefficients[own],
                    0.0,
                    term.known[own],
                )
            )
        return parts

    def _choose(self, model: Projector) -> Candidate | None:
        """The candidate to add, or None."""
        left = max(0.0, model.loss - self.problem.noise)
        # What happened once can be anything: what acts all the time is asked first.
        ranked = sorted(self.candidates(model)[:TRIED], key=lambda c: c.term.name == WINDOWED)
        for best in ranked:
            least = max(SMALL * left, self._imitated(best.term, model))
            if best.gain < max(self.problem.threshold(best.df), least):
                continue
            dominant = best.gain > DOMINANT * left and self._misfits_at(best.term, model)
            if not (dominant and self.problem.whitened) and not holds_on_blocks(
                self.problem, best.term, model
            ):
                continue
            return self.simplest(best, model)
        return None

    def _pair(self, model: Projector, chosen: Candidate | None) -> "_Pair | None":
        """Two effects for one, where one with a free shape had to imitate both: another shape of it
        and a second effect on its joint. Only if they gain as much as the candidate that would be
        added else; a whole link is blamed only where no two effects on a joint would do."""
        rival = 0.0 if chosen is None or chosen.term.is_inertial else chosen.gain
        least = SMALL * (model.loss - self.problem.noise)
        for term in self.terms:
            scanner = self.scanner_of(term)
            if scanner is None or term.place is None or not self._misfits_at(term, model):
                continue
            without = self.model(without=[term])
            found = self._best_pair(scanner, without)
            if found is None:
                continue
            first, second, loss = found
            gain = model.loss - loss
            enough = max(self.problem.threshold(len(second.columns)), least, rival)
            if gain < max(enough, MISFITTED * self._largest_near(term)):
                continue
            without.add(first.columns, first.place, visible=ROUNDING)
            if holds_on_blocks(self.problem, second, without):
                return _Pair(term, first, second, gain)
        return None

    def _divide(self, pair: "_Pair") -> None:
        first, second = pair.first, pair.second
        self.terms = [*(first if t is pair.old else t for t in self.terms), second]
        self._accepted[first.key] = self._accepted[second.key] = pair.gain

    def _best_pair(self, shapes: Scanner, without: Projector) -> tuple[Term, Term, float] | None:
        """The shape of an effect, and the effect without a shape on the same joint, that leave
        least together; and what they leave."""
        present = {t.key for t in self.terms} | self.left
        best: tuple[Term, Term, float] | None = None
        for scanner in self.scanners:
            bank = scanner.bank
            if bank.place != shapes.bank.place or len(bank.members) != 1 or bank.name == FRICTION:
                continue
            second = term_of(bank, 0).scaled(self.problem.keep)
            if second.key in present:
                continue
            beside = without.copy()
            beside.add(second.columns, second.place, visible=ROUNDING)
            first = best_member(shapes, beside)
            if first is not None and (best is None or beside.loss - first.gain < best[2]):
                best = first.term.scaled(self.problem.keep), second, beside.loss - first.gain
        return best

    def _misfits_at(self, term: Term, model: Projector) -> bool:
        """Whether more than noise is left where a term acts; a contact, which is there for a moment
        only, is clear by its gain."""
        if term.name == WINDOWED:
            return self.misfits(model.loss) or model.loss > self.problem.noise + CLEAR_WINDOW
        if term.place is None:
            return self.misfits(model.loss)
        own = float(model.r[term.place].square().sum())
        return own > MISFIT * self.problem.noise / self.problem.y.shape[0]

    def _imitated(self, term: Term, model: Projector) -> float:
        """What the misfit of an accepted effect can hold of a candidate."""
        if term.name != WINDOWED:
            return MISFITTED * self._largest_near(term)
        size = term.columns.abs().amax(0).reshape(self.problem.y.shape).amax(0)
        inside = size > TAIL * size.max()
        if float(inside.sum()) * self.problem.interval < LONG_WINDOW:
            return MISFITTED_BY_WINDOW * self._largest_near(term)
        places = torch.stack([inside, ~inside]).to(model.r)
        left = (places @ model.r.square().T).sum(1)
        beyond = float(left[1] - self.problem.noise * places[1].mean())
        expected = [0.0]
        for t in self.terms:
            held = (places @ self.model(without=[t]).r.square().T).sum(1) - left
            expected.append(float(held[0] / held[1].clamp(min=1e-300)) * max(0.0, beyond))
        total = model.loss - self.problem.noise if self.terms else 0.0
        return max(CONTRAST * max(expected), MOST * total)

    def _largest_near(self, term: Term) -> float:
        """Sum of squares of the largest contribution that was accepted on the same rows."""
        near = [t for t in self.terms if term.place is None or t.place in (term.place, None)]
        for t in near:
            if t.key not in self._accepted:
                self._accepted[t.key] = self.model(without=[t]).loss - self.model().loss
        return max((self._accepted[t.key] for t in near), default=0.0)
