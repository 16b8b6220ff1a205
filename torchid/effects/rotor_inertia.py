"""Inertia of the drive, reflected through the gear (Corke 2017, section 9.1.3)."""

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from torchid.effects.base import Coefficient, Family, JointEffect, Motion
from torchid.typing import Float


@dataclass(frozen=True)
class RotorInertia(JointEffect):
    """Torque in proportion to the joint's own acceleration: gear ratio squared times rotor inertia.

    On the first joints it cannot be told from the links' own inertia about the axis; the base
    parameters then carry both.
    """

    name: ClassVar[str] = "rotor_inertia"
    family: ClassVar[Family] = "inertia"
    coefficients: ClassVar = (Coefficient("Ia", "kg m^2", True, "reflected rotor inertia"),)
    meaning: ClassVar[str] = "The motor's rotor, seen through the gear, resists acceleration."
    remedy: ClassVar[str] = "Set the joint's armature to Ia in the simulator."
    source: ClassVar[str] = "Corke 2017, Robotics, Vision and Control, section 9.1.3"

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Float[Tensor, "*batch n C"]:
        """ddq."""
        return motion.ddq.unsqueeze(-1)
