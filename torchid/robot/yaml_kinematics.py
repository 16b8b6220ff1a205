"""The kinematics of a robot's yaml: a DH table, or the placement of each joint as it is."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchid.errors import RobotError
from torchid.robot.model import JointType
from torchid.robot.placement import dh_classical, dh_modified, pose, rotation_z
from torchid.robot.yaml_values import known, number, numbers
from torchid.typing import Float

_NAMES = ("name", "link")
_DH_KEYS = ("type", "a", "alpha", "alpha_deg", "d", "theta", "theta_deg", *_NAMES)
_PLACEMENT_KEYS = ("type", "before", "after", *_NAMES)
_ORTHONORMAL = 1e-6
"""How far a rotation that was typed with a few digits may be from one."""


class Kinematics(NamedTuple):
    """Fields of a Robot, under the same names."""

    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    joint_types: tuple[JointType, ...]
    before: Float[Tensor, "n 4 4"]
    after: Float[Tensor, "n 4 4"]


class _Joint(NamedTuple):
    kind: JointType
    before: Tensor
    after: Tensor


def read_kinematics(data: Mapping[str, Any], source: str) -> Kinematics:
    """From a yaml's `dh` or `placements`, of which there must be exactly one.

    Raises:
        RobotError: both or neither, an unknown key, or a value that is not what it should be.
    """
    given = [key for key in ("dh", "placements") if key in data]
    if len(given) == 2:
        raise RobotError(f"{source}: both 'dh' and 'placements' are given.", expected="one of them")
    if not given:
        raise RobotError(
            f"{source}: 'dh' is missing.", available=list(data), expected="dh, or placements"
        )
    if given == ["dh"]:
        rows, joints = _dh(data["dh"], source)
    else:
        rows, joints = _placements(data["placements"], source)
    named = list(enumerate(rows, start=1))
    return Kinematics(
        joint_names=tuple(str(row.get("name", f"joint_{i}")) for i, row in named),
        link_names=tuple(str(row.get("link", f"link_{i}")) for i, row in named),
        joint_types=tuple(joint.kind for joint in joints),
        before=torch.stack([joint.before for joint in joints]),
        after=torch.stack([joint.after for joint in joints]),
    )


def dh_step(
    convention: str, a: float, alpha: float, d: float, theta: float
) -> tuple[Float[Tensor, "4 4"], Float[Tensor, "4 4"]]:
    """Poses before and after a joint's motion, from its row of a DH table.

    Args:
        convention: `classical` or `modified`.
        a, d: [m].
        alpha, theta: [rad].
    """
    if convention == "classical":
        return pose(), dh_classical(a, alpha, d, theta)
    # Rz(theta) and Tz(d) commute with the joint's own motion about or along z.
    return dh_modified(a, alpha) @ pose(rotation_z(theta), (0, 0, d)), pose()


def _dh(dh: Any, source: str) -> tuple[Sequence[Mapping[str, Any]], list[_Joint]]:
    if not isinstance(dh, Mapping) or "joints" not in dh or "convention" not in dh:
        raise RobotError(
            f"{source}: 'dh' needs 'convention' and 'joints'.",
            got=list(dh) if isinstance(dh, Mapping) else type(dh).__name__,
            expected="dh: {convention: classical|modified, joints: [{type, a, alpha, d, theta}]}",
        )
    known(dh, ("convention", "joints"), f"{source}: dh")
    convention = dh["convention"]
    if convention not in ("classical", "modified"):
        raise RobotError(
            f"{source}: unknown DH convention.", got=convention, available=["classical", "modified"]
        )
    rows = _rows(dh["joints"], _DH_KEYS, f"{source}: dh.joints", source)
    joints = []
    for i, row in enumerate(rows, start=1):
        where = f"{source}: joint {i}"
        kind = _kind(row, where)
        a, d = (number(row.get(key, 0), f"{where}: {key}") for key in ("a", "d"))
        alpha, theta = (_angle(row, key, where) for key in ("alpha", "theta"))
        joints.append(_Joint(kind, *dh_step(convention, a, alpha, d, theta)))
    return rows, joints


def _placements(data: Any, source: str) -> tuple[Sequence[Mapping[str, Any]], list[_Joint]]:
    if not isinstance(data, Mapping) or "joints" not in data:
        raise RobotError(
            f"{source}: 'placements' needs 'joints'.",
            got=list(data) if isinstance(data, Mapping) else type(data).__name__,
            expected="placements: {joints: [{type, before: {xyz, rotation}, after}]}",
        )
    known(data, ("joints",), f"{source}: placements")
    rows = _rows(data["joints"], _PLACEMENT_KEYS, f"{source}: placements.joints", source)
    joints = []
    for i, row in enumerate(rows, start=1):
        where = f"{source}: joint {i}"
        before, after = (_pose(row.get(key, {}), f"{where}: {key}") for key in ("before", "after"))
        joints.append(_Joint(_kind(row, where), before, after))
    return rows, joints


def _rows(rows: Any, keys: Sequence[str], where: str, source: str) -> Sequence[Mapping[str, Any]]:
    if not isinstance(rows, Sequence) or isinstance(rows, str) or not rows:
        raise RobotError(f"{where} must be a list with one entry a joint.", got=rows)
    for i, row in enumerate(rows, start=1):
        known(row, keys, f"{source}: joint {i}")
    return rows


def _kind(row: Mapping[str, Any], where: str) -> JointType:
    kind = row.get("type", "R")
    if kind not in ("R", "P"):
        raise RobotError(f"{where}: unknown joint type.", got=kind, available=["R", "P"])
    return JointType(kind)


def _angle(row: Mapping[str, Any], key: str, where: str) -> float:
    if f"{key}_deg" in row:
        if key in row:
            raise RobotError(
                f"{where}: both {key} and {key}_deg are given.", expected="one of them"
            )
        return math.radians(number(row[f"{key}_deg"], f"{where}: {key}_deg"))
    return number(row.get(key, 0), f"{where}: {key}")


def _pose(data: Any, where: str) -> Tensor:
    """(4, 4) from {xyz, rotation}, entry by entry as written: what was written is read back."""
    known(data, ("xyz", "rotation"), where)
    out = torch.eye(4, dtype=torch.float64)
    if "xyz" in data:
        out[:3, 3] = numbers(data["xyz"], (3,), f"{where}.xyz")
    if "rotation" in data:
        rotation = numbers(data["rotation"], (3, 3), f"{where}.rotation")
        error = (rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs().max()
        if error > _ORTHONORMAL or torch.linalg.det(rotation) < 0:
            raise RobotError(
                f"{where}.rotation: not a rotation.",
                got=data["rotation"],
                expected="three orthonormal rows, right-handed",
            )
        out[:3, :3] = rotation
    return out
