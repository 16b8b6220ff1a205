"""Effects as they are written on one line: name:key=value,key=value."""

from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any

from torchid.effects.names import PLACES
from torchid.errors import TorchidError

if TYPE_CHECKING:
    from torchid.effects.registry import Valued
    from torchid.robot.model import Robot


def split_list(text: str) -> tuple[str, ...]:
    """Effects separated by commas, which also separate the keys of one; `none` for none.

    >>> split_list("viscous_friction, joint_spring:joint=2,curvature=0, cogging")
    ('viscous_friction', 'joint_spring:joint=2,curvature=0', 'cogging')
    """
    if text.strip() in ("", "none"):
        return ()
    out: list[str] = []
    for part in (p.strip() for p in text.split(",")):
        if out and ":" in out[-1] and ":" not in part and "=" in part:
            out[-1] += f",{part}"
        else:
            out.append(part)
    return tuple(out)


def name_and_pairs(text: str, what: str) -> tuple[str, dict[str, Any]]:
    """Name of an effect, and its values by key; joints stay as written, from 1.

    Args:
        text: `name` or `name:key=value,key=value`.
        what: what to call it in errors, e.g. `--effect`.

    Raises:
        TorchidError: an item without a value, a key twice, a value that is no number.
    """
    name, _, rest = text.partition(":")
    pairs: dict[str, Any] = {}
    for item in filter(None, (part.strip() for part in rest.split(","))):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals or key in pairs:
            raise TorchidError(
                f"{what} {text}: cannot be read at '{item}'.",
                expected="name:key=value,key=value, each key once",
            )
        try:
            number = float(value)
        except ValueError:
            raise TorchidError(f"{what} {text}: {key} is not a number.", got=value) from None
        whole = key in (*PLACES, "seed") and number.is_integer()
        pairs[key] = int(number) if whole else number
    return name.strip(), pairs


def effect_written(text: str, robot: "Robot", what: str) -> "Valued":
    """An effect and its coefficients, e.g. of `coulomb_friction:joint=2,Fc=0.6`.

    Joints count from 1. Shape parameters and other settings may be left out where they have a
    default.

    Args:
        text: as it is written.
        robot: whose joints are meant.
        what: what to call the text in errors, e.g. the option.

    Raises:
        TorchidError: an unknown effect or key, a value that is no number, a missing coefficient.
        RobotError: a joint that the robot does not have.
    """
    from torchid.effects.base import Coefficient, Shape
    from torchid.effects.registry import effect_from_record, effect_kind
    from torchid.robot.model import JointType

    name, given = name_and_pairs(text, what)
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
            f"{what} {text}: '{unknown[0]}' does not belong to {kind.name}.", available=keys
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
            f"{what} {text}: {what} is missing.",
            expected=f"{kind.name}:" + ",".join(f"{key}=..." for key in needed),
        )
    return effect_from_record({"effect": kind.name, **given}, robot)
