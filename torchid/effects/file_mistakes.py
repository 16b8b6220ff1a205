"""Usual mistakes of a robot's file: inertias about another point, of another size, mirrored links.

Such a mistake changes the ten parameters of a link in a direction that the file's own numbers give,
so that it has one coefficient where a wrong link has ten. All links may have the same one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.effects.base import Columns, Effect, Example, Motion
from torchid.effects.inertia import LinkEffect
from torchid.effects.variation import ArmCoefficient, needed
from torchid.robot.inertia import InertialParameters, parallel_axis
from torchid.robot.model import Robot
from torchid.typing import Float

_MOST, _LEAST = 1.3, 0.7
"""Shares of a mistake that are the whole of it [1]: it is there, or it is not."""


@dataclass(frozen=True)
class FileMistake(LinkEffect):
    """A link's parameters as its file would have them without a mistake.

    Attributes:
        joint: the joint that moves the link, from 0.
    """

    of_bodies = True
    shared = True
    experiment = "swing the link fast about its own joint, and hold it level"

    source = (
        "Atkeson, An and Hollerbach 1986, IJRR 5(3), for the parameters; URDF: inertial, inertia"
    )

    def correction(self, body: InertialParameters) -> InertialParameters:
        """What a link's parameters lack per unit coefficient."""
        raise NotImplementedError

    def change(self, robot: Robot) -> Float[Tensor, "L 10"]:
        """What the parameters of all links lack per unit coefficient."""
        pi = robot.require_parameters(f"the effect {self.name}").pi
        out, link = torch.zeros_like(pi), self.link(robot)
        out[link] = self.correction(InertialParameters(pi[link])).pi
        return out

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """The link's columns of the regressor along the change (T, n, 1)."""
        arm = needed(robot, self.name)
        change = self.change(arm)[self.link(arm)].to(motion.q)
        return super().torque_columns(motion, robot) @ change.unsqueeze(-1)

    def plant(self, robot: Robot, values: Sequence[float] | Tensor) -> Robot:
        """The arm with the link's parameters changed."""
        pi = robot.require_parameters(f"the effect {self.name}").pi
        return robot.with_parameters(InertialParameters(pi + values[0] * self.change(robot)))


@dataclass(frozen=True)
class InertiaReferencePoint(FileMistake):
    """A link's inertia is given about its frame's origin, and declared at its centre of mass."""

    name = "inertia_reference_point"
    coefficients = (ArmCoefficient("w", "1", True, "share of m c^2 counted twice", _MOST, _LEAST),)
    meaning = (
        "The link's inertia is about its joint, and the file says that it is about its centre."
    )
    equation = "-w Y_j (0, 0, m (c'c 1 - c c'))"
    signature = "with acceleration, as the mass times the square of its distance counted twice"
    remedy = "Subtract m (c'c 1 - c c') from the link's inertia in the file."
    example = Example((1.0,), "acceleration")

    def correction(self, body: InertialParameters) -> InertialParameters:
        """Less m c^2 about the link frame."""
        out = torch.zeros_like(body.pi)
        out[..., 4:] = -parallel_axis(body.mass, body.com)
        return InertialParameters(out)


@dataclass(frozen=True)
class InertiaScale(FileMistake):
    """A link's inertia about its centre of mass is another one by a factor."""

    name = "inertia_scale"
    # No body has a negative inertia.
    coefficients = (ArmCoefficient("s", "1", False, "relative change of the inertia", 1e6, -1.0),)
    meaning = "The link's inertia is in another unit (g mm^2 for kg m^2), or of one of two halves."
    equation = "s Y_j (0, 0, J_c)"
    signature = "with acceleration alone; gravity is right"
    remedy = "Multiply the link's inertia in the file by 1 + s; near a power of ten it is a unit."
    example = Example((1.0,), "acceleration")

    def correction(self, body: InertialParameters) -> InertialParameters:
        """Once more the inertia about the centre of mass."""
        out = torch.zeros_like(body.pi)
        out[..., 4:] = body.inertia_about_com
        return InertialParameters(out)


@dataclass(frozen=True)
class MirroredLink(FileMistake):
    """A link's centre of mass and inertia are those of its mirror image.

    Attributes:
        joint: the joint that moves the link, from 0.
        axis: of the link frame that is turned round: x, y or z.
    """

    axis: str = "y"

    name = "mirrored_link"
    shared = False
    coefficients = (ArmCoefficient("w", "1", True, "share of the mirror image", _MOST, _LEAST),)
    meaning = "The link's body is mirrored: a left arm's file on a right arm, or a sign of its CAD."
    equation = "w Y_j (M pi_j - pi_j), M a reflection of the link's frame along an axis"
    signature = "with gravity, of the other sign along one axis, and with acceleration"
    remedy = (
        "Turn round the sign of the centre of mass and of the products of inertia of that axis."
    )
    example = Example((1.0,), "position")

    def __post_init__(self) -> None:
        if self.axis not in ("x", "y", "z"):
            raise ValueError("axis must be x, y or z")

    @classmethod
    def starts(cls, robot: Robot) -> list[Effect]:
        """Every link, mirrored along each of its axes."""
        return [cls(joint, axis) for joint in robot.driven for axis in "xyz"]

    def correction(self, body: InertialParameters) -> InertialParameters:
        """To the mirror image: moments along the axis and products with it are of other sign."""
        k = "xyz".index(self.axis)
        signs = torch.ones(3, dtype=body.pi.dtype)
        signs[k] = -1.0
        pairs = torch.stack([signs[a] * signs[b] for a in range(3) for b in range(a, 3)])
        mirror = torch.cat([torch.ones(1, dtype=body.pi.dtype), signs, pairs])
        return InertialParameters(body.pi * (mirror - 1.0))
