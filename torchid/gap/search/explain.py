"""An explanation: terms, what they leave, and the model that they correct."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.gap.problem import Problem
from torchid.gap.search.evidence import (
    Fitted,
    Question,
    effective_samples,
    fit_terms,
    refit,
    unphysical_terms,
)
from torchid.gap.search.solve import STEPS, Solution, solve_terms
from torchid.gap.search.terms import Term, excluding


@dataclass(frozen=True, eq=False)
class Explanation:
    """What a search has found.

    Attributes:
        question: candidates at the model as given, and what they explain.
        empty: the model as given, with what is always fitted.
        fit: what is told; its terms beside the fixed ones.
        unworthy: terms that the evidence has, which are not worth a name.
        solution: the corrected model.
    """

    question: Question
    empty: Fitted
    fit: Fitted
    unworthy: tuple[Term, ...]
    solution: Solution

    @property
    def terms(self) -> tuple[Term, ...]:
        """What is told."""
        return self.question.own(self.fit)


def fit_anew(question: Question, terms: Sequence[Term] = ()) -> Fitted:
    """Terms beside what is always fitted, with the effective samples of what they leave."""
    first = fit_terms(question, terms, torch.ones(question.candidates.gram.n).double())
    effective = effective_samples(question, first)
    return fit_terms(question, terms, effective, effective / first.losses.clamp(min=1e-300))


def drop_unphysical(question: Question, fit: Fitted, rounds: int = 2) -> Fitted:
    """Without the terms that physics refuses beside the others; `rounds` as for `fit_terms`."""
    while fit.evidence == -math.inf:
        gone = unphysical_terms(question, fit)
        own = excluding(question.own(fit), gone)
        if len(own) == len(question.own(fit)):
            break
        fit = refit(question, fit, own, rounds)
    return fit


def fit_to_convergence(question: Question, terms: Sequence[Term], fit: Fitted) -> Fitted:
    """What is told: terms, the fixed ones first, fitted until the joints' weights settle, without
    those that physics then refuses; samples and first weights are those of a fit."""
    return drop_unphysical(question, refit(question, fit, terms[len(question.fixed) :], 10), 10)


def solve(problem: Problem, fit: Fitted, steps: int = STEPS) -> Solution:
    """The corrected model of a fit, by so many steps at most."""
    asked = problem.data, problem.wanted, problem.block, fit.effective
    return solve_terms(problem.given, fit.terms, fit.values(), *asked, steps)


def without_terms(found: Explanation, gone: Sequence[Term], problem: Problem) -> Explanation:
    """The same explanation without some terms, the others fitted anew."""
    less = fit_to_convergence(found.question, excluding(found.fit.terms, gone), found.fit)
    return replace(found, fit=less, solution=solve(problem, less))
