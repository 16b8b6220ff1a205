"""Which effects: forward selection by group, with drops, swaps and refinement of shapes.

Sums of squares are of whitened rows: one unit a row is noise. A candidate's gain is compared with
PHI chi^2 at a level shared by all looks; a small one must also hold on blocks it was not fitted on,
or stand out against random signs of whole blocks. Thresholds are relative to what is left to
explain, so that a small effect beside a large one is not lost, nor the misfit of a large one named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import torch

from torchid.gap.blocks import (
    block_sums,
    held_out_gain,
    mean_bound,
    sign_flip_p,
    wald_p,
)
from torchid.gap.candidates import Bank, Place
from torchid.gap.fit import ROUNDED
from torchid.gap.problem import FRICTION, PENALTY, Candidate, Problem, Term, term_of
from torchid.gap.projection import ROUNDING, Gains, Projector, Scanner, in_all_rows
from torchid.typing import Float, Tensor

TRIED = 30
"""Candidates, best first, that may be refused before a search ends."""

FINEST = 7
"""Times a shape is searched around the best one, each time more closely."""

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

FEW_COLUMNS = 4
"""Blocks a column that a Wald test needs: with fewer it finds too much."""
DOUBTFUL = 0.2
"""Family-wise p-value above which an accepted effect leaves again where the noise is not known."""
FLIP_LEVEL = 0.02
HALF = 0.5
"""Share of a gain that an effect must have to stand for another."""

SIMPLER = 0.01
"""While misfit remains a simpler law is kept if it loses less than this share of the gain."""
MISFIT = 1.12
"""Loss, relative to noise, above which misfit remains."""


def _is_secant(term: Term) -> bool:
    return any(hasattr(effect, "at") for effect in term.effects)


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
class Search:
    """A model that grows and shrinks over a fixed set of candidates."""

    problem: Problem
    terms: list[Term] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._left: set[tuple[str, Place, tuple[str, ...]]] = set()
        self._accepted: dict[tuple[str, Place, tuple[str, ...]], float] = {}
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
            found = _best_member(scanner, model)
            if found is None or (found.term.key in present and found.term.effects):
                continue
            if found.term.key in self._left:  # or the search would go round in circles
                continue
            if found.gain > 0.5 * self.problem.threshold(found.df):
                found = replace(found, term=found.term.scaled(self.problem.keep))
            out.append(found)
        return sorted(out, key=lambda c: -c.score)

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
                    self.terms.append(self._refined(term))
                    self._accepted[self.terms[-1].key] = chosen.gain
            self._reshape(self.terms[-1])
            self._look_back(newest=self.terms[-1])
            model = self.model()
        self._look_back(newest=None)
        self._drop_doubtful()
        return self.terms

    def _leave(self, term: Term) -> None:
        """A term leaves for good."""
        self.terms = [t for t in self.terms if t is not term]
        self._left.add(term.key)

    def _drop_doubtful(self) -> None:
        """Without a known noise, terms that others have made doubtful leave, the weakest first."""
        while not self.problem.whitened and self.terms:
            model = self.model()
            left = {
                id(t): self.p_value(t, self.model(without=[t]).loss - model.loss)
                for t in self.terms
                if not t.is_inertial and FEW_COLUMNS * len(t.columns) <= len(self.problem.block)
            }
            worst = max(self.terms, key=lambda t: left.get(id(t), 0.0))
            if left.get(id(worst), 0.0) <= DOUBTFUL:
                return
            self._leave(worst)

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
            if not (dominant and self.problem.whitened) and not self._holds_on_blocks(
                best.term, model
            ):
                continue
            return self._simplest(best, model)
        return None

    def _pair(self, model: Projector, chosen: Candidate | None) -> "_Pair | None":
        """Two effects for one, where one with a free shape had to imitate both: another shape of it
        and a second effect on its joint. Only if they gain as much as the candidate that would be
        added else; a whole link is blamed only where no two effects on a joint would do."""
        rival = 0.0 if chosen is None or chosen.term.is_inertial else chosen.gain
        least = SMALL * (model.loss - self.problem.noise)
        for term in self.terms:
            scanner = self._scanner_of(term)
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
            if self._holds_on_blocks(second, without):
                return _Pair(term, first, second, gain)
        return None

    def _divide(self, pair: "_Pair") -> None:
        first, second = pair.first, pair.second
        self.terms = [*(first if t is pair.old else t for t in self.terms), second]
        self._accepted[first.key] = self._accepted[second.key] = pair.gain

    def _best_pair(self, shapes: Scanner, without: Projector) -> tuple[Term, Term, float] | None:
        """The shape of an effect, and the effect without a shape on the same joint, that leave
        least together; and what they leave."""
        present = {t.key for t in self.terms} | self._left
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
            first = _best_member(shapes, beside)
            if first is not None and (best is None or beside.loss - first.gain < best[2]):
                best = first.term.scaled(self.problem.keep), second, beside.loss - first.gain
        return best

    def _misfits_at(self, term: Term, model: Projector) -> bool:
        """Whether more than noise is left where a term acts; a contact, which is there for a moment
        only, is clear by its gain."""
        if term.name == WINDOWED:
            return self._misfits(model.loss) or model.loss > self.problem.noise + CLEAR_WINDOW
        if term.place is None:
            return self._misfits(model.loss)
        own = float(model.r[term.place].square().sum())
        return own > MISFIT * self.problem.noise / self.problem.y.shape[0]

    def _misfits(self, loss: float) -> bool:
        """Whether more than noise is left."""
        return loss > MISFIT * self.problem.noise

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

    def _simplest(self, best: Candidate, model: Projector) -> Candidate:
        """The simplest candidate that explains it as well: within 1 % while misfit remains, else
        not significantly worse."""
        misfit = self._misfits(model.loss - best.gain)
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
            if not misfit and not self.significantly_better(best.term, other.term, model):
                return other
        return best

    def significantly_better(
        self, one: Term, two: Term, model: Projector, confidence: float = 0.95
    ) -> bool:
        """Whether `one` leaves less than `two`, judged by differences of whole blocks."""
        losses = [self.block_losses(term, model) for term in (one, two)]
        extra = PENALTY * (len(one.columns) - len(two.columns))
        return mean_bound(losses[1] - losses[0], confidence) > max(0.0, extra)

    def block_losses(self, term: Term, model: Projector) -> Float[Tensor, " K"]:
        """Sum of squares of every block when a term joins the model."""
        after = model.copy()
        after.add(term.columns, term.place)
        return block_sums(after.r.square().sum(0), self.problem.block)

    def _holds_on_blocks(self, term: Term, model: Projector) -> bool:
        """Where rows are whitened: random signs of blocks, or coefficients from other folds,
        confirm the gain. Else both coefficients from other folds and a Wald test whose covariance
        is the spread between blocks, at the level shared by all looks (it has no power, and no
        validity, for groups of almost as many columns as there are blocks)."""
        columns, r, block = self._projected(term, model)
        scores = block_sums(columns * r, block).T
        if self.problem.whitened:
            if sign_flip_p(scores, self.problem.seed) < FLIP_LEVEL:
                return True
        else:
            few = FEW_COLUMNS * len(columns) <= len(scores)
            if few and wald_p(columns, r, block) * self.problem.looks > self.problem.alpha:
                return False
        return mean_bound(held_out_gain(columns, r, block), 0.95) > 0

    def p_value(self, term: Term, gain: float) -> float:
        """Family-wise p-value of an accepted term, by the test that judged it: of its gain where
        rows are white, else of the spread between blocks."""
        if self.problem.whitened:
            return self.problem.p_value(gain, len(term.columns))
        model = self.model(without=[term])
        columns, r, block = self._projected(term, model)
        return min(1.0, self.problem.looks * wald_p(columns, r, block))

    def _projected(self, term: Term, model: Projector) -> tuple[Tensor, Tensor, Tensor]:
        """A term's columns beside a model, the residual, and the block of each row."""
        columns = in_all_rows(term.columns, term.place, model.n)
        rows = model.rows_of(term.place)
        longest = columns.norm(dim=1).max()
        columns = (columns - (columns @ model.q.T) @ model.q)[:, rows]
        size = columns.norm(dim=1, keepdim=True)
        there = size[:, 0] > ROUNDED * longest
        columns = columns[there] / size[there]
        return columns, model.r.flatten()[rows], self.problem.blocks_of(term.place)

    def _refined(self, term: Term) -> Term:
        """The same term with its shape searched around the grid's best, until it gains no more."""
        if len(term.effects) != 1:
            return term
        model = self.model(without=[t for t in self.terms if t.key == term.key])
        gain = 0.0
        for level in range(FINEST):
            bank = self.problem.refine(term.effects[0], level)
            found = None if bank is None else _best_member(Scanner(bank, self.problem.keep), model)
            if found is None:
                break
            term, last, gain = found.term.scaled(self.problem.keep), gain, found.gain
            if level > 1 and gain - last < 1.0:
                break
        return term

    def _reshape(self, newest: Term) -> None:
        """Shapes on the same joint that imitated what `newest` explains are searched again."""
        for term in list(self.terms):
            if term is newest or term.place is None or term.place != newest.place:
                continue
            scanner = self._scanner_of(term)
            if scanner is None:
                continue
            without = self.model(without=[term])
            best = _best_member(scanner, without)
            better = best is not None and without.loss - best.gain < self.model().loss
            start = best.term.scaled(self.problem.keep) if best is not None and better else term
            refined = self._refined(start)
            self.terms = [refined if t is term else t for t in self.terms]

    def _scanner_of(self, term: Term) -> Scanner | None:
        """All shapes of a term's effect on its joint; None where it has none."""
        if len(term.effects) != 1 or not term.effects[0].shapes:
            return None
        own = (s for s in self.scanners if (s.bank.name, s.bank.place) == (term.name, term.place))
        return next(own, None)

    def _look_back(self, newest: Term | None) -> None:
        """Drop terms that others have made superfluous, swap those that another explains better."""
        for term in list(self.terms):
            related = newest is None or newest.place is None or term.place in (None, newest.place)
            if term is newest or not related or term not in self.terms:
                continue
            without = self.model(without=[term])
            own = _best_member(Scanner(_bank_of(term), self.problem.keep), without)
            if own is None or own.gain < self.problem.threshold(own.df):
                self._leave(term)
                continue
            if term.is_inertial and self._simplified(term, own, without):
                continue
            self._swap(term, own, without)

    def _simplified(self, term: Term, own: Candidate, without: Projector) -> bool:
        """Put one effect in the place of parameters that explained several, once the others are
        named: a search that adds one at a time begins with what holds a share of all."""
        other = self._simplest(own, without).term
        if other.key == term.key or other.name == FRICTION:
            return False
        self.terms = [t for t in self.terms if t is not term]
        self._left.add(term.key)
        self.terms.append(self._refined(other))
        return True

    def _swap(self, term: Term, own: Candidate, without: Projector) -> None:
        near = [s for s in self.scanners if s.bank.place in (term.place, None)]
        kept = self.terms
        self.terms = [t for t in kept if t is not term]
        others = [c for c in self.candidates(without, near) if c.term.key != term.key]
        better = [c for c in others if c.score > own.score + self.problem.threshold(c.df)]
        if better and self.significantly_better(better[0].term, term, without):
            chosen = self._simplest(better[0], without)
            if chosen.term.key != term.key and chosen.term.name != FRICTION:
                self._left.add(term.key)
                self.terms.append(self._refined(chosen.term))
                return
        self.terms = kept


def _bank_of(term: Term) -> Bank:
    return Bank(
        term.name,
        term.place,
        (term.effects,),
        term.columns.unsqueeze(0),
        term.coefficients,
        1.0,
        term.extra,
        term.known,
    )


def _best_member(scanner: Scanner, model: Projector) -> Candidate | None:
    gains: Gains = scanner.gains(model)
    score = gains.gain - PENALTY * gains.df
    k = int(score.argmax())
    if float(gains.gain[k]) <= 0:
        return None
    return Candidate(term_of(scanner.bank, k), float(gains.gain[k]), int(gains.df[k]))
