"""The pool: explanations that are as good as the answered one, or nearly, on logs that might have
been.

Climbs on drawn logs end elsewhere. Where such an end differs from the answer in several parts that
no joint feels in common, one part may be better for it and another worse, so every part is asked
by itself: alone in the answer, and left out of the end.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from torchid.gap.search.evidence import Fitted, Question, refit_each, rows_of
from torchid.gap.search.explain import Explanation
from torchid.gap.search.odds import Rival, weighed
from torchid.gap.search.terms import Term, excluding
from torchid.statistics.bagging import Alternative, Draws

FELT = 0.05
"""Share of a term's squares on a joint, in units of the noise there, from which the joint feels it
[1]."""

Change = tuple[list[Term], tuple[Term, ...]]
"""Terms that leave an explanation, and those that come in their place."""


@dataclass(frozen=True, eq=False)
class Pool:
    """Other explanations: their terms, in what they differ from the answered one, part by part, and
    their weights beside it."""

    every: tuple[tuple[list[Term], tuple[Change, ...], Alternative], ...]

    def without(self, term: Term) -> list[Rival]:
        """Those that have a term of the answered one in no shape."""
        holds = [any(t.key == term.key for t in terms) for terms, *_ in self.every]
        pairs = list(zip(self.every, holds, strict=True))
        beside = tuple(weight for (_, _, weight), there in pairs if there)
        return [
            Rival(next(come for gone, come in changes if term in gone), weight, beside)
            for (_, changes, weight), there in pairs
            if not there
        ]


def pool_of(found: Explanation, draws: Draws) -> Pool:
    """The ends of an explanation's search, and what stands between them and it."""
    question, fit = found.question, found.fit
    own, every = question.own(fit), dict[frozenset[int], tuple[list[Term], tuple[Change, ...]]]()
    for terms in found.ends:
        end = [t for t in terms if t.key not in question.barred]
        parts = list(_parts(question, fit, excluding(own, end), excluding(end, own)))
        some = [[p for p in parts if p is not one] for one in parts]
        for changes in (*([one] for one in parts), *some, parts):
            rest = excluding(own, [t for gone, _ in changes for t in gone])
            rest += [t for _, come in changes for t in come]
            if changes:
                every.setdefault(frozenset(map(id, rest)), (rest, tuple(changes)))
    fits = refit_each(question, fit, [terms for terms, _ in every.values()])
    weights = (weighed(question, fit, other, draws) for other in fits)
    return Pool(tuple((*one, w) for one, w in zip(every.values(), weights, strict=True)))


def _parts(
    question: Question, fit: Fitted, gone: Sequence[Term], come: Sequence[Term]
) -> Iterator[Change]:
    """Terms that leave and terms that come, in parts no two of which a joint feels."""
    groups: list[tuple[set[int], list[Term]]] = []
    for term in (*gone, *come):
        felt, members = _felt(question, fit, term), [term]
        for group in [g for g in groups if g[0] & felt]:
            groups.remove(group)
            felt, members = felt | group[0], group[1] + members
        groups.append((felt, members))
    for _, members in groups:
        yield excluding(members, come), tuple(excluding(members, gone))


def _felt(question: Question, fit: Fitted, term: Term) -> set[int]:
    """Joints that feel a term."""
    if term.place is not None:
        return {term.place}
    squares = rows_of(question, term).square().sum((0, 2)) * fit.weight
    return set((squares > FELT * squares.sum()).nonzero().flatten().tolist())
