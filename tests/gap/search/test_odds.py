"""One probability: of a cause against nothing, and against something unknown."""

import math

import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.gap.problems import measured, question_of, wanted_of
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.gap.search.evidence import fit_terms
from torchid.gap.search.odds import Misfit, Odds, Place
from torchid.gap.search.replication import own_torque
from torchid.gap.search.solve import solve_terms
from torchid.statistics.bagging import Draws
from torchid.statistics.blocks import block_numbers
from torchid.statistics.odds import DOUBT, stands_in

NOISE = 0.01


def asked(planted, misfit, name="viscous_friction", joint=1):
    """Probability of an effect of a joint on a log with what is planted, beside so much misfit."""
    data = measured(planted, noise=NOISE)
    question = question_of(data, (name,))
    term = next(t for t in question.candidates.terms if t.place == joint)
    rows = question.normal.rows
    fit, without = (fit_terms(question, terms, rows, None, 10) for terms in ([term], []))
    block = block_numbers(data.samples.bounds, len(data.samples) // 40)
    columns = question.candidates.columns
    wanted = wanted_of((name,))
    solution = solve_terms(columns, fit.terms, fit.values(), data, wanted, block, rows)
    share = misfit / (misfit + question.squares / rows)
    left = Misfit(torch.full_like(rows, misfit), share)
    own = own_torque(solution, len(question.fixed))
    return Place(question, (fit, without), term, own).sure(left, Draws.of(block))


LAW = [(ViscousFriction(1), [0.5])]


def test_a_law_without_misfit_is_sure():
    assert asked(LAW, 0.0) > 0.999


def test_nothing_is_more_likely_than_what_is_not_there():
    assert asked([], 0.0) < 0.5


def test_the_odds_end_where_misfit_begins():
    """The larger what no cause explains, the less sure, however clear the evidence is."""
    sure = [asked(LAW, misfit) for misfit in (1e-4, 0.05, 0.2, 1.0)]
    assert sure == sorted(sure, reverse=True)
    assert sure[0] > 0.99
    assert sure[-1] < 1 / (1 + 0.9 * DOUBT)


def test_what_another_law_leaves_to_a_proxy_is_less_sure():
    """Dry friction seen as viscous: in slow and in fast motion it wants another factor."""
    misfit = 0.02
    law, proxy = asked(LAW, misfit), asked([(CoulombFriction(1), [0.3])], misfit)
    assert 1 - proxy > 5 * (1 - law)


@given(st.lists(st.floats(0.0, 1.0), min_size=3, max_size=7))
def test_a_set_is_the_smallest_that_holds_nine_tenths_of_its_place(masses):
    sure, nothing, *others = (m / (sum(masses) or 1.0) for m in masses)
    each = Odds(sure, nothing, 0.0, tuple(others))
    members = [others[k] for k in each.in_set]
    assert members == sorted(members, reverse=True)
    assert sure + sum(members) >= 0.9 * each.set_sure - 1e-12
    if members:
        assert sure + sum(members[:-1]) < 0.9 * each.set_sure


@given(st.lists(st.floats(0.02, 5.0), min_size=2, max_size=5))
def test_equal_factors_speak_for_a_law_as_far_as_they_are_known(stds):
    same = stands_in([(1.0, s) for s in stds])
    assert same <= 1e-12
    assert stands_in([(1.0, 10 * s) for s in stds]) >= same
    assert stands_in([(1.0, math.inf), (1.0, math.inf)]) == 0.0
    spread = [(1.0 + (-1) ** k, s) for k, s in enumerate(stds)]
    assert stands_in(spread) > same
