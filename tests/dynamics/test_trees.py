"""The dynamics of trees: every way to compute it agrees, and what does not move is not computed."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arms import relative, states
from tests.trees import random_tree
from torchid.dynamics import forward, lagrange
from torchid.dynamics.newton_euler import inverse_dynamics, joint_wrenches
from torchid.dynamics.regressor import regressor
from torchid.robot.jacobian import tool_jacobian
from torchid.robot.model import JointType, Robot, tool_pose


@st.composite
def trees(draw: st.DrawFn) -> Robot:
    """Any tree of up to eight links, some of whose joints mimic others."""
    count = draw(st.integers(1, 8))
    parents = [draw(st.integers(-1, k - 1)) for k in range(count)]
    kinds = "".join(draw(st.sampled_from("RRP")) for _ in range(count))
    own = [k for k in range(count) if k == 0 or draw(st.booleans()) or draw(st.booleans())]
    follow = {k: draw(st.sampled_from(own)) for k in range(count) if k not in own}
    return random_tree(parents, kinds, draw(st.integers(0, 99)), follow)


HUMANLIKE = random_tree([-1, 0, 1, 0, 3, 0, 5, 5, -1], "RRRRPRRPR", 4, {7: 6, 4: 1})
TREES = settings(max_examples=25)


@TREES
@given(trees())
def test_torque_is_the_regressor_times_the_parameters(robot: Robot) -> None:
    motion = states(robot, 6)
    tau = inverse_dynamics(robot, *motion)
    pi = robot.parameters.to_paper_order()
    closed, taped = (regressor(robot, *motion, method=m) for m in ("closed", "autograd"))
    assert relative(closed @ pi, tau) < 1e-12
    assert relative(taped, closed) < 1e-12


@pytest.mark.nightly
@TREES
@given(trees())
def test_torque_is_that_of_the_energies(robot: Robot) -> None:
    motion = states(robot, 4)
    tau = inverse_dynamics(robot, *motion)
    assert relative(lagrange.inverse_dynamics(robot, *motion), tau) < 1e-9
    mass = forward.mass_matrix(robot, motion[0])
    assert relative(lagrange.mass_matrix(robot, motion[0]), mass) < 1e-10


@TREES
@given(trees())
def test_both_ways_to_the_equations_of_motion_agree(robot: Robot) -> None:
    q, dq, ddq = states(robot, 5)
    tau = inverse_dynamics(robot, q, dq, ddq)
    found = forward.forward_dynamics(robot, q, dq, tau)
    assert relative(found, ddq) < 1e-6
    # A few instants are those of many.
    mass, bias = forward.mass_matrix(robot, q), forward.bias_torque(robot, q, dq)
    many, rates = q.repeat(600, 1), dq.repeat(600, 1)
    assert relative(forward.mass_matrix(robot, many)[-5:], mass) < 1e-11
    assert relative(forward.bias_torque(robot, many, rates)[-5:], bias) < 1e-11


@TREES
@given(trees())
def test_power_is_the_rate_of_the_energy(robot: Robot) -> None:
    q, dq, ddq = states(robot, 5)

    def energy(t: torch.Tensor) -> torch.Tensor:
        at, rate = q + dq * t + ddq * t**2 / 2, dq + ddq * t
        return lagrange.kinetic_energy(robot, at, rate) + lagrange.potential_energy(robot, at)

    now, one = (torch.tensor(x, dtype=torch.float64) for x in (0.0, 1.0))
    rate = torch.func.jvp(energy, (now,), (one,))[1]
    power = (inverse_dynamics(robot, q, dq, ddq) * dq).sum(-1)
    assert relative(power, rate) < 1e-10


@pytest.mark.nightly
@TREES
@given(trees())
def test_the_jacobian_of_each_tip_is_the_derivative_of_its_pose(robot: Robot) -> None:
    q, dq, _ = (x.squeeze(0) for x in states(robot, 1))
    for tip in robot.ends:
        pose, rate = torch.func.jvp(lambda x, t=tip: tool_pose(robot, x, t.name), (q,), (dq,))
        spin = rate[:3, :3] @ pose[:3, :3].T
        turning = torch.stack([spin[2, 1], spin[0, 2], spin[1, 0]])
        found = tool_jacobian(robot, q, tip.name) @ dq
        torch.testing.assert_close(found, torch.cat([rate[:3, 3], turning]), rtol=0, atol=1e-11)


@pytest.mark.nightly
@TREES
@given(trees())
def test_what_carries_a_joint_balances_what_it_gives(robot: Robot) -> None:
    """Of the wrench through a joint the part along its axis is the joint's torque, and coordinates
    feel those of all joints that follow them."""
    motion = states(robot, 4)
    wrenches, tau = joint_wrenches(robot, *motion), inverse_dynamics(robot, *motion)
    felt = torch.zeros_like(tau)
    for link, drive in enumerate(robot.drives):
        turns = drive.joint_type is JointType.REVOLUTE
        part = wrenches[:, link, 3:] if turns else wrenches[:, link, :3]
        felt[:, drive.coordinate] += drive.ratio * (part @ robot.axes[link])
    torch.testing.assert_close(felt, tau, rtol=1e-11, atol=1e-10)


def test_other_branches_have_no_columns() -> None:
    robot = HUMANLIKE
    dense = regressor(robot, *states(robot, 3))
    for i in range(robot.n):
        moved = torch.zeros(robot.n_links, dtype=torch.bool)
        moved[list(robot.moved_by(i))] = True
        masses = dense[:, i, : robot.n_links]
        assert not masses[:, ~moved].any()
        assert masses[:, moved].any()


def test_a_tree_that_is_a_chain_is_that_chain() -> None:
    chain = random_tree([-1, 0, 1, 2], "RPRR", 5, {})
    assert chain.is_serial
    # The same chain beside a link of its own: the arm's torques are untouched.
    both = random_tree([-1, 0, 1, 2, -1], "RPRRR", 5, {})
    same = replace(chain, before=both.before[:4], after=both.after[:4], gravity=both.gravity)
    pi = replace(same.parameters, pi=both.parameters.pi[:4])
    q, dq, ddq = states(both, 8)
    arm = inverse_dynamics(same, q[:, :4], dq[:, :4], ddq[:, :4], pi)
    assert relative(inverse_dynamics(both, q, dq, ddq)[:, :4], arm) < 1e-13
