"""Separation of two explanations, against an ordinary least-squares fit of each."""

import json
from dataclasses import replace
from itertools import permutations

import pytest
import torch

from tests.excitation.usage import limit_usage
from tests.gap_files import found as found_effect
from tests.gap_files import hidden, open_gap
from torchid.dynamics.regressor import regressor
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import AsymmetricFriction, StribeckFriction
from torchid.effects.gravity import EncoderOffset
from torchid.effects.inertia import Payload
from torchid.errors import TorchidError
from torchid.excitation.limits import motion_limits
from torchid.excitation.trajectories import random_trajectory
from torchid.gap.record import GapRecord
from torchid.identification.base_parameters import base_parameters
from torchid.log.filtering import ZeroPhaseFilter
from torchid.next_motion.ambiguity import open_questions, rivals
from torchid.next_motion.rows import RATE, Rows, Setting
from torchid.next_motion.separating_motion import Separation, design_separation
from torchid.next_motion.separation import (
    DECISIVE,
    SAME_SHARE,
    Discrimination,
    Explanation,
    Rival,
    _in_blocks,
    imitation,
    separations,
)
from torchid.report.motion import separation_verdict
from torchid.results.record import decode, robot_record
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot

EDGE = round(3 * RATE / 8.0)
"""Samples left out at both ends: three periods of the cut-off."""

FLOOR = {"low": [1e-9] * 3, "high": [0.4] * 3, "source": "bracket"}
"""Noise of a log that repeats nothing."""

NOISE = torch.tensor([0.5, 0.4, 0.2], dtype=torch.float64)


@pytest.fixture(scope="module")
def robot():
    return load_robot("3r")


@pytest.fixture(scope="module")
def setting(robot):
    return Setting(robot, (), base_parameters(robot), NOISE, 20.0, 8.0)


def fitted_difference(setting, truth, others, trajectory, *, base=True):
    """|| residual ||^2 / sigma^2 of a noiseless torque of `truth` fitted with base parameters and
    `others`, by lstsq on filtered rows; every sample at RATE / 2 worth 2 x 20 Hz of noise."""
    motion = trajectory.sample(RATE)
    low = ZeroPhaseFilter(RATE, 8.0)

    def rows(columns):
        x = low.apply(columns.permute(2, 1, 0).contiguous())[..., EDGE : len(motion.t) - EDGE : 2]
        return (x / NOISE.unsqueeze(-1)).flatten(1).T

    z = rows(regressor(setting.robot, *motion.state))
    parts = [z[:, z.norm(dim=0) > 1e-9]] if base else []
    a = torch.cat([*parts, *(rows(o.torque_columns(motion)) for o in others)], 1)
    a = a / a.norm(dim=0)
    y = rows(truth[0].torque_columns(motion)) @ torch.tensor(truth[1], dtype=torch.float64)
    x = torch.linalg.lstsq(a, y.unsqueeze(-1), driver="gelsd").solution
    return float((y - (a @ x).flatten()).square().sum()) * 2 * 20.0 / (RATE / 2)


def pair(effect, values, *others, **leaving):
    truth = Explanation((effect,), tuple(values))
    return Rival(truth, tuple((o,) for o in others), others[0].name if others else "", **leaving)


PAIRS = [
    ((CoulombFriction(1), [0.5]), ViscousFriction(1)),
    ((ViscousFriction(0), [0.7]), CoulombFriction(0)),
    ((StribeckFriction(2, vs=0.1), [0.4]), CoulombFriction(2)),
    ((TorqueOffset(1), [1.0]), AsymmetricFriction(1)),
]


@pytest.mark.parametrize(("truth", "other"), PAIRS)
def test_separation_is_what_a_fit_of_the_wrong_one_leaves(robot, setting, truth, other):
    trajectory = random_trajectory(robot, 3, fill=True)
    found = separations(setting, [pair(*truth, other)], trajectory)[0].difference
    assert found == pytest.approx(fitted_difference(setting, truth, [other], trajectory), rel=1e-3)
    assert found > 0


