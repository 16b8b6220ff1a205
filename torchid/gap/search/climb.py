"""The search: terms enter, leave and change places as long as the evidence rises.

Evidence ranks, held-out worth gates. A step needs positive evidence. Whether a cause is worth a
name is asked of the finished explanation, for a true cause whose complement is missing looks
worthless: one that lowers the held-out error of no joint by a share that the user finds worth
having leaves, of several that which closes least in its turn.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial

import torch

from torchid.design.bodies import Priors
from torchid.design.gram import Equations, Folds
from torchid.effects.registry import KINDS
from torchid.gap.search.evidence import (
    TOGETHER,
    Fitted,
    Offer,
    Question,
    active_share,
    best_fits,
    cause_groups,
    common_names,
    comparable,
    correction_torque,
    cost,
    effective_samples,
    fit_terms,
    greedy_shares,
    log_likelihood_ratio,
    offers_of_each,
    prior_of,
    refit,
    refit_each,
    subset_of,
    unphysical_terms,
)
from torchid.gap.search.terms import Term, excluding
from torchid.typing import Float, Tensor

MOVES_TRIED = 10
"""Candidates, best first, whose evidence is computed exactly at each step; 5 and 20 change no
name."""

FRICTION = ("coulomb_friction", "viscous_friction")
"""What a joint without any friction in its model lacks at once: one alone takes the other's
part."""

LIKELIEST = 3
"""Of these, those whose effective samples are computed."""

FORETOLD = 0.3
"""Share of a term's squares that the other folds must hold for its coefficients to be taken from
them [1]; of something that is there all the time four folds of five hold 0.8."""

Move = tuple[Term, ...]


def fit_anew(question: Question, terms: Sequence[Term] = ()) -> Fitted:
    """Terms beside what is always fitted, with the effective samples of what they leave."""
    first = fit_terms(question, terms, torch.ones(question.candidates.gram.n).double())
    effective = effective_samples(question, first)
    return fit_terms(question, terms, effective, effective / first.losses.clamp(min=1e-300))


def climb_from(question: Question, start: Sequence[Term]) -> Fitted:
    """Terms from a start on, as long as the evidence rises."""
    fit = drop_unphysical(question, fit_anew(question, start))
    # No explanation is visited twice, so the climb ends.
    seen = {signature(fit)}
    lighter = cache(partial(_lighter, question))  # asked again of what nothing is added to
    while True:
        better = _added(question, fit) or lighter(fit) or swap_term(question, fit)
        if better is None or signature(better) in seen:
            return fit
        # Whatever a new term has made superfluous leaves at once.
        while better is not None and signature(better) not in seen:
            fit = better
            seen.add(signature(fit))
            better = lighter(fit)


def drop_unphysical(question: Question, fit: Fitted, rounds: int = 2) -> Fitted:
    """Without the terms that physics refuses beside the others; `rounds` as for `fit_terms`."""
    while fit.evidence == -math.inf:
        gone = unphysical_terms(question, fit)
        own = excluding(question.own(fit), gone)
        if len(own) == len(question.own(fit)):
            break
        fit = refit(question, fit, own, rounds)
    return fit


def signature(fit: Fitted, small: Sequence[Term] = ()) -> tuple[frozenset[int], ...]:
    """Which terms a fit has, and which are too small beside it."""
    return frozenset(map(id, fit.terms)), frozenset(map(id, small))


def candidate_moves(
    question: Question, fit: Fitted, instead: Term | None = None
) -> list[tuple[float, Move]]:
    """What may be added, with the rise of the evidence to first order: terms one by one, dry and
    viscous friction of a joint together, and what most joints have at once, priced as one cause.
    In the place of a term of one joint only what that joint feels is looked at, one by one."""
    return moves_beside_each(question, [fit], [instead])[0]


def moves_beside_each(
    question: Question, fits: Sequence[Fitted], instead: Sequence[Term | None]
) -> list[list[tuple[float, Move]]]:
    """The same beside each of several fits."""
    places = [None if t is None or t.place is None else (None, t.place) for t in instead]
    found = offers_of_each(question, fits, places)
    return [
        _moves(question, fit, some, groups=term is None)
        for fit, some, term in zip(fits, found, instead, strict=True)
    ]


def _moves(
    question: Question, fit: Fitted, found: Sequence[Offer], *, groups: bool
) -> list[tuple[float, Move]]:
    n = question.candidates.gram.n
    own = question.own(fit)
    # One by one.
    # A further joint of what most joints have is no further cause.
    free = common_names(own, question.joints)
    out: list[tuple[float, Move]] = [
        (o.net - (0.0 if o.term.name in free and o.term.place is not None else question.price()),
         (o.term,))
        for o in found
    ]  # fmt: skip
    # Of every effect that arms have on all joints, the best shape on each joint.
    best: dict[tuple[str, int], Offer] = {}
    for offer in found if groups else ():
        if offer.term.place is not None and KINDS[offer.term.name].on_all:
            best.setdefault((offer.term.name, offer.term.place), offer)
    # All joints that gain by it at once, effect by effect; and dry with viscous friction.
    both = FRICTION if groups else ()
    for names in [*((name,) for name in sorted({name for name, _ in best})), both]:
        nets: list[tuple[float, Move]] = []
        for j in range(n) if names else ():
            offered = [best[(name, j)] for name in names if (name, j) in best]
            if len(offered) < len(names):
                continue
            terms = tuple(o.term for o in offered)
            net = offered[0].net if len(names) == 1 else _joint_net(question, fit, terms)
            if len(names) > 1:
                out.append((net - len(names) * question.price(), terms))
            if net > 0:
                nets.append((net, terms))
        if 2 * len(nets) > question.joints and len(nets) > 1:
            together = tuple(t for _, terms in nets for t in terms)
            out.append((sum(net for net, _ in nets) - len(names) * question.price(), together))
    return sorted(out, key=lambda move: -move[0])


def _joint_net(question: Question, fit: Fitted, terms: Sequence[Term]) -> float:
    """Rise of the evidence by terms of one joint together, without the price of a cause; all
    samples count as independent."""
    rows = question.normal.rows
    more = refit(question, replace(fit, effective=rows), (*question.own(fit), *terms))
    paid = sum(t.count * math.log(max(float(rows[t.place]), 2.0)) for t in terms)
    return float(log_likelihood_ratio(rows, fit.losses, more.losses).sum()) - paid


def _lighter(question: Question, fit: Fitted) -> Fitted | None:
    """Without the term that the evidence misses least, if it rises. What a term holds beside the
    others is x' C^-1 x, C the block of the covariance (Wald): the weakest are looked at exactly."""
    own = question.own(fit)
    spread = fit.root @ fit.root.T
    held: list[tuple[float, int]] = []
    first = len(fit.x) - sum(t.count for t in own)
    for k, term in enumerate(own):
        rows = slice(first, first + term.count)
        first = rows.stop
        inner = torch.linalg.pinv(spread[rows, rows], rtol=1e-9, hermitian=True)
        held.append(
            (float(fit.x[rows] @ inner @ fit.x[rows]) - cost(question, [term], fit.effective), k)
        )
    lighter = [[*own[:k], *own[k + 1 :]] for _, k in sorted(held)[:LIKELIEST]]
    best: tuple[float, Fitted] | None = None
    for without in refit_each(question, fit, lighter):
        now, then = comparable(question, fit, without)
        rise = then.evidence - now.evidence
        if rise > 0 and (best is None or rise > best[0]):
            best = rise, then
    return None if best is None else best[1]


