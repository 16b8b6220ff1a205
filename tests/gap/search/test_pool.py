"""Explanations beside the answered one, and what they say of its terms."""

from collections.abc import Sequence
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.gap.problems import SIMPLE, measured, problem_of, question_of, term, two_folds, wanted_of
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.gap.data import Data
from torchid.gap.search.climb import fit_anew
from torchid.gap.search.evidence import Question
from torchid.gap.search.explain import Explanation, solve
from torchid.gap.search.findings import judge_terms, rivals_of
from torchid.gap.search.odds import Misfit
from torchid.gap.search.pool import _felt, _parts, pool_of
from torchid.gap.search.terms import Term
from torchid.statistics.bagging import Draws, bagged
from torchid.statistics.blocks import block_numbers

LAWS = [(ViscousFriction(1), [0.2]), (CoulombFriction(2), [0.6])]
DATA = measured(LAWS)
DRAWS = Draws.of(block_numbers(DATA.samples.bounds, 25))


def answer(
    terms: Sequence[Term], ends: Sequence[Sequence[Term]], question: Question, data: Data = DATA
) -> Explanation:
    fit = fit_anew(question, terms)
    solution = solve(problem_of(data, wanted_of(SIMPLE)), fit)
    return Explanation(question, fit_anew(question), fit, (), solution, tuple(map(tuple, ends)))


@pytest.fixture(scope="module")
def question() -> Question:
    return question_of(DATA, parts=two_folds(DATA))


@settings(deadline=None, max_examples=10)
@given(st.data())
def test_parts_hold_every_term_once_and_no_joint_feels_two(data) -> None:
    question = question_of(DATA, parts=two_folds(DATA))
    every = st.lists(st.sampled_from(question.candidates.terms), unique_by=id, max_size=6)
    gone = data.draw(every)
    come = [t for t in data.draw(every) if all(t is not g for g in gone)]
    fit = fit_anew(question)
    parts = list(_parts(question, fit, gone, come))
    for k, terms in enumerate((gone, come)):
        assert sorted(id(t) for part in parts for t in part[k]) == sorted(map(id, terms))
    felt = [{j for t in (*a, *b) for j in _felt(question, fit, t)} for a, b in parts]
    assert sum(map(len, felt)) == len(set().union(*felt))


def test_a_worse_end_takes_no_name_and_a_better_one_does(question) -> None:
    """An end has dry friction in the place of viscous; and the other way round."""
    viscous, dry = term(question, "viscous_friction", 1), term(question, "coulomb_friction", 2)
    other = term(question, "coulomb_friction", 1)
    found = answer([viscous, dry], [[other, dry]], question)
    (rival,) = pool_of(found, DRAWS).without(viscous)
    assert rival.terms == (other,)
    assert pool_of(found, DRAWS).without(dry) == []
    sure, mass = bagged([rival.weight], DRAWS, [rival.beside])
    assert sure > 0.99
    # From the worse one's side the other takes it all.
    worse = answer([other, dry], [[viscous, dry]], question)
    (rival,) = pool_of(worse, DRAWS).without(other)
    sure, mass = bagged([rival.weight], DRAWS, [rival.beside])
    assert mass > 0.99
    none = Misfit(torch.zeros(3).double(), torch.zeros(3).double())
    judged = {one.term: one for one in judge_terms(worse, none, DRAWS)}
    assert judged[other].odds.sure < 0.01
    assert judged[dry].odds.sure > 0.9


def test_what_an_end_has_elsewhere_speaks_for_no_part_of_it() -> None:
    """An end without viscous friction has the dry friction of another joint that the answer lacks:
    better as a whole, and yet viscous friction is there."""
    data = measured([(ViscousFriction(1), [0.02]), (CoulombFriction(2), [0.6])])
    question = question_of(data, parts=two_folds(data))
    viscous, dry = term(question, "viscous_friction", 1), term(question, "coulomb_friction", 2)
    other = term(question, "torque_offset", 1)
    found = answer([viscous], [[other, dry]], question, data)
    rivals = pool_of(found, DRAWS).without(viscous)
    weights, beside = [r.weight for r in rivals], [r.beside for r in rivals]
    assert bagged(weights, DRAWS)[0] < 0.01
    assert bagged(weights, DRAWS, beside)[0] > 0.5


def test_what_a_rival_adds_elsewhere_speaks_neither_for_nor_against_a_cause(question) -> None:
    viscous, dry = term(question, "viscous_friction", 1), term(question, "coulomb_friction", 2)
    fit, instead = fit_anew(question, [viscous]), fit_anew(question, [dry])
    (rival,) = rivals_of(question, fit, viscous, [((dry,), instead)], DRAWS)
    assert bagged([rival.weight], DRAWS, [rival.beside])[0] > 0.99


def test_terms_that_were_refused_are_in_no_end(question) -> None:
    viscous, dry = term(question, "viscous_friction", 1), term(question, "coulomb_friction", 2)
    barred = answer([viscous], [[viscous, dry]], question)
    assert len(pool_of(barred, DRAWS).every) == 1
    without = replace(barred, question=replace(question, barred=frozenset([dry.key])))
    assert pool_of(without, DRAWS).every == ()
