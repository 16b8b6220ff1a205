"""Friction of the paper's model, tau_f = Fv dq + Fc sign(dq) + F0 (eq. 2.16), as three effects."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchid.digits import number
from torchid.effects.base import Coefficient, Example, Family, JointEffect, Motion
from torchid.effects.c_text import add
from torchid.typing import Float


@dataclass(frozen=True)
class ViscousFriction(JointEffect):
    """Torque in proportion to the joint's own speed."""

    name: ClassVar[str] = "viscous_friction"
    family: ClassVar[Family] = "speed"
    coefficients: ClassVar = (Coefficient("Fv", "N m s/rad", True, "viscous friction"),)
    meaning: ClassVar[str] = (
        "Lubricant shear, or a drive's back-EMF, resists in proportion to speed."
    )
    equation: ClassVar[str] = "Fv dq"
    signature: ClassVar[str] = "odd in the joint's speed, and grows with it"
    experiment: ClassVar[str] = "run one joint at three or more constant speeds"
    remedy: ClassVar[str] = "Set the joint's damping to Fv in the simulator."
    source: ClassVar[str] = "eq. 2.16 of the report; Armstrong-Helouvry et al. 1994, section 2"
    example: ClassVar[Example] = Example((2.0,), "speed")
    on_all: ClassVar[bool] = True

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Float[Tensor, "*batch n C"]:
        """dq."""
        return motion.dq.unsqueeze(-1)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        return add(self.joint, f"{number(values[0])} * dq[{self.joint}]")

    def attributes(self, values: Sequence[float], mjcf: bool) -> dict[str, float] | None:
        """Damping."""
        return {"damping": values[0]} if values[0] >= 0 else None


@dataclass(frozen=True)
class CoulombFriction(JointEffect):
    """Constant torque against the joint's motion.

    Attributes:
        smoothing: 0 for the sharp sign (0 at rest); otherwise tanh(dq / smoothing) [rad/s].
    """

    smoothing: float = 0.0

    name: ClassVar[str] = "coulomb_friction"
    family: ClassVar[Family] = "sign"
    jumps: ClassVar[bool] = True
    coefficients: ClassVar = (Coefficient("Fc", "N m", True, "Coulomb friction"),)
    meaning: ClassVar[str] = "Dry contact in gears and bearings resists with a constant torque."
    equation: ClassVar[str] = "Fc sgn(dq)"
    signature: ClassVar[str] = "a step where the joint reverses, of the same height everywhere"
    experiment: ClassVar[str] = "reverse slowly and fast, in postures with different loads"
    remedy: ClassVar[str] = "Set the joint's dry friction (frictionloss) to Fc in the simulator."
    source: ClassVar[str] = "eq. 2.16 of the report; Armstrong-Helouvry et al. 1994, section 2"
    example: ClassVar[Example] = Example((1.0,), "speed")
    on_all: ClassVar[bool] = True

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Float[Tensor, "*batch n C"]:
        """Direction of motion."""
        return motion.sign.unsqueeze(-1)

    def columns(self, motion: Motion) -> Float[Tensor, "*batch C"]:
        """Direction of the joint's motion: as given, else sign(dq), sharp or smooth."""
        if self.smoothing == 0:
            return super().columns(motion)
        return torch.tanh(motion.dq[..., self.joint, None] / self.smoothing)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        speed = f"dq[{self.joint}]"
        smooth = f"tanh({speed} / {number(self.smoothing)})"
        direction = f"sign({speed})" if self.smoothing == 0 else smooth
        return add(self.joint, f"{number(values[0])} * {direction}")

    def attributes(self, values: Sequence[float], mjcf: bool) -> dict[str, float] | None:
        """Dry friction, where it is not smoothed."""
        known = self.smoothing == 0 and values[0] >= 0
        return {"friction": values[0]} if known else None


@dataclass(frozen=True)
class TorqueOffset(JointEffect):
    """Constant torque: the report's Coulomb offset, equally a bias of the torque sensor."""

    name: ClassVar[str] = "torque_offset"
    family: ClassVar[Family] = "constant"
    coefficients: ClassVar = (Coefficient("F0", "N m", False, "offset"),)
    meaning: ClassVar[str] = "A torque sensor or current sensor reads a constant too much."
    equation: ClassVar[str] = "F0"
    signature: ClassVar[str] = "the same torque everywhere, at rest too"
    experiment: ClassVar[str] = "let the joint dwell, and approach the dwell from both sides"
    remedy: ClassVar[str] = "Subtract F0 from the measured torque, or calibrate the sensor's zero."
    source: ClassVar[str] = "eq. 2.16 of the report"
    example: ClassVar[Example] = Example((1.0,), "speed")
    on_all: ClassVar[bool] = True

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Float[Tensor, "*batch n C"]:
        """One."""
        return torch.ones_like(motion.dq).unsqueeze(-1)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        return add(self.joint, number(values[0]))
