"""Columns of effects along segments, as samples: what every least squares of effects is made of.

A `Model` is a rigid body with effects. `Columns` evaluates what an effect would add to a model's
torque per unit coefficient: in the wide band, then through the filter that the torque passes. The
columns are those of the present model: friction that grows with load sees its torque, a compliance
its inertia. None of them contains a measured torque, whose noise would explain itself.
"""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch

from torchid.design.segments import Samples, Segment
from torchid.dynamics.regressor import regressor_chunks
from torchid.effects.base import Effect, JointEffect, ModelEffect, Motion
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.registry import Valued, carrying, model_torque, nominal_effects
from torchid.effects.transient import Contact
from torchid.robot.inertia import PARAMETERS_PER_LINK
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

AT_ONCE = 2_000_000
"""Values that are evaluated and filtered at a time: bounds the memory of long logs."""

KEPT = 12_500_000
"""Values of columns that are kept for the next time (0.1 GB), the first that are evaluated: of a
long log the others are evaluated again."""


SMOOTHED = ("q", "dq", "ddq", "torque")

Place = int | None
"""A joint, from 0, whose torque alone columns are in; None for those of all joints."""


@dataclass(frozen=True)
class Model:
    """A rigid body with effects and their coefficients."""

    robot: Robot
    effects: tuple[Valued, ...]

    @classmethod
    def of(cls, robot: Robot) -> "Model":
        """A robot with the effects that it has."""
        return cls(robot, tuple(nominal_effects(robot)))

    @property
    def bodies(self) -> list[Valued]:
        """The model's effects that are bodies, with their coefficients."""
        return [p for p in self.effects if p[0].inertial]

    @cached_property
    def _carrying(self) -> Robot:
        return carrying(self.robot, self.effects)

    def arm_of(self, effect: Effect) -> Robot:
        """The arm that an effect is of: a body's the robot, any other's with the bodies."""
        return self.robot if effect.inertial else self._carrying

    def torque(
        self, segment: Segment, samples: Samples, load: Float[Tensor, "T n"] | None = None
    ) -> Float[Tensor, "T n"]:
        """Torque along a segment, whose `load` may be known. Effects that differentiate the model's
        torque see the motion low-passed like the samples, as their columns do: twice
        differentiated, the encoder's noise would be all that is left of them."""
        load = self.load(segment.motion) if load is None else load
        motion = segment.motion._replace(torque=load)
        others = [p for p in self.effects if not _enters_load(p)]
        low = smoothed(motion, samples) if any(e.smooth for e, _ in others) else motion
        return load + sum(
            e.all_torques(low if e.smooth else motion, v, self.arm_of(e)) for e, v in others
        )

    def load(self, motion: Motion) -> Float[Tensor, "T n"]:
        """Torque that effects see: of the body and of the sharp effects that need no torque
        themselves."""
        return model_torque(self.robot, [p for p in self.effects if _enters_load(p)], motion)

    def described(self) -> Robot:
        """The model as a robot description."""
        return replace(self.robot, effects=tuple(e.record(v) for e, v in self.effects))


def _enters_load(valued: Valued) -> bool:
    return not (valued[0].smooth or "torque" in valued[0].needs)


def smoothed(motion: Motion, samples: Samples) -> Motion:
    """A motion low-passed like the samples."""
    return motion._replace(**{k: samples.low_passed(getattr(motion, k)) for k in SMOOTHED})


