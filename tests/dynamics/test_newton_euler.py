"""Newton-Euler against Pinocchio, MuJoCo and itself: torques, wrenches, shapes, gradients."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from tests.arms import arm, consistent_parameters, mixed_arm, relative, states
from tests.oracles import MujocoOracle, PinocchioOracle
from torchid.dynamics.newton_euler import inverse_dynamics, joint_wrenches
from torchid.errors import RobotError
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Robot

PEERS = 1e-9
"""Tolerance against other programs, relative to the largest value of the batch."""


def test_torques_equal_pinocchio(robot: Robot, pinocchio: PinocchioOracle) -> None:
    motion = states(robot, 1000)
    assert relative(inverse_dynamics(robot, *motion), pinocchio.inverse_dynamics(*motion)) < PEERS


def test_torques_equal_mujoco(robot: Robot, mujoco: MujocoOracle) -> None:
    motion = states(robot, 1000)
    assert relative(inverse_dynamics(robot, *motion), mujoco.inverse_dynamics(*motion)) < PEERS


def moved_to_our_frames(robot: Robot, q: Tensor, f: Tensor) -> Tensor:
    """Pinocchio's data.f, about the moved joint frame's origin and in its axes, moved to the
    unmoved joint frame's origin (different for a prismatic joint) and the link frame's axes."""
    force, moment = f[..., :3], f[..., 3:]
    sliding = torch.tensor([kind is JointType.PRISMATIC for kind in robot.joint_types])
    arm_ = torch.zeros_like(force)
    arm_[..., 2] = torch.where(sliding, q, torch.zeros_like(q))
    moment = moment + torch.linalg.cross(arm_, force)
    to_link = robot.after[:, :3, :3].transpose(-1, -2)
    turned = [(to_link @ x.unsqueeze(-1)).squeeze(-1) for x in (force, moment)]
    return torch.cat(turned, -1)


def test_wrenches_equal_pinocchio(robot: Robot, pinocchio: PinocchioOracle) -> None:
    q, dq, ddq = states(robot, 300)
    expected = moved_to_our_frames(robot, q, pinocchio.wrenches(q, dq, ddq))
    assert relative(joint_wrenches(robot, q, dq, ddq), expected) < PEERS


def test_component_along_the_axis_is_the_torque(robot: Robot) -> None:
    motion = states(robot, 50)
    wrenches, tau = joint_wrenches(robot, *motion), inverse_dynamics(robot, *motion)
    for i, kind in enumerate(robot.joint_types):
        part = wrenches[:, i, 3:] if kind is JointType.REVOLUTE else wrenches[:, i, :3]
        along = part @ robot.axes[i]
        torch.testing.assert_close(along, tau[:, i], rtol=0, atol=1e-11)


@pytest.mark.parametrize("batch", [(), (1,), (5, 3), (0,), (2, 0)])
def test_any_leading_batch(robot: Robot, batch: tuple[int, ...]) -> None:
    motion = states(robot, *batch)
    tau, wrenches = inverse_dynamics(robot, *motion), joint_wrenches(robot, *motion)
    assert tau.shape == (*batch, robot.n)
    assert wrenches.shape == (*batch, robot.n, 6)
    flat = [x.reshape(-1, robot.n) for x in motion]
    for k in range(flat[0].shape[0]):
        one = [x[k] for x in flat]
        torch.testing.assert_close(tau.reshape(-1, robot.n)[k], inverse_dynamics(robot, *one))


def test_signals_broadcast(robot: Robot) -> None:
    q, dq, ddq = states(robot, 4)
    tau = inverse_dynamics(
        robot,
        q,
        torch.zeros(robot.n, dtype=torch.float64),
        torch.zeros(1, robot.n, dtype=torch.float64),
    )
    assert tau.shape == (4, robot.n)
    still = inverse_dynamics(robot, q, torch.zeros_like(dq), torch.zeros_like(ddq))
    torch.testing.assert_close(tau, still)


def test_parameter_batches_broadcast_against_states(robot: Robot) -> None:
    q, dq, ddq = states(robot, 6)
    sets = consistent_parameters(robot.n, 11, (4,))
    batch = InertialParameters(sets.pi.unsqueeze(1))
    tau = inverse_dynamics(robot, q, dq, ddq, batch)
    wrenches = joint_wrenches(robot, q, dq, ddq, batch)
    assert tau.shape == (4, 6, robot.n)
    assert wrenches.shape == (4, 6, robot.n, 6)
    for k in range(4):
        one = InertialParameters(sets.pi[k])
        assert relative(tau[k], inverse_dynamics(robot, q, dq, ddq, one)) < 1e-14
        assert relative(wrenches[k], joint_wrenches(robot, q, dq, ddq, one)) < 1e-14


def test_gradients_in_motion_and_parameters() -> None:
    robot = mixed_arm("RPR")
    motion = [x.requires_grad_() for x in states(robot, 2)]
    assert robot.parameters is not None
    pi = robot.parameters.pi.clone().requires_grad_()

    def torques(q: Tensor, dq: Tensor, ddq: Tensor, pi: Tensor) -> Tensor:
        return inverse_dynamics(robot, q, dq, ddq, InertialParameters(pi))

    assert torch.autograd.gradcheck(torques, (*motion, pi))
    assert torch.autograd.gradcheck(lambda q: joint_wrenches(robot, q, *motion[1:]), (motion[0],))


def test_float32_within_its_accuracy(robot: Robot) -> None:
    motion = states(robot, 100)
    tau = inverse_dynamics(robot, *(x.float() for x in motion))
    assert tau.dtype is torch.float32
    assert relative(tau.double(), inverse_dynamics(robot, *motion)) < 2e-5


def test_device(robot: Robot, device: torch.device) -> None:
    motion = states(robot, 20)
    tau = inverse_dynamics(robot, *(x.to(device) for x in motion))
    assert tau.device.type == device.type
    assert relative(tau.cpu(), inverse_dynamics(robot, *motion)) < 1e-13


def test_a_long_motion_is_its_instants(robot: Robot) -> None:
    motion = states(robot, 13_001)
    tau, wrenches = inverse_dynamics(robot, *motion), joint_wrenches(robot, *motion)
    some = [0, 1, 999, 7000, 12_300, 13_000]
    apart = [x[some] for x in motion]
    assert relative(inverse_dynamics(robot, *apart), tau[some]) < 1e-13
    assert relative(joint_wrenches(robot, *apart), wrenches[some]) < 1e-13


def test_input_is_not_changed(robot: Robot) -> None:
    motion = states(robot, 5)
    copies = [x.clone() for x in motion]
    inverse_dynamics(robot, *motion)
    assert all(torch.equal(x, c) for x, c in zip(motion, copies, strict=True))


def test_without_parameters_says_what_is_missing() -> None:
    robot = replace(arm("panda"), parameters=None)
    with pytest.raises(RobotError, match="no inertial parameters"):
        inverse_dynamics(robot, *states(robot, 2))


kinds = st.text(alphabet="RP", min_size=1, max_size=6)


@settings(max_examples=30)
@given(kinds=kinds, seed=st.integers(0, 2**31))
def test_any_chain_equals_pinocchio(kinds: str, seed: int) -> None:
    robot = mixed_arm(kinds, seed)
    motion = states(robot, 3, seed=seed)
    expected = PinocchioOracle(robot).inverse_dynamics(*motion)
    assert relative(inverse_dynamics(robot, *motion), expected) < PEERS


@settings(max_examples=30)
@given(seed=st.integers(0, 2**31), factor=st.floats(-10, 10))
def test_torque_is_linear_in_the_parameters(seed: int, factor: float) -> None:
    robot = mixed_arm(seed=seed)
    motion = states(robot, 3, seed=seed)
    a, b = (consistent_parameters(robot.n, seed + k).pi for k in (1, 2))
    both = inverse_dynamics(robot, *motion, InertialParameters(a + factor * b))
    apart = inverse_dynamics(robot, *motion, InertialParameters(a)) + factor * inverse_dynamics(
        robot, *motion, InertialParameters(b)
    )
    torch.testing.assert_close(both, apart, rtol=1e-11, atol=1e-9)
