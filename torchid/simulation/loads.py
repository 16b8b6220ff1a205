"""Torque of effects on a batch of arms, taken apart for an implicit integrator.

Arms of a batch have different effects. Those of one kind are evaluated together: one call of the
kind's formula for all arms and joints, with coefficients that are zero where an arm lacks it.
"""

import copy
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchid.effects.base import Effect, JointEffect, ModelEffect, Motion
from torchid.effects.inertia import RotorInertia
from torchid.effects.names import PLACES
from torchid.effects.registry import Valued
from torchid.robot.model import Robot

_SPEED_STEP = 1e-4
"""Of the finite difference in speed [rad/s or m/s]."""


class Loads(NamedTuple):
    """Torque that resists a motion: smooth + slope (dq' - dq) + dry sign(dq') near dq.

    Attributes:
        smooth: (B, n) at the given dq [N m; N].
        slope: (B, n) of the smooth part over dq.
        dry: (B, n) at least 0; a joint at rest is held by anything up to it.
    """

    smooth: Tensor
    slope: Tensor
    dry: Tensor


@dataclass(frozen=True, eq=False)
class Kind:
    """All effects of one kind.

    Attributes:
        kind: class of the effect.
        coefficients: (B, n, C).
        shapes: one (B, n) a shape parameter.
    """

    kind: type[JointEffect]
    coefficients: Tensor
    shapes: tuple[Tensor, ...]

    @property
    def jumps(self) -> bool:
        """Whether its slope over the speed means nothing."""
        return self.kind.jumps

    @property
    def loaded(self) -> bool:
        """Whether it needs the torque that the joints transmit."""
        return "torque" in self.kind.needs

    def alone(self, arm: int) -> "Kind":
        """The effect on one arm alone."""
        shapes = tuple(shape[arm : arm + 1] for shape in self.shapes)
        return replace(self, coefficients=self.coefficients[arm : arm + 1], shapes=shapes)

    def torque(self, motion: Motion) -> Tensor:
        """(..., B, n)."""
        return (self.kind.formula(motion, *self.shapes) * self.coefficients).sum(-1)

    def advance(
        self, motion: Motion, dt: float, state: Tensor | None
    ) -> tuple[Tensor, Tensor | None]:
        """Torque (..., B, n) after `dt`, and the state then."""
        columns, after = self.kind.advance(motion, dt, state, *self.shapes)
        return (columns * self.coefficients).sum(-1), after


@dataclass(frozen=True, eq=False)
class Single:
    """One effect that its kind's formula does not cover, on the arms that have it.

    Attributes:
        effect: with fields beyond its shapes (a smoothed sign), or of two joints.
        coefficients: (B, 1, C).
        robot: whose model it needs.
    """

    effect: Effect
    coefficients: Tensor
    robot: Robot

    @property
    def jumps(self) -> bool:
        """Whether its slope over the speed means nothing; that of a smoothed sign does."""
        return isinstance(self.effect, ModelEffect) and self.effect.jumps

    @property
    def loaded(self) -> bool:
        """Whether it needs the torque that the joints transmit."""
        return "torque" in self.effect.needs

    def alone(self, arm: int) -> "Single":
        """The effect on one arm alone."""
        return replace(self, coefficients=self.coefficients[arm : arm + 1])

    def torque(self, motion: Motion) -> Tensor:
        """(..., B, n)."""
        shape = motion.q.shape
        rows = Motion(
            *(
                None if x is None else x.expand(shape if x.ndim == len(shape) else shape[:-1])
                for x in motion
            )  # type: ignore[arg-type]
        )
        flat = Motion(*(None if x is None else x.flatten(0, len(shape) - 2) for x in rows))  # type: ignore[arg-type]
        columns = self.effect.torque_columns(flat, self.robot).unflatten(0, shape[:-1])
        return (columns * self.coefficients).sum(-1)


