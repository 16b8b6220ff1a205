"""Regressor of the rigid body: Y(q, dq, ddq) pi = tau (eq. 2.18).

The torque is linear in the parameters, so the regressor is its derivative. Two ways:

- `autograd`: only the force pass is taped, each parameter is a leaf with one value a sample, and
  one backward pass a torque row gives that row for all samples at once;
- `closed` (the default, and the faster): the same derivative written out, by virtual work.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Literal

import torch
from torch import Tensor

from torchid.dynamics.newton_euler import CHUNK, column_chunks
from torchid.dynamics.recursion import (
    ChainGeometry,
    chain_geometry,
    forces,
    kinematics,
    regressor_rows,
)
from torchid.robot.inertia import PARAMETERS_PER_LINK
from torchid.robot.library import as_robot
from torchid.robot.model import Robot, RobotLike
from torchid.tensors import joint_signals
from torchid.typing import Float, Numbers

Method = Literal["closed", "autograd"]

_KINDS = ((0, 1), (1, 4), (4, 10))
"""Where mass, first moment and inertia are among a link's ten parameters."""


Rows = Sequence[Mapping[int, Sequence[Tensor | float | int]]]


@dataclass(frozen=True)
class RegressorChunk:
    """Non-zero part of the regressor for M samples.

    Attributes:
        rows: rows[i][l][k] is the entry of torque i for parameter k (torchid's order) of link l,
            from 0: a tensor (M,), a float where it is the same in all samples, or an int for that
            row of `stacked`. Links that coordinate i does not move do not enter torque i.
        like: (M,), any tensor of the samples' dtype and device.
        stacked: (E, M) entries in one piece, or None.
    """

    rows: Rows
    like: Float[Tensor, " M"]
    stacked: Float[Tensor, "E M"] | None = None

    def entry(self, i: int, link: int, k: int) -> Float[Tensor, " M"]:
        """Column of parameter k of a link (from 0) in torque row i (M,)."""
        entries = self.rows[i].get(link)
        value = 0.0 if entries is None else entries[k]
        if isinstance(value, Tensor):
            return value
        if isinstance(value, int):
            assert self.stacked is not None
            return self.stacked[value]
        return self.like.new_full((), value).expand_as(self.like)

    def row(self, i: int, parameters: Sequence[tuple[int, int]]) -> Float[Tensor, "P M"]:
        """Torque row i (P, M), for the given (link, parameter) pairs, both from 0."""
        return torch.stack([self.entry(i, link, k) for link, k in parameters])


def regressor_chunks(
    robot: Robot,
    q: Float[Tensor, "M n"],
    dq: Float[Tensor, "M n"],
    ddq: Float[Tensor, "M n"],
    *,
    method: Method = "closed",
    size: int | None = None,
) -> Iterator[RegressorChunk]:
    """The regressor of M samples in equal chunks of about `size`, non-zeros only.

    Args:
        robot: kinematics and gravity.
        q, dq, ddq: (M, n) [rad, rad/s, rad/s^2; m for prismatic joints].
        method: `closed` or `autograd`.
        size: samples a chunk; by default CHUNK.
    """
    geometry = chain_geometry(robot)
    make = _closed if method == "closed" else _by_autograd
    for motion in column_chunks(q, dq, ddq, size=size or CHUNK):
        yield RegressorChunk(make(geometry, *motion), motion[0][0])


