"""Errors of the internal wrenches of many parameter sets against a reference set.

The difference of the wrenches is the wrench of the difference of the parameters. Sums and maxima
over the instants are taken tile by tile, while the products are in the cache.
"""

from dataclasses import dataclass

import torch

from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Robot
from torchid.typing import Float, Int, Samples, Tensor
from torchid.wrenches import tiles as sizes
from torchid.wrenches.blocks import WrenchBlock, block_chunks
from torchid.wrenches.grouping import lumped_parameters, wrench_chain
from torchid.wrenches.request import MEMORY_LIMIT, check, check_reference, chunk_size
from torchid.wrenches.tiles import Columns, Parameters, Tile, Tiles, columns_of, spans


@dataclass(frozen=True)
class WrenchErrors:
    """How far the wrenches of K sets are from a reference set's, per set and joint, over a motion.

    Attributes:
        force_rms, moment_rms: (K, n) root mean square over the instants of the norm of the
            difference of the force [N] or moment [N m] vectors.
        force_max, moment_max: (K, n) its largest value.
        force_norm_rms, moment_norm_rms: (K, n) root mean square of the difference of the norms,
            | ||w|| - ||w_ref|| |: what plots of norms show (the report's figures 5.6 to 5.19). It
            is never larger than the first, and can be small when that is not.
        torque_rms: (K, n) root mean square of the difference of the joint torques [N m; N for
            prismatic joints]: 0 up to rounding for sets with the reference's base parameters.
        reference_force_rms, reference_moment_rms: (n,) root mean square of the norms of the
            reference's own force [N] and moment [N m].
    """

    force_rms: Float[Tensor, "K n"]
    moment_rms: Float[Tensor, "K n"]
    force_max: Float[Tensor, "K n"]
    moment_max: Float[Tensor, "K n"]
    force_norm_rms: Float[Tensor, "K n"]
    moment_norm_rms: Float[Tensor, "K n"]
    torque_rms: Float[Tensor, "K n"]
    reference_force_rms: Float[Tensor, " n"]
    reference_moment_rms: Float[Tensor, " n"]


@torch.no_grad()
def wrench_errors(
    robot: Robot,
    q: Samples,
    dq: Samples,
    ddq: Samples,
    parameters: InertialParameters,
    reference: InertialParameters,
    *,
    memory_limit: int = MEMORY_LIMIT,
) -> WrenchErrors:
    """Errors of the wrenches of K sets against a reference set's, never storing the wrenches.

    The difference of the wrenches is the wrench of the difference of the parameters, so errors far
    smaller than the wrenches keep their digits.

    Args:
        robot, q, dq, ddq, parameters: as for `internal_wrenches`, with T >= 1.
        reference: (n, 10), finite.
        memory_limit: bytes for the work, which is done in smaller chunks of instants if needed.

    Raises:
        TorchidError: motion, parameters or reference do not fit the robot or each other, or are
            not finite where they have to be, or the work does not fit into the memory limit.
    """
    check(robot, (q, dq, ddq), parameters)
    check_reference(robot, reference)
    chain = wrench_chain(robot)
    lumped = lumped_parameters(chain, parameters.pi - reference.pi)
    lumped_reference = lumped_parameters(chain, reference.pi.unsqueeze(0))
    sums = [
        _JointSums(*joint, q)
        for joint in zip(robot.joint_types, lumped, lumped_reference, strict=True)
    ]
    tiles, reference_tiles = Tiles(q), Tiles(q)
    for _, blocks in block_chunks(chain, q, dq, ddq, size=chunk_size(chain, q, memory_limit)):
        for joint, block in zip(sums, blocks, strict=True):
            joint.add(block, tiles, reference_tiles)
    fields = zip(*(joint.means(q.shape[0]) for joint in sums), strict=True)
    return WrenchErrors(*(torch.stack(x, -1) for x in fields))


class _JointSums:
    """Running sums and maxima of all sets at one joint."""

    def __init__(
        self, kind: JointType, parameters: Parameters, reference: Parameters, like: Tensor
    ):
        k = parameters[0].shape[0]
        self._squares, self._largest, self._of_norms = (like.new_zeros(2, k) for _ in range(3))
        self._torque, self._of_reference = like.new_zeros(k), like.new_zeros(2)
        self._reference = reference
        self._parts = [
            _PartSums(
                kind,
                (parameters[0][sets], parameters[1][sets]),
                self._squares[:, sets],
                self._largest[:, sets],
                self._of_norms[:, sets],
                self._torque[sets],
            )
            for sets in spans(k, sizes.SETS)
        ]

    def add(self, block: WrenchBlock, tiles: Tiles, reference_tiles: Tiles) -> None:
        """Take in more instants."""
        for instants in spans(block.force.shape[-1], sizes.INSTANTS):
            columns = columns_of(block, instants)
            reference = reference_tiles.of(1, columns)
            reference.fill(self._reference, columns)
            self._of_reference += reference.square_norms().sum((1, 2))
            reference.norms()
            for part in self._parts:
                part.add(tiles.of(len(part.torque), columns), columns, reference)

    def means(self, instants: int) -> list[Tensor]:
        """The fields of WrenchErrors at this joint, in their order."""
        return [
            *(self._squares / instants).sqrt(),
            *self._largest.sqrt(),
            *(self._of_norms / instants).sqrt(),
            (self._torque / instants).sqrt(),
            *(self._of_reference / instants).sqrt(),
        ]


@dataclass(frozen=True)
class _PartSums:
    """Views of the sums for the sets of one tile, added to in place."""

    kind: JointType
    parameters: Parameters
    squares: Float[Tensor, "2 k"]
    largest: Float[Tensor, "2 k"]
    of_norms: Float[Tensor, "2 k"]
    torque: Float[Tensor, " k"]

    def add(self, tile: Tile, columns: Columns, reference: Tile) -> None:
        """Take in a tile of instants, given the reference's norms there."""
        tile.fill(self.parameters, columns)
        squares = tile.square_norms()
        self.squares.add_(squares.sum(-1))
        torch.maximum(self.largest, squares.amax(-1), out=self.largest)
        # The axis is z in these frames.
        torque = torch.linalg.vector_norm(
            tile.component(self.kind is JointType.REVOLUTE, 2), dim=-1
        )
        self.torque.addcmul_(torque, torque)
        for vector, of_reference in zip(tile.vectors, reference.vectors, strict=True):
            vector.add_(of_reference)
        apart = torch.linalg.vector_norm(tile.norms().sub_(reference.squares), dim=-1)
        self.of_norms.addcmul_(apart, apart)


def alike(force: Float[Tensor, "K n"], group: Int[Tensor, " K"] | None = None) -> Int[Tensor, " K"]:
    """Which sets are one and the same (K,): those of a group whose forces agree to 0.1 %.

    Where a loss has one minimiser all runs of a search end there: one observation, not fifty.

    Args:
        force: (K, n) force errors [N].
        group: (K,) sets of different groups are never the same; one group if None.
    """
    digits = (force.clamp(min=1e-9).log() * 1e3).round().nan_to_num(0.0).long()
    own = torch.zeros_like(digits[:, 0]) if group is None else group
    return torch.unique(torch.cat([own.unsqueeze(-1), digits], -1), dim=0, return_inverse=True)[1]
