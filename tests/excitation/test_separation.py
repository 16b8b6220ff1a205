"""Separation of two explanations, against an ordinary least-squares fit of each."""

import math

import pytest
import torch

from torchid.dynamics.regressor import regressor
from torchid.effects.base import Motion
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import AsymmetricFriction, StribeckFriction
from torchid.effects.inertia import Payload
from torchid.errors import TorchidError
from torchid.excitation.ambiguity import read_open, rivals
from torchid.excitation.limits import limit_usage, motion_limits
from torchid.excitation.separation import (
    RATE,
    Rival,
    Setting,
    design_separation,
    imitation,
    separations,
)
from torchid.excitation.trajectories import random_trajectory
from torchid.identification.base_parameters import base_parameters
from torchid.log.filtering import ZeroPhaseFilter
from torchid.robot.library import load_robot
from torchid.robot.record import robot_record

NOISE = torch.tensor([0.5, 0.4, 0.2], dtype=torch.float64)


@pytest.fixture(scope="module")
def robot():
    return load_robot("3r")


@pytest.fixture(scope="module")
def setting(robot):
    return Setting(robot, (), base_parameters(robot), NOISE, 20.0, 8.0)


def fitted_difference(setting, truth, other, trajectory):
    """|| residual ||^2 / sigma^2 of a noiseless torque of `truth` fitted with base parameters and
    `other`, by lstsq on filtered rows; every sample at RATE / 2 worth 2 x 20 Hz of noise."""
    s = trajectory.sample(RATE)
    motion = Motion(s.q, s.dq, s.ddq, t=s.t)
    low = ZeroPhaseFilter(RATE, 8.0)

    def rows(columns):
        x = low.apply(columns.permute(2, 1, 0).contiguous())[..., ::2]
        return (x / NOISE.unsqueeze(-1)).flatten(1).T

    z = rows(regressor(setting.robot, *motion.state))
    a = torch.cat([z[:, z.norm(dim=0) > 1e-9], rows(other.torque_columns(motion))], 1)
    a = a / a.norm(dim=0)
    y = rows(truth[0].torque_columns(motion)) @ torch.tensor(truth[1])
    x = torch.linalg.lstsq(a, y.unsqueeze(-1), driver="gelsd").solution
    return float((y - (a @ x).flatten()).square().sum()) * 2 * 20.0 / (RATE / 2)


@pytest.mark.parametrize(
    ("truth", "other"),
    [
        ((CoulombFriction(1), [0.5]), ViscousFriction(1)),
        ((ViscousFriction(0), [0.7]), CoulombFriction(0)),
        ((StribeckFriction(2, vs=0.1), [0.4]), CoulombFriction(2)),
        ((TorqueOffset(1), [1.0]), AsymmetricFriction(1)),
    ],
)
def test_separation_is_what_a_fit_of_the_wrong_one_leaves(robot, setting, truth, other):
    trajectory = random_trajectory(robot, 3, fill=True)
    found = separations(setting, [Rival(truth, (other,), other.name)], trajectory)[0]
    expected = fitted_difference(setting, truth, other, trajectory)
    assert found == pytest.approx(expected, rel=1e-3)
    assert found > 0


def test_an_effect_is_not_separated_from_itself(robot, setting):
    trajectory = random_trajectory(robot, 3, fill=True)
    own = CoulombFriction(1)
    assert separations(setting, [Rival((own, [2.0]), (own,), "itself")], trajectory)[0] < 1e-9


def test_the_least_favourable_shape_counts(robot, setting):
    trajectory = random_trajectory(robot, 3, fill=True)
    truth = (StribeckFriction(1, vs=0.1), [0.5])
    shapes = [StribeckFriction(1, vs=v) for v in (0.05, 0.1, 0.3)]
    alone = [separations(setting, [Rival(truth, (s,), "")], trajectory)[0] for s in shapes]
    together = separations(setting, [Rival(truth, tuple(shapes), "")], trajectory)[0]
    assert together == pytest.approx(min(alone), abs=1e-9)
    found = imitation(setting, truth, shapes, trajectory)
    assert found[0].vs == 0.1
    assert found[1] == pytest.approx([0.5], rel=1e-6)


