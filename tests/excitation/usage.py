"""Designs that use all of the limits, and how much of its limits a motion uses."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from torchid.effects.base import JointEffect
from torchid.excitation.design import Excitation, excite
from torchid.excitation.fourier import Extremes
from torchid.excitation.limits import MotionLimits
from torchid.robot.model import Robot
from torchid.typing import Float


def limit_usage(extremes: Extremes, limits: MotionLimits) -> Float[Tensor, "3 *batch n"]:
    """Share of the limits used (3, ..., n): position, velocity, acceleration; above 1 is too much.

    Args:
        extremes: lower and upper values, each (..., n, 2), as `FourierTrajectory.extremes`.
        limits: of the robot; positions are measured from the middle of their range.
    """
    bounds = torch.stack([limits.position, limits.velocity, limits.acceleration]).to(extremes.q)
    middle = torch.zeros_like(bounds[..., :1])
    middle[0] = bounds[0].mean(-1, keepdim=True)
    shares = [
        ((value - centre) / (bound - centre)).amax(-1)
        for value, bound, centre in zip(extremes, bounds, middle, strict=True)
    ]
    return torch.stack(shares)


def full_design(robot: Robot, effects: Sequence[JointEffect] = (), **settings: Any) -> Excitation:
    """A design for a robot without effects, unless given, by all of its limits."""
    return excite(robot, effects=effects, **({"usage": 1.0} | settings))
