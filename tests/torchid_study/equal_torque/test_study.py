"""The study of sets with equal torque: closed forms, linear programs by hand, planted answers."""

from functools import lru_cache

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.optimize import linprog

from tests.arms import mixed_arm, states
from tests.oracles import PinocchioOracle
from torchid.effects.base import Motion
from torchid.errors import TorchidError
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import nominal_set
from torchid.identification.base_parameters import base_parameters
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import JointType, Robot
from torchid.wrenches.deviation import wrench_errors
from torchid.wrenches.regressor import internal_wrenches
from torchid_study.equal_torque.force_reach import force_reach, force_squares
from torchid_study.equal_torque.given_sets import given_record, given_sets
from torchid_study.equal_torque.sample import equal_torque_space, kernel
from torchid_study.equal_torque.setting import (
    Setting,
    equal_torque_setting,
    reference_motion,
)
from torchid_study.equal_torque.study import EqualTorqueStudy, equal_torque_study

ROBOTS = ("3r", "kuka_lwr4_friction")
KINDS = ("feasible", "inertia", "com", "total_mass")
GRAVITY = 9.81
SLOW_FOR_THE_LWR = ("3r", pytest.param("kuka_lwr4_friction", marks=pytest.mark.nightly))


@lru_cache
def setting(name: str) -> Setting:
    return equal_torque_setting(load_robot(name))


@lru_cache
def drawn(name: str) -> EqualTorqueStudy:
    case = setting(name)
    return equal_torque_study(
        case.robot, setting=case, kinds=KINDS, per_kind=24, chains=12, resamples=20
    )


@lru_cache
def study() -> EqualTorqueStudy:
    return equal_torque_study(load_robot("3r"), per_kind=24, chains=12, kinds=KINDS, resamples=50)


def at_rest(robot: Robot) -> Motion:
    q, _, _ = states(robot, 5)
    return Motion(q, torch.zeros_like(q), torch.zeros_like(q))


def test_reference_is_the_nominal_set_where_it_is_feasible() -> None:
    case = setting("3r")
    assert case.origin == "nominal"
    assert torch.equal(case.reference.vector, nominal_set(case.robot).vector)
    assert float(case.torque_change.abs().max()) == 0.0


def test_reference_of_the_lwr_is_feasible_and_says_what_changed() -> None:
    case = setting("kuka_lwr4_friction")
    assert case.origin == "nearest"
    assert bool(feasibility(case.reference, case.conditions).feasible[0])
    names = case.reference.coefficient_names()
    assert float(case.nominal.coefficients[0, names.index("Fv6")]) < 0
    assert float(case.reference.coefficients[0, names.index("Fv6")]) >= 0
    text = " ".join(case.notes)
    for expected in ("inertia_3", "Fv6", "nearest in torque"):
        assert expected in text
    assert 0 < float(case.torque_change.square().mean().sqrt()) < 0.05
    # The printed box of link 7 excludes the true centre of mass.
    assert case.geometry == "normal_corrected"


@pytest.mark.nightly
@pytest.mark.parametrize("name", ROBOTS)
def test_torque_is_equal_by_pinocchio(name: str) -> None:
    found = drawn(name)
    robot, sets = found.setting.robot, found.family.sets
    motion = states(robot, 4)
    expected = PinocchioOracle(found.setting.reference.to_robot(robot, 0)).inverse_dynamics(*motion)
    expected = np.asarray(expected)
    for kind in KINDS:
        k = found.family.kind.index(kind)
        tau = np.asarray(PinocchioOracle(sets.to_robot(robot, k)).inverse_dynamics(*motion))
        scale = np.abs(expected).max()
        assert np.abs(tau - expected).max() < 1e-9 * scale
    relative = found.errors.torque_rms / found.errors.reference_moment_rms
    assert float(relative.max()) < 1e-9


