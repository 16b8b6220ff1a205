"""Regressor: Y pi = tau, both ways of making it, its chunks."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arms import mixed_arm, relative, states
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.regressor import Method, regressor, regressor_chunks
from torchid.robot.inertia import InertialParameters, paper_order
from torchid.robot.model import JointType, Robot

METHODS: tuple[Method, ...] = ("closed", "autograd")


@pytest.mark.parametrize("method", METHODS)
def test_times_parameters_is_the_torque(robot: Robot, method: Method) -> None:
    motion = states(robot, 1000)
    assert robot.parameters is not None
    tau = regressor(robot, *motion, method=method) @ robot.parameters.to_paper_order()
    # Relative to the largest torque: single entries may cancel to nothing.
    assert relative(tau, inverse_dynamics(robot, *motion)) < 1e-12


def test_closed_form_equals_autograd(robot: Robot) -> None:
    motion = states(robot, 200)
    closed, automatic = (regressor(robot, *motion, method=m) for m in METHODS)
    assert relative(closed, automatic) < 1e-12


def test_columns_are_torques_of_unit_parameters(robot: Robot) -> None:
    motion = states(robot, 3)
    y = regressor(robot, *motion)
    for column in range(10 * robot.n):
        unit = torch.zeros(10 * robot.n, dtype=torch.float64)
        unit[column] = 1.0
        tau = inverse_dynamics(robot, *motion, InertialParameters.from_paper_order(unit))
        torch.testing.assert_close(y[..., column], tau, rtol=1e-11, atol=1e-11)


def test_links_before_a_joint_do_not_enter_its_torque(robot: Robot) -> None:
    y = regressor(robot, *states(robot, 4))
    link = torch.arange(10 * robot.n).div(10, rounding_mode="floor")[paper_order(robot.n)]
    for i in range(robot.n):
        assert torch.equal(y[:, i, link < i], torch.zeros_like(y[:, i, link < i]))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("batch", [(), (1,), (5, 3), (0,)])
def test_any_leading_batch(robot: Robot, batch: tuple[int, ...], method: Method) -> None:
    y = regressor(robot, *states(robot, *batch), method=method)
    assert y.shape == (*batch, robot.n, 10 * robot.n)


@pytest.mark.parametrize("method", METHODS)
def test_a_long_motion_is_its_instants(robot: Robot, method: Method) -> None:
    motion = states(robot, 13_001)
    y = regressor(robot, *motion, method=method)
    some = [0, 1, 999, 7000, 12_300, 13_000]
    apart = regressor(robot, *(x[some] for x in motion), method=method)
    assert relative(apart, y[some]) < 1e-13


@pytest.mark.parametrize("method", METHODS)
def test_chunks_hold_the_rows_of_the_dense_matrix(robot: Robot, method: Method) -> None:
    motion = states(robot, 25)
    y = regressor(robot, *motion)
    place = paper_order(robot.n).argsort()
    pairs = [(robot.n - 1, k) for k in range(10)] + [(0, 5)]
    columns = [int(place[10 * link + k]) for link, k in pairs]
    for i in range(robot.n):
        rows = [
            chunk.row(i, pairs)
            for chunk in regressor_chunks(robot, *motion, size=10, method=method)
        ]
        assert [r.shape for r in rows] == [(11, 13), (11, 12)]
        torch.testing.assert_close(torch.cat(rows, -1).T, y[:, i, columns], rtol=0, atol=1e-11)


def test_gradient_in_q() -> None:
    robot = mixed_arm("RPR")
    q, dq, ddq = states(robot, 2)
    assert torch.autograd.gradcheck(lambda x: regressor(robot, x, dq, ddq), (q.requires_grad_(),))


def test_float32_within_its_accuracy(robot: Robot) -> None:
    motion = states(robot, 50)
    y = regressor(robot, *(x.float() for x in motion))
    assert y.dtype is torch.float32
    assert relative(y.double(), regressor(robot, *motion)) < 1e-5


@pytest.mark.parametrize("method", METHODS)
def test_device(robot: Robot, device: torch.device, method: Method) -> None:
    motion = states(robot, 20)
    y = regressor(robot, *(x.to(device) for x in motion), method=method)
    assert y.device.type == device.type
    assert relative(y.cpu(), regressor(robot, *motion)) < 1e-12


@pytest.mark.parametrize("kind", ["R", "P"])
def test_last_joint_alone(kind: str) -> None:
    """By hand: a slider's force is m (ddq - g_axis), and it feels no other parameter."""
    robot = mixed_arm(kind)
    q, dq, ddq = states(robot, 4)
    y = regressor(robot, q, dq, ddq)
    if robot.joint_types[0] is JointType.PRISMATIC:
        axis = robot.before[0, :3, 2]
        torch.testing.assert_close(y[:, 0, 0], ddq[:, 0] - axis @ robot.gravity)
        assert float(y[:, 0, 1:].abs().max()) < 1e-14
    else:
        axis = robot.axes[0]
        spin = torch.stack(
            [axis[i] * axis[j] * (1 if i == j else 2) for i in range(3) for j in range(i, 3)]
        )
        torch.testing.assert_close(y[:, 0, 4:], ddq * spin)


@settings(max_examples=30)
@given(kinds=st.text(alphabet="RP", min_size=1, max_size=6), seed=st.integers(0, 2**31))
def test_both_ways_agree_on_any_chain(kinds: str, seed: int) -> None:
    robot = mixed_arm(kinds, seed)
    motion = states(robot, 3, seed=seed)
    closed, automatic = (regressor(robot, *motion, method=m) for m in METHODS)
    assert relative(closed, automatic) < 1e-11
