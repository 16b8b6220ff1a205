"""What is told and what cannot be told from it, with the covariance of all their coefficients."""

import msgspec

from torchid.design.columns import Model
from torchid.effects.inertia import LinkInertia
from torchid.effects.registry import EVENTS
from torchid.gap.problem import Problem
from torchid.gap.record import Fitted, JointFit
from torchid.gap.search.explain import Explanation, fit_to_convergence, solve
from torchid.gap.search.findings import Findings
from torchid.gap.search.solve import Solution
from torchid.gap.search.terms import BASE, LINK, Term, excluding
from torchid.robot.inertia import PARAMETERS_PER_LINK

MOST_ALTERNATIVES = 8
"""Alternatives that are fitted at most, the likeliest first."""


def joint_fits(found: Explanation, said: Findings, problem: Problem) -> tuple[JointFit, ...]:
    """The answered explanation, and those with one term in another's place, by their probabilities
    in the answer; none where nothing was fitted.

    Args:
        found: the answered one.
        said: what is told of it, with the rivals of its terms.
        problem: of which it is an explanation.
    """
    solution = found.solution
    if not len(solution.covariance):
        return ()
    question, fit = found.question, found.fit
    out = [_fit(solution, 1.0, "")]
    for odds, term, other in sorted(said.rivals, key=lambda r: -r[0])[:MOST_ALTERNATIVES]:
        others = excluding(fit.terms, [term])
        again = fit_to_convergence(question, [*others, other], fit)
        # What physics then refuses has left, and with it the alternative.
        if not any(t is other for t in again.terms):
            continue
        out.append(
            _fit(solve(problem, again), odds, f"{_words(other)} in the place of {_words(term)}")
        )
    total = sum(one.weight for one in out)
    return tuple(msgspec.structs.replace(one, weight=one.weight / total) for one in out)


def _fit(solution: Solution, odds: float, words: str) -> JointFit:
    """A solution's coefficients, without those of what happened once."""
    coefficients: list[Fitted] = []
    lasting: list[int] = []
    at = 0
    for term, values in zip(solution.terms, solution.values, strict=True):
        if not any(e.name in EVENTS for e in term.effects):
            lasting += range(at, at + len(values))
            name = LINK if term.name == BASE else term.name
            pairs = zip(_names(term, solution), values.tolist(), strict=True)
            coefficients += [Fitted(effect=name, names=names, value=v) for names, v in pairs]
        at += len(values)
    model = solution.model
    effects = tuple(p for p in model.effects if p[0].name not in EVENTS)
    return JointFit(
        weight=odds,
        words=words,
        coefficients=tuple(coefficients),
        covariance=solution.covariance[lasting][:, lasting],
        corrected=Model(model.robot, effects).described() if words else None,
    )


def _names(term: Term, solution: Solution) -> list[tuple[str, ...]]:
    """Names of each coefficient: bodies' by link; of one that joints share all of theirs."""
    if term.name != BASE:
        return list(zip(*(e.coefficient_names() for e in term.effects), strict=True))
    entries = term.at.tolist() if term.bodies else solution.wanted.base.by_link
    places = (divmod(k, PARAMETERS_PER_LINK) for k in entries)
    return [(LinkInertia(link).coefficient_names()[k],) for link, k in places]


def _words(term: Term) -> str:
    """`viscous_friction of joint 2`."""
    if term.name == BASE:
        return "all base parameters"
    joints = " and ".join(str(j + 1) for j in term.joints)
    return f"{term.name} of joint {joints}" if joints else term.name