@pytest.mark.nightly
@pytest.mark.parametrize("name", ROBOTS)
def test_forces_do_not_depend_on_the_inertias(name: str) -> None:
    found = drawn(name)
    robot = found.setting.robot
    motion = states(robot, 4)
    own = found.family.sets.parameters
    pi = own.pi.clone()
    pi[..., 4:] = found.setting.reference.parameters.pi[..., 4:]
    forces, others = (
        internal_wrenches(robot, *motion, p)[..., :3] for p in (own, InertialParameters(pi))
    )
    torch.testing.assert_close(forces, others, rtol=1e-12, atol=1e-12)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ROBOTS)
def test_at_rest_the_error_is_the_weight_of_the_carried_mass(name: str) -> None:
    case = setting(name)
    found = equal_torque_study(
        case.robot, setting=case, motion=at_rest(case.robot), kinds=("feasible", "inertia"),
        per_kind=10, chains=6, resamples=5,
    )  # fmt: skip
    mass = found.family.sets.parameters.mass - case.reference.parameters.mass
    for joint in range(case.robot.n):
        expected = GRAVITY * mass[:, joint:].sum(-1).abs()
        torch.testing.assert_close(found.errors.force_rms[:, joint], expected, rtol=1e-7, atol=1e-7)
        torch.testing.assert_close(found.carried[:, joint], mass[:, joint:].sum(-1))


def carried_by_linear_program(case: Setting, joint: int) -> float:
    """Largest |difference of the carried mass| [kg] over all sets with the reference's base
    parameters, masses and |J| within the outer bounds, centres of mass in their boxes and the total
    mass in its interval: written in (m, mc, J), without the null space."""
    n = case.robot.n
    grouping = case.base.grouping[:, : 10 * n].numpy()
    x0 = case.reference.parameters.to_paper_order()[0].numpy()
    rows, right = [], []
    for link in range(n):
        for axis in range(3):
            low, high = case.conditions.com_box[link, axis].tolist()
            for sign, edge in ((1, high), (-1, low)):
                row = np.zeros(10 * n)
                row[n + 3 * link + axis], row[link] = sign, -sign * edge
                rows.append(row)
                right.append(0.0)
    total = np.r_[np.ones(n), np.zeros(9 * n)]
    low, high = case.conditions.total_mass.tolist()
    rows += [total, -total]
    right += [high, -low]
    masses = [(0.0, float(m)) for m in case.outer.mass[:, 1]]
    inertia = case.outer.inertia.abs().amax(-1).T.flatten().tolist()
    limits = [*masses, *[(None, None)] * (3 * n), *[(-j, j) for j in inertia]]
    cost = np.zeros(10 * n)
    cost[joint:n] = 1.0
    best = 0.0
    for sign in (1.0, -1.0):
        found = linprog(
            sign * cost, A_ub=np.array(rows), b_ub=right, A_eq=grouping, b_eq=grouping @ x0,
            bounds=limits, method="highs",
        )  # fmt: skip
        assert found.status == 0
        best = max(best, abs(float(cost @ (found.x - x0))))
    return best


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4"])
def test_reach_at_rest_is_a_linear_program(name: str) -> None:
    """With inertias free and at rest, the greatest force is the weight of a linear program."""
    case = setting(name)
    space = equal_torque_space(case.reference, case.base, case.conditions, case.outer)
    squares = force_squares(case.robot, at_rest(case.robot), space.directions)
    found = force_reach(space, squares, ("inertia",))[0]
    for joint in range(case.robot.n):
        expected = GRAVITY * carried_by_linear_program(case, joint)
        assert float(found.reached[joint]) == pytest.approx(expected, rel=1e-4)
        assert float(found.bound[joint]) == pytest.approx(expected, rel=1e-4)