@pytest.mark.parametrize(("truth", "other"), PAIRS)
def test_what_else_was_accepted_is_fitted_too_and_trusted_parameters_are_not(robot, truth, other):
    """Beside another accepted effect, and never beside the one in whose place both are."""
    more = (StribeckFriction(truth[0].joint, vs=0.4),)
    setting = Setting(
        robot, (), base_parameters(robot), NOISE, 20.0, 8.0, False, (more, (truth[0],))
    )
    trajectory = random_trajectory(robot, 3, fill=True)
    rival = pair(*truth, other, leaving=(truth[0],))
    found = separations(setting, [rival], trajectory)[0].difference
    expected = fitted_difference(setting, truth, [other, *more], trajectory, base=False)
    assert found == pytest.approx(expected, rel=1e-3)
    against_links = Rival(rival.truth, (), "link_inertia", rival.leaving)
    found = separations(setting, [against_links], trajectory)[0].difference
    expected = fitted_difference(setting, truth, more, trajectory)
    assert found == pytest.approx(expected, rel=1e-3)


def test_an_effect_is_not_separated_from_itself(robot, setting):
    trajectory = random_trajectory(robot, 3, fill=True)
    own = CoulombFriction(1)
    assert separations(setting, [pair(own, [2.0], own)], trajectory)[0].difference < 1e-9


def test_a_decision_needs_more_than_noise_and_more_than_a_share(robot, setting):
    """A large effect is told from another by residuals that a small one does not have, but by no
    larger share of what it explains."""
    trajectory = random_trajectory(robot, 3, fill=True)
    small, large = (
        separations(setting, [pair(CoulombFriction(1), [v], ViscousFriction(1))], trajectory)[0]
        for v in (0.1, 1e4)
    )
    assert large.difference == pytest.approx(1e10 * small.difference)
    own = separations(setting, [pair(CoulombFriction(1), [1e4])], trajectory)[0].difference
    assert large.reached <= large.difference / own / SAME_SHARE < 1e-4 * large.difference / DECISIVE
    assert 0 < small.reached < small.difference / DECISIVE


def test_what_is_told_all_the_time_decides_more_than_what_is_told_once():
    even, once = torch.full((400,), 0.1, dtype=torch.float64), torch.zeros(400, dtype=torch.float64)
    once[40:60] = 2.0
    assert _in_blocks(even, 0) == pytest.approx(40 / DECISIVE)
    assert _in_blocks(once, 0) < 0.25 * _in_blocks(even, 0)
    assert _in_blocks(even, 20) == pytest.approx(10 / DECISIVE)
    assert _in_blocks(even, 60) == 0


def test_the_least_favourable_shape_counts(robot, setting):
    trajectory = random_trajectory(robot, 3, fill=True)
    truth = StribeckFriction(1, vs=0.1), [0.5]
    shapes = [StribeckFriction(1, vs=v) for v in (0.05, 0.1, 0.3)]
    alone = [separations(setting, [pair(*truth, s)], trajectory)[0].difference for s in shapes]
    together = separations(setting, [pair(*truth, *shapes)], trajectory)[0].difference
    assert together == pytest.approx(min(alone), abs=1e-9)
    rows = Rows(setting, trajectory)
    found = imitation(rows, Explanation((truth[0],), (0.5,)), [(s,) for s in shapes])
    assert found.effect.vs == 0.1
    assert found.values == pytest.approx([0.5], rel=1e-6)


def test_the_rival_is_as_large_as_the_truth(robot, setting):
    rows = Rows(setting, random_trajectory(robot, 3, fill=True))
    truth = Explanation((CoulombFriction(1),), (0.5,))
    found = imitation(rows, truth, [(ViscousFriction(1),)])
    sizes = [
        rows.beside(rows.columns(e.effects) @ torch.tensor(e.values).double()).norm()
        for e in (truth, found)
    ]
    assert float(sizes[0]) == pytest.approx(float(sizes[1]))
    assert found.values[0] > 0


@pytest.mark.slow
def test_the_design_separates_more_within_the_limits(robot, setting):
    plain = random_trajectory(robot, 1, fill=True, duration=8.0)
    pairs = [
        pair(StribeckFriction(1, vs=0.1), [0.5], CoulombFriction(1)),
        pair(CoulombFriction(1), [0.5], StribeckFriction(1, vs=0.1)),
    ]
    found = design_separation(setting, pairs, plain, seed=0, evaluations=80)
    before, after = (min(t.reached for t in x) for x in (found.with_plain, found.after))
    assert after > 1.3 * before
    assert float(limit_usage(found.trajectory.extremes(), motion_limits(robot)).max()) <= 1.0
    again = design_separation(setting, pairs, plain, seed=0, evaluations=80)
    assert torch.equal(again.trajectory.a, found.trajectory.a)


