"""From causes to the terms that the description of an answer is made of.

`torchid.gap.causes` says which causes there are, and how sure each is; the corrected model, its
intervals and what was not testable are still described in the terms of `torchid.gap.search`.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.design.repeats import counterparts
from torchid.effects.base import Effect
from torchid.effects.surroundings import PlaneContact
from torchid.effects.transient import Contact
from torchid.gap.causes import candidates as causes
from torchid.gap.causes.explain import Explained
from torchid.gap.causes.judge import is_one_curve
from torchid.gap.problem import Problem
from torchid.gap.search.events import LAWS, contacts, planes
from torchid.gap.search.evidence import Question, fit_terms, refit
from torchid.gap.search.explain import Explanation, fit_anew, solve
from torchid.gap.search.findings import Judged, at_an_end
from torchid.gap.search.odds import Odds, Place
from torchid.gap.search.replication import own_torque
from torchid.gap.search.terms import BASE, LINK, Term, candidates_of, excluding

LIKELIEST = 60
"""Candidates beside an explanation, of which some are asked run by run."""


def events_of(problem: Problem) -> list[Effect]:
    """Pushes and planes that stand out beside bodies and the usual laws."""
    wanted = problem.wanted
    names = [name for name in (Contact.name, PlaneContact.name) if name in wanted.names]
    if not names or not problem.data.keep.any():
        return []
    usual = replace(wanted, names=tuple(dict.fromkeys((*LAWS, LINK))), only=None)
    question = _question(problem, replace(problem, wanted=usual), [])
    out: list[Effect] = []
    if Contact.name in names:
        out += contacts(question, counterparts(problem.given.samples, problem.repeats))
    if PlaneContact.name in names:
        out += planes(question)
    return out


def explanation_of(explained: Explained, problem: Problem) -> Explanation:
    """The explanation whose terms are the causes."""
    terms = (*explained.found.fit.terms, *explained.found.small)
    rivals = [t for one in explained.judged for terms, _ in one.members for t in terms]
    extra = [t.effect for t in (*terms, *rivals) if t.effect is not None and not t.inertial]
    question = _question(problem, problem, list(dict.fromkeys(extra)))
    found = [_same(question, t) for t in explained.found.fit.terms]
    # What another sensor shows is there, however little of it the fit's torque has.
    shown = {t.key: t for t in question.candidates.terms if question.shows(t)}
    own = [*(t for t in found if t is not None and t.key not in shown), *shown.values()]
    small = [_same(question, t) for t in explained.found.small]
    empty = fit_anew(question)
    samples, losses = (
        torch.from_numpy(x) for x in (explained.found.fit.samples, explained.found.fit.losses)
    )
    first = fit_terms(question, own, samples, samples / losses)
    # What the search has found stays, whatever other limits would refuse.
    fit = refit(question, first, question.own(first), 10)
    unworthy = tuple(t for t in small if t is not None)
    return Explanation(question, empty, fit, unworthy, solve(problem, fit))


def judged_of(explained: Explained, found: Explanation, problem: Problem) -> list[Judged]:
    """How sure the terms of an explanation are."""
    question, fixed = found.question, len(found.question.fixed)
    of = {_name(question, one.term): one for one in explained.judged}
    laws: dict[object, Place] = {}
    fit, parts = explained.found.fit, dict[object, list[causes.Term]]()
    for t in fit.terms:
        if t.law is not None and t.law[0] == "position":
            parts.setdefault(t.law, []).append(t)
    curves = {
        law
        for law, terms in parts.items()
        if len(terms) > 1 and is_one_curve(explained.search, fit, terms)
    }
    out = []
    for k, term in enumerate(found.terms):
        one = of.get((term.name, term.effects if term.name != BASE else (), term.place))
        without = refit(question, found.fit, excluding(found.terms, [term]), 10)
        own, both = own_torque(found.solution, fixed + k), (found.fit, without)
        place = Place(question, both, term, own)
        ended = bool(at_an_end(question, term))
        if one is None:  # another sensor shows it
            alpha = problem.settings.alpha
            out.append(Judged(place, (), Odds(1 - alpha, alpha, 0.0), ended))
            continue
        # Of several terms in its place each has a part of their probability.
        others = [(t, p / len(ts)) for ts, p in one.members if ts[0] is not one.term for t in ts]
        some = [(_same(question, t), p) for t, p in others]
        kept = [(t, p) for t, p in some if t is not None]
        beside = max(0.0, 1 - one.own - one.nothing - sum(p for _, p in kept))
        odds = Odds(one.own, one.nothing, beside, tuple(p for _, p in kept))
        law = None if one.term.law is None else laws.setdefault(one.term.law, place)
        if law is not None and one.term.law in curves:
            # No part of the curve is told from another: the law alone has a name.
            law = laws[one.term.law] = law if law.curve else replace(law, curve=True)
            odds = replace(odds, sure=0.0, unknown=odds.unknown + odds.sure)
        out.append(Judged(place, tuple(t for t, _ in kept), odds, ended, law, one.law))
    return out


def likely_beside(explained: Explained, found: Explanation) -> list[Term]:
    """Candidates that the search would look at next beside an explanation, the likeliest first."""
    search = explained.search
    fit = explained.found.fit if found.terms else search.empty()
    ranked = search.screen.best(fit, search.library.rows, LIKELIEST)
    same = (_same(found.question, t) for _, t in ranked)
    return [t for t in same if t is not None]


def _question(of: Problem, asked: Problem, extra: Sequence[Effect]) -> Question:
    """Candidates at the model as given."""
    given, wanted = of.given, asked.wanted
    candidates = candidates_of(given, given.gap, of.data, wanted, given.model, extra)
    left = None if of.wanted.knowledge is None else of.wanted.knowledge.left
    return Question(candidates, candidates.gram.normal, of.settings, left=left)


def _name(question: Question, term: causes.Term) -> tuple[object, ...]:
    same = _same(question, term)
    return (
        () if same is None else (same.name, same.effects if same.name != BASE else (), same.place)
    )


def _same(question: Question, term: causes.Term) -> Term | None:
    """The term of a question that a cause is; None where it has none."""
    every = question.candidates.terms
    shared = term.key[-1] == "shared"
    for t in every:
        if t.name != term.name or shared != (len(t.effects) > 1):
            continue
        if term.effect is None or shared or term.effect in t.effects:
            return t
    return None
