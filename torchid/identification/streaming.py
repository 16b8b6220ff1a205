"""A long log reduced to the triangular factor of its base columns, in constant memory.

Torque i feels links >= i only, so each torque row has a factor of its own columns (see `rows`); the
factors are put on top of each other at the end.
"""

from collections.abc import Callable, Iterable
from functools import partial

import torch
from torch import Tensor

from torchid.dynamics.regressor import RegressorChunk, regressor_chunks
from torchid.errors import IdentificationError
from torchid.identification.base_parameters import BaseParameters
from torchid.identification.least_squares import TriangularFactor, combined_factor, stacked_factor
from torchid.identification.rows import layout
from torchid.robot.inertia import PARAMETERS_PER_LINK
from torchid.robot.model import Robot
from torchid.typing import Float, Samples

SEGMENT = 12280
"""Samples taken at a time."""


def reduce_to_factor(
    robot: Robot,
    base: BaseParameters,
    q: Samples,
    dq: Samples,
    ddq: Samples,
    tau: Samples,
    *,
    chunks: Callable[[Tensor, Tensor, Tensor], Iterable[RegressorChunk]] | None = None,
) -> Float[Tensor, "C C"]:
    """R of [Y_base tau] over all samples and joints, by one pass.

    Args:
        robot: kinematics and gravity.
        base: its base parameters, of the rigid body alone.
        q, dq, ddq: (T, n) [rad, rad/s, rad/s^2; m for prismatic joints].
        tau: (T, n) [N m; N].
        chunks: makes the regressor's chunks; `compiled_dynamics(robot).regressor_chunks` for long
            logs, the eager ones by default.

    Returns:
        (B + 1, B + 1) upper triangular with non-negative diagonal: the first B columns in the order
        of `base.independent`, the last the torque; R'R = [Y tau]'[Y tau]. Its last entry is the
        norm of the least-squares residual. Working memory does not depend on T.

    Raises:
        IdentificationError: base parameters with coefficients of effects, signals of different
            shapes.
    """
    if any(k >= PARAMETERS_PER_LINK * robot.n for k in base.independent):
        raise IdentificationError(
            "reduce_to_factor takes the rigid body's base parameters, without effects.",
            got=f"{len(base)} base parameters, {base.n_rigid} of the rigid body",
            hint="for a fit with effects use torchid.identification.identify",
        )
    shapes = [tuple(x.shape) for x in (q, dq, ddq, tau)]
    if len(set(shapes)) > 1 or q.shape[-1] != robot.n:
        raise IdentificationError(
            "q, dq, ddq and tau do not match each other or the robot.",
            got=shapes,
            expected=f"(T, {robot.n}) each",
        )
    columns = layout(robot, base, ())
    factors = [TriangularFactor(len(c) + 1, device=q.device) for c in columns.columns]
    start = 0
    for chunk in (chunks or partial(regressor_chunks, robot, size=SEGMENT))(q, dq, ddq):
        stop = start + chunk.like.shape[0]
        for i, (own, factor) in enumerate(zip(columns.rigid, factors, strict=True)):
            rows = [*(chunk.entry(i, *pair) for pair in own), tau[start:stop, i]]
            factor.add(torch.stack(rows).T)
        start = stop
    r = combined_factor([f.factor() for f in factors], columns.columns, columns.size)
    back = torch.tensor([*columns.order, columns.size], device=q.device).argsort()
    return stacked_factor([r[:, back]])
