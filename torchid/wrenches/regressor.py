"""Internal wrenches of many parameter sets on one motion (eq. 2.32).

A wrench is linear in the parameters of the links that its joint carries: the wrench regressor is
the recursion's answer for sets of one parameter each, and the wrenches of all sets at many instants
are matrix products with it. Products are made and worked on tile by tile, while they are in the
cache.

A set with a nan parameter has nan wrenches; the other sets do not notice. No gradients are kept.
"""

from collections.abc import Iterator
from math import prod
from typing import NamedTuple

import numpy as np
import torch

from torchid.dynamics.newton_euler import joint_wrenches, keep_freed_memory
from torchid.errors import TorchidError
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Float, Samples, Tensor

MEMORY_LIMIT = 4 * 2**30
"""Bytes that a result may take by default."""

SETS, INSTANTS = 128, 200
"""Most sets and instants in a tile: 128 x 200 x 6 numbers are 1.2 MB (the benchmark `wrenches`)."""


class Tile(NamedTuple):
    """Wrenches of k sets at one joint over t instants.

    Attributes:
        sets, joint, instants: which they are.
        wrench: (2, k, 3, t) force [N] and moment [N m].
    """

    sets: slice
    joint: int
    instants: slice
    wrench: Float[Tensor, "2 k 3 t"]


def wrench_tiles(
    robot: Robot, motion: tuple[Samples, Samples, Samples], pi: Float[Tensor, "K n 10"]
) -> Iterator[Tile]:
    """Wrenches of all sets as `internal_wrenches` has them, a tile at a time."""
    keep_freed_memory()
    links = robot.n_links
    unit = torch.eye(PARAMETERS_PER_LINK * links, dtype=pi.dtype, device=pi.device)
    units = InertialParameters(unit.reshape(-1, 1, links, PARAMETERS_PER_LINK))
    # Parameters of a link that make force: mass and first moment; the others are couples alone
    force_kinds = 4
    for instants in _spans(len(motion[0]), INSTANTS):
        q, dq, ddq = (x[instants] for x in motion)
        columns = joint_wrenches(robot, q, dq, ddq, units)
        # (joints, links, parameters of a link, 6, instants), of which a joint feels its own part.
        columns = columns.permute(2, 0, 3, 1).unflatten(1, (links, -1))
        for joint in range(links):
            carried = list(robot.descendants(joint))
            own = columns[joint, carried]
            parts = [
                (pi[:, carried, :kinds].flatten(1), part.flatten(2).flatten(0, 1))
                for kinds, part in ((force_kinds, own[:, :force_kinds, :3]), (None, own[:, :, 3:]))
            ]
            for sets in _spans(len(pi), SETS):
                made = torch.stack([felt[sets] @ block for felt, block in parts])
                yield Tile(sets, joint, instants, made.unflatten(-1, (3, -1)))


@torch.no_grad()
def internal_wrenches(
    robot: Robot,
    q: Samples,
    dq: Samples,
    ddq: Samples,
    parameters: InertialParameters,
    *,
    memory_limit: int = MEMORY_LIMIT,
) -> Float[Tensor, "K T n 6"]:
    """Wrenches of K sets at every joint and instant, all stored (eqs. 2.13, 2.32).

    Args:
        robot: kinematics and gravity.
        q, dq, ddq: (T, n) [rad, rad/s, rad/s^2; m for prismatic joints].
        parameters: (K, n, 10), of the device and dtype of the motion.
        memory_limit: bytes for the result.

    Returns:
        (K, T, n, 6) force [N], then moment [N m] about the origin of joint frame i, that link i-1
        exerts on link i, in axes of link frame i, as torchid.dynamics.newton_euler.joint_wrenches
        has them. In memory the instants of one component of one set are neighbours.

    Raises:
        TorchidError: motion or parameters do not fit the robot or each other, the motion is not
            finite, or the result exceeds the memory limit.
    """
    check_sets(robot, (q, dq, ddq), parameters)
    out = _empty((len(parameters.pi), robot.n_links, 6, len(q)), q, memory_limit)
    for sets, joint, instants, wrench in wrench_tiles(robot, (q, dq, ddq), parameters.pi):
        out[sets, joint, :3, instants], out[sets, joint, 3:, instants] = wrench
    return out.permute(0, 3, 1, 2)


def square_norms(wrench: Float[Tensor, "2 k 3 t"]) -> Float[Tensor, "2 k t"]:
    """Squares of the norms of forces and moments."""
    x, y, z = wrench.unbind(2)
    return (x * x).addcmul_(y, y).addcmul_(z, z)


def _spans(total: int, size: int) -> list[slice]:
    return [slice(start, min(start + size, total)) for start in range(0, total, size)]


def check_sets(
    robot: Robot, motion: tuple[Tensor, Tensor, Tensor], parameters: InertialParameters
) -> None:
    """Raise TorchidError unless motion and sets fit the robot, and the motion is finite."""
    instants = motion[0].shape[0] if motion[0].ndim else 0
    for name, x in zip(("q", "dq", "ddq"), motion, strict=True):
        if x.shape != (instants, robot.n):
            raise TorchidError(
                f"{name} does not fit robot '{robot.name}'.",
                got=f"shape {tuple(x.shape)}",
                expected=f"({instants} instants, {robot.n} joints)",
            )
        if not torch.isfinite(x).all():
            bad = torch.nonzero(~torch.isfinite(x))[0].tolist()
            raise TorchidError(
                f"{name} is not finite at instant {bad[0]} (from 0), joint {bad[1] + 1}.",
                got=x[bad[0], bad[1]].item(),
                expected="finite positions, velocities and accelerations",
            )
    if instants == 0:
        raise TorchidError("the motion has no instants.", expected="at least one")
    shape = parameters.pi.shape
    if len(shape) != 3 or shape[1:] != (robot.n_links, PARAMETERS_PER_LINK):
        raise TorchidError(
            f"the parameter sets do not fit robot '{robot.name}'.",
            got=f"shape {tuple(shape)}",
            expected=f"(sets, {robot.n_links} links, {PARAMETERS_PER_LINK})",
        )


def _empty(shape: tuple[int, ...], like: Tensor, memory_limit: int) -> Tensor:
    needed = prod(shape) * like.element_size()
    if needed > memory_limit:
        raise TorchidError(
            f"the result alone takes {needed / 2**20:,.1f} MiB.",
            got=f"{' x '.join(str(s) for s in shape)} numbers of {like.element_size()} bytes",
            expected=f"at most the memory limit, {memory_limit / 2**20:,.1f} MiB",
            hint="wrench_errors compares with a reference without storing wrenches; else take "
            "fewer sets or instants at a time, or raise memory_limit",
        )
    # NumPy asks Linux for huge pages: with small ones the first write takes longer than a product.
    return torch.from_numpy(np.empty(shape, like.cpu().numpy().dtype)).to(like.device)
