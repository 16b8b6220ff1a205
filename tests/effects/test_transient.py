"""Clipped torque, contact forces and held samples."""

from dataclasses import replace

import pytest
import torch

from tests.arms import QUICK_ARMS, arm
from tests.effects.exact_logs import smooth_motion
from tests.oracles import PinocchioOracle
from torchid.dynamics.forward import gravity_torque
from torchid.effects.transient import RAMP, Contact, DroppedSamples, Saturation
from torchid.errors import RobotError
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import link_poses
from torchid.robot.placement import pose


def test_hard_clip_is_a_clamp() -> None:
    motion = smooth_motion(arm("panda"), 300)
    assert motion.torque is not None
    limit = float(motion.torque[:, 1].abs().quantile(0.7))
    clipped = Saturation(1, limit).measured(motion, [1.0]).torque
    expected = motion.torque.clone()
    expected[:, 1].clamp_(-limit, limit)
    assert clipped is not None
    torch.testing.assert_close(clipped, expected)
    column = Saturation(1, limit).torque_columns(motion)[..., 0]
    torch.testing.assert_close(motion.torque + column, expected)


@pytest.mark.parametrize("name", ["panda", "ur10e", "3r"])
def test_contact_of_a_link_is_felt_before_it_and_not_behind(name: str) -> None:
    """Half way along a link: J' from central differences of the mean of its two joints' origins."""
    robot = arm(name)
    motion = smooth_motion(robot, 20)
    k = robot.n - 2
    columns = Contact(tip=robot.link_names[k], along=0.5).torque_columns(motion, robot)

    def middle(q: torch.Tensor) -> torch.Tensor:
        link = link_poses(robot, q)[:, k]
        ends = (pose[:3, 3] for pose in (torch.linalg.inv(robot.after[k]), robot.before[k + 1]))
        return link[:, :3, 3] + link[:, :3, :3] @ sum(ends) / 2

    h = 1e-6
    for j in range(robot.n):
        step = torch.zeros(robot.n, dtype=torch.float64)
        step[j] = h
        moved = (middle(motion.q + step) - middle(motion.q - step)) / (2 * h)
        torch.testing.assert_close(columns[:, j], moved, rtol=1e-6, atol=1e-8)
    assert not columns[:, k + 1 :].any()


def test_contact_moves_along_its_link() -> None:
    near = Contact(4.0, 5.0, "link_3", 0.9).around(0, 0.05)
    assert {c.along for c in near} == {0.9, 0.65}  # not beyond the next joint
    assert all(c.tip == "link_3" for c in near)


def test_a_contact_of_a_link_that_is_not_there_is_refused() -> None:
    robot = arm("3r")
    with pytest.raises(RobotError, match="no such link"):
        Contact(tip="elbow", along=0.5).torque_columns(smooth_motion(robot, 5), robot)


@pytest.mark.parametrize("name", QUICK_ARMS)
def test_contact_equals_pinocchios_jacobian_and_the_weight_of_a_unit_mass(name: str) -> None:
    robot = replace(arm(name), tool=pose(None, (0.1, -0.2, 0.3)))
    motion = smooth_motion(robot, 20)
    columns = Contact().torque_columns(motion, robot)
    expected = PinocchioOracle(robot).tool_jacobian(motion.q)[:, :3].mT
    assert (columns - expected).abs().max() < 1e-12
    # A weightless arm that holds 1 kg at the tool against 1 m/s^2 pushes with 1 N.
    at = robot.tool[:3, 3][None].repeat(robot.n, 1)
    mass = torch.zeros(robot.n, dtype=torch.float64)
    mass[-1] = 1.0
    held = InertialParameters.from_com(mass, at, torch.zeros(robot.n, 6, dtype=torch.float64))
    for axis, down in enumerate(-torch.eye(3, dtype=torch.float64)):
        weight = gravity_torque(replace(robot, gravity=down), motion.q, held)
        assert (columns[..., axis] - weight).abs().max() < 1e-12


def test_contact_keeps_its_digits_in_a_user_s_float32_world() -> None:
    robot = replace(arm("panda"), tool=pose(None, (0.1, -0.2, 0.3)))
    motion = smooth_motion(robot, 20)
    expected = Contact().torque_columns(motion, robot)
    default = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        again = Contact().torque_columns(motion, replace(robot))
    finally:
        torch.set_default_dtype(default)
    torch.testing.assert_close(again, expected, rtol=1e-12, atol=1e-12)


def test_contact_in_a_window_comes_and_goes_smoothly() -> None:
    robot = arm("3r")
    motion = smooth_motion(robot, 1000)
    assert motion.t is not None
    always = Contact().torque_columns(motion, robot)
    window = Contact(0.3, 0.6).torque_columns(motion, robot)
    outside = (motion.t < 0.3) | (motion.t > 0.6)
    inside = (motion.t > 0.3 + RAMP) & (motion.t < 0.6 - RAMP)
    assert not window[outside].any()
    torch.testing.assert_close(window[inside], always[inside], rtol=1e-12, atol=1e-12)
    # The steepest of 3 u^2 - 2 u^3 is 1.5 a ramp.
    share = window.norm(dim=(1, 2)) / always.norm(dim=(1, 2))
    assert share.diff().abs().max() < 1.6 / (RAMP * 1000)
    half_open = Contact(stop=0.6).torque_columns(motion, robot)
    torch.testing.assert_close(half_open[:500], always[:500], rtol=1e-12, atol=1e-12)


def test_held_samples_repeat_the_last_good_one() -> None:
    motion = smooth_motion(arm("3r"), 1500, rate=500.0)
    effect = DroppedSamples(1, rate=4.0, length=0.03, seed=3)
    log = effect.measured(motion, [1.0])
    assert log.torque is not None
    assert log.age is not None
    assert motion.torque is not None
    held = log.age[:, 1] > 0
    assert 0.05 < held.double().mean() < 0.4
    assert not log.age[:, [0, 2]].any()
    torch.testing.assert_close(log.torque[:, [0, 2]], motion.torque[:, [0, 2]])
    torch.testing.assert_close(log.torque[~held, 1], motion.torque[~held, 1])
    # A held sample equals the one before it, to rounding.
    repeated = log.torque[1:, 1] - log.torque[:-1, 1]
    assert repeated[held[1:]].abs().max() < 1e-9
    assert float(log.age.max()) <= 0.03 + 1e-9


def test_held_samples_follow_from_their_age() -> None:
    motion = smooth_motion(arm("3r"), 1500, rate=500.0)
    log = DroppedSamples(1).measured(motion, [0.6])
    columns = DroppedSamples(1).torque_columns(log._replace(torque=motion.torque))
    assert motion.torque is not None
    assert log.torque is not None
    assert columns.abs().max() > 0
    torch.testing.assert_close(motion.torque + 0.6 * columns[..., 0], log.torque)


def test_places() -> None:
    robot = arm("panda")
    assert [e.joints for e in DroppedSamples.candidates(robot)] == [(j,) for j in range(7)]
    assert Contact.candidates(robot) == [Contact()]
    # A force on a link shows where three joints or more move it; the last has the tool's.
    assert [c.tip for c in Contact.links(robot)] == list(robot.link_names[2:-1])
    assert Contact().joints == ()


def test_windows_come_from_the_seed() -> None:
    motion = smooth_motion(arm("3r"), 1500, rate=500.0)
    ages = [DroppedSamples(1, seed=s).measured(motion, [1.0]).age for s in (0, 0, 1)]
    assert ages[0] is not None
    assert torch.equal(ages[0], ages[1])
    assert not torch.equal(ages[0], ages[2])