class Columns:
    """Columns of effects at a model, as samples.

    Args:
        model: with parameters.
        samples: of the segments.
    """

    def __init__(self, model: Model, samples: Samples):
        self.model = model
        self.samples = samples
        self.motions = [s.motion._replace(torque=model.load(s.motion)) for s in samples.segments]
        # The rigid body's columns, once evaluated: of all models of the arm.
        self._rigid: list[Tensor] = []
        self._lasting: dict[Contact, list[Tensor]] = {}
        # By effect, or by a kind and its shapes.
        self._kept: dict[object, tuple[type[Effect], Place, Tensor]] = {}
        self._held = 0

    def at(self, model: Model) -> "Columns":
        """Columns of the same samples at another model of the arm. The rigid body's stay as they
        are; so does what no load enters, as long as the parameters do or it is one joint's alone,
        which knows no parameters."""
        new = Columns(model, self.samples)
        new._rigid = self._rigid
        same = model.robot is self.model.robot and model.bodies == self.model.bodies
        for key, (kind, place, columns) in self._kept.items():
            if "torque" not in kind.needs and (same or issubclass(kind, JointEffect)):
                new._keep(key, kind, place, columns)
        return new

    def _keep(self, key: object, kind: type[Effect], place: Place, columns: Tensor) -> None:
        """Keep columns for the next time, if there is room."""
        if self._held + columns.numel() <= KEPT:
            self._held += columns.numel()
            self._kept[key] = kind, place, columns

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.model.robot.n

    @property
    def gaps(self) -> list[Float[Tensor, "T n"]]:
        """Measured torque minus the model's, at each segment's own rate [N m; N]."""
        pairs = zip(self.samples.segments, self.motions, strict=True)
        return [s.tau - self.model.torque(s, self.samples, m.torque) for s, m in pairs]

    @cached_property
    def gap(self) -> Float[Tensor, "n N"]:
        """Samples of the measured torque minus the model's."""
        return self.samples.of([x.T for x in self.gaps])

    def of(self, effect: Effect) -> tuple[Place, Float[Tensor, "..."]]:
        """Columns of an effect: (C, N) of its joint, or (C, n, N) of all joints."""
        if effect in self._kept:
            return self._kept[effect][1:]
        if not isinstance(effect, JointEffect):
            assert isinstance(effect, ModelEffect)
            return next(self.of_several([effect]))
        motions = [only(m, effect.joint) for m in self.motions]
        columns = self._sampled([replace(effect, joint=0).columns(m).T for m in motions])
        self._keep(effect, type(effect), effect.joint, columns)
        return effect.joint, columns

    def of_several(
        self, effects: Sequence[ModelEffect]
    ) -> Iterator[tuple[Place, Float[Tensor, "..."]]]:
        """Columns of effects of one kind, those of a joint side by side, as `of`: so many at once
        as memory bears, segment by segment, for what effects have in common is evaluated once for
        all that are evaluated together."""
        values = AT_ONCE // self.n
        at_once = max(1, values // max(len(m.q) for m in self.motions))
        for k in range(0, len(effects), at_once):
            asked = effects[k : k + at_once]
            some = [e for e in asked if e not in self._kept]
            parts: list[list[Tensor]] = [[] for _ in some]
            for segments, _ in self._in_groups(values // len(some)) if some else ():
                for own, signals in zip(parts, self._signals(some, segments), strict=True):
                    own.append(self._sampled(signals))
            new = {e: self._felt(torch.cat(x, -1)) for e, x in zip(some, parts, strict=True)}
            for e, x in new.items():
                self._keep(e, type(e), *x)
            yield from (new[e] if e in new else self.of(e) for e in asked)

    def _felt(self, columns: Float[Tensor, "C n N"]) -> tuple[Place, Float[Tensor, "..."]]:
        """Columns on the joint that alone feels them, or on all."""
        peak = columns.abs().amax(2)
        # What only rounding has put there would be given any coefficient.
        # Size of a signal, relative to the largest of its effect, that is rounding
        rounding = 1e-11
        columns = columns * (peak > rounding * peak.max()).unsqueeze(2)
        felt = (peak.amax(0) > rounding * peak.max()).nonzero().flatten().tolist()
        return (felt[0], columns[:, felt[0]].clone()) if len(felt) == 1 else (None, columns)

    def on_all_joints(self, effect: Effect) -> Float[Tensor, "C n N"]:
        """Columns of an effect, zero on joints that do not feel it."""
        place, columns = self.of(effect)
        return columns if place is None else on_joint(columns, place, self.n)

    def laws(self, joint: int) -> Float[Tensor, "K N"]:
        """Columns of the rigid body, dry and viscous friction and an offset on a joint."""
        moved = list(self.model.robot.moved_by(joint))
        laws = (ViscousFriction, CoulombFriction, TorqueOffset)
        own = [self.of(law(joint))[1] for law in laws]
        return torch.cat([self.regressor[moved, :, joint].flatten(0, 1), *own])

    def torque(self, effect: Effect, values: Sequence[float]) -> Float[Tensor, "n N"]:
        """Torque of an effect on all joints [N m; N]."""
        columns = self.on_all_joints(effect)
        return torch.tensordot(columns.new_tensor(values), columns, 1)

    def of_shapes(
        self, kind: type[JointEffect], joint: int, shapes: Float[Tensor, "S P"]
    ) -> Float[Tensor, "S C N"]:
        """Columns of a joint effect for a list of shapes."""
        key = kind, joint, tuple(shapes.flatten().tolist())
        if key in self._kept:
            return self._kept[key][2]
        motions = [only(m, joint) for m in self.motions]
        total = sum(m.q.shape[0] for m in motions) * len(kind.coefficients)
        parts = []
        for some in shapes.split(max(1, AT_ONCE // total)) if len(kind.shapes) else [shapes[:1]]:
            given = [s.reshape(-1, 1, 1) for s in some.unbind(1)]
            signals = [kind.formula(m, *given)[..., 0, :].transpose(-1, -2) for m in motions]
            parts.append(self._sampled([x if given else x.unsqueeze(0) for x in signals]))
        columns = torch.cat(parts)
        self._keep(key, kind, joint, columns)
        return columns

    @property
    def regressor(self) -> Float[Tensor, "L 10 n N"]:
        """The rigid body's columns, link by link; zero where a joint does not feel a link. They
        depend on the kinematics alone."""
        if not self._rigid:
            self._rigid.append(self._regressor())
        return self._rigid[0]

    def _regressor(self) -> Float[Tensor, "L 10 n N"]:
        n, robot = self.n, self.model.robot
        links = robot.n_links
        out = torch.zeros(links, PARAMETERS_PER_LINK, n, len(self.samples), dtype=torch.float64)
        for segments, own in self._in_groups(AT_ONCE // (links * n * PARAMETERS_PER_LINK)):
            motions = self.motions[segments]
            chunks = list(regressor_chunks(robot, *together(motions).state))
            lengths = [len(m.q) for m in motions]
            for j in range(n):
                moved = list(robot.moved_by(j))
                pairs = [(link, k) for link in moved for k in range(PARAMETERS_PER_LINK)]
                rows = torch.cat([c.row(j, pairs) for c in chunks], -1).split(lengths, -1)
                sampled = self._sampled(rows).unflatten(0, (len(moved), PARAMETERS_PER_LINK))
                for link, values in zip(moved, sampled, strict=True):
                    out[link, :, j, own] = values
        return out

    def _in_groups(self, instants: int) -> Iterator[tuple[slice, slice]]:
        """Segments, so many together as have no more than so many instants (of a longer one, it
        alone), and their samples."""
        first = 0
        while first < len(self.motions):
            total = itertools.accumulate(len(m.q) for m in self.motions[first:])
            count = max(1, sum(1 for _ in itertools.takewhile(instants.__ge__, total)))
            bounds = self.samples.bounds[first : first + count]
            yield slice(first, first + count), slice(bounds[0].start, bounds[-1].stop)
            first += count

    def _signals(
        self, effects: Sequence[ModelEffect], segments: slice
    ) -> Iterator[list[Float[Tensor, "C n _"]]]:
        """Columns of model effects of one kind along some segments, one effect after the other; of
        all these in one call where time plays no part."""
        kind, robot = type(effects[0]), self.model.arm_of(effects[0])
        if isinstance(effects[0], Contact) and effects[0] != effects[0].lasting:
            times = [m.require("t", kind.name) for m in self.motions[segments]]
            for effect in effects:
                assert isinstance(effect, Contact)
                gates = [effect.window(t) for t in times]
                lasting = self._all_the_time(effect.lasting)[segments]
                yield [x * gate for x, gate in zip(lasting, gates, strict=True)]
            return
        motions = (self._smooth if kind.smooth else self.motions)[segments]
        lengths = [len(m.q) for m in motions]
        if kind.windowed or not kind.needs & {"t", "age"}:
            motions = [together(motions)]
        for parts in kind.columns_along(effects, motions, robot):
            yield list(torch.cat([x.permute(2, 1, 0) for x in parts], -1).split(lengths, -1))

    def _all_the_time(self, contact: Contact) -> list[Float[Tensor, "C n _"]]:
        """A contact that lasts, of which windows are parts."""
        if contact not in self._lasting:
            self._lasting[contact] = next(self._signals([contact], slice(None)))
        return self._lasting[contact]

    @cached_property
    def _smooth(self) -> list[Motion]:
        return [smoothed(m, self.samples) for m in self.motions]

    def _sampled(self, signals: Sequence[Tensor]) -> Tensor:
        """Samples of signals (..., T_s), so many at a time as memory bears."""
        flat = [x.reshape(-1, x.shape[-1]) for x in signals]
        step = max(1, AT_ONCE // max(x.shape[-1] for x in flat))
        parts = [
            self.samples.of([x[k : k + step] for x in flat])
            for k in range(0, flat[0].shape[0], step)
        ]
        return torch.cat(parts).reshape(*signals[0].shape[:-1], -1)


def only(motion: Motion, joint: int) -> Motion:
    """The motion of one joint alone, as that of an arm with one."""
    own = slice(joint, joint + 1)
    signals: Iterable[Tensor | None] = (
        x if x is None or name == "t" else x[..., own]
        for name, x in zip(Motion._fields, motion, strict=True)
    )
    return Motion(*signals)  # type: ignore[arg-type]


def together(motions: Sequence[Motion]) -> Motion:
    """Motions one after the other, as one."""
    parts = zip(*motions, strict=True)
    return Motion(*(None if x[0] is None else torch.cat(x) for x in parts))  # type: ignore[arg-type]


def on_joint(columns: Float[Tensor, "C N"], joint: int, n: int) -> Float[Tensor, "C n N"]:
    """Columns of one joint's torque with zeros in those of the other n - 1."""
    out = columns.new_zeros(columns.shape[0], n, columns.shape[1])
    out[:, joint] = columns
    return out
