"""Friction of file and found together resists at the speeds of the log, whatever one law does."""

import math
from collections.abc import Sequence

import pytest
import torch

from tests.gap.problems import measured, question_of, term
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import PowerLawFriction
from torchid.effects.gravity import TorqueGain
from torchid.effects.registry import Valued
from torchid.effects.spring import JointSpring
from torchid.gap.search.evidence import Fitted, Question, fit_terms, unphysical_terms
from torchid.gap.search.explain import drop_unphysical

LAWS = ("viscous_friction", "coulomb_friction", "power_law_friction", "joint_spring")


def fitted(effects: Sequence[Valued], *names: str, given: Sequence[Valued] = ()) -> Fitted:
    """Laws of joint 2 fitted to a log with these effects on it."""
    return asked(question_of(measured(effects), LAWS, given=given), *names)


def asked(question: Question, *names: str) -> Fitted:
    return fit_terms(question, [term(question, n, 1) for n in names], question.normal.rows)


@pytest.mark.parametrize(("thinning", "stays"), [(-0.3, True), (-4.0, False)])
def test_a_law_that_falls_is_refused_where_the_sum_drives(thinning: float, stays: bool) -> None:
    """Lubricant that thins beside viscous friction: as long as the two together resist."""
    laws = ((ViscousFriction(1), [1.0]), (PowerLawFriction(1, a=1.5), [thinning]))
    question = question_of(measured(laws), LAWS)
    fit = asked(question, "viscous_friction", "power_law_friction")
    assert math.isfinite(fit.evidence) == stays
    if not stays:
        (gone,) = unphysical_terms(question, fit)
        assert gone.name == "power_law_friction"
        left = drop_unphysical(question, fit)
        assert all(t.name != "power_law_friction" for t in left.terms)


@pytest.mark.parametrize(("of_file", "stays"), [(3.0, True), (0.0, False)])
def test_a_law_may_take_what_the_file_has_too_much(of_file: float, stays: bool) -> None:
    given = ((ViscousFriction(1), [of_file]),)
    thins = ((PowerLawFriction(1, a=1.5), [-0.5]),)
    fit = fitted((*given, *thins), "power_law_friction", given=given)
    assert math.isfinite(fit.evidence) == stays


@pytest.mark.parametrize(("of_file", "stays"), [(1.5, True), (0.0, False)])
def test_damping_of_file_and_found_together_is_not_below_zero(of_file: float, stays: bool) -> None:
    given = ((ViscousFriction(1), [of_file]),)
    drives = ((ViscousFriction(1), [of_file - 1.0]),)
    fit = fitted(drives, "viscous_friction", given=given)
    assert math.isfinite(fit.evidence) == stays


@pytest.mark.parametrize("k", [2.7, -2.7])
def test_a_spring_pulls_back(k: float) -> None:
    straight = JointSpring(1, curvature=0.0)
    question = question_of(measured(((straight, [k, 0.0]),)), LAWS)
    own = next(t for t in question.candidates.terms if t.effects == (straight,))
    fit = fit_terms(question, [own], question.normal.rows)
    assert math.isfinite(fit.evidence) == (k > 0)


def test_a_counterbalance_may_push_away() -> None:
    lever = JointSpring(1, curvature=1.0)
    question = question_of(measured(((lever, [-2.7, 0.0]),)), LAWS)
    own = next(t for t in question.candidates.terms if t.effects == (lever,))
    assert math.isfinite(fit_terms(question, [own], question.normal.rows).evidence)


@pytest.mark.parametrize("gain", [-0.3, -0.6])
def test_a_gain_is_above_half_of_its_nominal(gain: float) -> None:
    question = question_of(measured(((TorqueGain(1), [gain]),), noise=0.01), ("torque_gain",))
    fit = asked(question, "torque_gain")
    assert math.isfinite(fit.evidence) == (gain > -0.5)


def test_friction_that_resists_is_never_refused() -> None:
    laws = ((CoulombFriction(1), [0.5]), (ViscousFriction(1), [1.0]), (TorqueOffset(1), [0.4]))
    question = question_of(measured(laws), LAWS)
    fit = asked(question, "viscous_friction", "coulomb_friction")
    assert not unphysical_terms(question, fit)
    assert not question.dissipation.driving(fit.terms, fit.x, torch.zeros(len(fit.x), 1).double())
