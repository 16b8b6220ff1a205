"""An effect: something that adds torque to the rigid body.

Friction, rotor inertia, offsets, delays, tilt, ... are the same kind of thing everywhere:
identification uses an effect's columns, simulation adds its torque, the gap diagnosis searches over
effects. A new one is one class in the file of its family and a line in `registry.py`, and nothing
elsewhere; the test battery in tests/effects covers it.

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
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import torch
from torch import Tensor

from torchid.effects.motion import Motion
from torchid.effects.names import PLACES
from torchid.effects.parameters import Coefficient, Shape
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

Branch = Literal["friction", "inertia", "transmission", "sensing", "surroundings"]
"""Where in an arm a cause is, as engineers sort them: friction of a joint; bodies and what they
carry; gears; sensors and actuators; what the arm stands in. How far a log decides is said in this
tree, whose leaves are effects at joints."""


Abscissa = Literal["speed", "position", "acceleration", "time"]

Columns = Float[Tensor, "*batch n C"]
"""Torque of n joints per unit of each of C coefficients."""


class Example(NamedTuple):
    """An effect of a size to be seen, on the shoulder of an arm that weighs tens of newton metres.

    Attributes:
        values: coefficients.
        over: what its torque is drawn over.
        given: fields of the effect but its joint, where they are not the default.
    """

    values: tuple[float, ...]
    over: Abscissa
    given: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class Effect(ABC):
    """Something that adds torque to the rigid body, linear in its coefficients.

    All that is known of an effect stands in its class, and nowhere else. It gives the class
    attributes values without annotating them again: what is annotated there is a field.

    Class attributes:
        name, family: as in files (see the registry).
        branch: of the tree of causes.
        detail: what it says of its joint's friction law, in plain words; of friction alone.
        coefficients: what it is linear in.
        shapes: what it is not; each is also a field of the instance.
        gloss: what its name says, in a few plain words; empty where it is everybody's.
        meaning: what it is physically, one sentence.
        equation: torque that it adds, in the names of its coefficients and shapes. `Y_i` are the
            columns of link i in the regressor (eq. 2.18), `tau(..)` is the model's torque, `e_j`
            the unit vector of joint j.
        signature: how it shows in the residual torque.
        experiment: the motion in which it shows itself, as an order (the literature's advice).
        beyond: what settles whether it is there when no motion of the bare arm does; None where
            only the maker's data or trusted inertial parameters do.
        remedy: what an engineer does about it, one sentence.
        source: where its equation comes from.
        example: what is drawn of it.
        needs: which of `t`, `torque`, `age`, `robot`, and `velocity` (that dq was measured on its
            own, not differentiated from q) its columns need.
        jumps: whether its columns are discontinuous in the motion.
        essential: numbers of the coefficients without which it would be another, simpler effect.
        event: whether it happened once in one log, and is no property of the arm.
        windowed: whether it is there in a window of time only, which must be found first.
        at_ends: whether it acts at an end of the travel alone, so that few stretches of a log show
            it.
        servo: numbers of a position servo (`torchid.effects.servo.PARAMETERS`) that it is in
            logs of commands and positions, the one that gives its size first.
        positions: whether such logs show it.
        by_motion: whether a motion of some seconds brings it about.
        shared: whether one coefficient may be common to all joints.
        inertial: whether it is a change of the bodies' inertial parameters.
        smooth: whether its columns differentiate the model's torque, so that it is evaluated on a
            motion that is low-passed as the rows are.
        linearised: whether its columns are a secant, taken at the field `at`.
        over_position: whether its torque is a curve of its joint's position, whatever else moves.
        of_sensor: whether it is an error of what was measured: the log is to be corrected, and no
            simulator.
        scale_of_torque: whether it is the error of a measured torque's scale.
        of_bodies: whether its columns need the links' own parameters: the same base parameters,
            split among the links in another way, give others.
        memory: whether the torque of its joint depends on the past: then time is the last axis but
            one of the motion.
        costly: whether its columns take so long that they are evaluated only on joints where
            something is left to explain.
        elastic: whether its joint's link swings on the gear.
        logs_late: what it logs late: torque, or velocity.
        after_noise: whether it acts on samples as they were logged, noise and all.
        bounds_key: of its coefficient in the `bounds` of a robot's file.
        usual: whether it is planted in every check of an answer by withheld causes.
        where: what it is located at, in words.
    """

    name: ClassVar[str]
    family: ClassVar[Family]
    branch: ClassVar[Branch]
    detail: ClassVar[str] = ""
    coefficients: ClassVar[tuple[Coefficient, ...]]
    shapes: ClassVar[tuple[Shape, ...]] = ()
    gloss: ClassVar[str] = ""
    meaning: ClassVar[str]
    equation: ClassVar[str]
    signature: ClassVar[str]
    experiment: ClassVar[str]
    beyond: ClassVar[str | None] = None
    remedy: ClassVar[str]
    source: ClassVar[str]
    example: ClassVar[Example]
    needs: ClassVar[frozenset[str]] = frozenset()
    jumps: ClassVar[bool] = False
    essential: ClassVar[tuple[int, ...]] = ()
    event: ClassVar[bool] = False
    windowed: ClassVar[bool] = False
    at_ends: ClassVar[bool] = False
    servo: ClassVar[tuple[str, ...]] = ()
    positions: ClassVar[bool] = False
    by_motion: ClassVar[bool] = True
    shared: ClassVar[bool] = False
    inertial: ClassVar[bool] = False
    smooth: ClassVar[bool] = False
    linearised: ClassVar[bool] = False
    over_position: ClassVar[bool] = False
    of_sensor: ClassVar[bool] = False
    scale_of_torque: ClassVar[bool] = False
    of_bodies: ClassVar[bool] = False
    memory: ClassVar[bool] = False
    costly: ClassVar[bool] = False
    elastic: ClassVar[bool] = False
    logs_late: ClassVar[Literal["torque", "velocity"] | None] = None
    after_noise: ClassVar[bool] = False
    bounds_key: ClassVar[str] = ""
    usual: ClassVar[bool] = False
    where: ClassVar[str]

    @classmethod
    def exemplar(cls, joint: int) -> "Effect":
        """The effect of the example, on a joint where it is located at one."""
        place = {"joint": joint} if any(f.name == "joint" for f in fields(cls)) else {}
        return cls(**place, **cls.example.given)

    @classmethod
    def logs(cls) -> tuple[str, ...]:
        """Which logs can show it: of torques, of commands and positions, or both."""
        return ("torque", "positions") if cls.positions else ("torque",)

    @classmethod
    @abstractmethod
    def candidates(cls, robot: "Robot") -> "list[Effect]":
        """One instance a place of the arm where it can be, of the example's shapes or, for effects
        of the model, the first of the grid."""

    @classmethod
    def starts(cls, robot: "Robot") -> "list[Effect]":
        """What a search begins with: several at a place where the column is another one at another
        secant, so far apart that each has something in common with those `between`."""
        return cls.candidates(robot)

    @property
    @abstractmethod
    def joints(self) -> tuple[int, ...]:
        """Joints it is located at, from 0; empty where it belongs to the whole arm."""

    @property
    def reads(self) -> tuple[int, ...]:
        """Joints, from 0, whose logged torque it reads beside its own."""
        return ()

    @property
    def of_speed(self) -> bool:
        """Whether its torque is a curve of its joint's speed, whatever else moves."""
        return False

    @property
    def span(self) -> tuple[float, float] | None:
        """The window in which it is there, on the motion's clock [s]; None where it has none."""
        return None

    @property
    def point(self) -> str:
        """The point of the arm that it acts at, in words with a comma behind; empty of joints."""
        return ""

    def remarks(self, values: Sequence[float], q: Float[Tensor, "T n"]) -> list[str]:
        """What its coefficients do not say of it along the positions of a log, sentences without a
        full stop."""
        return []

    def at_an_end(self, motions: Sequence[Motion]) -> tuple[str, ...]:
        """Shapes that are at an end of their range on these motions: there the effect has become
        another, simpler one."""
        return ()

    def plant(self, robot: "Robot", values: Sequence[float]) -> "Robot":
        """The arm as it is with this effect; itself where it adds torque, or is in the sensors."""
        return robot

    def measured(
        self, motion: Motion, values: Sequence[float], robot: "Robot | None" = None
    ) -> Motion:
        """What the sensors make of a true motion whose `torque` is the true one, time the first
        axis; the motion itself where it is no effect of sensors."""
        return motion

    @abstractmethod
    def torque_columns(self, motion: Motion, robot: "Robot | None" = None) -> Columns:
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
    def identity(self) -> tuple[str, tuple[int, ...]]:
        """Name and places (joint, source joint): effects with the same are the same effect, with
        other shapes or options perhaps."""
        return self.name, tuple(getattr(self, p) for p in PLACES if hasattr(self, p))

    def coefficient_names(self) -> list[str]:
        """Names with the joint's number, e.g. `Fv3`; `C2_4` on joint 2 from joint 4."""
        return [f"{c.name}{self._place}" for c in self.coefficients]

    def shape_names(self) -> list[str]:
        """Names of the shapes with the joint's number, e.g. `vs3`."""
        return [f"{s.name}{self._place}" for s in self.shapes]

    @property
    def _place(self) -> str:
        return "_".join(str(j + 1) for j in self.identity[1])

    def at_estimate(self, values: Sequence[float]) -> "Effect":
        """The effect with its secant taken at the estimated coefficient; itself where it is not
        `linearised`, or the estimate is zero or one that no arm has."""
        value, (least, most) = float(values[0]), self.ranges[0]
        if not self.linearised or value == 0 or not least <= value <= most:
            return self
        return replace(self, at=value)  # type: ignore[call-arg]

    @property
    def law(self) -> str:
        """Name of the joint's law whose details are several effects; empty of a cause by itself."""
        return "friction" if self.branch == "friction" else "position" * self.over_position

    @property
    def over_time(self) -> bool:
        """Whether its torque at one instant depends on other instants of the motion."""
        return False

    @property
    def ranges(self) -> tuple[tuple[float, float], ...]:
        """Least and largest that each coefficient can be: on any arm, unless the columns are those
        of one size alone."""
        return tuple(c.range for c in self.coefficients)

    def body(self, robot: "Robot") -> int | None:
        """Link, from 0, to whose inertial parameters its coefficients are added; None of what is no
        body."""
        return None

    def own_columns(
        self, motion: Motion, robot: "Robot | None" = None
    ) -> list[Float[Tensor, "*batch C"]]:
        """Columns (..., C) of the torque of each of its joints, in the order of `joints`."""
        columns = self.torque_columns(motion, robot)
        return [columns[..., j, :] for j in self.joints]

    def unsure(self, values: Sequence[float]) -> list[float]:
        """By how much coefficients are less sure than a fit of its columns says: nothing, unless
        the columns are those of another size and stay so."""
        return [0.0] * len(values)

    @property
    def becomes(self) -> str | None:
        """Name of the simpler effect that this one has become, its shape near an end of its range;
        None elsewhere."""
        return None

    def all_torques(
        self, motion: Motion, values: Sequence[float] | Tensor, robot: "Robot | None" = None
    ) -> Float[Tensor, "*batch n"]:
        """Torque of all joints (..., n) [N m; N] for the given coefficients."""
        columns = self.torque_columns(motion, robot)
        return columns @ torch.as_tensor(values, dtype=columns.dtype, device=columns.device)

    def c_code(self, values: Sequence[float]) -> list[str] | None:
        """C statements that add its torque (see `c_text`); None where the torque is no closed form
        of the present motion."""
        return None

    def attributes(self, values: Sequence[float]) -> dict[str, float] | None:
        """What it adds to its joint's damping, friction, armature, stiffness and offset in a
        simulator's file; None where no format has an attribute for it.

        A negative damping, friction or armature, which physics forbids and simulators refuse or
        destabilise on, is none.
        """
        return None

    def record(self, values: Sequence[float]) -> dict[str, Any]:
        """As in a robot's yaml: {effect, joint or joints, coefficients, shape parameters}."""
        out: dict[str, Any] = {"effect": self.name}
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        out |= {place: own.pop(place) + 1 for place in PLACES if place in own}
        for c, v in zip(self.coefficients, values, strict=True):
            # A solution at a bound of zero may lie below it by rounding, which no reader takes;
            # where there is no largest size, readers take any sign.
            bound = c.non_negative and c.largest < math.inf
            # 1e-9: of the largest size of a coefficient
            out[c.name] = 0.0 if bound and -1e-9 * c.largest < v < 0 else float(v)
        return out | own


@dataclass(frozen=True)
class JointEffect(Effect):
    """An effect on one joint that depends on the motion of that joint.

    Attributes:
        joint: index of the joint it acts on, from 0.
    """

    joint: int

    where: ClassVar[str] = "one joint (`joint`)"

    @classmethod
    def candidates(cls, robot: "Robot") -> "list[Effect]":
        """One on every joint that a motor drives."""
        return [cls(joint, **cls.example.given) for joint in robot.driven]

    @property
    def of_speed(self) -> bool:
        """Whether it is friction of the present speed alone."""
        return self.law == "friction" and not (self.memory or self.needs)

    @classmethod
    @abstractmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """Torque per unit coefficient, of every joint as if the effect were on it.

        Args:
            motion: signals (..., n); with a memory (..., T, n).
            shapes: one tensor a shape parameter, that broadcasts with the signals: () for one
                value, (S, 1, 1) for a grid over (T, n) signals, (B, n) for a batch of arms.

        Returns:
            (..., n, C), the shapes' leading axes in front.
        """

    @classmethod
    def grid(cls, motions: Sequence[Motion], joint: int, cutoff: float) -> Float[Tensor, "S P"]:
        """Shapes that a search begins with on a joint, one combination a row; no row where these
        motions cannot show the effect.

        Args:
            motions: with torque, where a shape is relative to it.
            joint: from 0.
            cutoff: of the torque's band [Hz].
        """
        sizes = [s.size(motions, joint) for s in cls.shapes]
        values = [[v * size for v in s.grid] for s, size in zip(cls.shapes, sizes, strict=True)]
        return torch.tensor(list(product(*values)), dtype=torch.float64)

    def finer(
        self, motions: Sequence[Motion], level: int, cutoff: float
    ) -> Float[Tensor, "S P"] | None:
        """Shapes around its own, one combination a row, ever closer with `level`: within the grid's
        step at 0, a third of it at 1, ...; None where it has no shape.

        Args:
            motions, cutoff: as for `grid`.
            level: from 0.
        """
        if not self.shapes:
            return None
        values = zip(self.shapes, self.shape_values, strict=True)
        axes = [s.around(v, level, s.size(motions, self.joint)) for s, v in values]
        return torch.cartesian_prod(*axes).reshape(-1, len(axes))

    def at_an_end(self, motions: Sequence[Motion]) -> tuple[str, ...]:
        """Shapes that are at an end of their range on this joint's motions: there the effect has
        become another, simpler one."""
        out = []
        for shape, value in zip(self.shapes, self.shape_values, strict=True):
            size = shape.size(motions, self.joint)
            near = 1e-3 * (shape.high - shape.low) * size
            if not shape.low * size + near < value < shape.high * size - near:
                out.append(shape.name)
        return tuple(out)

    @classmethod
    def initial(cls, motion: Motion, *shapes: Tensor) -> Tensor | None:
        """State (..., n) before the first instant; None where there is no memory."""
        return None

    @classmethod
    def advance(
        cls, motion: Motion, dt: float, state: Tensor | None, *shapes: Tensor
    ) -> tuple[Columns, Tensor | None]:
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
        """The joint that it acts on, as a tuple."""
        return (self.joint,)

    @property
    def over_time(self) -> bool:
        """Whether it has a memory."""
        return self.memory

    def columns_from(
        self, motion: Motion, state: Float[Tensor, "*batch"]
    ) -> Float[Tensor, "*batch T C"]:
        """Columns of an effect with a memory, from a state at the first instant."""
        raise NotImplementedError

    def after(self, motion: Motion, state: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """State of an effect with a memory at the last instant."""
        raise NotImplementedError

    def columns(self, motion: Motion) -> Float[Tensor, "*batch C"]:
        """Columns (..., C) of the torque of joint `joint`, one a coefficient."""
        shapes = (
            torch.as_tensor(v, dtype=motion.dq.dtype, device=motion.dq.device)
            for v in self.shape_values
        )
        return self.formula(motion, *shapes)[..., self.joint, :]

    def own_columns(
        self, motion: Motion, robot: "Robot | None" = None
    ) -> list[Float[Tensor, "*batch C"]]:
        """Columns of its joint."""
        return [self.columns(motion)]

    def torque_columns(self, motion: Motion, robot: "Robot | None" = None) -> Columns:
        """Torque of all joints per unit coefficient (..., n, C): zero but for the own joint."""
        own = self.columns(motion)
        out = own.new_zeros(*motion.dq.shape, own.shape[-1])
        out[..., self.joint, :] = own
        return out

    def torque(self, motion: Motion, values: Sequence[float]) -> Float[Tensor, "*batch"]:
        """Torque on the joint (...) [N m; N] for the given coefficients."""
        columns = self.columns(motion)
        return columns @ torch.as_tensor(values, dtype=columns.dtype, device=columns.device)


@dataclass(frozen=True)
class ModelEffect(Effect):
    """A change of the arm or of its sensors, seen through the model's torque.

    For simulation it says what it does to the arm (`plant`), or to what is measured (`measured`).
    Time is the first axis of the motion.
    """

    needs: ClassVar[frozenset[str]] = frozenset({"robot"})
    where: ClassVar[str] = "the whole arm"

    @property
    def joints(self) -> tuple[int, ...]:
        """None: it belongs to the whole arm, unless it says where it is."""
        return ()

    @property
    def over_time(self) -> bool:
        """Whether it needs times for more than the window in which it is there."""
        return "t" in self.needs and not self.windowed

    @classmethod
    def candidates(cls, robot: "Robot") -> "list[Effect]":
        """The one of the whole arm, with the first shapes of the grid."""
        return [cls()]

    def between(self) -> "Sequence[ModelEffect]":
        """What stands between this one of the `starts` and the next, and is looked at where the
        starts explain something; none where the starts are all."""
        return []

    @classmethod
    def columns_of(
        cls, effects: "Sequence[ModelEffect]", motion: Motion, robot: "Robot | None" = None
    ) -> Iterator[Columns]:
        """Columns of several effects of this kind, one after the other, joint by joint; a kind
        whose columns have much in common evaluates that once."""
        yield from (effect.torque_columns(motion, robot) for effect in effects)

    @classmethod
    def columns_along(
        cls,
        effects: "Sequence[ModelEffect]",
        motions: Sequence[Motion],
        robot: "Robot | None" = None,
    ) -> Iterator[Sequence[Columns]]:
        """Columns of several effects along several trajectories, one column each."""
        yield from zip(*(cls.columns_of(effects, m, robot) for m in motions), strict=True)

    def around(self, level: int, interval: float) -> "Sequence[ModelEffect]":
        """The effect with what no coefficient scales a little otherwise, ever less so with `level`;
        none where there is no such thing.

        Args:
            level: from 0.
            interval: between samples [s].
        """
        return []

    def sharp(self) -> "Sequence[ModelEffect]":
        """The effect with other shapes at the same size `at` that only the torque above the
        fit's band tells apart, as that of an impact; none where there is no such thing."""
        return []
