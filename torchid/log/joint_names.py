"""The joints of a recording in the order of the robot's, by their names."""

import re
from collections.abc import Sequence

from torchid.errors import LogError
from torchid.log.table import natural


def in_robot_order(
    names: Sequence[str], joints: Sequence[str], label: str
) -> tuple[list[str], tuple[str, ...]]:
    """Names of the recording, one for each joint of the robot, and what to say about it.

    A name fits a joint if it is the same, or ends in it, or the other way round
    (`left_joint_1`, `joint1`). Where none fit, names that differ in one number only, as many as
    the robot has joints, are taken in the order of that number. Names of other joints, of a
    gripper say, are left out. Without a robot all names are taken, numbers in their order.

    Args:
        names: in the recording, in any order.
        joints: of the robot, in order; empty where it is not known.
        label: of the recording, for the messages.

    Raises:
        LogError: the robot's joints are not to be found among the names.
    """
    if not joints:
        ordered = sorted(names, key=natural)
        note = f"{label}: joints in the order of their names: {_listed(ordered)}"
        return ordered, (note,) if len(names) > 1 else ()
    found = [_fitting(joint, names) for joint in joints]
    if all(found) and len(set(found)) == len(joints):
        return [name for name in found if name], ()
    families: dict[str, list[str]] = {}
    for name in names:
        families.setdefault(re.sub(r"\d+", "#", name), []).append(name)
    right = [
        f for f in families.values() if len(f) == len(joints) and ("#" in _shape(f) or len(f) == 1)
    ]
    if len(right) == 1:
        ordered = sorted(right[0], key=natural)
        return ordered, (
            f"{label}: its joints do not have the robot's names; taken in the order of their "
            f"numbers: {_listed(ordered)}",
        )
    raise LogError(
        f"{label}: its joints cannot be told from their names.",
        got=_listed(names),
        expected=_listed(joints),
        hint="give the joints these names in the robot's description, or say which is which: "
        '--columns "q=[.., ..],dq=[.., ..],tau=[.., ..]" with the names that '
        "`torchid log show` lists",
    )


def _shape(names: Sequence[str]) -> str:
    return re.sub(r"\d+", "#", names[0])


def _fitting(joint: str, names: Sequence[str]) -> str | None:
    """The one name that fits a joint."""
    if joint in names:
        return joint
    wanted = _plain(joint)
    fits = [n for n in names if _plain(n).endswith(wanted) or wanted.endswith(_plain(n))]
    return fits[0] if len(fits) == 1 else None


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]|joint(?!_?\d)", "", name.lower()) or name


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:20]) + (f", and {len(names) - 20} more" if len(names) > 20 else "")
