"""Accepted effects seen again once others are known: they leave, change shape, or give way."""

from torchid.gap.bank import Bank
from torchid.gap.evidence import few_columns, p_value, significantly_better
from torchid.gap.problem import FRICTION, Candidate, Term
from torchid.gap.projection import Projector, Scanner
from torchid.gap.terms import Terms, best_member

DOUBTFUL = 0.2
"""Family-wise p-value above which an accepted effect leaves again where the noise is not known."""


def look_back(search: Terms, newest: Term | None) -> None:
    """Drop terms that others have made superfluous, swap those that another explains better."""
    for term in list(search.terms):
        related = newest is None or newest.place is None or term.place in (None, newest.place)
        if term is newest or not related or term not in search.terms:
            continue
        without = search.model(without=[term])
        own = best_member(Scanner(_bank_of(term), search.problem.keep), without)
        if own is None or own.gain < search.problem.threshold(own.df):
            search.leave(term)
            continue
        if term.is_inertial and _simplified(search, term, own, without):
            continue
        _swap(search, term, own, without)


def reshape(search: Terms, newest: Term) -> None:
    """Shapes on the same joint that imitated what `newest` explains are searched again."""
    for term in list(search.terms):
        if term is newest or term.place is None or term.place != newest.place:
            continue
        scanner = search.scanner_of(term)
        if scanner is None:
            continue
        without = search.model(without=[term])
        best = best_member(scanner, without)
        better = best is not None and without.loss - best.gain < search.model().loss
        start = best.term.scaled(search.problem.keep) if best is not None and better else term
        refined = search.refined(start)
        search.terms = [refined if t is term else t for t in search.terms]


def drop_doubtful(search: Terms) -> None:
    """Without a known noise, terms that others have made doubtful leave, the weakest first."""
    problem = search.problem
    while not problem.whitened and search.terms:
        loss = search.model().loss
        left = {}
        for term in search.terms:
            if not term.is_inertial and few_columns(problem, len(term.columns)):
                without = search.model(without=[term])
                left[id(term)] = p_value(problem, term, without.loss - loss, without)
        worst = max(search.terms, key=lambda t: left.get(id(t), 0.0))
        if left.get(id(worst), 0.0) <= DOUBTFUL:
            return
        search.leave(worst)


def _simplified(search: Terms, term: Term, own: Candidate, without: Projector) -> bool:
    """Put one effect in the place of parameters that explained several, once the others are
    named: a search that adds one at a time begins with what holds a share of all."""
    other = search.simplest(own, without).term
    if other.key == term.key or other.name == FRICTION:
        return False
    search.terms = [t for t in search.terms if t is not term]
    search.left.add(term.key)
    search.terms.append(search.refined(other))
    return True


def _swap(search: Terms, term: Term, own: Candidate, without: Projector) -> None:
    near = [s for s in search.scanners if s.bank.place in (term.place, None)]
    kept = search.terms
    search.terms = [t for t in kept if t is not term]
    others = [c for c in search.candidates(without, near) if c.term.key != term.key]
    better = [c for c in others if c.score > own.score + search.problem.threshold(c.df)]
    if better and significantly_better(search.problem, better[0].term, term, without):
        chosen = search.simplest(better[0], without)
        if chosen.term.key != term.key and chosen.term.name != FRICTION:
            search.left.add(term.key)
            search.terms.append(search.refined(chosen.term))
            return
    search.terms = kept


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
