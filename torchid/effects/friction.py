"""Friction of the paper's model, tau_f = Fv dq + Fc sign(dq) + F0 (eq. 2.16), as three effects."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchid.effects.base import Coefficient, Effect, Motion
from torchid.typing import Float


@dataclass(frozen=True)
class ViscousFriction(Effect):
    """Torque in proportion to the joint's own speed."""

    name: ClassVar[str] = "viscous_friction"
    family: ClassVar[str] = "speed"
    coefficients: ClassVar = (Coefficient("Fv", "N m s/rad", True, "viscous friction"),)

    def columns(self, motion: Motion) -> Float[Tensor, "*batch C"]:
        """dq of the joint."""
        return motion.dq[..., self.joint, None]


@dataclass(frozen=True)
class CoulombFriction(Effect):
    """Constant torque against the joint's motion.

    Attributes:
        smoothing: 0 for the sharp sign (0 at rest); otherwise tanh(dq / smoothing) [rad/s].
    """

    smoothing: float = 0.0

    name: ClassVar[str] = "coulomb_friction"
    family: ClassVar[str] = "sign"
    jumps: ClassVar[bool] = True
    coefficients: ClassVar = (Coefficient("Fc", "N m", True, "Coulomb friction"),)

    def columns(self, motion: Motion) -> Float[Tensor, "*batch C"]:
        """Direction of the joint's motion: as given, else sign(dq), sharp or smooth."""
        if motion.direction is not None and self.smoothing == 0:
            return motion.direction[..., self.joint, None].to(motion.dq.dtype)
        dq = motion.dq[..., self.joint, None]
        return torch.tanh(dq / self.smoothing) if self.smoothing > 0 else torch.sign(dq)


@dataclass(frozen=True)
class TorqueOffset(Effect):
    """Constant torque: the report's Coulomb offset, equally a bias of the torque sensor."""

    name: ClassVar[str] = "torque_offset"
    family: ClassVar[str] = "constant"
    coefficients: ClassVar = (Coefficient("F0", "N m", False, "offset"),)

    def columns(self, motion: Motion) -> Float[Tensor, "*batch C"]:
        """One."""
        return torch.ones_like(motion.dq[..., self.joint, None])
