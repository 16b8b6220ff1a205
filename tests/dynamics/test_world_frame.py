"""The base-frame equations of motion against the recursion, Pinocchio, and batches of arms."""

from dataclasses import replace

import pytest
import torch

from tests.arms import arm, consistent_parameters, mixed_arm, relative, states
from tests.oracles import PinocchioOracle
from torchid.dynamics.forward import forward_dynamics, mass_matrix, solve_mass
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.world_frame import arms_of
from torchid.robot.model import Robot


def test_torque_equals_the_recursion(robot: Robot) -> None:
    q, dq, ddq = states(robot, 100)
    posture = arms_of([robot], q).at(q)
    assert relative(posture.torque(dq, ddq), inverse_dynamics(robot, q, dq, ddq)) < 1e-13


@pytest.mark.parametrize("name", ["3r", "kuka_lwr4", "panda", "mixed"])
def test_accelerations_equal_pinocchios_articulated_bodies(name: str) -> None:
    found = arm(name)
    robot = found.with_parameters(consistent_parameters(found.n, 5))
    q, dq, _ = states(robot, 100)
    tau = 20 * torch.randn(100, robot.n, dtype=torch.float64)
    ddq = forward_dynamics(robot, q, dq, tau)
    assert relative(ddq, PinocchioOracle(robot).forward_dynamics(q, dq, tau)) < 1e-10


def test_a_batch_of_different_arms_is_each_of_them() -> None:
    arms = [mixed_arm(seed=seed) for seed in (3, 4, 5)]
    q, dq, ddq = states(arms[0], 3)
    posture = arms_of(arms, q).at(q)
    for k, robot in enumerate(arms):
        assert relative(posture.mass_matrix()[k], mass_matrix(robot, q[k])) < 1e-13
        expected = inverse_dynamics(robot, q[k], dq[k], ddq[k])
        assert relative(posture.torque(dq, ddq)[k], expected) < 1e-13


def test_small_and_large_batches_agree() -> None:
    robot = arm("mixed")
    q, dq, tau = states(robot, 5000)
    ddq = forward_dynamics(robot, q, dq, tau)
    assert relative(ddq[:50], forward_dynamics(robot, q[:50], dq[:50], tau[:50])) < 1e-9


def test_an_indefinite_mass_matrix_still_has_accelerations() -> None:
    mass = torch.stack(
        [
            torch.diag(torch.tensor([2.0, -1.0], dtype=torch.float64)),
            torch.eye(2, dtype=torch.float64),
        ]
    )
    torque = torch.tensor([[4.0, 3.0], [1.0, 2.0]], dtype=torch.float64)
    assert torch.equal(
        solve_mass(mass, torque), torch.tensor([[2.0, -3.0], [1.0, 2.0]], dtype=torch.float64)
    )


def test_gravity_of_each_arm_counts() -> None:
    robot = arm("3r")
    weightless = replace(robot, gravity=torch.zeros(3, dtype=torch.float64))
    q, _, _ = states(robot, 2)
    still = torch.zeros_like(q)
    tau = arms_of([robot, weightless], q).at(q).torque(still)
    assert float(tau[0].abs().max()) > 0.1
    assert torch.equal(tau[1], torch.zeros(3, dtype=torch.float64))
