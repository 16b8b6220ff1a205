"""Nonlinear effects are recovered at their true size, and the corrected model has each once."""

from dataclasses import replace

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import NOISE, measured, question_of, term, two_folds, wanted_of
from torchid.design.columns import Columns, Model
from torchid.design.gram import least_squares
from torchid.effects.base import Effect
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import LoadDependentFriction, StribeckFriction
from torchid.effects.gravity import EncoderOffset
from torchid.effects.phase import TimeDelay
from torchid.gap.data import Data
from torchid.gap.search.evidence import Question
from torchid.gap.search.solve import Solution, corrected_model, solve_terms
from torchid.gap.search.terms import Term
from torchid.robot.inertia import InertialParameters
from torchid.statistics.blocks import block_numbers
from torchid.statistics.robust import huber_weights


def solution_of(
    data: Data,
    question: Question,
    terms: list[Term],
    *,
    start: list[float] | None = None,
    block: int = 20,
) -> Solution:
    """All terms together, from zero if nothing is known of them."""
    columns = Columns(question.candidates.columns.model, data.samples)
    x = [torch.zeros(len(t.at), dtype=torch.float64) for t in terms]
    if start is not None:
        x = [torch.full_like(v, s) for v, s in zip(x, start, strict=True)]
    blocks = block_numbers(data.samples.bounds, block)
    names = tuple({t.name for t in terms} & set(NAMES))
    return solve_terms(columns, terms, x, data, wanted_of(names or NAMES), blocks)


NAMES = (
    "viscous_friction", "coulomb_friction", "torque_offset", "encoder_offset", "time_delay",
    "load_dependent_friction", "stribeck_friction",
)  # fmt: skip


def planted(effect: Effect, value: float, name: str, **how) -> tuple[Data, Question, Term]:
    """A log with one effect, and the candidate for it with its usual secant."""
    data = measured([(effect, [value])], **how)
    question = question_of(data, (name,))
    (joint,) = effect.joints
    return data, question, on_joint(question, joint)


def on_joint(question: Question, joint: int) -> Term:
    """The first candidate that is located at this joint."""
    found = (t for t in question.candidates.terms if t.effects and t.effects[0].joints == (joint,))
    return next(found)


@pytest.mark.parametrize(
    ("effect", "value"),
    [(EncoderOffset(1, at=0.05), 0.05), (TimeDelay(1, at=8e-3), 8e-3)],
)
def test_secants_end_at_the_true_size(effect, value):
    """The torque is that of the whole offset or delay; the candidate's secant begins elsewhere."""
    data, question, candidate = planted(effect, value, effect.name, noise=0.0)
    assert candidate.effects[0] != effect
    found = solution_of(data, question, [candidate])
    assert float(found.values[0]) == pytest.approx(value, rel=5e-3)
    assert found.terms[0].effects[0].at == pytest.approx(value, rel=0.02)
    ((own, values),) = found.model.effects
    assert own.identity == effect.identity
    assert values[0] == pytest.approx(float(found.values[0]))
    before = question.candidates.gap * data.keep
    assert float(found.left.norm() / before.norm()) < 0.01


def test_standard_deviations_are_those_of_the_noise():
    """Of a term in white noise: that of least squares on as many samples, within a factor of two,
    and the value within three of them. Many blocks tell of it, so that Student's factor is none."""
    data = measured([(ViscousFriction(1), [1.0])])
    question = question_of(data)
    found = solution_of(data, question, [term(question, "viscous_friction", 1)], block=4)
    std, value = float(found.std[0]), float(found.values[0])
    assert abs(value - 1.0) < 3 * std
    square = float(found.a.square().sum())
    left = float(found.left[1].square().mean())
    assert 0.5 < std / (left / square) ** 0.5 < 2.0
    assert left**0.5 < NOISE


def test_friction_that_grows_with_load_sees_the_corrected_load():
    """An offset that is found too changes what the friction's column is."""
    truth = [(TorqueOffset(1), [8.0]), (LoadDependentFriction(1), [0.1])]
    data = measured(truth, noise=0.0)
    question = question_of(data, ("torque_offset", "load_dependent_friction"))
    terms = [term(question, e.name, 1) for e, _ in truth]
    found = solution_of(data, question, terms)
    assert [float(v) for v in found.values] == pytest.approx([8.0, 0.1], rel=1e-3)


def test_a_fold_is_not_fitted():
    """Its torque is spoilt, and a model without it does not know."""
    data = measured([(ViscousFriction(1), [1.0])], noise=0.0)
    held = two_folds(data) == 1
    question = question_of(data)
    found = solution_of(data, question, [term(question, "viscous_friction", 1)])
    spoilt = replace(found, left=found.left + 3.0 * held)
    ((_, clean),) = spoilt.without(~held).effects
    assert clean == pytest.approx([1.0], rel=1e-6)
    ((_, both),) = spoilt.without(torch.ones_like(held)).effects
    assert abs(both[0] - 1.0) > 0.01


