"""Mass matrix, bias, gravity, forward dynamics; energy along a simulated swing."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.arms import arm, consistent_parameters, relative, states
from tests.oracles import MujocoOracle, PinocchioOracle
from torchid.dynamics import lagrange
from torchid.dynamics.forward import bias_torque, forward_dynamics, gravity_torque, mass_matrix
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot


def test_mass_matrix_and_gravity_equal_pinocchio(robot: Robot, pinocchio: PinocchioOracle) -> None:
    q, _, _ = states(robot, 200)
    assert relative(mass_matrix(robot, q), pinocchio.mass_matrix(q)) < 1e-9
    assert relative(gravity_torque(robot, q), pinocchio.gravity_torque(q)) < 1e-9


def test_mass_matrix_is_symmetric_and_positive(robot: Robot) -> None:
    q, _, _ = states(robot, 500)
    consistent = consistent_parameters(robot.n, 5)
    m = mass_matrix(robot, q, consistent)
    assert relative(m, m.transpose(-1, -2)) < 1e-12
    assert float(torch.linalg.eigvalsh(m).min()) > 0


def test_terms_add_up(robot: Robot) -> None:
    q, dq, ddq = states(robot, 50)
    inertial = (mass_matrix(robot, q) @ ddq.unsqueeze(-1)).squeeze(-1)
    tau = inverse_dynamics(robot, q, dq, ddq)
    assert relative(inertial + bias_torque(robot, q, dq), tau) < 1e-12
    still = torch.zeros_like(dq)
    assert relative(gravity_torque(robot, q), bias_torque(robot, q, still)) < 1e-14


def test_forward_inverts_inverse(robot: Robot) -> None:
    q, dq, ddq = states(robot, 200)
    consistent = consistent_parameters(robot.n, 5)
    tau = inverse_dynamics(robot, q, dq, ddq, consistent)
    assert relative(forward_dynamics(robot, q, dq, tau, consistent), ddq) < 1e-9


@pytest.mark.parametrize("name", ["panda", "ur10e", "mixed"])
def test_forward_equals_peers(name: str) -> None:
    robot = arm(name)
    q, dq, _ = states(robot, 100)
    tau = 20 * torch.randn(100, robot.n, dtype=torch.float64)
    ddq = forward_dynamics(robot, q, dq, tau)
    assert relative(ddq, PinocchioOracle(robot).forward_dynamics(q, dq, tau)) < 1e-9
    assert relative(ddq, MujocoOracle(robot).forward_dynamics(q, dq, tau)) < 1e-9


@pytest.mark.parametrize("batch", [(), (1,), (5, 3), (0,)])
def test_any_leading_batch(robot: Robot, batch: tuple[int, ...]) -> None:
    q, dq, tau = states(robot, *batch)
    assert mass_matrix(robot, q).shape == (*batch, robot.n, robot.n)
    assert gravity_torque(robot, q).shape == (*batch, robot.n)
    assert bias_torque(robot, q, dq).shape == (*batch, robot.n)
    assert forward_dynamics(robot, q, dq, tau).shape == (*batch, robot.n)


def test_parameter_batches_broadcast(robot: Robot) -> None:
    q, dq, tau = states(robot, 3)
    sets = InertialParameters(consistent_parameters(robot.n, 11, (2,)).pi.unsqueeze(1))
    assert mass_matrix(robot, q, sets).shape == (2, 3, robot.n, robot.n)
    assert forward_dynamics(robot, q, dq, tau, sets).shape == (2, 3, robot.n)


def test_a_robot_without_gravity_has_no_gravity_torque(robot: Robot) -> None:
    q, _, _ = states(robot, 5)
    weightless = replace(robot, gravity=torch.zeros(3, dtype=torch.float64))
    assert torch.equal(gravity_torque(weightless, q), torch.zeros(5, robot.n, dtype=torch.float64))


def test_power_balance(robot: Robot) -> None:
    """d(T + U)/dt = tau . dq at any state: energies of one model, torques of the other."""
    q, dq, ddq = states(robot, 50)

    def energy(q: Tensor, dq: Tensor) -> Tensor:
        return lagrange.kinetic_energy(robot, q, dq) + lagrange.potential_energy(robot, q)

    _, rate = torch.func.jvp(energy, (q, dq), (dq, ddq))
    power = (inverse_dynamics(robot, q, dq, ddq) * dq).sum(-1)
    assert relative(rate, power) < 1e-10
