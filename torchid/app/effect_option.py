"""Effects as they are written on the command line: name:key=value,key=value."""

from dataclasses import MISSING, fields

from torchid.effects.base import PLACES, Coefficient, Shape
from torchid.effects.registry import Valued, effect_from_record, effect_kind
from torchid.effects.written import name_and_pairs
from torchid.errors import TorchidError
from torchid.robot.model import JointType, Robot


def effect_from_text(text: str, robot: Robot) -> Valued:
    """An effect and its coefficients, e.g. from `coulomb_friction:joint=2,Fc=0.6`.

    Joints count from 1. Shape parameters and other settings may be left out where they have a
    default.

    Raises:
        TorchidError: an unknown effect or key, a value that is no number, a missing coefficient.
        RobotError: a joint that the robot does not have.
    """
    name, given = name_and_pairs(text, "--effect")
    kind = effect_kind(name)
    # Where it is, what its coefficients are, then shapes and other settings.
    own = [f for f in fields(kind) if f.name not in PLACES]
    first = [f.name for f in fields(kind) if f.name in PLACES]
    first += [c.name for c in kind.coefficients]
    keys = [*first, *(f.name for f in own)]
    needed = [*first, *(f.name for f in own if f.default is MISSING)]
    unknown = [key for key in given if key not in keys]
    if unknown:
        raise TorchidError(
            f"--effect {text}: '{unknown[0]}' does not belong to {kind.name}.", available=keys
        )
    missing = [key for key in needed if key not in given]
    if missing:
        key = missing[0]
        what = f"{key} (1 to {robot.n})" if key in PLACES else key
        every: list[Coefficient | Shape] = [*kind.coefficients, *kind.shapes]
        for entry in (entry for entry in every if entry.name == key):
            # With its unit on the given joint.
            joint = given.get("joint", 1)
            there = joint in range(1, robot.n + 1)
            prismatic = there and robot.joint_types[joint - 1] is JointType.PRISMATIC
            unit = entry.unit_for(prismatic) if isinstance(entry, Coefficient) else entry.unit
            what = f"{key} [{unit}] ({entry.meaning})"
        raise TorchidError(
            f"--effect {text}: {what} is missing.",
            expected=f"{kind.name}:" + ",".join(f"{key}=..." for key in needed),
        )
    return effect_from_record({"effect": kind.name, **given}, robot)