class BatchEffects:
    """The torque effects of a batch of arms.

    Args:
        effects: one list an arm; those that change the arm or its sensors are left out here.
        robot: number of joints; the nominal model.
        like: dtype and device.
    """

    def __init__(self, effects: Sequence[Sequence[Valued]], robot: Robot, like: Tensor):
        # Effects by kind (a second one of a kind on a joint opens another group), and single ones.
        kinds: list[tuple[type[JointEffect], Slots]] = []
        singles: dict[Effect, dict[int, list[float]]] = {}
        for arm, own in enumerate(effects):
            for effect, values in own:
                if not adds_torque(effect):
                    continue
                if isinstance(effect, JointEffect) and _is_plain(effect):
                    place = (arm, effect.joint)
                    free = (s for kind, s in kinds if kind is type(effect) and place not in s)
                    slots = next(free, None)
                    if slots is None:
                        slots = {}
                        kinds.append((type(effect), slots))
                    slots[place] = (effect, values)
                else:
                    had = singles.setdefault(effect, {}).get(arm, [0.0] * len(values))
                    singles[effect][arm] = [a + b for a, b in zip(had, values, strict=True)]
        groups = [_kind(kind, slots, len(effects), robot.n, like) for kind, slots in kinds]
        self._memory = [group for group in groups if group.kind.memory]
        self._plain: list[Kind | Single] = [g for g in groups if not g.kind.memory]
        self._plain += [_single(*item, len(effects), robot, like) for item in singles.items()]
        # (B, n, n) torque per acceleration, which adds to the mass matrix. Accelerations are
        # therefore 0 wherever the effects are evaluated.
        zero = like.new_zeros(len(effects), robot.n)
        still = Motion(zero, zero, zero, zero, zero[:, 0], zero)
        columns = []
        for unit in torch.eye(zero.shape[-1]).to(zero):
            moved = still._replace(ddq=unit.expand_as(zero))
            parts = [g.torque(moved) - g.torque(still) for g in self._plain if not g.loaded]
            columns.append(sum(parts, zero))
        self.inertia = torch.stack(columns, -1)
        self._plain = [
            g for g in self._plain if not (isinstance(g, Kind) and g.kind is RotorInertia)
        ]
        self.needs_torque = any(group.loaded for group in [*self._plain, *self._memory])

    def alone(self, arm: int) -> "BatchEffects":
        """The effects of one of the arms."""
        own = copy.copy(self)
        own.inertia = self.inertia[arm : arm + 1]
        own._plain = [group.alone(arm) for group in self._plain]
        own._memory = [group.alone(arm) for group in self._memory]
        return own

    def initial(self, motion: Motion) -> list[Tensor | None]:
        """States of the effects with a memory."""
        return [group.kind.initial(motion, *group.shapes) for group in self._memory]

    def advance(
        self, motion: Motion, dt: float, states: Sequence[Tensor | None]
    ) -> list[Tensor | None]:
        """States after a step of `dt` with this motion."""
        return [g.advance(motion, dt, s)[1] for g, s in zip(self._memory, states, strict=True)]

    def at(self, motion: Motion, dt: float, states: Sequence[Tensor | None]) -> Loads:
        """The resisting torques.

        Args:
            motion: q, dq, ddq (B, n), t (B,), and the rigid body's torque where `needs_torque`.
            dt: seconds since the instant of the states.
            states: of the effects with a memory.
        """
        both, way = _both_ways(motion), torch.sign(motion.dq)
        sharp = smooth = torch.zeros_like(both.dq)
        for loaded in (False, True) if self.needs_torque else (False,):
            if loaded:
                assert motion.torque is not None
                # In the direction in which each joint moves, or between both at rest.
                forwards, backwards = (sharp[0] + smooth[0]).unbind()
                own = forwards + backwards + (forwards - backwards) * way
                carried = motion.torque + own / 2
                both = both._replace(torque=carried.expand(both.dq.shape))
            for group, torque in self._torques(both, dt, states, loaded):
                if group.jumps:
                    sharp = sharp + torque
                else:
                    smooth = smooth + torque
        return _loads(sharp, smooth, way)

    def _torques(
        self, both: Motion, dt: float, states: Sequence[Tensor | None], loaded: bool
    ) -> Iterator[tuple[Kind | Single, Tensor]]:
        for group in self._plain:
            if group.loaded is loaded:
                yield group, group.torque(both)
        for held, state in zip(self._memory, states, strict=True):
            if held.loaded is loaded:
                yield held, held.advance(both, dt, state)[0]


