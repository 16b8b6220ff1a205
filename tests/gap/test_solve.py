"""Fits and corrected models of the 3R against what was planted."""

from dataclasses import replace

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import Case, bank, motions, problem, random
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.gravity import EncoderOffset, TorqueGain
from torchid.effects.hysteresis import PreslidingHysteresis
from torchid.effects.registry import model_torque
from torchid.effects.transient import Contact
from torchid.gap.fit import Fit, fitted
from torchid.gap.problem import BASE, Term, term_of
from torchid.gap.solve import Solution, corrected, fitted_on, solve
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Tensor

# A fit holds terms of different sizes, which its annotation gives one name.
pytestmark = pytest.mark.usefixtures("types_unchecked")

SEARCHED = ("coulomb_friction", "viscous_friction", "torque_offset", "torque_gain", "link_inertia")


def pi_of(robot: Robot) -> Tensor:
    return robot.require_parameters("a test").pi


def changed(link: int, factor: float = 1.2) -> Robot:
    """The 3R with one link heavier."""
    pi = pi_of(ROBOT).clone()
    pi[link] *= factor
    return ROBOT.with_parameters(InertialParameters(pi))


def solved(case: Case, **options) -> Solution:
    return solve(case.evaluator, case.evaluator, case.keep, case.task, case.banks, **options)


def away(found, real, effects) -> float:
    """RMS difference of the corrected model's torque and the real one, relative to the torque."""
    left, size = 0.0, 0.0
    for m in motions(2):
        sharp = m._replace(direction=torch.sign(m.dq))
        truth = model_torque(real, effects, sharp)
        wrong = model_torque(found.robot, found.effects, sharp) - truth
        left += float(wrong.square().sum())
        size += float(truth.square().sum())
    return (left / size) ** 0.5


def left(case: Case, robot, effects) -> float:
    """Sum of squares that a model leaves."""
    return float(case.evaluator.with_model(robot, effects).residual().square().sum())


@pytest.mark.parametrize("free", [False, True])
def test_parameters_and_an_effect_are_recovered_to_the_noise(free):
    """A heavier last link and friction: the residual is the noise's, the coefficient is right
    within its deviation, and the torque of the corrected model is the arm's."""
    real, effects = changed(2), [(CoulombFriction(1), [0.5])]
    case = Case(effects, SEARCHED, real=real, free=free)
    found = solved(case)
    named = {t.name for t in found.terms}
    assert "coulomb_friction" in named
    assert ("link_inertia" in named or BASE in named) != free
    term = next(t for t in found.terms if t.name == "coulomb_friction")
    value, std = found.values_of(term)
    assert abs(float(value) - 0.5) < 4 * float(std)
    assert float(std) < 0.01
    assert left(case, found.robot, found.effects) < 1.005 * left(case, real, effects)
    assert left(case, real, effects) < 0.1 * left(case, ROBOT, ())
    assert away(found, real, effects) < 0.01


def test_the_corrected_model_holds_the_fitted_values():
    case = Case([(CoulombFriction(1), [0.5]), (ViscousFriction(0), [0.3])], SEARCHED)
    found = solved(case)
    for term in found.terms:
        value = found.values_of(term)[0].tolist()
        assert (term.effects[0], value) in [(e, list(v)) for e, v in found.effects]
    assert torch.equal(pi_of(found.robot), pi_of(ROBOT))


def test_a_gain_on_refitted_parameters_settles():
    """The gain multiplies the parameters it is fitted with: one linear step ends beside it. The
    other two joints keep a common scale from being gain or parameters alike."""
    real, effects = changed(2, 1.5), [(TorqueGain(1), [0.2])]
    case = Case(effects, ("torque_gain",), real=real, free=True)
    found = solved(case)
    assert [t.name for t in found.terms] == ["torque_gain"]
    value, std = found.values_of(found.terms[0])
    assert float(value) == pytest.approx(0.2, abs=max(0.004, 4 * float(std)))
    assert left(case, found.robot, found.effects) < 1.005 * left(case, real, effects)
    assert away(found, real, effects) < 0.01


