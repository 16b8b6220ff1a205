"""Mass matrix, bias, gravity and forward dynamics.

Small batches, as a simulation steps them, go through `world_frame.py`, some 50 times faster than
the recursion there; large ones through the Newton-Euler recursion, which has fewer operations.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchid.dynamics.recursion import ChainGeometry, chain_geometry, forces, kinematics
from torchid.dynamics.scalars import ZERO, Scalar
from torchid.dynamics.world_frame import Posture, arms_of
from torchid.inputs import RobotLike, as_robot
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.tensors import joint_signals
from torchid.typing import BroadcastJoints, JointMatrix, Joints, Numbers

SMALL_BATCH, SMALL_BATCH_BIAS = 1500, 250
"""Samples up to which few kernel calls count more than few operations (measured, 7 joints)."""


def mass_matrix(
    robot: RobotLike, q: Numbers, parameters: InertialParameters | None = None
) -> JointMatrix:
    """Mass matrix M(q) of the rigid body (eq. 2.15): column j is the torque of a unit acceleration
    of joint j, at rest and without gravity.

    Args:
        robot: kinematics.
        q: (..., n) [rad; m for prismatic joints]; arrays and lists too, in float64.
        parameters: (..., L, 10), leading axes broadcast against those of q; the robot's nominal
            ones if None.

    Returns:
        (..., n, n) [kg m^2; kg m and kg where joints are prismatic], symmetric.

    Raises:
        RobotError: no parameters given and none in the robot.
        TorchidError: not numbers of all joints.

    >>> import torchid
    >>> m = mass_matrix(torchid.load_robot("3r"), [0.1, -0.4, 0.7])
    >>> m.shape, bool((m - m.T).abs().max() < 1e-12)
    (torch.Size([3, 3]), True)
    """
    robot = as_robot(robot)
    (q,) = joint_signals(robot.n, q=q)
    if _is_small(q, parameters):
        return _posture(robot, q, parameters).mass_matrix()
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
    if _is_small(torch.broadcast_tensors(q, dq)[0], parameters, SMALL_BATCH_BIAS):
        return _posture(robot, q, parameters).torque(dq)
    rates = list(dq.unbind(-1))
    return _torques(robot, chain_geometry(robot), q, rates, [0.0] * robot.n, parameters)


def gravity_torque(
    robot: Robot, q: BroadcastJoints, parameters: InertialParameters | None = None
) -> Joints:
    """g(q) (..., n) [N m]."""
    if _is_small(q, parameters, SMALL_BATCH_BIAS):
        return _posture(robot, q, parameters).torque(torch.zeros_like(q))
    still = [0.0] * robot.n
    return _torques(robot, chain_geometry(robot), q, still, still, parameters)


def forward_dynamics(
    robot: RobotLike,
    q: Numbers,
    dq: Numbers,
    tau: Numbers,
    parameters: InertialParameters | None = None,
) -> Joints:
    """Joint accelerations of the rigid body, from M(q) ddq = tau - S(q, dq) dq - g(q) (eq. 2.15).

    Args:
        robot: kinematics and gravity.
        q, dq: (..., n) [rad, rad/s; m, m/s for prismatic joints]; arrays and lists too, in float64.
        tau: (..., n) [N m; N for prismatic joints], positive along the axis.
        parameters: (..., L, 10), leading axes broadcast against those of q; the robot's nominal
            ones if None.

    Returns:
        (..., n) [rad/s^2; m/s^2 for prismatic joints].

    Raises:
        RobotError: no parameters given and none in the robot.
        TorchidError: not numbers of all joints.

    >>> import torchid
    >>> robot = torchid.load_robot("3r")
    >>> q, dq, ddq = [0.1, -0.4, 0.7], [1.0, 0.0, -2.0], [3.0, -1.0, 2.0]
    >>> tau = torchid.inverse_dynamics(robot, q, dq, ddq)
    >>> [round(x, 9) for x in forward_dynamics(robot, q, dq, tau).tolist()]
    [3.0, -1.0, 2.0]
    """
    robot = as_robot(robot)
    q, dq, tau = joint_signals(robot.n, q=q, dq=dq, tau=tau)
    if _is_small(torch.broadcast_tensors(q, dq, tau)[0], parameters):
        posture = _posture(robot, q, parameters)
        return solve_mass(posture.mass_matrix(), tau - posture.torque(dq))
    rest = tau - bias_torque(robot, q, dq, parameters)
    return solve_mass(mass_matrix(robot, q, parameters), rest)


def solve_mass(mass: JointMatrix, torque: BroadcastJoints) -> Joints:
    """Accelerations (..., n) that torques (..., n) give: M^-1 torque.

    By Cholesky, the faster and more exact; by LU if a matrix of the batch is not positive definite:
    a set of parameters that is not physically consistent still has accelerations.
    """
    factor, info = torch.linalg.cholesky_ex(mass)
    if bool(info.any()):
        return torch.linalg.solve(mass, torque.unsqueeze(-1)).squeeze(-1)
    return torch.cholesky_solve(torque.unsqueeze(-1), factor).squeeze(-1)


def _is_small(q: Tensor, parameters: InertialParameters | None, most: int = SMALL_BATCH) -> bool:
    sets = 1 if parameters is None else parameters.pi[..., 0, 0].numel()
    return q[..., 0].numel() * sets <= most


def _posture(robot: Robot, q: Tensor, parameters: InertialParameters | None) -> Posture:
    return arms_of([robot], q, None if parameters is None else [parameters]).at(q)


def _torques(
    robot: Robot,
    geometry: ChainGeometry,
    q: Tensor,
    dq: Sequence[Scalar],
    ddq: Sequence[Scalar],
    parameters: InertialParameters | None,
) -> Tensor:
    pi = (parameters or robot.require_parameters("the equations of motion")).pi.to(q)
    links = kinematics(geometry, q.unbind(-1), dq, ddq)
    components = [link.unbind(-1) for link in pi.unbind(-2)]
    values, _ = forces(geometry, links, components)
    # Not torch.broadcast_shapes, whose first call imports sympy: more than a second.
    like = q.new_zeros(torch.broadcast_tensors(q[..., 0], pi[..., 0, 0])[0].shape)
    return torch.stack([v + like for v in values], -1)
