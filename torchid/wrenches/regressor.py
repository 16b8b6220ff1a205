"""Internal wrenches of many parameter sets on one motion (eq. 2.32).

The kinematics is computed once. The wrench at a joint is then a block of the wrench regressor
(torchid.wrenches.blocks) times the sets' lumped parameters (torchid.wrenches.grouping): matrix
products of all sets and many instants at once.

A set with a nan parameter has nan wrenches; the other sets do not notice. No gradients are kept.
"""

import numpy as np
import torch

from torchid.errors import TorchidError
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Float, Samples, Tensor
from torchid.wrenches.blocks import block_chunks
from torchid.wrenches.grouping import lumped_parameters, wrench_chain
from torchid.wrenches.request import MEMORY_LIMIT, check, chunk_size, memory_after
from torchid.wrenches.tiles import Tiles, joint_tiles


@torch.no_grad()
def internal_wrenches(
    robot: Robot,
    q: Samples,
    dq: Samples,
    ddq: Samples,
    parameters: InertialParameters,
    *,
    memory_limit: int = MEMORY_LIMIT,
    out: Float[Tensor, "K T n 6"] | None = None,
) -> Float[Tensor, "K T n 6"]:
    """Wrenches of K sets at every joint and instant, all stored (eqs. 2.13, 2.32).

    Args:
        robot: kinematics and gravity.
        q, dq, ddq: (T, n) [rad, rad/s, rad/s^2; m for prismatic joints].
        parameters: (K, n, 10), of the device and dtype of the motion.
        memory_limit: bytes for the result and the work.
        out: the result of an earlier call for as many sets and instants, to be overwritten and
            returned. The first write to new memory can take longer than the arithmetic.

    Returns:
        (K, T, n, 6) force [N], then moment [N m] about the origin of joint frame i, that link i-1
        exerts on link i, in axes of link frame i, as torchid.dynamics.newton_euler.joint_wrenches
        has them. In memory the instants of one component of one set are neighbours.

    Raises:
        TorchidError: motion or parameters do not fit the robot or each other, the motion is not
            finite, the result exceeds the memory limit, or `out` is no earlier result.
    """
    check(robot, (q, dq, ddq), parameters)
    chain = wrench_chain(robot)
    shape = (parameters.pi.shape[0], robot.n_links, 6, q.shape[0])
    left = memory_after(shape, q, memory_limit)
    stored = _empty(shape, q) if out is None else _earlier(out, shape, q)
    lumped = lumped_parameters(chain, parameters.pi)
    axes = chain.link_axes.to(q)
    for instants, blocks in block_chunks(chain, q, dq, ddq, size=chunk_size(chain, q, left)):
        for i, (block, (for_force, for_moment)) in enumerate(zip(blocks, lumped, strict=True)):
            _products(for_force, _rotated(axes[i], block.force), stored[:, i, :3, instants])
            _products(for_moment, _rotated(axes[i], block.moment), stored[:, i, 3:, instants])
    return stored.permute(0, 3, 1, 2)


@torch.no_grad()
def wrench_norms(
    robot: Robot,
    q: Samples,
    dq: Samples,
    ddq: Samples,
    parameters: InertialParameters,
    *,
    memory_limit: int = MEMORY_LIMIT,
) -> tuple[Float[Tensor, "K T n"], Float[Tensor, "K T n"]]:
    """Norms of the internal forces and moments of K sets, which the report plots (section 2.4).

    Args:
        robot, q, dq, ddq, parameters, memory_limit: as for `internal_wrenches`.

    Returns:
        (K, T, n) norms of the forces [N], and of the moments about the origins of the joint frames
        [N m]. In memory the instants are neighbours.

    Raises:
        TorchidError: as for `internal_wrenches`.
    """
    check(robot, (q, dq, ddq), parameters)
    chain = wrench_chain(robot)
    shape = (2, parameters.pi.shape[0], robot.n_links, q.shape[0])
    left = memory_after(shape, q, memory_limit)
    out = _empty(shape, q)
    lumped, tiles = lumped_parameters(chain, parameters.pi), Tiles(q)
    for span, blocks in block_chunks(chain, q, dq, ddq, size=chunk_size(chain, q, left)):
        for i, block in enumerate(blocks):
            for sets, part, tile in joint_tiles(tiles, lumped[i], block):
                where = slice(span.start + part.start, span.start + part.stop)
                out[:, sets, i, where] = tile.norms()
    force, moment = out.transpose(-1, -2)
    return force, moment


def _products(
    parameters: Float[Tensor, "K C"], block: Float[Tensor, "3 C T"], out: Float[Tensor, "K 3 T"]
) -> None:
    for axis in range(3):
        torch.mm(parameters, block[axis], out=out[:, axis])


def _rotated(
    rotation: Float[Tensor, "3 3"], block: Float[Tensor, "3 C T"]
) -> Float[Tensor, "3 C T"]:
    return (rotation @ block.flatten(1)).reshape(block.shape)


def _earlier(
    out: Float[Tensor, "K T n 6"], shape: tuple[int, ...], like: Tensor
) -> Float[Tensor, "K n 6 T"]:
    stored = out.permute(0, 2, 3, 1)
    same_kind = (out.dtype, out.device) == (like.dtype, like.device)
    if stored.shape != shape or not same_kind or not stored.is_contiguous():
        raise TorchidError(
            "`out` is not an earlier result for as many sets and instants.",
            got=f"shape {tuple(out.shape)}, strides {out.stride()}, {out.dtype}, {out.device}",
            expected=f"(sets, instants, joints, 6) of {(shape[0], shape[3], shape[1], 6)}, as "
            f"internal_wrenches returns it, {like.dtype}, {like.device}",
        )
    return stored


def _empty(shape: tuple[int, ...], like: Tensor) -> Tensor:
    """As torch.empty. On a CPU the memory comes from NumPy, which asks Linux for huge pages: with
    small ones the first write takes longer than the wrenches themselves."""
    if like.device.type != "cpu":
        return like.new_empty(shape)
    return torch.from_numpy(np.empty(shape, dtype=like.new_empty(0).numpy().dtype))
