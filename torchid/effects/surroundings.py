"""Contact as a law: what the arm meets again and again at the same place."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.digits import number
from torchid.effects.base import (
    Coefficient,
    Columns,
    Effect,
    Example,
    JointEffect,
    ModelEffect,
    Motion,
    Shape,
)
from torchid.effects.c_text import add
from torchid.effects.parameters import travel
from torchid.effects.variation import ArmCoefficient, needed
from torchid.robot.jacobian import tool_jacobian
from torchid.robot.model import Robot, tool_pose
from torchid.typing import Float

SIDES = ("+x", "-x", "+y", "-y", "+z", "-z")
"""Where a plane's free side is, in axes of the base."""


@dataclass(frozen=True)
class PlaneContact(ModelEffect):
    """A point of the tool presses into a plane: a table, a wall.

    The force grows with the depth, and with its rate while the tool is inside:
    J' n (k depth + c rate), n out of the free side into the plane. It is the force that the tool
    exerts, and acts wherever the tool is beyond the plane.

    Attributes:
        height: where the plane meets the base's axis [m].
        side: on which side it is free: `+z` is a table, `-z` a ceiling.
        reach: how far in front of the tool's origin, along the tool's z, the point is [m].
    """

    height: float = 0.0
    side: str = "+z"
    reach: float = 0.0

    name = "plane_contact"
    family = "transient"
    branch = "surroundings"
    needs = frozenset({"robot"})
    coefficients = (
        ArmCoefficient("k", "N/m", True, "stiffness of plane and tool together", 1e6),
        ArmCoefficient("c", "N s/m", True, "damping while they touch", 1e4),
    )
    essential = (0,)
    positions = True
    meaning = "The tool touches a table or a wall whenever it comes there."
    equation = "-J(q)' n (k depth + c d(depth)/dt) while depth > 0; n points to the free side"
    signature = "on all joints at once, wherever the tool is beyond one plane"
    experiment = "repeat the motion a few centimetres farther from the table"
    beyond = experiment
    remedy = "Put a plane of this stiffness into the simulator, or keep the tool clear of it."
    source = (
        "Hunt and Crossley 1975, Coefficient of restitution interpreted as damping in "
        "vibroimpact (J. Applied Mechanics 42), with a linear spring"
    )
    example = Example((2000.0, 0.0), "time", {"height": 0.6})
    at_ends = True

    def __post_init__(self) -> None:
        if self.side not in SIDES:
            raise ValueError(f"the free side must be one of {', '.join(SIDES)}, not {self.side}.")
        if not (math.isfinite(self.height) and math.isfinite(self.reach)):
            raise ValueError(f"height and reach must be numbers, not {self.height}, {self.reach}.")

    @property
    def identity(self) -> tuple[str, tuple[int, ...]]:
        """Name and side: planes of one side are the same at another height."""
        return self.name, (SIDES.index(self.side),)

    def coefficient_names(self) -> list[str]:
        """`k` and `c` with the side: `k+z`."""
        return [f"{c.name}{self.side}" for c in self.coefficients]

    @classmethod
    def starts(cls, robot: Robot) -> list[Effect]:
        """None: planes are looked for where the tool turns back (`near_ends`)."""
        return []

    @classmethod
    def columns_of(
        cls, effects: Sequence[ModelEffect], motion: Motion, robot: Robot | None = None
    ) -> Iterator[Columns]:
        """Columns of several planes, which share poses and Jacobians."""
        arm = needed(robot, cls.name)
        pose, jacobian = tool_pose(arm, motion.q), tool_jacobian(arm, motion.q)
        for effect in effects:
            assert isinstance(effect, PlaneContact)
            axis, sign = "xyz".index(effect.side[1]), 1.0 if effect.side[0] == "+" else -1.0
            # The point's coordinate along the plane's axis, and its row of the Jacobian.
            arrow = effect.reach * pose[..., :3, 2]
            turned = torch.linalg.cross(jacobian[..., 3:, :], arrow.unsqueeze(-1), dim=-2)
            row = jacobian[..., axis, :] + turned[..., axis, :]
            depth = sign * (effect.height - pose[..., axis, 3] - arrow[..., axis])
            inside = (depth > 0).to(depth)
            rate = -sign * (row * motion.dq).sum(-1)
            push = torch.stack((depth * inside, rate * inside), -1)
            yield -sign * row.unsqueeze(-1) * push.unsqueeze(-2)

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """-J' n depth, -J' n rate (T, n, 2) where the tool is beyond the plane."""
        return next(iter(self.columns_of([self], motion, robot)))

    def around(self, level: int, interval: float) -> "list[PlaneContact]":
        """The plane a little higher and lower, by 6 mm at 0, half of it at 1, ..., and its point a
        little farther out and in, by six times as much."""
        step = 6e-3 / 2**level
        moves = [(k * step, r * 6 * step) for k in (-1, 0, 1) for r in (-1, 0, 1) if k or r]
        return [PlaneContact(self.height + h, self.side, self.reach + r) for h, r in moves]

    @classmethod
    def near_ends(cls, robot: Robot, motions: Sequence[Motion]) -> "list[PlaneContact]":
        """Planes that the tool could meet: on every side a little short of where it turns back.

        A plane acts at an end of the tool's travel alone, or the tool would go farther. Of a robot
        with several tips there is no such tool, and none is looked for.
        """
        if len(robot.ends) > 1:
            return []
        place = torch.cat([tool_pose(robot, m.q)[:, :3, 3] for m in motions])
        out = []
        for side in SIDES:
            own, sign = place[:, "xyz".index(side[1])], 1.0 if side[0] == "+" else -1.0
            end = float((sign * own).amin()) * sign
            out += [cls(end + sign * d, side) for d in (0.003, 0.008, 0.02, 0.05, 0.12)]
        return out