def test_the_design_separates_more_within_the_limits(robot, setting):
    plain = random_trajectory(robot, 1, fill=True, duration=8.0)
    pair = Rival((StribeckFriction(1, vs=0.1), [0.5]), (CoulombFriction(1),), "coulomb_friction")
    back = Rival((CoulombFriction(1), [0.5]), (StribeckFriction(1, vs=0.1),), "stribeck_friction")
    found = design_separation(setting, [pair, back], plain, seed=0, evaluations=80)
    assert min(found.after) >= min(found.with_plain)
    assert min(found.after) > 1.3 * min(found.with_plain)
    assert float(limit_usage(found.trajectory.extremes(), motion_limits(robot)).max()) <= 1.0
    again = design_separation(setting, [pair, back], plain, seed=0, evaluations=80)
    assert torch.equal(again.trajectory.a, found.trajectory.a)


def test_what_no_motion_separates_is_refused(robot, setting):
    """A payload is part of the base parameters."""
    pair = Rival((Payload(), [1.0] + [0.0] * 9), (), "all_base")
    plain = random_trajectory(robot, 1, fill=True, duration=8.0)
    with pytest.raises(TorchidError, match="no motion tried separates"):
        design_separation(setting, [pair], plain, seed=0, evaluations=20)


def diagnosis(robot, **changes):
    """The keys of a torchid.gap/1 record that a design reads."""
    entry = {
        "effect": "stribeck_friction",
        "joints": [2],
        "ambiguous_with": ["coulomb_friction", "link_inertia"],
        "parameters": {"Fs": 0.5, "vs": 0.1, "d": 2.0},
    }
    return {
        "schema": "torchid.gap/1",
        "status": "explained",
        "which": [entry],
        "not_testable": [],
        "noise_floor": {"low": [0.1] * 3, "high": [0.4] * 3},
        "band_hz": 20.0,
        "cutoff_hz": 8.0,
        "corrected": robot_record(robot),
        **changes,
    }


def test_pairs_of_a_diagnosis(robot, tmp_path):
    found = read_open(tmp_path, diagnosis(robot), None)
    assert found.kind == "ambiguity"
    torch.testing.assert_close(found.setting.noise, torch.full((3,), 0.2))
    plain = random_trajectory(robot, 1, fill=True, duration=8.0)
    pairs = rivals(found, plain)
    assert [(r.truth[0].name, r.name) for r in pairs] == [
        ("stribeck_friction", "coulomb_friction"),
        ("coulomb_friction", "stribeck_friction"),
        ("stribeck_friction", "link_inertia"),
    ]
    assert pairs[0].truth[0] == StribeckFriction(1, vs=0.1)
    assert pairs[2].others == ()


def test_untestable_effects_of_a_diagnosis(robot, tmp_path):
    data = diagnosis(
        robot,
        which=[],
        status="not_testable",
        not_testable=[
            {"effect": "viscous_friction", "joint": 3, "smallest_detectable": 0.4},
            {"effect": "joint_spring", "joint": 1, "smallest_detectable": None},
            {"effect": "contact", "joint": None, "smallest_detectable": 1.0},
        ],
    )
    found = read_open(tmp_path, data, None)
    assert found.kind == "not_testable"
    assert [(p[0][0].name, p[0][0].joints) for p in found.pairs] == [
        ("viscous_friction", (2,)),
        ("joint_spring", (0,)),
    ]
    assert found.pairs[0][0][1] == [0.4]
    assert all(math.isfinite(v) for (_, values), _ in found.pairs for v in values)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"which": []}, "leaves nothing open"),
        ({"corrected": None}, "corrected model"),
        ({"noise_floor": {}}, "not a complete diagnosis"),
    ],
)
def test_diagnoses_that_ask_for_no_motion(robot, tmp_path, changes, match):
    with pytest.raises(TorchidError, match=match):
        read_open(tmp_path, diagnosis(robot, **changes), None)
