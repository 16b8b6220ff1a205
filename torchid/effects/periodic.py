"""Torque that repeats along the joint's travel."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchid.effects.base import Coefficient, Family, JointEffect, Motion, Shape
from torchid.typing import Float


@dataclass(frozen=True)
class Cogging(JointEffect):
    """A ripple along the position: a_s sin kq + a_c cos kq.

    k is a count of poles, teeth or slots a turn of the joint: gear ratio times pole pairs, twice
    the gear ratio for a harmonic drive's wave generator, and their multiples. Two wave numbers
    closer than 2 pi / travel cannot be told apart, so k is refined in differences; where to look
    comes from the residual's spectrum over the angle, since a grid fine enough would be long. At
    k = 1 it equals `joint_spring` of a counterbalance.

    Attributes:
        k: wave number [1/rad; 1/m], periods of the ripple times 2 pi a unit of travel.
    """

    k: float = 12.0

    name: ClassVar[str] = "cogging"
    family: ClassVar[Family] = "periodic"
    coefficients: ClassVar = (
        Coefficient("a_s", "N m", False, "amplitude of the ripple's sine"),
        Coefficient("a_c", "N m", False, "amplitude of the ripple's cosine"),
    )
    shapes: ClassVar = (
        Shape(
            "k",
            "1/rad",
            0.5,
            1000.0,
            (2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 60.0),
            "wave number along the position",
            logarithmic=False,
        ),
    )
    meaning: ClassVar[str] = (
        "Magnets pull towards slots, and gear teeth mesh unevenly: torque ripples with position."
    )
    remedy: ClassVar[str] = (
        "Add the ripple as a table over position, or cancel it by the drive's cogging compensation."
    )
    source: ClassVar[str] = (
        "Holtz and Springob 1996, Identification and compensation of torque ripple in "
        "high-precision permanent magnet motor drives (IEEE Trans. Ind. Electron. 43)"
    )

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Float[Tensor, "*batch n C"]:
        """sin kq and cos kq; shapes: k."""
        (k,) = shapes
        phase = k * motion.q
        return torch.stack((torch.sin(phase), torch.cos(phase)), -1)
