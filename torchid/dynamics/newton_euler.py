"""Newton-Euler inverse dynamics (eqs. 2.12-2.14) and the wrench at every joint (eq. 2.32)."""

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor

from torchid.dynamics.recursion import chain_geometry, forces, kinematics
from torchid.dynamics.scalars import Scalar
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import as_robot
from torchid.robot.model import Robot, RobotLike
from torchid.tensors import joint_signals
from torchid.typing import Float, Joints, Numbers, Wrenches

CHUNK = 12280
"""Samples at a time: long enough to hide the cost of a kernel call, short enough for the cache, and
not a power of two, whose strides share cache lines."""

_KEEP_FREED_BYTES = 31 * 2**20


def inverse_dynamics(
    robot: RobotLike,
    q: Numbers,
    dq: Numbers,
    ddq: Numbers,
    parameters: InertialParameters | None = None,
) -> Joints:
    """Joint torques of the rigid body, tau = M(q) ddq + S(q, dq) dq + g(q) (eq. 2.15), without the
    robot's effects, which `torchid.inverse_dynamics` adds.

    Args:
        robot: kinematics and gravity.
        q, dq, ddq: (..., n) [rad, rad/s, rad/s^2; m for prismatic joints]; arrays and lists too,
            in float64. Of tensors the widest dtype counts.
        parameters: (..., L, 10), leading axes broadcast against those of q; the robot's nominal
            ones if None.

    Returns:
        (..., n) [N m; N for prismatic joints], positive along the axis.

    Raises:
        RobotError: no parameters given and none in the robot.
        TorchidError: not numbers of all joints.
    """
    robot = as_robot(robot)
    state = joint_signals(robot.n, q=q, dq=dq, ddq=ddq)
    parameters = parameters or robot.require_parameters("inverse dynamics")
    return _along(robot, state, parameters, lambda torques, _, like: _stack(torques, like))


def joint_wrenches(
    robot: RobotLike,
    q: Numbers,
    dq: Numbers,
    ddq: Numbers,
    parameters: InertialParameters | None = None,
) -> Wrenches:
    """Internal wrenches: what each link is given through its joint by the link that carries it
    (eqs. 2.13, 2.32).

    Args:
        robot: kinematics and gravity.
        q, dq, ddq: (..., n) [rad, rad/s, rad/s^2; m for prismatic joints]; arrays and lists too,
            in float64.
        parameters: (..., L, 10), leading axes broadcast against those of q; the robot's nominal
            ones if None.

    Returns:
        (..., L, 6): force [N], then moment [N m] about the origin of joint frame i (O_{i-1} for
        classical DH), both in axes of link frame i. The component along the axis is the torque.

    Raises:
        RobotError: no parameters given and none in the robot.
        TorchidError: not numbers of all joints.

    >>> import torchid
    >>> robot = torchid.load_robot("3r")
    >>> w = joint_wrenches(robot, [0.1, -0.4, 0.7], [0, 0, 0], [0, 0, 0])  # at rest
    >>> weight = 9.81 * float(robot.parameters.mass.sum())  # which the first joint carries
    >>> w.shape, round(float(w[0, :3].norm()) / weight, 9)
    (torch.Size([3, 6]), 1.0)
    """
    robot = as_robot(robot)
    state = joint_signals(robot.n, q=q, dq=dq, ddq=ddq)
    parameters = parameters or robot.require_parameters("internal wrenches")

    def rows(_: Any, wrenches: Any, like: Tensor) -> Tensor:
        return torch.stack([_stack([*force, *moment], like) for force, moment in wrenches], -2)

    return _along(robot, state, parameters, rows)


def _along(
    robot: Robot,
    state: Sequence[Tensor],
    parameters: InertialParameters,
    stacked: Callable[[Any, Any, Tensor], Tensor],
) -> Tensor:
    """Torques and wrenches of the recursion along states (..., n), stacked."""
    q, dq, ddq = state
    pi, geometry = parameters.pi.to(q), chain_geometry(robot)

    def stacked_forces(motion: Sequence[Sequence[Tensor]], like: Tensor) -> Tensor:
        return stacked(*forces(geometry, kinematics(geometry, *motion), components(pi)), like)

    if pi.ndim > 2:
        return stacked_forces([x.unbind(-1) for x in (q, dq, ddq)], _broadcast_like(q, pi))
    return _in_chunks(stacked_forces, q, dq, ddq)


def components(pi: Float[Tensor, "*batch n 10"]) -> list[list[Scalar]]:
    """Each parameter as a float where it is one number, which folds it into the kernels."""
    if pi.ndim == 2 and not pi.requires_grad:
        return pi.tolist()
    return [list(link.unbind(-1)) for link in pi.unbind(-2)]


def _broadcast_like(q: Tensor, pi: Tensor) -> Tensor:
    # Not torch.broadcast_shapes, whose first call imports sympy: more than a second.
    return q.new_zeros(torch.broadcast_tensors(q[..., 0], pi[..., 0, 0])[0].shape)


def _stack(values: Sequence[Scalar], like: Tensor) -> Tensor:
    full = [
        v.expand_as(like) if isinstance(v, Tensor) else torch.full_like(like, v) for v in values
    ]
    return torch.stack(full, -1)


@cache
def keep_freed_memory() -> None:
    """Have the C library keep freed memory instead of giving every chunk's back to the system.

    glibc raises its threshold for that to the largest mapped block (up to 32 MB) it has seen freed.
    Without this, each chunk asks for its pages again, which doubles the time of a regressor.
    """
    torch.empty(_KEEP_FREED_BYTES, dtype=torch.uint8)


def column_chunks(*signals: Float[Tensor, "M n"], size: int) -> Iterator[list[tuple[Tensor, ...]]]:
    """Equal pieces of about `size` samples (at most 1.5 times), each signal as n contiguous columns
    (m,). Equal, because a short tail costs as many kernel calls as a full piece."""
    keep_freed_memory()
    total = signals[0].shape[0]
    pieces = max(1, round(total / size))
    step = max(1, -(-total // pieces))
    for start in range(0, total, step):
        # Stacking columns is a third faster than making the transpose contiguous.
        yield [torch.stack(x[start : start + step].unbind(1)).unbind(0) for x in signals]


def _in_chunks(function, q: Tensor, dq: Tensor, ddq: Tensor) -> Tensor:  # type: ignore[no-untyped-def]
    q, dq, ddq = torch.broadcast_tensors(q, dq, ddq)
    batch, n = q.shape[:-1], q.shape[-1]
    flat = [x.reshape(-1, n) for x in (q, dq, ddq)]
    if flat[0].shape[0] == 0:
        pieces = [function([x.T.unbind(0) for x in flat], q.new_zeros(0))]
    else:
        pieces = [function(m, m[0][0]) for m in column_chunks(*flat, size=CHUNK)]
    out = torch.cat(pieces)
    return out.reshape(*batch, *out.shape[1:])
