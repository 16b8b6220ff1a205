"""Wrenches of some sets over some instants, small enough to stay in the cache.

A tile is filled by two matrix products and worked on in place. Its memory and its views are made
once and used for all tiles of one size: making views would take as long as the arithmetic.
"""

from collections.abc import Iterator

import torch

from torchid.typing import Float, Tensor
from torchid.wrenches.blocks import WrenchBlock

SETS, INSTANTS = 128, 200
"""Most sets and instants in a tile: 128 x 200 x 6 numbers are 1.2 MB (benchmarks/wrenches.py)."""

Parameters = tuple[Tensor, Tensor]
"""Of k sets at one joint: those (k, Cf) that make the force and those (k, Cm) of the moment."""

Columns = tuple[Tensor, Tensor]
"""A block's part for t instants: force (Cf, 3 t) and moment (Cm, 3 t)."""


def spans(total: int, size: int) -> list[slice]:
    """0 to total in pieces of `size`, the last one shorter."""
    return [slice(start, min(start + size, total)) for start in range(0, total, size)]


def columns_of(block: WrenchBlock, instants: slice) -> Columns:
    """Some instants of a block, laid out for one matrix product."""
    force, moment = (
        x[..., instants].transpose(0, 1).flatten(1) for x in (block.force, block.moment)
    )
    return force, moment


class Tile:
    """Wrenches of k sets over t instants at one joint, in axes of its moved frame."""

    def __init__(self, sets: int, instants: int, like: Tensor):
        self._force = like.new_empty(sets, 3 * instants)
        self._moment = like.new_empty(sets, 3 * instants)
        shape = (sets, 3, instants)
        self.vectors = (self._force.view(shape), self._moment.view(shape))
        self._components = tuple(v.unbind(1) for v in self.vectors)
        self.squares = like.new_empty(2, sets, instants)
        self._each = self.squares.unbind(0)
        self._scratch = torch.empty_like(self.squares)
        self._tiny = like.new_full((), torch.finfo(like.dtype).tiny)

    def fill(self, parameters: Parameters, columns: Columns) -> None:
        """The wrenches themselves."""
        torch.mm(parameters[0], columns[0], out=self._force)
        torch.mm(parameters[1], columns[1], out=self._moment)

    def component(self, moment: bool, axis: int) -> Float[Tensor, "k t"]:
        """One component of the force or of the moment."""
        return self._components[moment][axis]

    def square_norms(self) -> Float[Tensor, "2 k t"]:
        """Squared norms of force and moment, in `squares` (overwritten by the next call)."""
        for (x, y, z), out in zip(self._components, self._each, strict=True):
            torch.mul(x, x, out=out).addcmul_(y, y).addcmul_(z, z)
        return self.squares

    def norms(self) -> Float[Tensor, "2 k t"]:
        """Norms of force and moment, in `squares`.

        x / sqrt(x) is exact to 2 units in the last place and, on processors other than Intel's,
        twice as fast as torch's sqrt. The smallest number in each square keeps 0 / 0 away: the
        norm of no force is 1e-154 N.
        """
        for (x, y, z), out in zip(self._components, self._each, strict=True):
            torch.addcmul(self._tiny, x, x, out=out).addcmul_(y, y).addcmul_(z, z)
        return self.squares.mul_(torch.rsqrt(self.squares, out=self._scratch))


class Tiles:
    """A tile for every size that comes up: full ones, and the last of a row or column."""

    def __init__(self, like: Tensor):
        self._like = like
        self._made: dict[tuple[int, int], Tile] = {}

    def of(self, sets: int, columns: Columns) -> Tile:
        """The tile for so many sets and the instants of these columns, made once."""
        size = (sets, columns[0].shape[1] // 3)
        if size not in self._made:
            self._made[size] = Tile(*size, self._like)
        return self._made[size]


def joint_tiles(
    tiles: Tiles, parameters: Parameters, block: WrenchBlock
) -> Iterator[tuple[slice, slice, Tile]]:
    """All tiles of a joint, filled in turn: sets, instants, tile (valid until the next)."""
    for instants in spans(block.force.shape[-1], INSTANTS):
        columns = columns_of(block, instants)
        for sets in spans(parameters[0].shape[0], SETS):
            tile = tiles.of(sets.stop - sets.start, columns)
            tile.fill((parameters[0][sets], parameters[1][sets]), columns)
            yield sets, instants, tile
