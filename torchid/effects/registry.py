"""The library of effects: one line a kind."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from torchid.effects.base import Effect, Motion
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.rotor_inertia import RotorInertia
from torchid.errors import RobotError, TorchidError
from torchid.robot.model import Robot
from torchid.typing import Joints

KINDS: dict[str, type[Effect]] = {
    kind.name: kind for kind in (ViscousFriction, CoulombFriction, TorqueOffset, RotorInertia)
}


def effect_kind(name: str) -> type[Effect]:
    """The class of an effect by name, or a TorchidError that lists those that exist."""
    if name not in KINDS:
        raise TorchidError(f"unknown effect '{name}'.", available=list(KINDS))
    return KINDS[name]


def on_every_joint(names: Iterable[str], n: int) -> list[Effect]:
    """The named effects on all n joints: effect by effect, joint by joint."""
    return [effect_kind(name)(joint) for name in names for joint in range(n)]


def nominal_effects(robot: Robot) -> list[tuple[Effect, list[float]]]:
    """The effects a robot's description lists, with their coefficients.

    Raises:
        RobotError: a record without a joint or without a coefficient, or with an unknown key.
    """
    return [_from_record(record, robot) for record in robot.effects]


def nominal_effect_torque(robot: Robot, motion: Motion) -> Joints:
    """Torque (..., n) of the robot's nominal effects."""
    tau = motion.q * 0.0
    for effect, values in nominal_effects(robot):
        tau[..., effect.joint] += effect.torque(motion, values)
    return tau


def _from_record(record: Mapping[str, Any], robot: Robot) -> tuple[Effect, list[float]]:
    where = f"robot '{robot.name}': an effect"
    if "effect" not in record:
        raise RobotError(f"{where} has no key 'effect'.", got=dict(record), available=list(KINDS))
    kind = effect_kind(str(record["effect"]))
    expected = ["effect", "joint", *(c.name for c in kind.coefficients)]
    if sorted(record) != sorted(expected):
        raise RobotError(f"{where} has wrong entries.", got=dict(record), expected=expected)
    joint = record["joint"]
    if not isinstance(joint, int) or not 1 <= joint <= robot.n:
        joints = list(range(1, robot.n + 1))
        raise RobotError(f"{where} is on a joint that does not exist.", got=joint, available=joints)
    values = [record[c.name] for c in kind.coefficients]
    for value in values:
        if not isinstance(value, int | float) or not math.isfinite(value):
            raise RobotError(f"{where} has a value that is not a number.", got=dict(record))
    return kind(joint - 1), [float(value) for value in values]
