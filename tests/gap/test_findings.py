"""Findings of the 3R: shares, joints, deviations, aliases, and what to do next."""

from dataclasses import replace
from functools import cache

import pytest

from tests.gap.problems import Case
from tests.gap.test_solve import changed, solved
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.gravity import BaseTilt
from torchid.effects.inertia import Payload
from torchid.effects.registry import KINDS, experiment
from torchid.gap.findings import findings, next_experiment
from torchid.gap.solve import Solution

# A fit holds terms of different sizes, which its annotation gives one name.
pytestmark = pytest.mark.usefixtures("types_unchecked")

BOTH = [(CoulombFriction(1), [0.6]), (ViscousFriction(2), [0.1])]


@cache
def two() -> tuple[Case, Solution]:
    case = Case(BOTH, ("coulomb_friction", "viscous_friction", "torque_offset"))
    return case, solved(case)


def test_values_joints_and_shares():
    _, solution = two()
    found = findings(solution)
    assert [(f.effect.name, f.joints) for f in found.effects] == [
        ("coulomb_friction", (1,)),
        ("viscous_friction", (2,)),
    ]
    assert found.parametric == ()
    for f, (_, expected) in zip(found.effects, BOTH, strict=True):
        assert abs(f.values[0] - expected[0]) < 4 * f.std[0]
        assert f.p_value < 0.01
    # Nothing else is there: alone and left out each closes its own part, and both close all.
    first, second = found.effects
    assert first.share > second.share > 0
    assert first.share + second.share == pytest.approx(1.0, abs=0.03)
    for f in found.effects:
        assert f.first == pytest.approx(f.share, abs=0.03)


def test_a_global_effect_lists_the_joints_that_feel_it():
    """A tilt about the axis of the first joint of a vertical arm is felt where gravity is."""
    case = Case([(BaseTilt(), [0.05, 0.03])], ("base_tilt", "torque_offset", "kinematic_error"))
    found = findings(solved(case))
    assert found.effects[0].effect.name == "base_tilt"
    assert "kinematic_error" in found.effects[0].ambiguous_with
    felt = set(found.effects[0].joints)
    columns = case.evaluator.columns(BaseTilt())[1].reshape(2, 3, -1)
    values = case.evaluator.rigid.new_tensor(found.effects[0].values)
    share = (values @ columns.flatten(1)).reshape(3, -1).square().sum(1)
    share = share / share.sum()
    assert (
        {j for j in range(3) if share[j] > 0.1} <= felt <= {j for j in range(3) if share[j] > 1e-3}
    )


def test_a_load_is_a_payload_or_the_last_link():
    mass = [0.3, 0.05, 0.0, 0.0, 0.01, 0.0, 0.0, 0.01, 0.0, 0.01]
    case = Case([(Payload(), mass)], ("payload", "link_inertia", "base_tilt"))
    found = findings(solved(case))
    if found.effects:
        assert found.effects[0].effect.name == "payload"
        assert "link_inertia" in found.effects[0].ambiguous_with
    else:
        assert found.parametric[0].links == (2,)
        assert "payload" in found.parametric[0].ambiguous_with


def test_wrong_parameters_are_no_effects():
    case = Case([], ("coulomb_friction", "link_inertia"), real=changed(1, 1.3))
    found = findings(solved(case))
    assert found.effects == ()
    assert len(found.parametric) == 1
    assert found.parametric[0].links in ((1,), ())
    assert found.parametric[0].share == pytest.approx(1.0, abs=0.05)


def test_a_coefficient_that_is_open_is_said():
    _, solution = two()
    position = len(solution.problem.fixed)
    std = list(solution.fit.std)
    std[position] = 10 * solution.fit.values[position].abs() + 1
    wide = replace(solution.fit, std=tuple(std))
    notes = {f.effect.name: f.notes for f in findings(replace(solution, fit=wide)).effects}
    name = solution.terms[0].name
    assert "not determined" in notes[name][0]
    assert all(not v for k, v in notes.items() if k != name)


def test_nothing_to_separate_nothing_to_do():
    case, solution = two()
    found = findings(solution)
    assert all(not f.ambiguous_with for f in found.effects)
    assert next_experiment(solution, found, case.rows) is None


LAWS = (
    "coulomb_friction",
    "stribeck_friction",
    "load_dependent_friction",
    "asymmetric_friction",
    "viscous_friction",
)


def test_the_next_experiment_names_what_it_separates():
    """Friction a little above what can be found at all is of no particular law."""
    case = Case([(CoulombFriction(1), [0.005])], LAWS)
    solution = solved(case)
    found = findings(solution)
    assert len(found.effects) == 1
    assert found.effects[0].ambiguous_with
    said = next_experiment(solution, found, case.rows)
    assert said["separates"][0] == found.effects[0].effect.name
    assert said["separates"][1] in found.effects[0].ambiguous_with
    assert said["joint"] == 2
    assert said["do"].endswith(".")
    where = said["most_informative"]
    passage = next(p for p in case.rows.passages if p.name == where["trajectory"])
    assert passage.motion.t[0] <= where["from_s"] <= where["to_s"] <= passage.motion.t[-1]
    assert 0 < where["share"] <= 1
    seconds = said["seconds_of_the_same_motion"]
    assert seconds is None or seconds > 0


def test_no_amount_of_the_same_motion_separates_what_is_the_same():
    mass = [0.3, 0.05, 0.0, 0.0, 0.01, 0.0, 0.0, 0.01, 0.0, 0.01]
    case = Case([(Payload(), mass)], ("payload", "link_inertia"))
    solution = solved(case)
    said = next_experiment(solution, findings(solution), case.rows)
    assert said is None or said["seconds_of_the_same_motion"] is None


def test_experiments_are_told_for_every_effect():
    for one in KINDS:
        text = experiment(one, "coulomb_friction")
        assert text[0].isupper()
        assert text.endswith(".")
    same = experiment("base_tilt", "base_tilt")
    assert same.count("joint 1") == 1
