"""How sure a cause is: one probability, from one calculation.

In the place of a term there may be nothing, or another term of the library. On logs that might have
been, blocks of samples drawn again with replacement, half as many as there are (Huggins and Miller
2023, Bayesian Analysis 18(4)), each explanation has its evidence: the likelihood of the drawn
samples, and what its coefficients and the looking cost in proportion to the drawn samples. A
probability is a mean over the draws. What a rival adds beside the term speaks for neither.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchid.effects.inertia import Payload
from torchid.effects.periodic import Cogging
from torchid.effects.spring import JointSpring
from torchid.gap.causes.candidates import Term, excluding
from torchid.gap.causes.evidence import Fit
from torchid.gap.causes.search import ONE_BODY, STEP, Search, every_other, same_columns
from torchid.results.cause import When
from torchid.statistics.bagging import Draws
from torchid.statistics.criteria import LIKELY, SET_MASS, WRONG_FILE
from torchid.statistics.evidence import most_sure, probabilities_of

WAVES = 4
"""The longest of the grid, of which any smooth curve over a joint's position is: up to three
periods."""

NEARLY = 0.8
"""Probability, over that of the likeliest, from which an explanation is nearly as likely [1]: the
simplest of these gives the name."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A term, and what may be in its place.

    Attributes:
        term: of the explanation.
        own: probability of the term itself.
        name: the term that gives the name: the simplest of those nearly as likely.
        sure: probability of `name`.
        nothing: that nothing is there.
        members: smallest set that holds nine tenths of what may be there, the likeliest first, with
            their probabilities.
        law: probability of the joint's law that `name` is a form of; of `name` where it is no form.
        when: whether it is `new` since an earlier log or `in both`; None where neither is likelier
            than not, and without an earlier log.
    """

    term: Term
    name: Term
    own: float
    sure: float
    nothing: float
    members: tuple[tuple[tuple[Term, ...], float], ...]
    law: float
    when: When | None = None


def judge(
    search: Search, fit: Fit, left: np.ndarray, draws: Draws, refused: Sequence[Term] = ()
) -> list[Judged]:
    """All terms of an explanation.

    Args:
        search: that found it.
        fit: the explanation.
        left: (n,) share of the squares of each joint's gap that is left without a cause, and the
            arm's as a whole behind them (n + 1,).
        draws: logs that might have been.
        refused: terms that were not worth a name, which are no rivals.
    """
    return [judged(search, fit, t, left, draws, refused) for t in fit.terms]


def is_one_curve(search: Search, fit: Fit, terms: Sequence[Term]) -> bool:
    """Whether several terms of a joint's law over its position are told from no other smooth curve:
    its springs and longest waves together, whose coefficients cost nothing, do as well as one
    cause.

    Args:
        search: that found them.
        fit: the explanation.
        terms: of one joint's law.
    """
    evidence, joint = search.evidence, terms[0].joints[0]
    grid = Cogging.grid(search.library.columns.motions, joint, search.library.samples.cutoff)
    longest = grid[:WAVES, 0].tolist()
    curve = [
        t
        for t in search.library.terms
        if t.place == joint
        and t.since == terms[0].since
        and (
            isinstance(t.effect, JointSpring)
            or (isinstance(t.effect, Cogging) and t.effect.k in longest)
        )
    ]
    free = [replace(t, low=np.full(t.count, -np.inf)) for t in curve]
    # Coefficients of the curve are free of sign and cost nothing: if it does not do as well then,
    # it never does.
    other = evidence.fit((*excluding(fit.terms, terms), *free), fit.samples)
    samples = evidence.telling(fit, other)
    ratio = 0.5 * float((samples * np.log(fit.losses / other.losses)).sum())
    return ratio + (len(terms) - 1) * evidence.price(terms[:1]) > 0


def judged(
    search: Search,
    fit: Fit,
    term: Term,
    left: np.ndarray,
    draws: Draws,
    refused: Sequence[Term] = (),
) -> Judged:
    """One term of an explanation."""
    evidence, library = search.evidence, search.library
    # Without it, with as many samples: evidence is compared on one number of independent samples.
    others = excluding(fit.terms, [term])
    base = evidence.fit(others, fit.samples)
    # Another shape of the same cause is no rival of it.
    gone = frozenset({term.key, *(t.key for t in refused)})
    # Forms of a law stand for each other two by two; all else is tried in its place one by one.
    tried = [] if term.law is None else search.other_forms(fit, (term.law, term.since))
    nearest = [search.beside(others, u, fit.samples) for u in search.likely(base, gone)]
    tried += [((f.terms[-1],), f) for f in nearest]
    # Evidence is of pairs: a rival must be likelier than nothing, by what it does not explain
    # beside the term as well.
    rivals, beside = list[tuple[tuple[Term, ...], Fit]](), list[float]()
    for u, f in tried:
        alone, last = evidence.over(f, base), len(f.terms) - 1
        if alone <= STEP or f.terms[last].is_beyond(f.values()[last]):
            continue
        if f.terms[last].name == Payload.name and not search.is_load(f, last):
            continue
        both = max(0.0, evidence.over(evidence.fit((*fit.terms, *u), fit.samples), fit))
        if alone > both + STEP:
            rivals.append((u, f))
            beside.append(both)
    asked = draws
    if term.rare:
        # A log drawn without the block in which it happened would say that it is not there.
        asked = draws.parting(torch.from_numpy(search.acting(fit, term)))
    masses = probabilities(search, fit, [base, *(f for _, f in rivals)], asked, beside)
    own, nothing, *others_sure = masses
    for k, (u, f) in enumerate(rivals):
        if len(u) == 1 and same_columns(term, u[0]) and search.alike(f, fit, base, ONE_BODY):
            # A load and an error of its link are one torque: nothing but the file tells which.
            both = own + others_sure[k]
            own, others_sure[k] = both * (1 - WRONG_FILE), both * WRONG_FILE
    every: list[tuple[tuple[Term, ...], float]] = [((term,), own)]
    every += [(u, p) for (u, _), p in zip(rivals, others_sure, strict=True)]
    every.sort(key=lambda pair: -pair[1])
    when: When | None = None
    if term.since:
        # Whether it is new is asked at its place alone, and what it is among those that are.
        every = [(t, p) for t, p in every if t[0].since == term.since and is_near(t[0], term)]
        likelier = sum(p for _, p in every) > LIKELY
        when = (term.since or None) if likelier else None
    there = sum(p for _, p in every) if term.since else 1 - nothing
    # The smallest set, and the simplest of those that are nearly as likely as the likeliest.
    members, held = list[tuple[tuple[Term, ...], float]](), 0.0
    for pair in every:
        if held >= SET_MASS * there:
            break
        members.append(pair)
        held += pair[1]
    # Of single terms nearly as likely as the likeliest the one with fewest numbers has the name,
    # and among those the one that the search took.
    single = [(t[0], p) for t, p in every if len(t) == 1]
    near = [(t, p) for t, p in single if p >= NEARLY * single[0][1]]
    name, sure = min(near, key=lambda pair: (pair[0].count, pair[0] is not term))
    law = sum(p for t, p in every if t[0].cause == name.cause)
    fall = np.maximum(base.losses - fit.losses, 0.0) / library.rows
    if term.rare:
        # What happened once, or at an end of the travel, is judged where it acts.
        left = np.full_like(left, _left_where_it_acts(search, fit, term))
    # How much each joint tells of it, and what all that is left could make there: no cause is surer
    # than what is left allows (`most_sure`).
    told = fit.samples * np.log(np.maximum(base.losses / fit.losses, 1.0))
    if term.place is not None:
        told = told * (np.arange(library.n) == term.place)
    rest = left[:-1] * (library.gap**2).sum(1) / library.rows
    # What another sensor shows is asked of no torque that is left.
    bound = 1.0 if term.shown else most_sure(told, fall, rest, float(left[-1]))
    return Judged(
        term, name, min(own, bound), min(sure, bound), nothing, tuple(members),
        min(law, bound), when,
    )  # fmt: skip


def is_near(one: Term, other: Term) -> bool:
    """Whether two terms are at one place of the arm, or are the same torque."""
    return one.joints == other.joints or same_columns(one, other)


def _left_where_it_acts(search: Search, fit: Fit, term: Term) -> float:
    """Share of the squares that is left of a gap where a term acts, beside half of these samples
    that it was not fitted on; each joint in units of what is left of it."""
    part = every_other(search.acting(fit, term))
    after, before = (search.left_out(fit, part, gone) ** 2 for gone in (None, term))
    # A joint with little noise tells as much as one with a large torque.
    unit, noise = fit.losses, fit.losses / search.library.rows
    a, b = (((x - noise) / unit).sum() for x in (after, before))
    return float(np.clip(a / max(b, 1e-300), 0.0, 1.0))


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
        # Both are fitted with the samples that tell these two apart, for others say nothing of
        # which of them it is.
        samples = evidence.telling(fit, other)
        mine, its = (evidence.fit(f.terms, samples) for f in (fit, other))
        a, b = (_squares(search, f, draws, share) for f in (mine, its))
        ratio = -0.5 * (samples * share * np.log(b / a)).sum(1)
        # Prices and what was known before are paid once a log, so a drawn log pays by its length.
        paid = its.known - mine.known + evidence.price(its.terms) - evidence.price(mine.terms)
        more = beside[k - 1] if k and len(beside) else 0.0
        rises.append(ratio - drawn * (paid + more))
    return probabilities_of(np.stack(rises))


def _squares(search: Search, fit: Fit, draws: Draws, share: np.ndarray) -> np.ndarray:
    """Sums of squares (M, n) of what a fit leaves, in logs with such shares (M, n) of the rows."""
    left = torch.from_numpy(search.evidence.left(fit))
    drawn = draws.sums(left.square()).numpy()
    return np.maximum(drawn, search.evidence.floor * np.maximum(share, 1e-3))