@dataclass(frozen=True)
class EndStop(JointEffect):
    """A stop that the joint meets: torque in proportion to how far it is beyond.

    Attributes:
        limit: where it begins [rad; m].
        towards: 1 of a stop at high positions, -1 of one at low positions.
    """

    limit: float = 0.0
    towards: float = 1.0

    name = "end_stop"
    family = "transient"
    branch = "surroundings"
    coefficients = (Coefficient("ks", "N m/rad", True, "stiffness of the stop", 1e6),)
    shapes = (
        Shape(
            "limit", "rad", -1e3, 1e3, (-0.02, -0.01, -0.005), "where the stop begins",
            logarithmic=False,
        ),
        Shape(
            "towards", "1", -1.0, 1.0, (-1.0, 1.0), "side of the travel that it ends",
            logarithmic=False,
        ),
    )  # fmt: skip
    servo = ("stop_low", "stop_high")
    positions = True
    meaning = "The joint runs into a stop, a cable or a bellows at an end of its travel."
    equation = "ks max(towards (q - limit), 0) towards"
    signature = "torque that rises at one end of the joint's travel"
    experiment = "repeat the motion a few degrees short of the end"
    beyond = experiment
    remedy = "Put a joint limit of this position and stiffness into the simulator."
    source = "Khalil 2002, Nonlinear Systems, section 1.2.7 (a dead zone)"
    example = Example((200.0,), "position", {"limit": 0.5})
    at_ends = True

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """The excess over the limit, with its sign; shapes: limit, towards."""
        limit, towards = shapes
        return ((towards * (motion.q - limit)).clamp(min=0) * towards).unsqueeze(-1)

    @classmethod
    def grid(cls, motions: Sequence[Motion], joint: int, cutoff: float) -> Float[Tensor, "S 2"]:
        """Stops a little before either end of the travel, by shares of it."""
        q = torch.cat([m.q[:, joint] for m in motions])
        reach = travel(motions, joint)
        if not reach > 0:
            return torch.zeros(0, 2, dtype=torch.float64)
        rows = [
            (float(end) - side * share * reach, side)
            for side, end in ((1.0, q.max()), (-1.0, q.min()))
            for share in (0.01, 0.03, 0.08)
        ]
        return torch.tensor(rows, dtype=torch.float64)

    def finer(
        self, motions: Sequence[Motion], level: int, cutoff: float
    ) -> Float[Tensor, "S 2"] | None:
        """The stop farther and nearer: within the grid's widest step at 0, a third at 1, ..."""
        step = 0.05 * travel(motions, self.joint) / 3**level
        limits = self.limit + step * torch.linspace(-1, 1, 7, dtype=torch.float64)
        return torch.stack((limits, torch.full_like(limits, self.towards)), -1)

    def at_an_end(self, motions: Sequence[Motion]) -> tuple[str, ...]:
        """`limit` where it would act on most of the travel, for then it is a spring; else
        nothing."""
        q = torch.cat([m.q[:, self.joint] for m in motions])
        most = float((self.towards * (q - self.limit) > 0).double().mean()) > 0.5
        return ("limit",) if most else ()

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        side = number(self.towards)
        excess = f"fmax({side} * (q[{self.joint}] - {number(self.limit)}), 0.0)"
        return add(self.joint, f"{number(values[0])} * {excess} * {side}")