def test_a_secant_is_taken_at_the_estimate():
    effects = [(EncoderOffset(1, 0.1), [0.06])]
    case = Case(effects, ("encoder_offset", "coulomb_friction"), inertial=False)
    found = solved(case)
    effect, values = found.effects[-1]
    assert effect.name == "encoder_offset"
    assert effect.joints == (1,)
    assert values[0] == pytest.approx(0.06, rel=0.02)
    assert effect.at == pytest.approx(values[0], rel=0.02)


def test_nothing_is_found_where_there_is_nothing():
    found = solved(Case([], SEARCHED))
    assert found.terms == ()
    assert found.effects == ()
    assert torch.equal(pi_of(found.robot), pi_of(ROBOT))


def test_a_term_that_plain_rows_do_not_confirm_leaves():
    """Named on rows that hold it; the rows that coefficients are fitted on do not."""
    case = Case([(CoulombFriction(1), [0.5])], ("coulomb_friction", "torque_offset"))
    quiet = Case([], ("coulomb_friction", "torque_offset"))
    found = solve(case.evaluator, quiet.evaluator, case.keep, case.task, case.banks)
    assert found.terms == ()
    kept = solve(case.evaluator, case.evaluator, case.keep, case.task, case.banks)
    assert [t.name for t in kept.terms] == ["coulomb_friction"]


def test_rows_left_out_have_no_say():
    """A third of the rows is another arm's; left out, nothing of it is found."""
    case = Case([(CoulombFriction(1), [0.5])], ("coulomb_friction", "torque_offset"))
    folds = torch.ones(len(case.rows), dtype=torch.bool)
    folds[case.rows.bounds[2]] = False
    spoiled = case.rows.passages[2]
    other = replace(spoiled, tau=spoiled.tau + torch.tensor([5.0, -20.0, 3.0]))
    case.rows.passages = (*case.rows.passages[:2], other)
    found = solved(case, folds=folds)
    assert [t.name for t in found.terms] == ["coulomb_friction"]
    assert found.values_of(found.terms[0])[0] == pytest.approx(0.5, abs=0.01)
    assert found.problem.count == 3 * int(folds.sum())


def test_a_background_is_fitted_with_the_parameters():
    real, effects = changed(1), [(ViscousFriction(j), [0.1 * (j + 1)]) for j in range(3)]
    case = Case(effects, (), real=real, free=True, background=("viscous_friction",))
    found = solve(case.evaluator, case.evaluator, case.keep, replace(case.task, most=0), ())
    assert [(e.name, e.joints) for e, _ in found.effects] == [
        ("viscous_friction", (j,)) for j in range(3)
    ]
    assert torch.tensor([v[0] for _, v in found.effects]) == pytest.approx(
        torch.tensor([0.1, 0.2, 0.3]), abs=0.02
    )
    assert away(found, real, effects) < 0.01


def terms(count: int = 2) -> list[Term]:
    x = random(count, 2, 400, seed=1) * torch.tensor([1.0, 300.0]).unsqueeze(1)
    return [
        Term("cogging", k, (TorqueOffset(k),), x[k], TorqueOffset.coefficients * 2)
        for k in range(count)
    ]


def test_a_fit_is_least_squares():
    y = random(3, 400, seed=0)
    both = terms()
    fit = fitted(problem(y, ()), both)
    for k, term in enumerate(both):
        expected = torch.linalg.lstsq(term.columns.T, y[k].unsqueeze(1)).solution[:, 0]
        assert torch.allclose(fit.values[k], expected, rtol=1e-8)
    assert fit.loss == pytest.approx(
        float(y.square().sum())
        - sum(float(y[k] @ (t.columns.T @ fit.values[k])) for k, t in enumerate(both))
    )


def test_deviations_are_those_of_the_estimates():
    """Over 300 draws of white noise, within a tenth: sandwiches of 20 blocks are rough."""
    both = terms(1)
    values, stds = [], []
    for seed in range(300):
        fit = fitted(problem(random(3, 400, seed=100 + seed), ()), both)
        values.append(fit.values[0])
        stds.append(fit.std[0])
    spread = torch.stack(values).std(0)
    typical = torch.stack(stds).square().mean(0).sqrt()
    assert torch.allclose(typical / spread, torch.ones(2), atol=0.15)


