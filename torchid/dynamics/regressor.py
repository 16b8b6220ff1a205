"""Regressor of the rigid body: Y(q, dq, ddq) pi = tau (eq. 2.18).

The torque is linear in the parameters, so the regressor is its derivative. Two ways:

- `autograd`: only the force pass is taped, each parameter is a leaf with one value a sample, and
  one backward pass a torque row gives that row for all samples at once;
- `closed` (the default, and the faster): the same derivative written out, by virtual work.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from torchid.dynamics.newton_euler import column_chunks
from torchid.dynamics.recursion import (
    ChainGeometry,
    chain_geometry,
    forces,
    kinematics,
    regressor_columns,
)
from torchid.robot.inertia import PARAMETERS_PER_LINK, paper_order
from torchid.robot.model import Robot
from torchid.typing import Float, Joints

Method = Literal["closed", "autograd"]
CHUNK = 3064
"""Samples at a time; see newton_euler.CHUNK."""


@dataclass(frozen=True)
class LinkColumns:
    """Non-zero part of the regressor for one chunk of M samples.

    Attributes:
        columns: for link l (from 0) ten tensors (l + 1, M): the columns of its ten parameters in
            torchid's order for the torque rows 0..l. Rows below l are zero.
    """

    columns: tuple[tuple[Tensor, ...], ...]

    def row(self, i: int, parameters: Sequence[tuple[int, int]]) -> Float[Tensor, "P M"]:
        """Torque row i, for the given (link, parameter) pairs, all of links >= i."""
        return torch.stack([self.columns[link][k][i] for link, k in parameters])


def regressor_chunks(
    robot: Robot,
    q: Float[Tensor, "M n"],
    dq: Float[Tensor, "M n"],
    ddq: Float[Tensor, "M n"],
    *,
    method: Method = "closed",
    size: int = CHUNK,
) -> Iterator[LinkColumns]:
    """The regressor of M samples in chunks, non-zeros only."""
    geometry = chain_geometry(robot)
    make = _closed if method == "closed" else _by_autograd
    for motion in column_chunks(q, dq, ddq, size=size):
        yield LinkColumns(make(geometry, *motion))


def regressor(
    robot: Robot, q: Joints, dq: Joints, ddq: Joints, *, method: Method = "closed"
) -> Float[Tensor, "*batch n P"]:
    """Y (..., n, 10 n) with Y pi = tau, pi in the paper's order (eq. 2.5).

    Args:
        robot: kinematics and gravity.
        q, dq, ddq: (..., n) [rad, rad/s, rad/s^2; m for prismatic joints].
        method: `closed` or `autograd`.

    Returns:
        (..., n, 10 n), dense. For long logs prefer `regressor_chunks`, which keeps the non-zeros.
    """
    batch, n = q.shape[:-1], q.shape[-1]
    flat = [x.reshape(-1, n) for x in (q, dq, ddq)]
    pieces = [_dense(chunk, n) for chunk in regressor_chunks(robot, *flat, method=method)]
    dense = torch.cat(pieces) if pieces else q.new_zeros(0, n, PARAMETERS_PER_LINK * n)
    return dense[..., paper_order(n).to(q.device)].reshape(*batch, n, -1)


def _dense(chunk: LinkColumns, n: int) -> Float[Tensor, "M n P"]:
    blocks = []
    for link, columns in enumerate(chunk.columns):
        block = torch.stack(columns, -1).transpose(0, 1)
        blocks.append(torch.nn.functional.pad(block, (0, 0, 0, n - 1 - link)))
    return torch.cat(blocks, -1)


def _closed(
    geometry: ChainGeometry, q: Sequence[Tensor], dq: Sequence[Tensor], ddq: Sequence[Tensor]
) -> tuple[tuple[Tensor, ...], ...]:
    return tuple(regressor_columns(geometry, kinematics(geometry, q, dq, ddq)))


def _by_autograd(
    geometry: ChainGeometry, q: Sequence[Tensor], dq: Sequence[Tensor], ddq: Sequence[Tensor]
) -> tuple[tuple[Tensor, ...], ...]:
    n = len(q)
    links = kinematics(geometry, q, dq, ddq)
    with torch.enable_grad():
        leaves = [
            [torch.zeros_like(q[0]).requires_grad_() for _ in range(PARAMETERS_PER_LINK)]
            for _ in range(n)
        ]
        torques, _ = forces(geometry, links, leaves)
    rows: list[list[tuple[Tensor, ...]]] = []
    one = torch.ones_like(q[0])
    for i, torque in enumerate(torques):
        felt = [leaf for link in leaves[i:] for leaf in link]
        gradient = _gradient(torque, felt, one)
        k = PARAMETERS_PER_LINK
        rows.append([gradient[j : j + k] for j in range(0, len(gradient), k)])
    return tuple(
        tuple(
            torch.stack([rows[i][link - i][k] for i in range(link + 1)])
            for k in range(PARAMETERS_PER_LINK)
        )
        for link in range(n)
    )


def _gradient(torque: object, leaves: list[Tensor], one: Tensor) -> tuple[Tensor, ...]:
    if not isinstance(torque, Tensor) or not torque.requires_grad:
        return tuple(torch.zeros_like(one) for _ in leaves)
    found = torch.autograd.grad(torque, leaves, one, retain_graph=True, allow_unused=True)
    return tuple(torch.zeros_like(one) if g is None else g for g in found)
