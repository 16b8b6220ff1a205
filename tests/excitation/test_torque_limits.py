"""Torque limits of planned motions, against Pinocchio, regressors and closed forms."""

import math
import re
from dataclasses import replace

import pytest
import torch

from tests.arms import mixed_arm
from tests.excitation.test_design import prior_in
from tests.excitation.usage import full_design, limit_usage
from tests.marks import some
from tests.oracles import PinocchioOracle
from torchid.effects.friction import CoulombFriction, ViscousFriction
from torchid.effects.registry import on_every_joint
from torchid.errors import RobotError
from torchid.excitation.design import base_regressor, design_for
from torchid.excitation.limits import motion_limits
from torchid.excitation.torque import identified_torque_limits, nominal_torque_limits
from torchid.excitation.trajectories import random_trajectory, sinusoid, trajectory_log
from torchid.identification.base_parameters import base_parameters
from torchid.log.readers import read_log, write_log
from torchid.next_motion.planned import plan
from torchid.next_motion.rows import Setting
from torchid.next_motion.separating_motion import design_separation
from torchid.next_motion.separation import Explanation, Rival
from torchid.next_motion.settings import MotionSettings
from torchid.robot.library import load_robot
from torchid.robot.model import Limits

FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")


def bounds(values):
    """(n, 2) of symmetric limits, or of pairs."""
    pairs = [v if isinstance(v, tuple) else (-v, v) for v in values]
    return torch.tensor(pairs, dtype=torch.float64)


def limited(name, torque):
    if name.startswith("mixed_"):
        robot = mixed_arm(name.removeprefix("mixed_"))
        n = robot.n
        robot = replace(
            robot, limits=Limits(bounds([1.5] * n), bounds([1.5] * n), bounds([5.0] * n))
        )
    else:
        robot = load_robot(name)
    return replace(robot, limits=replace(robot.limits, torque=bounds(torque)))


LIMITED = {
    "3r": [0.3, 2.0, 0.5],
    "3r_friction": [0.6, 3.0, 0.8],
    "kuka_lwr4": [5, 25, 8, 9, 0.2, 0.1, math.inf],
    "kuka_lwr4_friction": [5, 30, 8, 9, 0.6, 0.4, 0.4],
    "mixed_RPR": [(-10.0, 14.0), 14, 1.5],
    "mixed_PRP": [40, 9, 9],
}
"""What no random motion that fills the limits of motion keeps; joint 1 of PRP carries 31.6 N."""


@pytest.fixture(params=list(LIMITED))
def robot(request):
    return limited(request.param, LIMITED[request.param])


def expected_torque(robot, motion):
    """Pinocchio's, and friction in closed form."""
    tau = PinocchioOracle(robot).inverse_dynamics(motion.q, motion.dq, motion.ddq)
    for record in robot.effects:
        j = record["joint"] - 1
        dq = motion.dq[:, j]
        tau[:, j] += record.get("Fv", 0.0) * dq + record.get("Fc", 0.0) * dq.sign()
        tau[:, j] += record.get("F0", 0.0)
    return tau


def share(robot, tau):
    """Of the limit, whichever side is nearer (n,)."""
    return (tau / robot.limits.torque[:, 1]).maximum(tau / robot.limits.torque[:, 0]).amax(0)


@pytest.mark.parametrize("usage", some([0.9, 1.0], 1))
def test_the_written_trajectory_keeps_them(robot, usage, tmp_path):
    assert {r["effect"] for r in robot.effects} <= set(FRICTION)
    start = random_trajectory(robot, 0, fill=True, usage=usage)
    assert float(share(robot, expected_torque(robot, start.sample(50.0))).max()) > usage
    made = full_design(
        robot, on_every_joint(FRICTION, robot.n), seed=0, restarts=2, iterations=30, usage=usage
    )
    write_log(trajectory_log(made.trajectory, 237.0), tmp_path / "motion.csv")
    own = share(robot, expected_torque(robot, read_log(tmp_path / "motion.csv")))
    assert float(own.max()) < usage
    said = made.torque.use([made.trajectory])
    torch.testing.assert_close(said.share, own, rtol=0.01, atol=0.001)
    used = limit_usage(made.trajectory.extremes(), motion_limits(robot, usage=usage))
    assert float(used.max()) <= 1.0
    assert made.condition_after <= min(made.condition_before)


@pytest.mark.parametrize("plan", [random_trajectory, sinusoid])
def test_a_motion_is_drawn_to_rest_no_further_than_needed(robot, plan):
    torque = nominal_torque_limits(robot)
    full = plan(robot, 1)
    done = torque.within(full)
    own = share(robot, expected_torque(robot, done.sample(200.0)))
    assert float(own.max()) < 1.0
    if done is not full:
        assert float(own.max()) > 0.97
    part = full.towards(torque.rest, torch.tensor(0.3, dtype=torch.float64)).sample(50.0)
    whole = full.sample(50.0)
    torch.testing.assert_close(part.q, torque.rest + 0.3 * (whole.q - torque.rest))
    torch.testing.assert_close(part.dq, 0.3 * whole.dq)
    torch.testing.assert_close(part.ddq, 0.3 * whole.ddq)


