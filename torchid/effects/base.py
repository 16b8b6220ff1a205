"""An effect: something that adds torque to the rigid body.

Friction, rotor inertia, offsets, ... are the same kind of thing everywhere: identification uses an
effect's columns, simulation adds its torque, the gap diagnosis searches over effects. A new one is
one class in one file and a line in `registry.py`; the test battery in tests/effects covers it.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torchid.typing import Float


class Motion(NamedTuple):
    """Motion of all joints, each (..., n): q [rad or m], dq [rad/s, m/s], ddq [rad/s^2, m/s^2]."""

    q: Tensor
    dq: Tensor
    ddq: Tensor


@dataclass(frozen=True)
class Coefficient:
    """One coefficient of an effect that is linear in it.

    Attributes:
        name: as in files and tables, e.g. `Fv`.
        unit: for a revolute joint; for a prismatic one N replaces N m and m replaces rad.
        non_negative: whether physics forbids a negative value.
        meaning: one line.
    """

    name: str
    unit: str
    non_negative: bool
    meaning: str

    def unit_for(self, prismatic: bool) -> str:
        """The unit on this kind of joint."""
        if not prismatic:
            return self.unit
        return self.unit.replace("kg m^2", "kg").replace("N m", "N").replace("rad", "m")


@dataclass(frozen=True)
class Effect(ABC):
    """An effect on one joint, linear in its coefficients.

    Attributes:
        joint: index of the joint it acts on, from 0.
    """

    joint: int

    name: ClassVar[str]
    family: ClassVar[str]
    coefficients: ClassVar[tuple[Coefficient, ...]]

    @abstractmethod
    def columns(self, motion: Motion) -> Float[Tensor, "*batch C"]:
        """Columns (..., C) of the torque of joint `joint`, one a coefficient."""

    def torque(self, motion: Motion, values: Sequence[float]) -> Float[Tensor, "*batch"]:
        """Torque on the joint (...) [N m; N] for the given coefficients."""
        columns = self.columns(motion)
        return columns @ torch.as_tensor(values, dtype=columns.dtype, device=columns.device)

    def coefficient_names(self) -> list[str]:
        """Names with the joint's number, e.g. `Fv3`."""
        return [f"{c.name}{self.joint + 1}" for c in self.coefficients]
