"""How sure each cause of an explanation is, as it is told: itself, one of a set, or the law of its
joint."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch

from torchid.effects.base import Effect
from torchid.effects.registry import KINDS
from torchid.gap.causes.candidates import Library, Term
from torchid.gap.causes.explain import Explained
from torchid.gap.causes.judge import Judged, is_one_curve
from torchid.gap.wanted import BASE
from torchid.results.cause import LINK
from torchid.statistics.criteria import LIKELY, SET_MASS
from torchid.typing import Float, Tensor


@dataclass(frozen=True, eq=False)
class Claim:
    """A cause of an explanation, and what may be there in its place.

    Attributes:
        judged: the cause, with its probability and those of its rivals.
        fall: (n,) sum of squares that it takes from each joint.
        at_an_end: whether its shape is at the end of its range.
        curve: whether its joint's law is told from no other smooth curve, and no part of it has a
            name.
        confirmed: share of what is there that data which were not fitted confirm.
    """

    judged: Judged
    fall: Float[Tensor, " n"]
    at_an_end: bool = False
    curve: bool = False
    confirmed: float = 1.0

    @property
    def term(self) -> Term:
        """The term that is claimed."""
        return self.judged.term

    @property
    def law(self) -> tuple[str, int] | None:
        """The law of its joint, friction say, of which it is one term of several."""
        return self.term.law

    @property
    def law_sure(self) -> float:
        """Probability that there is any form of the law, or of the cause itself."""
        return self.confirmed * self.judged.law

    @property
    def alone_sure(self) -> float:
        """Probability of the cause itself."""
        return 0.0 if self.curve else self.confirmed * self.judged.own

    @cached_property
    def others(self) -> tuple[tuple[Term, float], ...]:
        """What may stand in its place, the likeliest first, with probabilities; of several terms
        together each has a part."""
        members = ((ts, p) for ts, p in self.judged.members if ts[0] is not self.term)
        return tuple((t, self.confirmed * p / len(ts)) for ts, p in members for t in ts)

    @property
    def set_sure(self) -> float:
        """Probability that the cause is there or one of the rivals in its place."""
        return self.alone_sure + sum(p for _, p in self.others)

    @cached_property
    def in_set(self) -> tuple[Term, ...]:
        """Rivals of the smallest set that holds `SET_MASS` of what is in this place, the cause
        among it; the likeliest first."""
        # What is in this place is the whole: a set is to hold so much of it, not of all that may
        # be.
        held, out = self.alone_sure, list[Term]()
        for other, mass in sorted(self.others, key=lambda pair: -pair[1]):
            if held >= SET_MASS * self.set_sure:
                break
            held += mass
            out.append(other)
        return tuple(out)

    @property
    def one_of_a_set(self) -> bool:
        """Whether it is the likeliest of a set none of which is likely by itself."""
        return self.alone_sure < LIKELY <= self.set_sure and bool(self.others)

    @property
    def sure(self) -> float:
        """Probability of it, or of the set."""
        return self.set_sure if self.one_of_a_set else self.alone_sure

    @property
    def named(self) -> bool:
        """Whether it, or one of its set, is likelier there than not."""
        return self.sure >= LIKELY

    @property
    def unnamed(self) -> bool:
        """Whether neither it, nor the law of its joint as a whole, has a name."""
        return not self.named and self.law_sure < LIKELY

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """Names of the others of its set, the same effect elsewhere with the number of its joint or
        link; at the end of a shape's range at least the best other, for what lies beyond nobody has
        looked at."""
        # A shape at the end of its range has become another effect, which nobody has tried.
        some = self.in_set
        if self.at_an_end and not some:
            some = tuple(t for t, _ in self.others[:1])
        names = dict.fromkeys(_name_beside(other, self.term) for other in some)
        return tuple(name for name in names if name != self.name)

    @property
    def name(self) -> str:
        """That of its effect."""
        return _name(self.term)

    @property
    def asked_again(self) -> bool:
        """Whether it can be asked of data that were not fitted: not what happened once, or shows on
        another sensor."""
        return not (self.term.shown or self.term.rare)

    @property
    def probabilities(self) -> dict[str, float]:
        """Of it alone and of each of its set, by name; what has its name elsewhere on the arm, as
        another push in the same window, is part of its own."""
        mass, out = {id(t): p for t, p in self.others}, {self.name: self.alone_sure}
        for term in self.in_set:
            name = _name_beside(term, self.term)
            out[name] = out.get(name, 0.0) + mass[id(term)]
        return out

    @property
    def branch_sure(self) -> float:
        """Probability that the cause is of this branch at this place, whichever it is."""
        mine = kind_of(self.term).branch
        alike = (p for t, p in self.others if kind_of(t).branch == mine and _near(t, self.term))
        return self.alone_sure + sum(alike)

    def as_known(self, value: float, std: float) -> "Claim":
        """This claim, its largest coefficient being known to a standard deviation: what acts at
        times only, and may as well not, is not confirmed."""
        return replace(self, confirmed=0.0) if self.term.rare and abs(value) < std else self

    def beside(self, shrinks: Float[Tensor, " n"]) -> "Claim":
        """This claim beside data that were not fitted.

        Args:
            shrinks: (n,) probability that each joint's error is less with what is told.
        """
        if not self.asked_again:
            return self
        joint = self.term.place
        return replace(
            self, confirmed=float(shrinks[self.fall.argmax() if joint is None else joint])
        )


def claims_of(explained: Explained) -> list[Claim]:
    """All causes of an explanation."""
    search, fit = explained.search, explained.found.fit
    parts: dict[tuple[str, int], list[Term]] = {}
    for t in fit.terms:
        if t.law is not None and t.law[0] == "position":
            parts.setdefault(t.law, []).append(t)
    curves = {
        law for law, some in parts.items() if len(some) > 1 and is_one_curve(search, fit, some)
    }
    return [
        Claim(
            one,
            torch.from_numpy(search.without(fit, one.term).losses - fit.losses).clamp(min=0),
            bool(at_an_end(search.library, one.term)),
            one.term.law in curves,
        )
        for one in explained.judged
    ]


def unsure(claims: Sequence[Claim]) -> bool:
    """Whether there are causes, and none of them is likely."""
    return bool(claims) and all(one.unnamed for one in claims)


def with_a_name(claims: Sequence[Claim], shares: Sequence[float]) -> list[bool]:
    """Which causes are told by name: those that are likely; and of the law of a joint that is
    there, while none of its terms is likely by itself, the one that takes most.

    Args:
        claims: of the causes.
        shares: of the error that each takes.
    """
    out = [one.named for one in claims]
    laws: dict[tuple[str, int], list[int]] = {}
    for k, one in enumerate(claims):
        if one.law is not None and one.law_sure >= LIKELY:
            laws.setdefault(one.law, []).append(k)
    # A law that is there for sure has a name, though which of its forms it is nobody knows.
    for numbers in laws.values():
        if not any(out[k] for k in numbers):
            out[max(numbers, key=lambda k: shares[k])] = True
    return out


def at_an_end(library: Library, term: Term) -> tuple[str, ...]:
    """Shapes at the end of their range: a term with one has become another effect there."""
    effect = term.effect
    if effect is None:
        return ()
    given = any(e == effect for e, _ in library.problem.given.model.effects)
    return () if given else tuple(effect.at_an_end(library.columns.motions))


def _name_beside(other: Term, term: Term) -> str:
    """Of another term in the place of one."""
    name = _name(other)
    return f"{name} {other.joints[0] + 1}" if name == term.name and other.joints else name


def kind_of(term: Term) -> type[Effect]:
    """The kind of effect that a term is."""
    return KINDS[_name(term)]


def _name(term: Term) -> str:
    """Of the effect that a term is; all bodies are links."""
    return LINK if term.name == BASE else term.name


def _near(one: Term, two: Term) -> bool:
    """Whether two terms are at one place of an arm: joints in common, or both all of it."""
    return bool(set(one.joints) & set(two.joints)) or not (one.joints or two.joints)
