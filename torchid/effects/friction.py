"""Friction of the paper's model, tau_f = Fv dq + Fc sign(dq) + F0 (eq. 2.16), as three effects."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.digits import number
from torchid.effects.base import Coefficient, Columns, Example, JointEffect, Motion
from torchid.effects.c_text import add
from torchid.typing import Float


@dataclass(frozen=True)
class ViscousFriction(JointEffect):
    """Torque in proportion to the joint's own speed."""

    name = "viscous_friction"
    bounds_key = "friction_viscous"
    usual = True
    family = "speed"
    branch = "friction"
    detail = "viscous"
    coefficients = (Coefficient("Fv", "N m s/rad", True, "viscous friction"),)
    servo = ("damping",)
    positions = True
    meaning = "Lubricant shear, or a drive's back-EMF, resists in proportion to speed."
    equation = "Fv dq"
    signature = "odd in the joint's speed, and grows with it"
    experiment = "run one joint at three or more constant speeds"
    remedy = "Set the joint's damping to Fv in the simulator."
    source = "eq. 2.16 of the report; Armstrong-Helouvry et al. 1994, section 2"
    example = Example((2.0,), "speed")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """dq."""
        return motion.dq.unsqueeze(-1)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        return add(self.joint, f"{number(values[0])} * dq[{self.joint}]")

    def attributes(self, values: Sequence[float]) -> dict[str, float] | None:
        """Damping."""
        return {"damping": values[0]} if values[0] >= 0 else None


@dataclass(frozen=True)
class CoulombFriction(JointEffect):
    """Constant torque against the joint's motion.

    Attributes:
        smoothing: 0 for the sharp sign (0 at rest); otherwise tanh(dq / smoothing) [rad/s].
    """

    smoothing: float = 0.0

    name = "coulomb_friction"
    bounds_key = "friction_coulomb"
    usual = True
    family = "sign"
    branch = "friction"
    detail = "dry"
    jumps = True
    coefficients = (Coefficient("Fc", "N m", True, "Coulomb friction"),)
    servo = ("coulomb",)
    positions = True
    meaning = "Dry contact in gears and bearings resists with a constant torque."
    equation = "Fc sgn(dq)"
    signature = "a step where the joint reverses, of the same height everywhere"
    experiment = "reverse slowly and fast, in postures with different loads"
    remedy = "Set the joint's dry friction (frictionloss) to Fc in the simulator."
    source = "eq. 2.16 of the report; Armstrong-Helouvry et al. 1994, section 2"
    example = Example((1.0,), "speed")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
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

    def attributes(self, values: Sequence[float]) -> dict[str, float] | None:
        """Dry friction, where it is not smoothed."""
        known = self.smoothing == 0 and values[0] >= 0
        return {"friction": values[0]} if known else None


@dataclass(frozen=True)
class TorqueOffset(JointEffect):
    """Constant torque: the report's Coulomb offset, equally a bias of the torque sensor."""

    name = "torque_offset"
    bounds_key = "friction_offset"
    usual = True
    family = "constant"
    branch = "sensing"
    of_sensor = True
    coefficients = (Coefficient("F0", "N m", False, "offset"),)
    servo = ("offset",)
    positions = True
    meaning = "A torque sensor or current sensor reads a constant too much."
    equation = "F0"
    signature = "the same torque everywhere, at rest too"
    experiment = "let the joint dwell, and approach the dwell from both sides"
    remedy = "Subtract F0 from the measured torque, or calibrate the sensor's zero."
    source = "eq. 2.16 of the report"
    example = Example((1.0,), "speed")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """One."""
        return torch.ones_like(motion.dq).unsqueeze(-1)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        return add(self.joint, number(values[0]))