def test_a_motion_within_them_stays_as_it_is(robot):
    torque = nominal_torque_limits(robot)
    many = random_trajectory(robot, 0, count=3)
    small = torque.within(many)
    assert torque.within(small) is small
    alone = torque.within(many.select(1))
    torch.testing.assert_close(alone.a, small.a[1])
    torch.testing.assert_close(alone.q0, small.q0[1])


@pytest.mark.parametrize(
    ("name", "limits", "joint", "gravity"),
    [("mixed_PRP", [20, 90, 90], 1, True), ("3r_friction", [9, 9, 0.1], 3, False)],
)
def test_limits_that_gravity_or_friction_exceed_are_an_error(name, limits, joint, gravity):
    robot = limited(name, limits)
    with pytest.raises(RobotError, match=f"no motion keeps the torque limit of joint {joint}") as e:
        full_design(robot, seed=0, restarts=1, iterations=1)
    assert f"of a limit of {limits[joint - 1]:g}" in e.value.expected
    if gravity:  # of a sliding first joint: the whole arm's weight along its axis, in any posture
        axis = robot.before[0, :3, :3][:, 2]
        weight = float(robot.parameters.mass.sum() * (robot.gravity @ axis).abs())
        assert f"{weight:.4g} N for gravity alone" in e.value.got
    else:
        friction = [r["Fc"] for r in robot.effects if r["joint"] == joint and "Fc" in r]
        whole = float(re.search("([0-9.]+) with friction", e.value.got)[1])
        assert whole >= friction[0] > limits[joint - 1]


def test_limits_without_0_are_refused():
    with pytest.raises(RobotError, match="do not contain 0"):
        nominal_torque_limits(limited("3r", [1, (0.5, 2.0), 1]))


def test_without_limits_or_parameters_the_design_is_the_same():
    robot = limited("3r", LIMITED["3r"])
    free = replace(robot, limits=replace(robot.limits, torque=None))
    infinite = limited("3r", [math.inf] * 3)
    made = [
        full_design(r, seed=0, restarts=2, iterations=5)
        for r in (free, replace(robot, parameters=None), infinite, robot)
    ]
    assert [m.torque is None for m in made] == [True, True, True, False]
    # Without parameters rows still count by the limits.
    assert torch.equal(made[0].trajectory.coefficients, made[2].trajectory.coefficients)
    assert torch.equal(made[0].trajectory.q0, made[2].trajectory.q0)


def test_the_next_motion_keeps_them_by_what_was_identified(tmp_path):
    robot = limited("3r_friction", LIMITED["3r_friction"])
    prior = prior_in(tmp_path, robot, 10, blocks=1000)
    # An arm that needs more: the nominal parameters would not tell.
    prior = replace(prior, values=1.7 * prior.values)
    found = design_for(robot, prior, seed=0, restarts=2, iterations=20, duration=8.0)
    for trajectory in (found.trajectory, found.plain):
        motion = trajectory.sample(200.0)
        tau = base_regressor(robot, prior.base, motion, effects=prior.effects) @ prior.values
        assert float(share(robot, tau.reshape(-1, robot.n)).max()) < 1.0
    assert "identified" in found.torque.source

    unknown = replace(prior, known=torch.zeros_like(prior.known))
    torque = identified_torque_limits(robot, unknown)
    assert "not determined: nominal" in torque.source
    fitted = tuple(r for r in robot.effects if r["effect"] != "torque_offset")
    nominal = nominal_torque_limits(replace(robot, effects=fitted)).use([found.trajectory])
    torch.testing.assert_close(torque.use([found.trajectory]).share, nominal.share)


def test_a_slow_run_has_the_path_of_the_full_one():
    """Which torque of inertia makes smaller than it would have to be at that speed."""
    robot = limited("3r", [0.2, 90.0, 90.0])
    whole, slow = (
        plan(robot, MotionSettings(kind="random", duration=8.0, speed=speed)).motions[0]
        for speed in (1.0, 0.25)
    )
    t = torch.linspace(0, 8, 50, dtype=torch.float64)
    torch.testing.assert_close(slow.at(4 * t).q, whole.at(t).q, atol=1e-6, rtol=0)
    full = random_trajectory(robot, 0, fill=True, usage=0.7, duration=8.0)
    assert float((full.at(t).q - whole.at(t).q).abs().max()) > 0.1


@pytest.mark.nightly
def test_a_separating_motion_keeps_them_by_the_corrected_model():
    robot = limited("3r", LIMITED["3r"])
    given = (ViscousFriction(1), [0.5])
    noise = torch.full((3,), 0.1, dtype=torch.float64)
    setting = Setting(robot, (given,), base_parameters(robot), noise, 20.0, 8.0)
    pair = Rival(Explanation((CoulombFriction(1),), (0.5,)), ((ViscousFriction(1),),), "viscous")
    plain = random_trajectory(robot, 1, fill=True, duration=8.0)
    found = design_separation(setting, [pair], plain, seed=0, evaluations=48)
    for trajectory in (found.trajectory, found.plain):
        motion = trajectory.sample(200.0)
        tau = expected_torque(robot, motion)
        tau[:, 1] += 0.5 * motion.dq[:, 1]
        assert float(share(robot, tau).max()) < 1.0