def _both_ways(motion: Motion) -> Motion:
    """The motion (2, 2, B, n): at dq and a little faster, in the direction forwards and backwards.
    A joint slides in the direction it moves in, and would do in either when it is at rest."""
    shape = (2, 2, *motion.dq.shape)
    faster = torch.stack([motion.dq, motion.dq + _SPEED_STEP]).unsqueeze(1)
    way = motion.dq.new_tensor([1.0, -1.0])[:, None, None]
    return Motion(
        motion.q.expand(shape),
        faster.expand(shape),
        motion.ddq.expand(shape),
        way.expand(shape),
        None if motion.t is None else motion.t.expand(shape[:-1]),
        None if motion.torque is None else motion.torque.expand(shape),
        None if motion.age is None else motion.age.expand(shape),
    )


def _loads(sharp: Tensor, smooth: Tensor, way: Tensor) -> Loads:
    """From torques (2, 2, B, n) as `_both_ways` has them: of effects that jump, and of others."""
    forwards, backwards = (sharp[0] + smooth[0]).unbind()
    half = (forwards - backwards) / 2
    # Where it drives the motion instead (a coefficient of the wrong sign) it holds nothing.
    dry = half.clamp(min=0)
    slope = (smooth[1] - smooth[0]).sum(0) / (2 * _SPEED_STEP)
    return Loads((forwards + backwards) / 2 + (half - dry) * way, slope, dry)


Slots = dict[tuple[int, int], tuple[JointEffect, list[float]]]
"""The effect of each (arm, joint)."""


def adds_torque(effect: Effect) -> bool:
    """Whether an effect neither changes the arm's bodies nor what is measured."""
    return not changes_measurement(effect) and type(effect).plant is Effect.plant


def changes_measurement(effect: Effect) -> bool:
    """Whether it is in the sensors: it has a `measured` of its own."""
    return type(effect).measured is not Effect.measured


def _is_plain(effect: JointEffect) -> bool:
    """Whether the formula of its kind covers it: no field but joint and shapes is set."""
    known = {*PLACES, *(s.name for s in effect.shapes)}
    if "source_joint" in (f.name for f in fields(effect)):
        return False
    extra = [f for f in fields(effect) if f.name not in known]
    return all(f.default is not MISSING and getattr(effect, f.name) == f.default for f in extra)


def _kind(kind: type[JointEffect], slots: Slots, arms: int, n: int, like: Tensor) -> Kind:
    coefficients = like.new_zeros(arms, n, len(kind.coefficients))
    usual = next(iter(slots.values()))[0].shape_values
    shapes = [like.new_full((arms, n), value) for value in usual]
    for (arm, joint), (effect, values) in slots.items():
        coefficients[arm, joint] = like.new_tensor(values)
        for shape, value in zip(shapes, effect.shape_values, strict=True):
            shape[arm, joint] = value
    return Kind(kind, coefficients, tuple(shapes))


def _single(
    effect: Effect, values: dict[int, list[float]], arms: int, robot: Robot, like: Tensor
) -> Single:
    coefficients = like.new_zeros(arms, 1, len(effect.coefficients))
    for arm, own in values.items():
        coefficients[arm, 0] = like.new_tensor(own)
    return Single(effect, coefficients, robot)