@pytest.mark.slow
def test_no_search_for_what_the_plain_motion_decides(robot, setting, monkeypatch):
    """And half of one where the plain motion is hardly beaten by then."""
    plain = random_trajectory(robot, 1, fill=True, duration=8.0)

    def done(*pairs):
        seen = []
        found = design_separation(
            setting, pairs, plain, seed=0, evaluations=160, progress=lambda k, _: seen.append(k)
        )
        return seen[-1], found.hardly

    large = pair(CoulombFriction(1), [5.0], ViscousFriction(1))
    assert done(large) == (33, True)
    close = pair(StribeckFriction(1, vs=0.1), [0.005], CoulombFriction(1))
    assert done(close) == (160, False)
    monkeypatch.setattr("torchid.next_motion.separating_motion._hardly", lambda *told: True)
    assert done(close) == (97, True)


def test_what_no_motion_settles_is_refused_with_what_would(robot, setting):
    """A payload is part of the base parameters; the zero of a vertical first joint changes no
    torque at all."""
    plain = random_trajectory(robot, 1, fill=True, duration=8.0)
    lost = [pair(Payload(), [1.0] + [0.0] * 9), pair(EncoderOffset(0), [0.1])]
    with pytest.raises(TorchidError, match="no motion settles") as caught:
        design_separation(setting, lost, plain, seed=0, evaluations=20)
    assert caught.value.got == "payload; encoder_offset of joint 1"
    assert "weigh the load" in caught.value.hint
    assert "encoder_offset: measure the pose" in caught.value.hint
    seen = pair(ViscousFriction(1), [1.0])
    found = design_separation(setting, [*lost, seen], plain, seed=0, evaluations=20)
    assert found.rivals == (seen,)
    assert found.hopeless == tuple(lost)
    said = separation_verdict(found, "not_testable")
    assert "No motion tried settles payload; encoder_offset of joint 1" in said


@pytest.mark.parametrize(
    ("kind", "told", "of_plain", "said"),
    [
        ("not_testable", [2.0, 1.5], [0.1, 1.5],
         "Drive this motion: of 2 causes that the log could not have shown this one shows 2, where "
         "a cause is a tenth of the joint's torque: viscous friction of joint 2 and coulomb "
         "friction of joint 1; a plain exciting motion of the same length 1."),
        ("not_testable", [0.1, 0.1], [0.1, 0.1], "Drive another motion: of 2 causes"),
        ("ambiguity", [0.4, 1.5], [0.1, 1.5],
         "Drive this motion: it is expected to settle 1 of 2 questions about viscous friction and "
         "Coulomb friction, a plain exciting motion of the same length 1. The hardest, "
         "viscous_friction, joint 2, takes 3 drives."),
        ("ambiguity", [0.01, 1.5], [0.01, 1.5],
         "It will hardly settle viscous_friction, joint 2."),
        ("ambiguity", [1.0, 1.5], [1.0, 1.5], "Drive this motion, or a plain one: it is expected "
         "to settle 2 of 2 questions"),
    ],
)  # fmt: skip
def test_what_to_drive_is_said_first(robot, kind, told, of_plain, said):
    motion = random_trajectory(robot, 1, fill=True, duration=8.0)
    pairs = (pair(ViscousFriction(1), [1.0]), pair(CoulombFriction(0), [1.0]))
    numbers = [tuple(Discrimination(DECISIVE * x, x) for x in both) for both in (of_plain, told)]
    found = Separation(
        trajectory=motion, plain=motion, rivals=pairs, with_plain=numbers[0], after=numbers[1],
        hopeless=(),
    )  # fmt: skip
    assert said in separation_verdict(found, kind)


def left_open(model, robot=None, **changes):
    """What a diagnosis by hand leaves open, as it would be read from its file."""
    data = json.dumps(open_gap(model, **changes)).encode()
    return open_questions(decode(data, GapRecord, "gap.json"), robot or model, "gap.json")


def test_pairs_of_a_diagnosis(robot):
    found = left_open(robot)
    assert found.kind == "ambiguity"
    torch.testing.assert_close(found.setting.noise, torch.full((3,), 0.2, dtype=torch.float64))
    assert not found.setting.free
    assert found.setting.fitted == ((StribeckFriction(1, vs=0.1),),)
    assert found.notes == (
        "contact or stribeck_friction is no matter of motion; contact: repeat the motion away "
        "from obstacles",
    )
    plain = random_trajectory(robot, 1, fill=True, duration=8.0)
    pairs = rivals(found, plain)
    members = ("stribeck_friction", "coulomb_friction", "link_inertia")
    assert [(r.truth.effect.name, r.name) for r in pairs] == list(permutations(members, 2))
    assert pairs[0].truth.effect == StribeckFriction(1, vs=0.1)
    assert all((r.others == ()) == (r.name == "link_inertia") for r in pairs)
    assert all(r.leaving == (StribeckFriction(1, vs=0.1),) for r in pairs)