def swap_term(question: Question, fit: Fitted, *, every: bool = False) -> Fitted | None:
    """With one term changed for another, if the evidence rises: another shape, or another effect.
    Those that promise more than the term to first order are tried, or every likely one."""
    own = question.own(fit)
    without = [tuple(t for t in own if t is not term) for term in own]
    tried: list[Move] = []
    fits = refit_each(question, fit, without)
    found = moves_beside_each(question, fits, own)
    for term, rest, offered in zip(own, without, found, strict=True):
        for _, move in offered[: MOVES_TRIED if every else LIKELIEST]:
            if move[0] is term and not every:
                break
            tried.append((*rest, *move))
    if not tried:
        return None
    ((_, best),) = best_fits(question, fit, tried)
    now, then = comparable(question, fit, best)
    return then if then.evidence > now.evidence + 1e-6 else None


def _added(question: Question, fit: Fitted) -> Fitted | None:
    """The best addition, if the evidence rises with it; what it leaves is the noise, for one that
    is true makes the rest less dependent. Only the most likely are looked at so closely."""
    own = question.own(fit)
    if len(cause_groups(own, question.joints)) >= question.settings.max_effects:
        return None
    options = [m for _, m in candidate_moves(question, fit)][:MOVES_TRIED]
    # Ranked with all samples.
    alike = replace(fit, effective=question.normal.rows)
    best: tuple[float, Fitted] | None = None
    for _, likely in best_fits(question, alike, [(*own, *m) for m in options], LIKELIEST):
        then, now = comparable(question, likely, fit)
        rise = then.evidence - now.evidence
        # Of a step it is asked whether its torque is worth it on some joint, not yet whether the
        # error falls by as much: what is still missing may be larger.
        new = excluding(question.own(then), own)
        size = (question.fall(then, now) / active_share(question, new)).sqrt()
        least = question.least(question.mean(now.losses))
        if question.known:
            size = torch.maximum(size, correction_torque(question, then, now, new))
        worth = bool((size >= least).any()) or any(map(question.shows, question.own(then)))
        if rise > 0 and worth and (best is None or rise > best[0]):
            best = rise, then
    if best is None:
        return None
    fit = best[1]
    return refit(question, fit, question.own(fit))


def held_out_losses(
    question: Question, folds: Folds, fit: Fitted, terms: Sequence[Term]
) -> Float[Tensor, " n"]:
    """Sums of squares that terms leave on data they were not fitted on. What happened once cannot
    be predicted: a term that the other folds hardly hold keeps the coefficients of all data
    there."""
    return held_out_losses_of_each(question, folds, fit, [terms])[0]


