"""What the functions of this room ask of their arguments, and how much they do at a time."""

from math import prod

import torch

from torchid.errors import TorchidError
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Tensor
from torchid.wrenches.grouping import WrenchChain

MEMORY_LIMIT = 4 * 2**30
"""Bytes that a call may take by default, results included."""

_CHUNK = 1000
"""Most instants whose blocks are held at a time."""

_BLOCK_COPIES = 3
"""Memory of the blocks while they are made, in their final size: 1.9 measured, rounded up."""


def check(robot: Robot, motion: tuple[Tensor, ...], parameters: InertialParameters) -> None:
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


def check_reference(robot: Robot, reference: InertialParameters) -> None:
    """Raise TorchidError unless the reference is one finite set of the robot."""
    if reference.pi.shape != (robot.n_links, PARAMETERS_PER_LINK):
        raise TorchidError(
            f"the reference does not fit robot '{robot.name}'.",
            got=f"shape {tuple(reference.pi.shape)}",
            expected=f"one set ({robot.n_links} links, {PARAMETERS_PER_LINK})",
        )
    if not torch.isfinite(reference.pi).all():
        raise TorchidError("the reference has parameters that are not finite.", expected="numbers")


def memory_after(result: tuple[int, ...], like: Tensor, memory_limit: int) -> int:
    """Bytes left for the work when the result is stored; TorchidError when it does not fit."""
    needed = prod(result) * like.element_size()
    if needed > memory_limit:
        raise TorchidError(
            f"the result alone takes {needed / 2**20:,.1f} MiB.",
            got=f"{' x '.join(str(s) for s in result)} numbers of {like.element_size()} bytes",
            expected=f"at most the memory limit, {memory_limit / 2**20:,.1f} MiB",
            hint="wrench_errors compares with a reference without storing wrenches; else take "
            "fewer sets or instants at a time, or raise memory_limit",
        )
    return memory_limit - needed


def chunk_size(chain: WrenchChain, like: Tensor, memory: int) -> int:
    """Instants whose blocks fit into the memory, 1 at the least."""
    each = 3 * chain.columns * like.element_size() * _BLOCK_COPIES
    # Chunks are made equal and may be half as long again (column_chunks).
    return max(1, min(_CHUNK, int(memory / each / 1.5)))
