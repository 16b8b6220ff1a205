"""The wrench regressor of every joint, as dense blocks over the instants.

The wrench at joint i is linear in the parameters of links i to n (eq. 2.13 with unit parameters).
Blocks are made from the tip to the base: a joint's block is that of the joint beyond it, turned and
moved, and the columns of its own link. Everything is in the frames that move with the joints (z
along the axis), moments about the origins of the joint frames.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import torch

from torchid.dynamics.newton_euler import column_chunks
from torchid.dynamics.recursion import (
    ChainGeometry,
    JointGeometry,
    Link,
    Matrix,
    forces,
    kinematics,
)
from torchid.dynamics.scalars import ZERO, Scalar, Vec3, add3, add_cross, dot
from torchid.robot.inertia import PARAMETERS_PER_LINK
from torchid.typing import Float, Samples, Tensor
from torchid.wrenches.grouping import FORCE_KINDS, Kept, WrenchChain


@dataclass(frozen=True)
class WrenchBlock:
    """Wrench of one joint for unit values of its lumped parameters, over T instants.

    Attributes:
        force: (3, Cf, T).
        moment: (3, Cm, T) about the joint frame's origin; its first Cf columns belong to the
            parameters of `force`.
    """

    force: Float[Tensor, "3 Cf T"]
    moment: Float[Tensor, "3 Cm T"]


def block_chunks(
    chain: WrenchChain, q: Samples, dq: Samples, ddq: Samples, *, size: int
) -> Iterator[tuple[slice, list[WrenchBlock]]]:
    """Pieces of about `size` instants, each with the blocks of all joints, base to tip."""
    start = 0
    for motion in column_chunks(q, dq, ddq, size=size):
        stop = start + motion[0][0].shape[0]
        yield slice(start, stop), wrench_blocks(chain, *motion)
        start = stop


def wrench_blocks(
    chain: WrenchChain, q: Sequence[Tensor], dq: Sequence[Tensor], ddq: Sequence[Tensor]
) -> list[WrenchBlock]:
    """Blocks of all joints, base to tip, from n tensors (T,) each of q, dq, ddq."""
    links = kinematics(chain.geometry, q, dq, ddq)
    blocks: dict[int, WrenchBlock] = {}
    for i in reversed(range(chain.n)):
        block = _own_columns(chain.geometry.joints[i], links[i], like=q[0])
        for beyond in chain.children(i):
            # From the joint beyond to this one: to the link frame's origin, and on to the joint's.
            arm = add3(chain.geometry.joints[beyond].previous_offset, links[i].offset)
            rotation = links[beyond].rotation
            block = _joined(block, _carried(blocks[beyond], chain.kept[beyond], rotation, arm))
        blocks[i] = block
    return [blocks[i] for i in range(chain.n)]


def _own_columns(joint: JointGeometry, link: Link, like: Float[Tensor, " T"]) -> WrenchBlock:
    """Of the ten parameters of the joint's own link."""
    own = replace(joint, parent=-1, coordinate=0)
    alone = ChainGeometry((own,), ZERO, ((0,),))
    wrenches = []
    for k in range(PARAMETERS_PER_LINK):
        unit = [float(k == j) for j in range(PARAMETERS_PER_LINK)]
        wrenches.append(forces(alone, [link], [unit])[1][0])
    force = [_rows([f[axis] for f, _ in wrenches[:FORCE_KINDS]], like) for axis in range(3)]
    moment = [_rows([m[axis] for _, m in wrenches], like) for axis in range(3)]
    return WrenchBlock(torch.stack(force), torch.stack(moment))


def _rows(values: Sequence[Scalar], like: Float[Tensor, " T"]) -> Float[Tensor, "C T"]:
    return torch.stack([v if isinstance(v, Tensor) else torch.full_like(like, v) for v in values])


def _carried(block: WrenchBlock, kept: Kept, rotation: Matrix, arm: Vec3) -> WrenchBlock:
    """The block in the axes of the link before, about a point `arm` away (in those axes), without
    the columns that its own link has handed over."""
    forces_before, couples_before = FORCE_KINDS, PARAMETERS_PER_LINK - FORCE_KINDS
    n_forces = block.force.shape[1]
    stay = [*kept.forces, *range(forces_before, n_forces)]
    couples = [n_forces + k - FORCE_KINDS for k in kept.couples]
    stay_couples = [*couples, *range(n_forces + couples_before, block.moment.shape[1])]
    force = _turned(rotation, block.force[:, stay])
    moment = _turned(rotation, block.moment[:, stay + stay_couples])
    # Couples have no force and are the same about every point.
    of_forces, of_couples = moment[:, : len(stay)], moment[:, len(stay) :]
    moved = add_cross(Vec3(*of_forces.unbind(0)), arm, Vec3(*force.unbind(0)))
    return WrenchBlock(force, torch.cat([_stacked(moved), of_couples], 1))


def _turned(rotation: Matrix, block: Float[Tensor, "3 C T"]) -> Float[Tensor, "3 C T"]:
    vector = Vec3(*block.unbind(0))
    return _stacked(Vec3(*(dot(row, vector) for row in rotation)))


def _stacked(vector: Vec3) -> Float[Tensor, "3 C T"]:
    # Columns of a block are tensors and stay so: a row of a rotation is never all zeros.
    return torch.stack(cast(list[Tensor], list(vector)))


def _joined(own: WrenchBlock, beyond: WrenchBlock) -> WrenchBlock:
    """Columns of forces before those of couples, the own link's first in each."""
    n_own, n_forces = own.force.shape[1], beyond.force.shape[1]
    moment = [
        own.moment[:, :n_own],
        beyond.moment[:, :n_forces],
        own.moment[:, n_own:],
        beyond.moment[:, n_forces:],
    ]
    return WrenchBlock(torch.cat([own.force, beyond.force], 1), torch.cat(moment, 1))
