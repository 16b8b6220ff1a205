"""Friction that changes while the arm warms up."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.effects.base import Coefficient, Columns, Example, JointEffect, Motion, Shape


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

    name = "thermal_friction_drift"
    family = "time"
    needs = frozenset({"t"})
    jumps = True
    coefficients = (
        Coefficient("dFv", "N m s/rad", False, "viscous friction: warm minus cold"),
        Coefficient("dFc", "N m", False, "Coulomb friction: warm minus cold"),
    )
    shapes = (
        Shape("T", "s", 5.0, 1000.0, (15.0, 30.0, 60.0, 120.0, 240.0), "time constant of warming"),
    )
    meaning = "Grease thins as the gear warms up, so friction drifts (mostly falls) along the log."
    equation = "(dFv dq + dFc sgn(dq)) (1 - exp(-t/T))"
    signature = "a slow trend with the shape of friction"
    experiment = "repeat one motion cold, warm and cold again"
    beyond = experiment
    remedy = (
        "Warm the arm up before it is used or measured, or use the friction of its working "
        "temperature: Fv + dFv, Fc + dFc."
    )
    source = (
        "Bittencourt and Gunnarsson 2012, Static friction in a robot joint: modeling and "
        "identification of load and temperature effects (J. Dyn. Sys., Meas., Control 134)"
    )
    example = Example((-0.5, -0.5), "time")
    by_motion = False

    def __post_init__(self) -> None:
        if not self.T > 0:
            raise ValueError(f"the time constant T must be positive, not {self.T}.")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """dq and the direction, times 1 - exp(-t/T); shapes: T."""
        (constant,) = shapes
        t = motion.require("t", cls.name).to(motion.dq).unsqueeze(-1)
        warmth = -torch.expm1(-t / constant)
        return torch.stack((motion.dq * warmth, motion.sign * warmth), -1)
