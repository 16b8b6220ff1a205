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
    """Motion of all joints.

    Attributes:
        q, dq, ddq: (..., n) [rad, rad/s, rad/s^2; m for prismatic joints].
        direction: (..., n) sign of each joint's motion, where it is known better than from the
            sign of dq: measured velocity is noise at standstill.
    """

    q: Tensor
    dq: Tensor
    ddq: Tensor
    direction: Tensor | None = None

    @property
    def state(self) -> tuple[Tensor, Tensor, Tensor]:
        """q, dq, ddq: what a rigid body feels."""
        return self.q, self.dq, self.ddq

    def to(self, device: torch.device | str) -> "Motion":
        """The motion on another device."""
        return Motion(*(None if x is None else x.to(device) for x in self))  # type: ignore[arg-type]

    def part(self, rows: slice) -> "Motion":
        """The motion at some of the instants (first axis)."""
        return Motion(*(None if x is None else x[rows] for x in self))  # type: ignore[arg-type]


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
    jumps: ClassVar[bool] = False
    """Whether its columns are discontinuous in the motion."""

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
