"""Euler-Lagrange: equal to Pinocchio and MuJoCo, and the properties its terms have."""

import torch
from torch import Tensor

from tests.arms import mixed_arm, relative, states
from tests.oracles import MujocoOracle, PinocchioOracle
from torchid.dynamics import lagrange
from torchid.dynamics.forward import mass_matrix
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.robot.model import Robot


def test_equals_pinocchio_and_mujoco(
    robot: Robot, pinocchio: PinocchioOracle, mujoco: MujocoOracle
) -> None:
    motion = states(robot, 200)
    tau = lagrange.inverse_dynamics(robot, *motion)
    assert relative(tau, pinocchio.inverse_dynamics(*motion)) < 1e-9
    assert relative(tau, mujoco.inverse_dynamics(*motion)) < 1e-9


def test_mass_matrix_and_gravity_equal_pinocchio(robot: Robot, pinocchio: PinocchioOracle) -> None:
    q, _, _ = states(robot, 100)
    assert relative(lagrange.mass_matrix(robot, q), pinocchio.mass_matrix(q)) < 1e-9
    assert relative(lagrange.gravity_torque(robot, q), pinocchio.gravity_torque(q)) < 1e-9


def test_coriolis_matrix_equals_pinocchio(robot: Robot, pinocchio: PinocchioOracle) -> None:
    # Pinocchio's too is made of Christoffel symbols, but only C dq is unique in general.
    q, dq, _ = states(robot, 50)
    ours, theirs = lagrange.coriolis_matrix(robot, q, dq), pinocchio.coriolis_matrix(q, dq)
    speed = dq.unsqueeze(-1)
    assert relative(ours @ speed, theirs @ speed) < 1e-9


def test_rate_of_mass_minus_twice_coriolis_is_skew(robot: Robot) -> None:
    q, dq, _ = states(robot, 20)
    s = lagrange.coriolis_matrix(robot, q, dq)
    # dM/dt from the other model, so that the property is not an identity of one formula.
    _, rate = torch.func.jvp(lambda x: mass_matrix(robot, x), (q,), (dq,))
    k = rate - 2 * s
    assert relative(k, -k.transpose(-1, -2)) < 1e-10


def test_kinetic_energy_is_half_the_quadratic_form(robot: Robot) -> None:
    q, dq, _ = states(robot, 50)
    quadratic = 0.5 * torch.einsum("...i,...ij,...j->...", dq, mass_matrix(robot, q), dq)
    assert relative(lagrange.kinetic_energy(robot, q, dq), quadratic) < 1e-12


def test_gradient_in_q() -> None:
    robot = mixed_arm("RP")
    q, dq, ddq = states(robot)

    def torques(x: Tensor) -> Tensor:
        return lagrange.inverse_dynamics(robot, x, dq, ddq)

    expected = torch.func.jacrev(lambda x: inverse_dynamics(robot, x, dq, ddq))(q)
    assert relative(torch.func.jacrev(torques)(q), expected) < 1e-10