def regressor(
    robot: RobotLike,
    q: Numbers,
    dq: Numbers,
    ddq: Numbers,
    *,
    method: Method = "closed",
) -> Float[Tensor, "*batch n P"]:
    """Y (..., n, 10 L) with Y pi = tau, pi in the paper's order (eq. 2.5).

    Args:
        robot: kinematics and gravity.
        q, dq, ddq: (..., n) [rad, rad/s, rad/s^2; m for prismatic joints]; arrays and lists too,
            in float64. Of tensors the widest dtype counts.
        method: `closed` or `autograd`.

    Returns:
        (..., n, 10 L), dense. For long logs prefer `regressor_chunks`, which keeps the non-zeros.

    Raises:
        TorchidError: not numbers of all joints.

    >>> import torch, torchid
    >>> robot = torchid.load_robot("3r")
    >>> q, dq, ddq = torch.rand(3, 50, robot.n, dtype=torch.float64)
    >>> y = regressor(robot, q, dq, ddq)
    >>> tau = y @ robot.parameters.to_paper_order()
    >>> y.shape, torch.allclose(tau, torchid.inverse_dynamics(robot, q, dq, ddq))
    (torch.Size([50, 3, 30]), True)
    """
    robot = as_robot(robot)
    motion = torch.broadcast_tensors(*joint_signals(robot.n, q=q, dq=dq, ddq=ddq))
    batch, n = motion[0].shape[:-1], motion[0].shape[-1]
    flat = [x.reshape(-1, n) for x in motion]
    columns = PARAMETERS_PER_LINK * robot.n_links
    dense = flat[0].new_zeros(flat[0].shape[0], n, columns)
    start = 0
    for chunk in regressor_chunks(robot, *flat, method=method):
        stop = start + chunk.like.shape[0]
        _write_dense(dense[start:stop], chunk)
        start = stop
    return dense.reshape(*batch, n, columns)


def _write_dense(out: Float[Tensor, "M n P"], chunk: RegressorChunk) -> None:
    """Write a chunk's non-zeros into zeros (M, n, 10 L), columns in the paper's order: all masses,
    then all first moments, then all inertias."""
    links = out.shape[-1] // PARAMETERS_PER_LINK
    # Samples transposed at a time, so that source and destination stay in the cache
    tile = 1000
    for i, entries in enumerate(chunk.rows):
        for run in _runs(list(entries)):
            for first, last in _KINDS:
                wanted = [(link, k) for link in run for k in range(first, last)]
                block = chunk.row(i, wanted)
                column = first * links + (last - first) * run[0]
                own = out[:, i, column : column + len(wanted)]
                for start in range(0, out.shape[0], tile):
                    own[start : start + tile] = block[:, start : start + tile].T


def _runs(links: Sequence[int]) -> list[list[int]]:
    """Links in order as pieces without gaps."""
    out: list[list[int]] = []
    for link in links:
        if not out or link != out[-1][-1] + 1:
            out.append([])
        out[-1].append(link)
    return out


def _closed(
    geometry: ChainGeometry, q: Sequence[Tensor], dq: Sequence[Tensor], ddq: Sequence[Tensor]
) -> Rows:
    return regressor_rows(geometry, kinematics(geometry, q, dq, ddq))


def _by_autograd(
    geometry: ChainGeometry, q: Sequence[Tensor], dq: Sequence[Tensor], ddq: Sequence[Tensor]
) -> Rows:
    links = kinematics(geometry, q, dq, ddq)
    with torch.enable_grad():
        leaves = [
            [torch.zeros_like(q[0]).requires_grad_() for _ in range(PARAMETERS_PER_LINK)]
            for _ in links
        ]
        torques, _ = forces(geometry, links, leaves)
    rows = []
    one = torch.ones_like(q[0])
    for torque, moved in zip(torques, geometry.moved, strict=True):
        felt = [leaf for link in moved for leaf in leaves[link]]
        gradient = iter(_gradient(torque, felt, one))
        rows.append({link: list(islice(gradient, PARAMETERS_PER_LINK)) for link in moved})
    return rows


def _gradient(torque: object, leaves: list[Tensor], one: Tensor) -> tuple[Tensor, ...]:
    if not isinstance(torque, Tensor) or not torque.requires_grad:
        return tuple(torch.zeros_like(one) for _ in leaves)
    found = torch.autograd.grad(torque, leaves, one, retain_graph=True, allow_unused=True)
    return tuple(torch.zeros_like(one) if g is None else g for g in found)
