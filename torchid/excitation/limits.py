"""What a motion may use: position, velocity and acceleration limits of every joint."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.errors import RobotError
from torchid.excitation.fourier import FourierTrajectory
from torchid.robot.model import JointType, Robot
from torchid.typing import Float


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits that every joint has, for the design of motions.

    Attributes:
        position, velocity, acceleration: (n, 2) lower and upper [rad or m, per s, per s^2]; the
            last two contain 0.
        warnings: what was assumed, one sentence each.
    """

    position: Float[Tensor, "n 2"]
    velocity: Float[Tensor, "n 2"]
    acceleration: Float[Tensor, "n 2"]
    warnings: tuple[str, ...] = ()

    @property
    def middle(self) -> Float[Tensor, " n"]:
        """Middle of the position range (n,)."""
        return self.position.mean(-1)

    @property
    def half_range(self) -> Float[Tensor, " n"]:
        """Half of the position range (n,)."""
        return (self.position[:, 1] - self.position[:, 0]) / 2


def motion_limits(robot: Robot, *, usage: float = 1.0) -> MotionLimits:
    """The robot's limits, complete.

    A revolute joint without position limits is given one turn, +-pi, with a warning.

    Args:
        robot: its limits.
        usage: share of every limit that may be used, in (0, 1]; of positions about the middle.

    Raises:
        RobotError: velocity or acceleration limits are missing or do not contain 0, a prismatic
            joint has no position limits, or `usage` is out of range.
    """
    limits = robot.limits
    limits.require("velocity", "acceleration", robot=robot.name, purpose="excitation")
    assert limits.velocity is not None
    assert limits.acceleration is not None
    for name, bounds in (("velocity", limits.velocity), ("acceleration", limits.acceleration)):
        if bool(((bounds[:, 0] >= 0) | (bounds[:, 1] <= 0)).any()):
            raise RobotError(
                f"robot '{robot.name}': {name} limits that do not contain 0 let no joint rest.",
                got=bounds.tolist(),
            )
    position, warnings = position_limits(robot, usage)
    return MotionLimits(
        position,
        usage * limits.velocity,
        usage * limits.acceleration,
        warnings,
    )


def position_limits(
    robot: Robot, usage: float = 1.0
) -> tuple[Float[Tensor, "n 2"], tuple[str, ...]]:
    """The share of the position limits that may be used, about their middle; one turn where a
    revolute joint has none, and a sentence that says so.

    Raises:
        RobotError: a prismatic joint has none, or `usage` is out of range.
    """
    if not 0 < usage <= 1:
        raise RobotError(
            "the share of the limits to use is out of range.",
            got=usage,
            expected="above 0, at most 1",
        )
    given = robot.limits.position
    if given is None:
        given = torch.tensor([[-math.inf, math.inf]] * robot.n, dtype=torch.float64)
    lower, upper = given.unbind(-1)
    free = ~torch.isfinite(given).all(-1)
    slides = torch.tensor([kind is JointType.PRISMATIC for kind in robot.joint_types])
    if bool((free.cpu() & slides).any()):
        robot.limits.require("position", robot=robot.name, purpose="excitation of a sliding joint")
    # With one of the two given, the turn starts or ends there.
    low = torch.where(torch.isfinite(upper), upper - 2 * math.pi, -math.pi)
    high = torch.where(torch.isfinite(lower), lower + 2 * math.pi, math.pi)
    low = torch.where(torch.isfinite(lower), lower, low)
    high = torch.where(torch.isfinite(upper), upper, high)
    middle, half = (low + high) / 2, usage * (high - low) / 2
    joints = ", ".join(str(i + 1) for i in free.nonzero().flatten().tolist())
    warning = (
        f"robot '{robot.name}' has no position limits for joint {joints}: motions stay within "
        "one turn, +-pi where neither limit is given."
    )
    return torch.stack([middle - half, middle + half], -1), (warning,) if joints else ()


def largest_scale(trajectory: FourierTrajectory, limits: MotionLimits) -> Float[Tensor, "*batch n"]:
    """The largest factor (..., n) that keeps each joint inside its limits at every instant.

    Differentiable in the coefficients; infinite (1e12) for a joint that does not move. q0 must lie
    inside the position limits.
    """
    q, dq, ddq = trajectory.extremes()
    centre = trajectory.q0.unsqueeze(-1)
    room = limits.position.to(q) - centre, limits.velocity.to(q), limits.acceleration.to(q)
    scale = torch.full_like(trajectory.q0, 1e12)
    for extremes, bounds in zip((q - centre, dq, ddq), room, strict=True):
        # A motion that never goes up is not held by the upper limit.
        up = bounds[..., 1] / extremes[..., 1].clamp(min=1e-12)
        down = bounds[..., 0] / extremes[..., 0].clamp(max=-1e-12)
        scale = torch.minimum(scale, torch.minimum(up, down))
    # 1e-9: what a scale stays below the exact one, relative
    return scale * (1 - 1e-9)
