"""Friction of the paper's model, tau_f = Fv dq + Fc sign(dq) + F0 (eq. 2.16), as three effects."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchid.effects.base import Coefficient, Family, JointEffect, Motion
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
    remedy: ClassVar[str] = "Set the joint's damping to Fv in the simulator."
    source: ClassVar[str] = "eq. 2.16 of the report; Armstrong-Helouvry et al. 1994, section 2"

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Float[Tensor, "*batch n C"]:
        """dq."""
        return motion.dq.unsqueeze(-1)


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
    remedy: ClassVar[str] = "Set the joint's dry friction (frictionloss) to Fc in the simulator."
    source: ClassVar[str] = "eq. 2.16 of the report; Armstrong-Helouvry et al. 1994, section 2"

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Float[Tensor, "*batch n C"]:
        """Direction of motion."""
        return motion.sign.unsqueeze(-1)

    def columns(self, motion: Motion) -> Float[Tensor, "*batch C"]:
        """Direction of the joint's motion: as given, else sign(dq), sharp or smooth."""
        if self.smoothing == 0:
            return super().columns(motion)
        return torch.tanh(motion.dq[..., self.joint, None] / self.smoothing)


@dataclass(frozen=True)
class TorqueOffset(JointEffect):
    """Constant torque: the report's Coulomb offset, equally a bias of the torque sensor."""

    name: ClassVar[str] = "torque_offset"
    family: ClassVar[Family] = "constant"
    coefficients: ClassVar = (Coefficient("F0", "N m", False, "offset"),)
    meaning: ClassVar[str] = "A torque sensor or current sensor reads a constant too much."
    remedy: ClassVar[str] = "Subtract F0 from the measured torque, or calibrate the sensor's zero."
    source: ClassVar[str] = "eq. 2.16 of the report"

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Float[Tensor, "*batch n C"]:
        """One."""
        return torch.ones_like(motion.dq).unsqueeze(-1)