@pytest.mark.nightly
@pytest.mark.parametrize("name", SLOW_FOR_THE_LWR)
def test_no_drawn_set_exceeds_the_reach(name: str) -> None:
    found = drawn(name)
    reach = {r.kind: r for r in found.reach}
    kinds = np.array(found.family.kind)
    for kind in KINDS:
        errors = found.errors.force_rms[torch.from_numpy(kinds == kind)]
        assert bool((reach[kind].reached <= reach[kind].bound * (1 + 1e-6)).all())
        assert bool((errors <= reach[kind].bound * (1 + 1e-5) + 1e-6).all()), kind
        # What may be violated need not be: more is allowed, more is reached.
        assert bool((reach[kind].bound >= reach["feasible"].reached * (1 - 1e-4)).all())


@settings(max_examples=8, derandomize=True)
@given(seed=st.integers(0, 1000), letters=st.sampled_from(["RP", "PRR", "RPRR", "PPR", "RRRP"]))
def test_forces_along_prismatic_axes_are_known(seed: int, letters: str) -> None:
    """The torque of a prismatic joint is that force: no set with equal torque changes it."""
    robot = mixed_arm(letters, seed)
    rigid = base_parameters(robot, nominal_set(robot).effects)
    n = 10 * robot.n
    directions = InertialParameters.from_paper_order(kernel(rigid.grouping).T[:, :n].contiguous())
    errors = wrench_errors(
        robot,
        *states(robot, 6, seed=seed),
        directions,
        InertialParameters(torch.zeros(robot.n, 10, dtype=torch.float64)),
    )
    prismatic = [kind is JointType.PRISMATIC for kind in robot.joint_types]
    assert float(errors.torque_rms[:, prismatic].max()) < 1e-9


@pytest.mark.nightly
def test_study_answers_every_question_for_the_3r() -> None:
    found = study()
    assert found.kinds == KINDS
    assert float(found.torque_relative.max()) < 1e-9
    middle, low, high = found.static_share
    assert 0.9 < low <= middle <= high < 1.1
    assert {c.name for c in found.comparison.classes} == {
        "feasible", "inertia only", "CoM only", "total mass only",
    }  # fmt: skip
    pairs = [(e.first, e.second) for e in found.comparison.effects]
    assert ("CoM only", "inertia only") in pairs
    assert [c.kind for c in found.correlations] == list(KINDS)


def test_correlations_of_a_kind_are_those_of_its_sets() -> None:
    found = drawn("3r")
    for c in found.correlations:
        rows = found.rows(c.kind)
        expected = stats.spearmanr(found.degree[rows], found.worst[rows]).statistic
        assert c.degree.value == pytest.approx(expected)
        assert c.sets == len(rows)
        assert c.degree.low <= c.degree.value <= c.degree.high


@pytest.mark.nightly
def test_same_seed_same_study() -> None:
    again = equal_torque_study(load_robot("3r"), per_kind=24, chains=12, kinds=KINDS, resamples=50)
    assert again.plain() == study().plain()


def test_bad_requests_are_refused() -> None:
    with pytest.raises(TorchidError, match="include feasible"):
        equal_torque_study(load_robot("3r"), kinds=("com",))
    with pytest.raises(TorchidError, match="no bounds 'loose'"):
        equal_torque_setting(mixed_arm("RR", 0))
    case = setting("3r")
    with pytest.raises(TorchidError, match="one set"):
        given_sets(
            case.robot,
            case.nominal,
            drawn("3r").family.sets,
            case.conditions,
            reference_motion(case.robot),
        )


def test_given_sets_have_the_errors_of_their_wrenches() -> None:
    found = drawn("3r")
    case = found.setting
    motion = reference_motion(case.robot)
    sets = found.family.sets
    got = given_sets(case.robot, sets, case.nominal, case.conditions, motion, resamples=20)
    torch.testing.assert_close(got.errors.force_rms, found.errors.force_rms)
    record = given_record(got, ("sets.json",)).plain()
    assert record["schema"] == "torchid.wrenches/1"
    assert [s["id"] for s in record["sets"]] == list(sets.ids)
    assert record["sets"][0]["force_rms"] == got.errors.force_rms[0].tolist()