def test_without_repeats_the_noise_is_the_upper_bound_and_a_background_is_fitted(robot):
    settings = {"background": ["viscous_friction"], "parameters": "free", "refitted": True}
    found = left_open(robot, noise_floor=FLOOR, settings=settings)
    torch.testing.assert_close(found.setting.noise, torch.full((3,), 0.4, dtype=torch.float64))
    assert found.setting.free
    assert (ViscousFriction(2),) in found.setting.fitted
    unseen = [hidden("viscous_friction", 3)]
    with pytest.raises(TorchidError, match="leaves nothing open"):
        left_open(robot, which=[], settings=settings, not_testable=unseen)


def test_an_effect_common_to_all_joints_and_a_link(robot):
    heavier = robot.with_parameters(
        InertialParameters(robot.parameters.pi + 0.1 * torch.eye(3, 10, dtype=torch.float64))
    )
    which = [
        found_effect("time_delay", 1, 3, common=True, parameters={"delay": 0.01},
                     ambiguous_with=["filter_lag", "torque_gain"]),
        found_effect("link_inertia", 2, ambiguous_with=["joint_spring", "payload"],
                     parameters={"links": [2]}),
    ]  # fmt: skip
    found = left_open(robot, which=which, corrected=robot_record(heavier))
    delay, _, link = (q.truth for q in found.questions)
    assert [e.joints for e in delay.effects] == [(0,), (1,), (2,)]
    assert link.effect.joints == (1,)
    assert link.values == pytest.approx([0, 0.1] + [0] * 8)
    assert found.notes == (
        "link_inertia or payload is no matter of motion; link_inertia: weigh the load, or compare "
        "the link's parameters with CAD",
    )
    pairs = rivals(found, random_trajectory(robot, 1, fill=True, duration=8.0))
    assert any(len(g) == 3 for r in pairs if r.name == "torque_gain" for g in r.others)


def test_untestable_effects_are_asked_for_at_a_tenth_of_the_torque(robot):
    found = left_open(
        robot,
        which=[],
        status="not_testable",
        not_testable=[
            hidden("viscous_friction", 3, 0.4),
            hidden("joint_spring", 1),
            hidden("encoder_offset", 1),
            hidden("contact", None, 1.0),
        ],
    )
    assert found.kind == "not_testable"
    plain = random_trajectory(robot, 1, fill=True, duration=8.0)
    pairs = rivals(found, plain)
    assert [(r.truth.effect.name, r.truth.effect.joints) for r in pairs] == [
        ("viscous_friction", (2,)),
        ("joint_spring", (0,)),
        ("encoder_offset", (0,)),
    ]
    rows = Rows(found.setting, plain)
    own = rows.columns(pairs[0].truth.effects)[:, 0] * pairs[0].truth.values[0]
    assert float(own.norm()) == pytest.approx(0.1 * float(rows.torque[2].norm()))
    assert pairs[2].truth.values == (0.35,)  # its largest plausible size


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"which": []}, "(?s)leaves nothing open.*has one name.*no effect found"),
        ({"which": [found_effect("contact", 1, ambiguous_with=["saturation"])]},
         "(?s)no motion settles.*contact of joint"),
        ({"which": [], "status": "detected_unexplained", "noise_floor": FLOOR},
         "(?s)drive one trajectory twice"),
        ({"which": [], "status": "detected_unexplained"}, "no effect found$"),
    ],
)  # fmt: skip
def test_diagnoses_that_ask_for_no_motion(robot, changes, match):
    with pytest.raises(TorchidError, match=match):
        left_open(robot, **changes)


def test_a_diagnosis_of_another_robot_is_refused(robot):
    other = replace(
        robot, before=robot.before + 0.1 * torch.eye(4, dtype=torch.float64), name="other"
    )
    for wrong in (load_robot("kuka_lwr4"), other):
        with pytest.raises(TorchidError, match="is of another robot"):
            left_open(robot, wrong)