def test_an_effect_that_is_there_already_grows():
    """Corrections of the model's own effect do not make a second one of it."""
    case = Case([], ("viscous_friction",))
    start = case.evaluator.with_model(ROBOT, ((ViscousFriction(0), [0.3]),))
    bank = next(b for b in case.banks if b.place == 0)
    term = Term(bank.name, 0, bank.members[0], bank.columns[0], bank.coefficients)
    step = Fit((torch.tensor([0.2]),), (torch.tensor([0.1]),), 0.0)
    _, effects = corrected(start, (), [term], step, case.task)
    assert [(e, pytest.approx(v)) for e, v in effects] == [(ViscousFriction(0), [0.5])]


def test_what_one_shape_imitates_is_divided_again():
    """Coulomb friction and a longer presliding look like a shorter presliding at first."""
    both = [(CoulombFriction(0), [1.0]), (PreslidingHysteresis(0, 0.05), [1.0])]
    found = solved(Case(both, ("coulomb_friction", "viscous_friction", "presliding_hysteresis")))
    assert {t.name for t in found.terms} == {"coulomb_friction", "presliding_hysteresis"}
    for effect, values in found.effects:
        assert values[0] == pytest.approx(1.0, abs=0.1)
        if isinstance(effect, PreslidingHysteresis):
            assert effect.length == pytest.approx(0.05, rel=0.2)


def test_a_contact_is_found_beside_a_large_effect():
    both = [(CoulombFriction(0), [3.0]), (Contact(20.0, 21.0), [6.0, 0.0, 4.0])]
    found = solved(Case(both, ("coulomb_friction", "contact")))
    assert [t.name for t in found.terms] == ["coulomb_friction", "contact"]
    contact = found.terms[1].effects[0]
    assert abs(contact.start - 20.0) < 0.8
    assert abs(contact.stop - 21.0) < 0.8


def test_a_wrong_law_of_friction_is_no_contact():
    """What Coulomb's law leaves of presliding is in windows too, at every reversal."""
    found = solved(Case([(PreslidingHysteresis(0, 0.1), [3.0])], ("coulomb_friction", "contact")))
    assert [t.name for t in found.terms] == ["coulomb_friction"]


def test_what_rounding_leaves_of_a_column_gets_no_coefficient():
    """A joint that rests in a fold has base parameters whose columns are 1e-200 there."""
    y, x = random(1, 300, seed=1), random(1, 1, 300, seed=2)
    terms = [term_of(bank(x, 0)), term_of(bank(1e-200 * random(1, 1, 300, seed=3), 0))]
    found = fitted(problem(y, ()), terms)
    assert float(found.values[1]) == 0.0
    assert float(found.values[0]) == pytest.approx(float((x[0] @ y[0]) / x.square().sum()))


def test_an_invisible_direction_of_an_effect_stays_at_zero():
    """One of two columns is rounding: the other is found, and significant."""
    y, x = random(1, 300, seed=1), random(1, 2, 300, seed=2)
    x[:, 1] *= 1e-290
    term = term_of(bank(x, 0))
    found = fitted(problem(y + 5 * x[0, :1], ()), [term])
    assert float(found.values[0][1]) == 0.0
    assert float(found.values[0][0]) == pytest.approx(5.0, abs=0.3)
    assert bool(found.std[0].isfinite().all())


def test_a_term_that_is_not_in_these_rows_is_fitted_as_nothing():
    """A contact's window may lie in the part that is left out."""
    y = random(1, 300, seed=1)
    term = term_of(bank(torch.zeros(1, 2, 300, dtype=torch.float64), 0))
    found = fitted(problem(y, ()), [term])
    assert found.values[0].tolist() == [0.0, 0.0]
    assert found.loss == pytest.approx(float(y.square().sum()))


def test_a_contact_elsewhere_is_not_fitted_to_its_tails():
    """Of rows that hold only what filters spread of a contact, the fit would be any size."""
    both = [(CoulombFriction(0), [3.0]), (Contact(20.0, 21.0), [6.0, 0.0, 4.0])]
    case = Case(both, ("coulomb_friction", "contact"))
    found = solved(case)
    columns = found.terms[1].columns.abs().amax(0).reshape(case.keep.shape)
    for inside in (True, False):
        tail = columns < 1e-4 * columns.max()
        keep = case.keep & (torch.ones_like(tail) if inside else tail)
        assert bool((columns * keep > 0).any())
        _, effects = fitted_on(case.evaluator, found, keep, case.task)
        assert [e.name for e, _ in effects] == ["coulomb_friction", "contact"][: 1 + inside]