def held_out_losses_of_each(
    question: Question, folds: Folds, fit: Fitted, explanations: Sequence[Sequence[Term]]
) -> Float[Tensor, "B n"]:
    """The same of B explanations, by several at once."""
    out, at_once = [], max(1, TOGETHER // len(folds))
    for k in range(0, len(explanations), at_once):
        every = [(*question.fixed, *terms) for terms in explanations[k : k + at_once]]
        subsets = [subset_of(question.normal, terms) for terms in every]
        priors = Priors([prior_of(terms) for terms in every])
        # Coefficients of all data, for what a fold cannot predict.
        weight = fit.weight.expand(len(every), -1)
        all_data = question.normal.of_each(subsets)
        whole = priors.solve_of(all_data, weight).x.unsqueeze(1)
        held = _energies(all_data, every).unsqueeze(1)
        # Each fold is judged by the coefficients of the others.
        others, judged = folds.of_each(subsets)
        x = priors.solve_of(others, weight.unsqueeze(1).expand(-1, len(folds), -1)).x
        seen = _energies(others, every) >= FORETOLD * held
        out.append(judged.losses(torch.where(seen, x, whole)).sum(1))
    return torch.cat(out)


def _energies(equations: Equations, every: Sequence[Sequence[Term]]) -> Float[Tensor, "B *batch K"]:
    """Squares of the terms' columns, each term's largest for all of its columns."""
    squares = equations.a.diagonal(dim1=-2, dim2=-1).sum(-2)
    for k, terms in enumerate(every):
        sizes = [t.count for t in terms]
        for own in squares[k].split([*sizes, squares.shape[-1] - sum(sizes)], -1):
            if own.shape[-1] > 1:
                own.copy_(own.amax(-1, keepdim=True))
    return squares


def drop_worthless(
    question: Question,
    folds: Folds,
    fit: Fitted,
) -> tuple[Fitted, list[Term]]:
    """Without the causes that are not worth a name; what closes least leaves first.

    Args:
        question: what is explained.
        folds: each judged by the others.
        fit: a finished explanation.

    Returns:
        what is left, and the terms that left.
    """
    left: list[Term] = []
    fit = drop_unphysical(question, fit)
    rows = folds.rows.sum(0).clamp(min=1.0)

    def falls(groups: Sequence[Sequence[Term]]) -> list[Float[Tensor, " m"]]:
        """By how much the held-out error of m joints falls with some terms, group by group, in
        units of the least that is worth a name: of their own joints, or of all; the largest
        first."""
        rests = [excluding(own, gone) for gone in groups]
        out = []
        if groups:
            every = held_out_losses_of_each(question, folds, fit, rests) / rows
        for gone, rest, then in zip(groups, rests, every if groups else (), strict=True):
            # The error while they act.
            lost = (now + (then - now) / active_share(question, gone)).clamp(min=0)
            least = question.least(lost)
            fall = (lost.sqrt() - now.sqrt()) / least
            if question.known:
                # Where the model's own corrections would be stretched in its place, that is its
                # size.
                without = refit(question, fit, rest)
                fall = torch.maximum(fall, correction_torque(question, fit, without, gone) / least)
            places = sorted({t.place for t in gone if t.place is not None})
            out.append((fall[places] if places else fall).sort(descending=True).values)
        return out

    def missed(terms: Sequence[Term]) -> dict[int, float]:
        """By how much each of some terms is missed, by its identity."""
        found = falls([[t] for t in terms])
        return {id(t): float(fall[0]) for t, fall in zip(terms, found, strict=True)}

    closes: dict[int, float] = {}
    while own := question.own(fit):
        now = held_out_losses(question, folds, fit, own) / rows
        groups = cause_groups(own, question.joints)
        # What most joints have must be worth it on more than half of them.
        asked = [g for g in groups if not any(map(question.shows, g))]
        worths = {
            id(g): float(fall[len(g) // 2 if len(g) > 1 else 0])
            for g, fall in zip(asked, falls(asked), strict=True)
        }
        # Causes that stand for each other all look worthless: of these the one leaves that closes
        # least in its turn.
        weak = [g for g in asked if worths[id(g)] < 1]
        if weak and not closes:
            closes = dict(zip(map(id, own), greedy_shares(question, fit, own), strict=True))
        gone = min(weak, key=lambda g: sum(closes[id(t)] for t in g), default=[])
        if not gone:
            # A joint whose error does not fall has no part in what most joints have.
            common = [t for g in groups if len(g) > 1 for t in g]
            by = missed(common)
            gone = [t for t in common if by[id(t)] <= 0]
            if not gone:
                break
        if len(gone) > 1:
            # Of a common cause the joint that misses it least leaves first.
            by = missed(gone)
            gone = [min(gone, key=lambda t: by[id(t)])]
        left += gone
        keep = excluding(own, gone)
        fit = drop_unphysical(question, refit(question, fit, keep))
    return fit, left
