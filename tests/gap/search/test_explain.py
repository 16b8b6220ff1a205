"""Explanations: the model as given, and terms that leave one."""

from tests.gap.problems import SIMPLE, measured, named, problem_of, question_of, term, wanted_of
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.gap.search.explain import Explanation, fit_anew, solve, without_terms


def test_nothing_is_the_model_as_given():
    question = question_of(measured([]))
    fit = fit_anew(question)
    assert fit.terms == ()
    assert fit.evidence == 0.0
    assert bool((fit.effective <= question.normal.rows).all())


def test_without_a_term_the_others_are_fitted_anew():
    data = measured([(CoulombFriction(1), [0.6]), (ViscousFriction(1), [0.8])])
    question = question_of(data)
    both = [term(question, name, 1) for name in ("coulomb_friction", "viscous_friction")]
    problem, fit = problem_of(data, wanted_of(SIMPLE)), fit_anew(question, both)
    found = Explanation(question, fit_anew(question), fit, (), solve(problem, fit))
    less = without_terms(found, both[:1], problem)
    assert named(less.terms) == {("viscous_friction", 1)}
    assert less.empty is found.empty
    # Viscous friction takes a part of what dry friction was.
    assert float(less.solution.values[0][0]) > float(found.solution.values[1][0]) + 0.1
