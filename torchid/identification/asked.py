"""The effects that an identification is asked for: kinds, places and shapes, as they are written.

viscous_friction                        on every joint
joint_spring:joint=2,curvature=0        on joint 2, its shape given
stribeck_friction:joint=3               its shape, vs, is searched
gear_coupling:joint=6,source_joint=5    on a pair of joints
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from torchid.effects.base import PLACES, Effect, JointEffect, ModelEffect
from torchid.effects.gravity import TorqueGain
from torchid.effects.registry import effect_from_record, fitted_kind
from torchid.effects.written import name_and_pairs
from torchid.errors import TorchidError
from torchid.robot.model import Robot


@dataclass(frozen=True)
class Asked:
    """An effect at one place.

    Attributes:
        effect: with the shapes that are given, and any value for the others.
        searched: names of those others.
    """

    effect: Effect
    searched: tuple[str, ...]

    @property
    def plain(self) -> bool:
        """Whether its columns are known, and functions of the present motion alone."""
        remembers = isinstance(self.effect, JointEffect) and self.effect.memory
        return not (self.searched or self.effect.needs or remembers)


def asked_effects(written: Sequence[str], robot: Robot) -> tuple[Asked, ...]:
    """Effects of a robot, kind by kind in the order in which they are first named.

    Raises:
        TorchidError: an effect that cannot be fitted beside base parameters, an unknown key or a
            joint that the robot does not have, a place named twice.
    """
    found = [asked for text in written for asked in _places(text, robot)]
    order = list(dict.fromkeys(a.effect.name for a in found))
    found.sort(key=lambda a: order.index(a.effect.name))
    places = [a.effect.identity for a in found]
    twice = [identity for k, identity in enumerate(places) if identity in places[:k]]
    if twice:
        name, joints = twice[0]
        where = " and ".join(f"joint {j + 1}" for j in joints)
        raise TorchidError(
            "an effect is named twice.", got=f"{name} of {where}", expected="each place once"
        )
    if sum(isinstance(a.effect, TorqueGain) for a in found) == robot.n:
        raise TorchidError(
            "torque gains of all joints cannot be identified: a gain that they share is the same "
            "as heavier bodies.",
            got=f"torque_gain on all {robot.n} joints",
            expected="torque_gain:joint=J, and one joint at least whose torque is trusted",
        )
    return tuple(found)


def _places(text: str, robot: Robot) -> list[Asked]:
    """The effect at the places that are named; at every place where none is."""
    name, given = name_and_pairs(text, "--effects")
    kind = fitted_kind(name)
    own = [f.name for f in fields(kind)]
    unknown = [key for key in given if key not in own]
    if unknown:
        what = "a coefficient, which is what is identified"
        known = unknown[0] in [c.name for c in kind.coefficients]
        raise TorchidError(
            f"--effects {text}: '{unknown[0]}' "
            + (f"is {what}." if known else f"does not belong to {kind.name}."),
            available=own,
        )
    shapes = {s.name: s.grid[len(s.grid) // 2] for s in kind.shapes if s.grid}
    searched = tuple(s for s in shapes if s not in given)
    values = {**shapes, **{k: v for k, v in given.items() if k not in PLACES}}
    where = {k: v for k, v in given.items() if k in PLACES}
    effects = [
        _made(kind, place, values, robot)
        for place in _every_place(kind, robot)
        if all(place[k] == v for k, v in where.items())
    ]
    if not effects:
        raise TorchidError(
            f"--effects {text}: there is no such place on this arm.",
            available=[
                ",".join(f"{k}={v}" for k, v in p.items()) for p in _every_place(kind, robot)
            ],
        )
    return [Asked(effect, searched) for effect in effects]


def _every_place(kind: type[Effect], robot: Robot) -> list[dict[str, int]]:
    """Joints, from 1, of every place where an effect can be."""
    if issubclass(kind, ModelEffect):
        found = [e.identity[1] for e in kind.candidates(robot)]
        names = [p for p in PLACES if p in (f.name for f in fields(kind))]
        return [
            dict(zip(names, (j + 1 for j in place), strict=True)) for place in dict.fromkeys(found)
        ]
    return [{"joint": j + 1} for j in range(robot.n)]


def _made(
    kind: type[Effect], place: Mapping[str, int], values: Mapping[str, Any], robot: Robot
) -> Effect:
    record = {"effect": kind.name, **place, **{c.name: 0.0 for c in kind.coefficients}, **values}
    return effect_from_record(record, robot)[0]


def with_shapes(effect: Effect, names: Sequence[str], values: Sequence[float]) -> Effect:
    """The effect with other values of some of its shapes."""
    return replace(effect, **dict(zip(names, values, strict=True)))
