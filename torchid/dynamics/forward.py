"""Mass matrix, bias, gravity and forward dynamics, all from the Newton-Euler recursion."""

from dataclasses import replace

import torch
from torch import Tensor

from torchid.dynamics.recursion import chain_geometry, forces, kinematics
from torchid.dynamics.scalars import ZERO
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.typing import BroadcastJoints, JointMatrix, Joints


def mass_matrix(
    robot: Robot, q: BroadcastJoints, parameters: InertialParameters | None = None
) -> JointMatrix:
    """M(q) (..., n, n) [kg m^2]: column j is the torque of a unit acceleration of joint j, at rest
    and without gravity."""
    geometry = replace(chain_geometry(robot), gravity=ZERO)
    still = [0.0] * robot.n
    columns = []
    for j in range(robot.n):
        unit = [1.0 if k == j else 0.0 for k in range(robot.n)]
        columns.append(_torques(robot, geometry, q, still, unit, parameters))
    return torch.stack(columns, -1)


def bias_torque(
    robot: Robot,
    q: BroadcastJoints,
    dq: BroadcastJoints,
    parameters: InertialParameters | None = None,
) -> Joints:
    """S(q, dq) dq + g(q) (..., n) [N m]."""
    rates = list(dq.unbind(-1))
    return _torques(robot, chain_geometry(robot), q, rates, [0.0] * robot.n, parameters)


def gravity_torque(
    robot: Robot, q: BroadcastJoints, parameters: InertialParameters | None = None
) -> Joints:
    """g(q) (..., n) [N m]."""
    still = [0.0] * robot.n
    return _torques(robot, chain_geometry(robot), q, still, still, parameters)


def forward_dynamics(
    robot: Robot,
    q: BroadcastJoints,
    dq: BroadcastJoints,
    tau: BroadcastJoints,
    parameters: InertialParameters | None = None,
) -> Joints:
    """Joint accelerations (..., n) from M(q) ddq = tau - S(q, dq) dq - g(q).

    Solved by LU, not Cholesky: a set of parameters that is not physically consistent may have an
    indefinite M, and still has accelerations.
    """
    m = mass_matrix(robot, q, parameters)
    rest = tau - bias_torque(robot, q, dq, parameters)
    return torch.linalg.solve(m, rest.unsqueeze(-1)).squeeze(-1)


def _torques(robot, geometry, q, dq, ddq, parameters) -> Tensor:  # type: ignore[no-untyped-def]
    pi = (parameters or robot.require_parameters("the equations of motion")).pi.to(q)
    links = kinematics(geometry, q.unbind(-1), dq, ddq)
    components = [link.unbind(-1) for link in pi.unbind(-2)]
    values, _ = forces(geometry, links, components)
    like = q.new_zeros(torch.broadcast_shapes(q.shape[:-1], pi.shape[:-2]))
    return torch.stack([v + like for v in values], -1)
