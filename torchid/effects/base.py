"""An effect: something that adds torque to the rigid body.

Friction, rotor inertia, offsets, delays, tilt, ... are the same kind of thing everywhere:
identification uses an effect's columns, simulation adds its torque, the gap diagnosis searches over
effects. A new one is one class in the file of its family and a line in `registry.py`; the test
battery in tests/effects covers it.

    tau = Y(q, dq, ddq) pi + sum_k X_k(motion; shape_k) c_k

Each effect is linear in its coefficients c once its shape parameters are given (a Stribeck speed, a
delay, a wave number, ...). Its columns X are torque per unit coefficient. There are two kinds:

- `JointEffect`: acts on one joint and needs that joint's motion only (and time, or the model's
  torque). One formula gives the columns of all joints, for many shapes at once.
- `ModelEffect`: how the model's torque changes when something about the arm or its sensors does; it
  needs the robot, and may act on all joints.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import torch
from torch import Tensor

from torchid.typing import Float

if TYPE_CHECKING:
    from torchid.robot.model import Robot

Family = Literal[
    "speed",
    "sign",
    "constant",
    "gravity",
    "inertia",
    "phase",
    "hysteresis",
    "periodic",
    "time",
    "transient",
]
"""What effects of one family have in common is their signature in the torque."""

Scale = Literal["one", "speed", "torque", "travel"]
"""What the grid of a shape parameter is relative to: nothing, or the joint's 99 % speed, the 99 %
torque of its model, or its range of positions."""


PLACES = ("joint", "source_joint")
"""Fields of effects that are joints: from 0 in Python, from 1 in files."""


class Motion(NamedTuple):
    """Motion of all joints.

    Attributes:
        q, dq, ddq: (..., n) [rad, rad/s, rad/s^2; m for prismatic joints].
        direction: (..., n) sign of each joint's motion, where it is known better than from the
            sign of dq: measured velocity is noise at standstill.
        t: (...,) [s] since the arm was switched on or the log began; where it is known.
        torque: (..., n) torque of the model along this motion [N m; N], never a measured one;
            where it is known.
        age: (..., n) [s] by which the measured torque is older than its stamp, where samples were
            held; where it is known.
        sensed: (..., n) measured torque, of which effects may use the sign alone; where there is a
            log.
    """

    q: Tensor
    dq: Tensor
    ddq: Tensor
    direction: Tensor | None = None
    t: Tensor | None = None
    torque: Tensor | None = None
    age: Tensor | None = None
    sensed: Tensor | None = None

    @property
    def state(self) -> tuple[Tensor, Tensor, Tensor]:
        """q, dq, ddq: what a rigid body feels."""
        return self.q, self.dq, self.ddq

    @property
    def sign(self) -> Tensor:
        """Direction of motion (..., n): as given, else the sign of dq."""
        return torch.sign(self.dq) if self.direction is None else self.direction.to(self.dq)

    def to(self, device: torch.device | str) -> "Motion":
        """The motion on another device."""
        return Motion(*(None if x is None else x.to(device) for x in self))  # type: ignore[arg-type]

    def part(self, rows: slice) -> "Motion":
        """The motion at some of the instants (first axis)."""
        return Motion(*(None if x is None else x[rows] for x in self))  # type: ignore[arg-type]

    def every(self, step: int) -> "Motion":
        """The motion at every so many instants."""
        return self.part(slice(None, None, step))

    def require(self, what: str, effect: str) -> Tensor:
        """`t`, `torque` or `age`, which an effect needs; ValueError (a programmer's) without it."""
        value: Tensor | None = getattr(self, what)
        if value is None:
            raise ValueError(f"{effect} needs the motion's {what}.")
        return value


@dataclass(frozen=True)
class Coefficient:
    """One coefficient of an effect that is linear in it.

    Attributes:
        name: as in files and tables, e.g. `Fv`.
        unit: for a revolute joint; for a prismatic one N replaces N m and m replaces rad.
        non_negative: whether physics forbids a negative value.
        meaning: one line.
        largest: size that it hardly exceeds on any arm, in `unit`; what seems larger is something
            else.
    """

    name: str
    unit: str
    non_negative: bool
    meaning: str
    largest: float = math.inf

    def unit_for(self, prismatic: bool) -> str:
        """The unit on this kind of joint."""
        if not prismatic:
            return self.unit
        return self.unit.replace("kg m^2", "kg").replace("N m", "N").replace("rad", "m")


@dataclass(frozen=True)
class Shape:
    """A parameter that an effect is not linear in.

    Attributes:
        name: as in files and tables, e.g. `vs`; also the name of the effect's field.
        unit: as Coefficient's.
        low, high: bounds, in units of `scale`.
        grid: where a search starts, in units of `scale`.
        scale: what bounds and grid are relative to.
        meaning: one line.
        logarithmic: whether to refine it in ratios rather than differences.
    """

    name: str
    unit: str
    low: float
    high: float
    grid: tuple[float, ...]
    meaning: str
    scale: Scale = "one"
    logarithmic: bool = True


@dataclass(frozen=True)
class Effect(ABC):
    """Something that adds torque to the rigid body, linear in its coefficients.

    Class attributes:
        name, family: as in files (see the registry).
        coefficients: what it is linear in.
        shapes: what it is not; each is also a field of the instance.
        meaning: what it is physically, one sentence.
        remedy: what an engineer does about it, one sentence.
        source: where its equation comes from.
        needs: which of `t`, `torque`, `age`, `robot`, and `velocity` (that dq was measured on its
            own, not differentiated from q) its columns need.
        jumps: whether its columns are discontinuous in the motion.
        essential: numbers of the coefficients without which it would be another, simpler effect.
    """

    name: ClassVar[str]
    family: ClassVar[Family]
    coefficients: ClassVar[tuple[Coefficient, ...]]
    shapes: ClassVar[tuple[Shape, ...]] = ()
    meaning: ClassVar[str]
    remedy: ClassVar[str]
    source: ClassVar[str]
    needs: ClassVar[frozenset[str]] = frozenset()
    jumps: ClassVar[bool] = False
    essential: ClassVar[tuple[int, ...]] = ()

    @property
    @abstractmethod
    def joints(self) -> tuple[int, ...]:
        """Joints it is located at, from 0; empty where it belongs to the whole arm."""

    @abstractmethod
    def torque_columns(
        self, motion: Motion, robot: "Robot | None" = None
    ) -> Float[Tensor, "*batch n C"]:
        """Torque of all joints per unit coefficient (..., n, C).

        Time is the axis before the joints for effects with a memory (see `memory`).

        Args:
            motion: with t and torque where `needs` names them.
            robot: with the parameters of the present model, where `needs` names it.
        """

    @property
    def shape_values(self) -> tuple[float, ...]:
        """Values of the shape parameters, in the order of `shapes`."""
        return tuple(getattr(self, s.name) for s in self.shapes)

    @property
    def becomes(self) -> str | None:
        """Name of the simpler effect that this one has become, its shape near an end of its range;
        None elsewhere."""
        return None

    def all_torques(
        self, motion: Motion, values: Sequence[float], robot: "Robot | None" = None
    ) -> Float[Tensor, "*batch n"]:
        """Torque of all joints (..., n) [N m; N] for the given coefficients."""
        columns = self.torque_columns(motion, robot)
        return columns @ torch.as_tensor(values, dtype=columns.dtype, device=columns.device)

    def record(self, values: Sequence[float]) -> dict[str, Any]:
        """As in a robot's yaml: {effect, joint or joints, coefficients, shape parameters}."""
        out: dict[str, Any] = {"effect": self.name}
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        out |= {place: own.pop(place) + 1 for place in PLACES if place in own}
        out |= {c.name: float(v) for c, v in zip(self.coefficients, values, strict=True)}
        return out | own


@dataclass(frozen=True)
class JointEffect(Effect):
    """An effect on one joint that depends on the motion of that joint.

    Attributes:
        joint: index of the joint it acts on, from 0.
    """

    joint: int

    memory: ClassVar[bool] = False
    """Whether the torque depends on the past: then time is the last axis but one of the motion."""

    @classmethod
    @abstractmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Float[Tensor, "*batch n C"]:
        """Torque per unit coefficient, of every joint as if the effect were on it.

        Args:
            motion: signals (..., n); with a memory (..., T, n).
            shapes: one tensor a shape parameter, that broadcasts with the signals: () for one
                value, (S, 1, 1) for a grid over (T, n) signals, (B, n) for a batch of arms.

        Returns:
            (..., n, C), the shapes' leading axes in front.
        """

    @classmethod
    def initial(cls, motion: Motion, *shapes: Tensor) -> Tensor | None:
        """State (..., n) before the first instant; None where there is no memory."""
        return None

    @classmethod
    def advance(
        cls, motion: Motion, dt: float, state: Tensor | None, *shapes: Tensor
    ) -> tuple[Float[Tensor, "*batch n C"], Tensor | None]:
        """For simulation: columns at one instant (..., n, C), and the state after it.

        Args:
            motion: of this instant, (..., n).
            dt: seconds since the instant of `state`; 0 to read the torque without a step.
            state: from `initial` or the last step.
            shapes: as for `formula`.
        """
        return cls.formula(motion, *shapes), state

    @property
    def joints(self) -> tuple[int, ...]:
        """Its joint."""
        return (self.joint,)

    def columns(self, motion: Motion) -> Float[Tensor, "*batch C"]:
        """Columns (..., C) of the torque of joint `joint`, one a coefficient."""
        shapes = (
            torch.as_tensor(v, dtype=motion.dq.dtype, device=motion.dq.device)
            for v in self.shape_values
        )
        return self.formula(motion, *shapes)[..., self.joint, :]

    def torque_columns(
        self, motion: Motion, robot: "Robot | None" = None
    ) -> Float[Tensor, "*batch n C"]:
        """Torque of all joints per unit coefficient (..., n, C): zero but for the own joint."""
        own = self.columns(motion)
        out = own.new_zeros(*motion.dq.shape, own.shape[-1])
        out[..., self.joint, :] = own
        return out

    def torque(self, motion: Motion, values: Sequence[float]) -> Float[Tensor, "*batch"]:
        """Torque on the joint (...) [N m; N] for the given coefficients."""
        columns = self.columns(motion)
        return columns @ torch.as_tensor(values, dtype=columns.dtype, device=columns.device)

    def coefficient_names(self) -> list[str]:
        """Names with the joint's number, e.g. `Fv3`."""
        return [f"{c.name}{self.joint + 1}" for c in self.coefficients]


@dataclass(frozen=True)
class ModelEffect(Effect):
    """A change of the arm or of its sensors, seen through the model's torque.

    For simulation it says what it does to the arm (`plant`), or to what is measured (`measured`).
    Time is the first axis of the motion.
    """

    needs: ClassVar[frozenset[str]] = frozenset({"robot"})

    @property
    def joints(self) -> tuple[int, ...]:
        """None: it belongs to the whole arm, unless it says where it is."""
        return ()

    @classmethod
    def candidates(cls, robot: "Robot") -> "list[ModelEffect]":
        """One instance a place of the arm where it can be, with the first shapes of the grid."""
        return [cls()]

    def plant(self, robot: "Robot", values: Sequence[float]) -> "Robot":
        """The arm as it is with this effect; the same where it only changes what is measured."""
        return robot

    def measured(self, motion: Motion, values: Sequence[float]) -> Motion:
        """What the sensors make of a true motion whose `torque` is the true one; time is the first
        axis. The same where the effect changes the arm."""
        return motion
