"""Which values of an effect's shape parameters are tried at first, on a joint's own motion."""

import math
from collections.abc import Sequence
from itertools import product

import torch

from torchid.effects.base import JointEffect, Motion, Shape
from torchid.typing import Float, Tensor

MOST_RIPPLES = 120
"""Wave numbers tried on a joint."""


def grid_of(
    motions: Sequence[Motion], kind: type[JointEffect], joint: int, cutoff: float
) -> Float[Tensor, "S P"]:
    """Values of the shape parameters tried at first, one combination a row."""
    if kind.name == "cogging":
        return _wave_numbers(motions, joint, cutoff).unsqueeze(-1)
    scales = [scale_of(motions, s, joint) for s in kind.shapes]
    values = [[v * k for v in s.grid] for s, k in zip(kind.shapes, scales, strict=True)]
    return torch.tensor(list(product(*values)), dtype=torch.float64)


def scale_of(motions: Sequence[Motion], shape: Shape, joint: int) -> float:
    """What a shape's bounds and grid are relative to, on this joint."""
    if shape.scale == "one":
        return 1.0
    if shape.scale == "travel":
        return max(1e-9, _travel(motions, joint))
    torques = [m.require("torque", "a grid") for m in motions]
    x = [m.dq for m in motions] if shape.scale == "speed" else torques
    size = torch.cat([s[:, joint] for s in x]).abs()
    return max(1e-9, float(torch.quantile(size[:: max(1, len(size) // 100_000)], 0.99)))


def _travel(motions: Sequence[Motion], joint: int) -> float:
    q = torch.cat([m.q[:, joint] for m in motions])
    return float(q.max() - q.min())


def _wave_numbers(motions: Sequence[Motion], joint: int, cutoff: float) -> Float[Tensor, " S"]:
    """Wave numbers that the log resolves: half a period apart over the joint's travel, from one
    and a half periods up to where the ripple leaves the band at half the usual speed."""
    travel = _travel(motions, joint)
    if travel < 1e-3:
        return torch.empty(0, dtype=torch.float64)
    step = math.pi / travel
    speed = torch.cat([m.dq[:, joint] for m in motions]).abs().median()
    highest = 2 * math.pi * cutoff / max(1e-6, 0.5 * float(speed))
    count = min(MOST_RIPPLES, int(highest / step) - 2)
    return step * (3 + torch.arange(max(0, count), dtype=torch.float64))