def test_what_the_other_samples_hardly_hold_keeps_its_size():
    """What happened in one fold cannot be predicted by the others; what is always there can."""
    data = measured([(ViscousFriction(1), [1.0]), (TorqueOffset(0), [0.5])], noise=0.0)
    question = question_of(data)
    terms = [term(question, "viscous_friction", 1), term(question, "torque_offset", 0)]
    found = solution_of(data, question, terms)
    few = torch.zeros(len(data.samples), dtype=torch.bool)
    few[:20] = True
    spoilt = replace(found, left=found.left + 3.0)
    kept = {e.name: v for e, v in spoilt.without(few).effects}
    assert kept == {"viscous_friction": pytest.approx([1.0]), "torque_offset": pytest.approx([0.5])}
    again = {e.name: v for e, v in spoilt.without(torch.ones_like(few)).effects}
    assert again["torque_offset"][0] > 1.0


def fitted(terms: list[Term], values: list[float], given=()) -> Model:
    x = [torch.tensor([v], dtype=torch.float64) for v in values]
    return corrected_model(Model(ROBOT, tuple(given)), terms, x, wanted_of(NAMES))


@pytest.fixture(scope="module")
def data() -> Data:
    return measured([])


def test_the_model_s_own_effect_grows(data):
    given = ((CoulombFriction(0), [0.4]), (ViscousFriction(1), [1.5]))
    question = question_of(data, given=given)
    own = term(question, "viscous_friction", 1)
    other = term(question, "torque_offset", 2)
    model = fitted([own, other], [-0.5, 0.2], given)
    assert model.effects == (
        (CoulombFriction(0), [0.4]), (ViscousFriction(1), [1.0]), (TorqueOffset(2), [0.2]),
    )  # fmt: skip


def test_another_shape_replaces_the_model_s_own(data):
    own = StribeckFriction(1, vs=0.3)
    question = question_of(data, ("stribeck_friction",), given=((own, [0.8]),))
    other = next(t for t in question.candidates.terms if t.instead)
    model = fitted([other], [1.1], ((own, [0.8]),))
    ((effect, values),) = model.effects
    assert effect == other.effects[0] != own
    assert values == [1.1]


def test_a_secant_of_the_model_s_own_moves_with_the_sum(data):
    own = EncoderOffset(1, at=0.04)
    question = question_of(data, ("encoder_offset",), given=((own, [0.04]),))
    found = on_joint(question, 1)
    ((effect, values),) = fitted([found], [0.02], ((own, [0.04]),)).effects
    assert values == pytest.approx([0.06])
    assert effect.at == pytest.approx(0.06)


def test_base_parameters_and_bodies_are_corrected(data):
    question = question_of(data, ("link_inertia",), inertial=True)
    pi = ROBOT.require_parameters("a test").pi
    link = on_joint(question, 2)
    change = torch.arange(1.0, 11.0, dtype=torch.float64)
    model = corrected_model(Model(ROBOT, ()), [link], [change], wanted_of(NAMES))
    found = model.robot.require_parameters("a test").pi
    assert torch.allclose(found[2], pi[2] + change)
    assert torch.allclose(found[:2], pi[:2])
    assert model.effects == ()


def test_wrong_base_parameters_are_found_up_to_what_is_seen():
    """The corrected model's torque is the real arm's, whichever parameters stand for it."""
    pi = ROBOT.require_parameters("a test").pi * torch.tensor([[1.0], [1.2], [0.8]])
    data = measured([], real=ROBOT.with_parameters(InertialParameters(pi)), noise=0.0)
    question = question_of(data, (), inertial=True)
    base = next(t for t in question.candidates.terms if t.name == "all_base")
    found = solution_of(data, question, [base])
    before = (question.candidates.gap * data.keep).norm()
    assert float(found.left.norm() / before) < 1e-6


def test_least_squares_leaves_what_is_not_determined_at_zero():
    g = torch.Generator().manual_seed(0)
    a = torch.randn(2, 60, generator=g, dtype=torch.float64)
    y = 2 * a[0] - a[1]
    x = least_squares(torch.cat([a, torch.zeros(1, 60)]), y)
    assert x.tolist() == pytest.approx([2.0, -1.0, 0.0], abs=1e-9)
    both = least_squares(torch.stack([a[0], a[0]]), 3 * a[0])
    assert both.tolist() == pytest.approx([1.5, 1.5], rel=1e-6)


def test_far_out_samples_count_as_their_limit():
    g = torch.Generator().manual_seed(1)
    r = torch.randn(1, 20_000, generator=g, dtype=torch.float64)
    r[0, :10] = 50.0
    r[0, 10:20] = 0.0  # of samples that do not count
    weights = huber_weights(r).square()
    assert bool((weights[0, :10] * 50.0 < 1.5).all())
    assert float((weights == 1).double().mean()) == pytest.approx(0.82, abs=0.02)


@pytest.mark.parametrize("gain_std", [0.05, 0.2])
def test_an_unknown_scale_of_the_torque_is_in_the_standard_deviations(gain_std: float) -> None:
    effects = [(ViscousFriction(0), [1.0]), (CoulombFriction(1), [0.5])]
    data = measured(effects)
    question = question_of(data, inertial=True)
    own = [term(question, "viscous_friction", 0), term(question, "coulomb_friction", 1)]
    exact = solution_of(data, question, own)
    scaled = solution_of(replace(data, gain_std=gain_std), question, own)
    for a, b, x in zip(exact.std, scaled.std, exact.values, strict=True):
        assert float(b.square() - a.square()) == pytest.approx(float(gain_std * x) ** 2, rel=1e-6)
