"""What effects of the model share: their places on the arm, and the model's torque itself."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.one_joint import torques_of_one_joint
from torchid.effects.base import Coefficient, Effect, ModelEffect, Motion
from torchid.robot.model import Robot
from torchid.typing import Float


class ArmCoefficient(Coefficient):
    """A coefficient of the arm's bodies or poses: its unit does not depend on a joint's kind."""

    def unit_for(self, prismatic: bool) -> str:
        """The unit, on any joint."""
        return self.unit


@dataclass(frozen=True)
class OneJointEffect(ModelEffect):
    """A model effect located at one joint.

    Attributes:
        joint: index of the joint, from 0.
    """

    joint: int

    where = "one joint (`joint`)"

    @property
    def joints(self) -> tuple[int, ...]:
        """The joint that it acts on, as a tuple."""
        return (self.joint,)

    @classmethod
    def candidates(cls, robot: Robot) -> list[Effect]:
        """One on every joint that a motor drives."""
        return [cls(joint) for joint in robot.driven]


@dataclass(frozen=True)
class JointPairEffect(OneJointEffect):
    """A model effect of one joint on another.

    Attributes:
        joint: index of the joint it acts on, from 0.
        source_joint: index of the other joint, from 0.
    """

    source_joint: int

    where = "a pair of joints (`joint`, `source_joint`)"

    def __post_init__(self) -> None:
        if self.joint == self.source_joint:
            raise ValueError("joint and source_joint must differ")

    @classmethod
    def candidates(cls, robot: Robot) -> list[Effect]:
        """One on every ordered pair of joints that motors drive."""
        joints = robot.driven
        return [cls(j, source) for j in joints for source in joints if j != source]


def needed(robot: Robot | None, effect: str) -> Robot:
    """The robot, which an effect needs; a ValueError (of the programmer) without it."""
    if robot is None:
        raise ValueError(f"{effect} needs the robot.")
    return robot


def rigid_torque(
    robot: Robot,
    q: Float[Tensor, "*batch n"],
    dq: Float[Tensor, "*batch n"],
    ddq: Float[Tensor, "*batch n"],
) -> Float[Tensor, "*batch n"]:
    """The model's torque in float64, of which small differences can be taken."""
    return inverse_dynamics(robot, q.double(), dq.double(), ddq.double())


def on_joint(signal: Float[Tensor, " T"], joint: int, n: int) -> Float[Tensor, "T n 1"]:
    """One column that acts on one joint."""
    out = signal.new_zeros(signal.shape[0], n, 1)
    out[:, joint, 0] = signal
    return out


def with_joint(
    x: Float[Tensor, "T n"], joint: int, add: Float[Tensor, "*batch T"] | float
) -> Float[Tensor, "*batch T n"]:
    """Copies of joint signals with something added to one joint's."""
    batch = add.shape[:-1] if isinstance(add, Tensor) else ()
    out = x.expand(*batch, *x.shape).clone()
    out[..., joint] += add
    return out


def link_lag_torque(
    robot: Robot,
    motion: Motion,
    joint: int,
    rigid: Float[Tensor, "T n"],
    by: Float[Tensor, "*batch T"],
    rate: Float[Tensor, "*batch T"],
    acceleration: Float[Tensor, "*batch T"],
) -> Float[Tensor, "*batch T n"]:
    """Change of the model's torque (float64) when a joint's link lags its motor by an angle.

    Args:
        robot: with parameters.
        motion: of the motors.
        joint: whose link lags.
        rigid: the model's torque along the motion, as `rigid_torque` has it [N m; N].
        by, rate, acceleration: angle by which it lags, and its derivatives.
    """
    lags = zip(motion.state, (by, rate, acceleration), strict=True)
    q, dq, ddq = (x[:, joint].double() - lag.double() for x, lag in lags)
    lagging = torques_of_one_joint(robot, motion.state, joint, (q, dq, ddq))
    return lagging - rigid.T.contiguous().T


def secant_at(at: float, smallest: float) -> float:
    """Where to take a secant: at the given value, or at the smallest that rounding allows."""
    return at if abs(at) >= smallest else smallest


def horizontal_axes(vector: Float[Tensor, "3"]) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Two unit vectors perpendicular to a vector and to each other; x and y for one along -z."""
    unit = vector.double() / vector.double().norm()
    start = torch.zeros_like(unit)
    start[int(unit.abs().argmin())] = 1.0
    first = start - (start @ unit) * unit
    first = first / first.norm()
    return first, torch.linalg.cross(first, unit)
