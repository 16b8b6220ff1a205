"""The joints of a recording in the order of the robot's, by their names."""

import re
from collections.abc import Sequence

from torchid.errors import LogError
from torchid.log.columns import first_names
from torchid.log.table import natural

_HAND = re.compile(r"finger|gripper|hand|knuckle|jaw|thumb")


def in_robot_order(
    names: Sequence[str], joints: Sequence[str], label: str, spare: Sequence[str] = ()
) -> tuple[list[str], tuple[str, ...]]:
    """Names of the recording, one for each joint of the robot, and what to say about it.

    A name fits a joint if it is the same, or ends in it, or the other way round
    (`left_joint_1`, `joint1`). Where they do not fit, names that differ in their numbers only, as
    many as the robot has joints, are taken in the order of the numbers if there are no others but
    a hand's. Left out are joints of a hand, and spare ones. Without a robot all names are taken,
    numbers in their order.

    Args:
        names: in the recording, in any order.
        joints: of the robot, in order; empty where it is not known.
        label: of the recording, for the messages.
        spare: joints without a coordinate that a recording may have (`Robot.spare`).

    Raises:
        LogError: the robot's joints are not to be found among the names, or a name is of a joint
            that the robot lacks.
    """
    if not joints:
        ordered = sorted(names, key=natural)
        note = f"{label}: joints in the order of their names: {_listed(ordered)}"
        return ordered, (note,) if len(names) > 1 else ()
    matching = [_fitting(joint, names) for joint in joints]
    fitting = [name for name in matching if name]
    if len(set(fitting)) == len(joints) and not _cut_short(fitting, joints, names, spare):
        others = [name for name in names if name not in fitting]
        strange = [n for n in others if not _HAND.search(n.lower()) and not _spare(n, spare)]
        if strange:
            raise LogError(
                f"{label} has joints that the robot lacks.",
                got=_listed(strange),
                expected=_listed(joints),
                hint=f"hold them in the robot's file (`lock=...`), or say which are the robot's: "
                f"{_mapping(fitting)}",
            )
        return fitting, (f"{label}: left out: {', '.join(others)}",) if others else ()
    families: dict[str, list[str]] = {}
    for name in names:
        if not _HAND.search(name.lower()):
            families.setdefault(re.sub(r"\d+", "#", name), []).append(name)
    right = [f for f, members in families.items() if "#" in f and len(members) == len(joints)]
    if right and len(families) == 1:
        ordered = sorted(families[right[0]], key=natural)
        return ordered, (
            f"{label}: its joints do not have the robot's names; taken in the order of their "
            f"numbers: {_listed(ordered)}",
        )
    raise LogError(
        f"{label}: the names do not identify its joints.",
        got=_listed(names),
        expected=_listed(joints),
        hint="give the joints these names in the robot's description, or say which is which: "
        f"{_mapping(names)}",
    )


def known_joints(names: Sequence[str], joints: Sequence[str]) -> int:
    """How many of the robot's joints are among the names of a recording, whatever else is."""
    try:
        return len(in_robot_order(names, joints, "", names)[0])
    except LogError:
        return sum(_fitting(joint, names) is not None for joint in joints)


def _cut_short(
    kept: Sequence[str], joints: Sequence[str], names: Sequence[str], spare: Sequence[str]
) -> bool:
    """Whether names that are not quite the robot's leave out some of their kind: another robot."""
    kinds = {re.sub(r"\d+", "#", name) for name in kept if "#" in re.sub(r"\d+", "#", name)}
    others = {re.sub(r"\d+", "#", n) for n in names if n not in kept and not _spare(n, spare)}
    return list(kept) != list(joints) and bool(kinds & others)


def _spare(name: str, spare: Sequence[str]) -> bool:
    return any(_fitting(joint, [name]) for joint in spare)


def _mapping(names: Sequence[str]) -> str:
    first = names[0] if names else "joint"
    return f'`columns="q=[{first}.position, ..],tau=[{first}.effort, ..]"`'


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
    return ", ".join(first_names(names, 20))
