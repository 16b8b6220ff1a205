"""The library of effects: one line a kind."""

from collections.abc import Iterable, Mapping, Sequence
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
    kind = effect_kind(str(record["effect"]))
    expected = ["effect", "joint", *(c.name for c in kind.coefficients)]
    if sorted(record) != sorted(expected):
        raise RobotError(
            f"robot '{robot.name}': effect '{kind.name}' has wrong entries.",
            got=dict(record),
            expected=expected,
        )
    values: Sequence[float] = [float(record[c.name]) for c in kind.coefficients]
    return kind(int(record["joint"]) - 1), list(values)
