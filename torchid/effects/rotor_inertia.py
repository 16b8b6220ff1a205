"""Inertia of the drive, reflected through the gear (Corke 2017, section 9.1.3)."""

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from torchid.digits import number
from torchid.effects.base import Coefficient, Columns, Example, JointEffect, Motion
from torchid.effects.c_text import add


@dataclass(frozen=True)
class RotorInertia(JointEffect):
    """Torque in proportion to the joint's own acceleration: gear ratio squared times rotor inertia.

    On the first joints it cannot be told from the links' own inertia about the axis; the base
    parameters then carry both.
    """

    name = "rotor_inertia"
    family = "inertia"
    coefficients = (Coefficient("Ia", "kg m^2", True, "reflected rotor inertia"),)
    meaning = "The motor's rotor, seen through the gear, resists acceleration."
    equation = "Ia ddq"
    signature = "follows the joint's own acceleration; for the first joints exactly as J_zz does"
    experiment = "accelerate the joint hard in postures with a large and a small link inertia"
    remedy = "Set the joint's armature to Ia in the simulator."
    source = "Corke 2017, Robotics, Vision and Control, section 9.1.3"
    example = Example((0.5,), "acceleration")
    on_all = True

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """ddq."""
        return motion.ddq.unsqueeze(-1)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        return add(self.joint, f"{number(values[0])} * ddq[{self.joint}]")

    def attributes(self, values: Sequence[float], mjcf: bool) -> dict[str, float] | None:
        """Armature, of an MJCF."""
        return {"armature": values[0]} if mjcf and values[0] >= 0 else None
