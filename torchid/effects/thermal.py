"""Friction that changes while the arm warms up."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchid.effects.base import Coefficient, Example, Family, JointEffect, Motion, Shape
from torchid.typing import Float


@dataclass(frozen=True)
class ThermalFrictionDrift(JointEffect):
    """Friction between its cold and its warm value: (dFv dq + dFc sgn dq) (1 - exp(-t/T)).

    The gear's temperature follows the heat of friction and motor with one time constant; friction
    follows temperature linearly. Added to `viscous_friction` and `coulomb_friction`, whose
    coefficients are then the cold ones. On a log much shorter than T only the slopes dFv/T and
    dFc/T can be told.

    Attributes:
        T: time constant [s].
    """

    T: float = 60.0

    name: ClassVar[str] = "thermal_friction_drift"
    family: ClassVar[Family] = "time"
    needs: ClassVar[frozenset[str]] = frozenset({"t"})
    jumps: ClassVar[bool] = True
    coefficients: ClassVar = (
        Coefficient("dFv", "N m s/rad", False, "viscous friction: warm minus cold"),
        Coefficient("dFc", "N m", False, "Coulomb friction: warm minus cold"),
    )
    shapes: ClassVar = (
        Shape("T", "s", 5.0, 1000.0, (15.0, 30.0, 60.0, 120.0, 240.0), "time constant of warming"),
    )
    meaning: ClassVar[str] = (
        "Grease thins as the gear warms up, so friction drifts (mostly falls) along the log."
    )
    equation: ClassVar[str] = "(dFv dq + dFc sgn(dq)) (1 - exp(-t/T))"
    signature: ClassVar[str] = "a slow trend with the shape of friction"
    experiment: ClassVar[str] = "repeat one motion cold, warm and cold again"
    beyond: ClassVar[str | None] = experiment
    remedy: ClassVar[str] = (
        "Warm the arm up before it is used or measured, or use the friction of its working "
        "temperature: Fv + dFv, Fc + dFc."
    )
    source: ClassVar[str] = (
        "Bittencourt and Gunnarsson 2012, Static friction in a robot joint: modeling and "
        "identification of load and temperature effects (J. Dyn. Sys., Meas., Control 134)"
    )
    example: ClassVar[Example] = Example((-0.5, -0.5), "time")
    by_motion: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not self.T > 0:
            raise ValueError(f"the time constant T must be positive, not {self.T}.")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Float[Tensor, "*batch n C"]:
        """dq and the direction, times 1 - exp(-t/T); shapes: T."""
        (constant,) = shapes
        t = motion.require("t", cls.name).to(motion.dq).unsqueeze(-1)
        warmth = -torch.expm1(-t / constant)
        return torch.stack((motion.dq * warmth, motion.sign * warmth), -1)
