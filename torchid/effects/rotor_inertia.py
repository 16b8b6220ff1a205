"""Inertia of the drive, reflected through the gear (Corke 2017, section 9.1.3)."""

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from torchid.effects.base import Coefficient, Effect, Motion
from torchid.typing import Float


@dataclass(frozen=True)
class RotorInertia(Effect):
    """Torque in proportion to the joint's own acceleration: gear ratio squared times rotor inertia.

    On the first joints it cannot be told from the links' own inertia about the axis; the base
    parameters then carry both.
    """

    name: ClassVar[str] = "rotor_inertia"
    family: ClassVar[str] = "inertia"
    coefficients: ClassVar = (Coefficient("Ia", "kg m^2", True, "reflected rotor inertia"),)

    def columns(self, motion: Motion) -> Float[Tensor, "*batch C"]:
        """ddq of the joint."""
        return motion.ddq[..., self.joint, None]
