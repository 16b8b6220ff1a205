"""Mass matrix, bias, gravity and forward dynamics.

Small batches, as a simulation steps them, go through `world_frame.py`, some 50 times faster than
the recursion there; large ones through the Newton-Euler recursion, which has fewer operations.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import torch
from torch import Tensor

from torchid.dynamics.recursion import ChainGeometry, chain_geometry, forces, kinematics
from torchid.dynamics.scalars import ZERO, Scalar
from torchid.dynamics.world_frame import Arms, Posture, arms_of
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import as_robot
from torchid.robot.model import Robot, RobotLike
from torchid.tensors import joint_signals
from torchid.typing import BroadcastJoints, JointMatrix, Joints, Numbers

_WHAT = "the equations of motion"
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
    return _posture(robot, q, parameters, SMALL_BATCH).mass_matrix()


def bias_torque(
    robot: Robot,
    q: BroadcastJoints,
    dq: BroadcastJoints,
    parameters: InertialParameters | None = None,
) -> Joints:
    """S(q, dq) dq + g(q) (..., n) [N m]."""
    return _posture(robot, torch.broadcast_tensors(q, dq)[0], parameters, SMALL_BATCH_BIAS).torque(
        dq
    )


def gravity_torque(
    robot: Robot, q: BroadcastJoints, parameters: InertialParameters | None = None
) -> Joints:
    """g(q) (..., n) [N m]."""
    posture = _posture(robot, q, parameters, SMALL_BATCH_BIAS)
    if isinstance(posture, ComponentsAt):
        return posture.torque(None)
    return posture.torque(torch.zeros_like(q))


def forward_dynamics(
    robot: RobotLike,
    q: Numbers,
    dq: Numbers,
    tau: Numbers,
    parameters: InertialParameters | None = None,
) -> Joints:
    """Joint accelerations of the rigid body, from M(q) ddq = tau - S(q, dq) dq - g(q) (eq. 2.15),
    without the robot's effects, which `torchid.forward_dynamics` has.

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
    """
    robot = as_robot(robot)
    q, dq, tau = joint_signals(robot.n, q=q, dq=dq, tau=tau)
    whole = torch.broadcast_tensors(q, dq, tau)[0]
    posture = _posture(robot, whole, parameters, SMALL_BATCH)
    return solve_mass(posture.mass_matrix(), tau - posture.torque(dq))


def solve_mass(mass: JointMatrix, torque: BroadcastJoints) -> Joints:
    """Accelerations (..., n) that torques (..., n) give: M^-1 torque.

    By Cholesky, the faster and more exact; by LU if a matrix of the batch is not positive definite:
    a set of parameters that is not physically consistent still has accelerations.
    """
    factor, info = torch.linalg.cholesky_ex(mass)
    if bool(info.any()):
        return torch.linalg.solve(mass, torque.unsqueeze(-1)).squeeze(-1)
    return torch.cholesky_solve(torque.unsqueeze(-1), factor).squeeze(-1)


class Components:
    """One arm, each of whose numbers is a tensor over the batch: what `Arms` is with few kernels,
    with few operations."""

    def __init__(self, robot: Robot, parameters: InertialParameters | None = None):
        self._geometry = chain_geometry(robot)
        self._pi = (parameters or robot.require_parameters(_WHAT)).pi

    def at(self, q: Joints) -> "ComponentsAt":
        """The arm at positions q."""
        return ComponentsAt(self._geometry, self._pi, q)


class ComponentsAt:
    """One arm at positions (..., n), see `Components`."""

    def __init__(self, geometry: ChainGeometry, pi: Tensor, q: Tensor):
        self._geometry = geometry
        self._pi = [link.unbind(-1) for link in pi.to(q).unbind(-2)]
        self._q = q.unbind(-1)
        # Not torch.broadcast_shapes, whose first call imports sympy: more than a second.
        self._like = torch.zeros_like(torch.broadcast_tensors(q[..., 0], pi[..., 0, 0])[0])

    def mass_matrix(self) -> JointMatrix:
        """M(q) [kg m^2], column by column."""
        n = len(self._q)
        still, floating = [0.0] * n, replace(self._geometry, gravity=ZERO)
        columns = [
            self._torques(floating, still, [1.0 if k == j else 0.0 for k in range(n)])
            for j in range(n)
        ]
        # The half below the diagonal, which no link before the joint has a part in.
        rows = [[columns[min(i, j)][max(i, j)] for j in range(n)] for i in range(n)]
        return torch.stack([torch.stack(row, -1) for row in rows], -2)

    def torque(self, dq: BroadcastJoints | None) -> Joints:
        """S(q, dq) dq + g(q) [N m; N]; gravity alone without speeds."""
        still = [0.0] * len(self._q)
        rates = still if dq is None else dq.unbind(-1)
        return torch.stack(self._torques(self._geometry, rates, still), -1)

    def _torques(
        self, geometry: ChainGeometry, dq: Sequence[Scalar], ddq: Sequence[Scalar]
    ) -> list[Tensor]:
        torques, _ = forces(geometry, kinematics(geometry, self._q, dq, ddq), self._pi)
        return [torque + self._like for torque in torques]


def _posture(
    robot: Robot, q: Tensor, parameters: InertialParameters | None, most: int
) -> Posture | ComponentsAt:
    """By whichever is faster: with few kernel calls up to so many samples."""
    sets = 1 if parameters is None else parameters.pi[..., 0, 0].numel()
    if q[..., 0].numel() * sets > most:
        return Components(robot, parameters).at(q)
    if parameters is None and not robot.require_parameters(_WHAT).pi.requires_grad:
        return _arm(robot, q.dtype, q.device).at(q)
    return arms_of([robot], q, None if parameters is None else [parameters]).at(q)


@lru_cache(maxsize=64)
@torch.inference_mode(False)
def _arm(robot: Robot, dtype: torch.dtype, device: torch.device) -> Arms:
    """Made once: of a small batch that takes as long as all that is done with it."""
    return arms_of([robot], torch.empty(0, dtype=dtype, device=device))
