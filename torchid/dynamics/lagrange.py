"""Euler-Lagrange equations by automatic differentiation of the energies (eqs. 2.8-2.11, 2.15).

Nothing here shares code with the Newton-Euler recursion: the energies come from chained 4x4 poses
T_i(q) and pseudo-inertias P_i,

    T = 1/2 sum_i tr(dT_i/dt P_i dT_i/dt'),      U = - sum_i [g' 0] T_i (m c, m)',

and everything else is a derivative of these two. It is the independent check of the recursion, and
the model to read; for speed use Newton-Euler.
"""

import torch
from torch import Tensor
from torch.func import grad, hessian, jacfwd, jvp, vmap

from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot, link_poses
from torchid.typing import Float, JointMatrix, Joints


def kinetic_energy(
    robot: Robot, q: Joints, dq: Joints, parameters: InertialParameters | None = None
) -> Float[Tensor, "*batch"]:
    """T(q, dq) (...) [J] (eq. 2.8)."""
    p = _given(robot, parameters).pseudo_inertia.to(q)
    velocity = jvp(lambda x: link_poses(robot, x), (q,), (dq,))[1]
    return 0.5 * torch.einsum("...iab,ibc,...iac->...", velocity, p, velocity)


def potential_energy(
    robot: Robot, q: Joints, parameters: InertialParameters | None = None
) -> Float[Tensor, "*batch"]:
    """U(q) (...) [J], zero at the base frame's origin (eq. 2.9)."""
    last_column = _given(robot, parameters).pseudo_inertia.to(q)[..., :, 3]
    poses = link_poses(robot, q)
    return -torch.einsum("a,...iab,ib->...", robot.gravity.to(q), poses[..., :3, :], last_column)


def mass_matrix(
    robot: Robot, q: Joints, parameters: InertialParameters | None = None
) -> JointMatrix:
    """M(q) (..., n, n): the Hessian of T with respect to dq (eq. 2.10)."""

    def one(x: Tensor) -> Tensor:
        return hessian(lambda rate: kinetic_energy(robot, x, rate, parameters))(torch.zeros_like(x))

    return _over_batch(one, q)


def gravity_torque(robot: Robot, q: Joints, parameters: InertialParameters | None = None) -> Joints:
    """g(q) (..., n): the gradient of U (eq. 2.11)."""

    def energy(x: Tensor) -> Tensor:
        return potential_energy(robot, x, parameters)

    return _over_batch(grad(energy), q)


def coriolis_matrix(
    robot: Robot, q: Joints, dq: Joints, parameters: InertialParameters | None = None
) -> JointMatrix:
    """S(q, dq) (..., n, n) by Christoffel symbols of M, so that dM/dt - 2 S is skew-symmetric:

    S_ij = 1/2 sum_k (dM_ij/dq_k + dM_ik/dq_j - dM_jk/dq_i) dq_k.
    """

    def one(x: Tensor, rate: Tensor) -> Tensor:
        dm = jacfwd(lambda y: mass_matrix(robot, y, parameters))(x)
        return 0.5 * (
            torch.einsum("ijk,k->ij", dm, rate)
            + torch.einsum("ikj,k->ij", dm, rate)
            - torch.einsum("jki,k->ij", dm, rate)
        )

    return _over_batch(one, q, dq)


def inverse_dynamics(
    robot: Robot,
    q: Joints,
    dq: Joints,
    ddq: Joints,
    parameters: InertialParameters | None = None,
) -> Joints:
    """tau = M(q) ddq + S(q, dq) dq + g(q) (..., n) [N m; N for prismatic joints] (eq. 2.15).

    Args:
        robot: kinematics and gravity.
        q, dq, ddq: (..., n) [rad, rad/s, rad/s^2; m for prismatic joints].
        parameters: one set (L, 10); the robot's nominal ones if None.

    Raises:
        RobotError: no parameters given and none in the robot.
    """
    inertial = mass_matrix(robot, q, parameters) @ ddq.unsqueeze(-1)
    coriolis = coriolis_matrix(robot, q, dq, parameters) @ dq.unsqueeze(-1)
    return (inertial + coriolis).squeeze(-1) + gravity_torque(robot, q, parameters)


def _given(robot: Robot, parameters: InertialParameters | None) -> InertialParameters:
    return parameters or robot.require_parameters("the Euler-Lagrange equations")


def _over_batch(function, *inputs: Tensor) -> Tensor:  # type: ignore[no-untyped-def]
    batch, n = inputs[0].shape[:-1], inputs[0].shape[-1]
    if not batch:
        return function(*inputs)
    if 0 in batch:
        one = function(*(x.new_zeros(n) for x in inputs))
        return one.new_zeros(*batch, *one.shape)
    out = vmap(function, chunk_size=512)(*(x.reshape(-1, n) for x in inputs))
    return out.reshape(*batch, *out.shape[1:])
