"""The kinematics of a robot's yaml: a DH table, or the placement of each joint as it is."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from torchid.errors import RobotError
from torchid.robot.model import JointType, Mimic, Tip
from torchid.robot.placement import dh_classical, dh_modified, pose, rotation_z
from torchid.robot.yaml_values import known, number, numbers
from torchid.typing import Float

_NAMES = ("name", "link")
_DH_KEYS = ("type", "a", "alpha", "alpha_deg", "d", "theta", "theta_deg", *_NAMES)
_PLACEMENT_KEYS = ("type", "parent", "before", "after", "mimic", *_NAMES)
_FORMS: dict[str, tuple[tuple[str, ...], tuple[str, ...], str]] = {
    "dh": (
        ("convention", "joints"),
        _DH_KEYS,
        "dh: {convention: classical|modified, joints: [{type, a, alpha, d, theta}]}",
    ),
    "placements": (
        ("joints",),
        _PLACEMENT_KEYS,
        "placements: {joints: [{type, parent, before: {xyz, rotation}, after}]}",
    ),
}
"""Keys of each way to give the kinematics, keys of its joints, and what it looks like."""
CONVENTIONS = ("classical", "modified")
_ORTHONORMAL = 1e-6
"""How far a rotation that was typed with a few digits may be from one."""


def read_kinematics(data: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Names, types and poses of the joints, under the names of a Robot's fields, from a yaml's `dh`
    or `placements`, of which there must be exactly one.

    Raises:
        RobotError: both or neither, an unknown key, or a value that is not what it should be.
    """
    given = [form for form in _FORMS if form in data]
    if len(given) == 2:
        raise RobotError(f"{source}: both 'dh' and 'placements' are given.", expected="one of them")
    if not given:
        raise RobotError(
            f"{source}: 'dh' is missing.", available=list(data), expected="dh, or placements"
        )
    form = given[0]
    table, (needs, keys, expected) = data[form], _FORMS[form]
    if not isinstance(table, Mapping) or not table.keys() >= set(needs):
        raise RobotError(
            f"{source}: '{form}' needs {' and '.join(repr(key) for key in needs)}.",
            got=list(table) if isinstance(table, Mapping) else type(table).__name__,
            expected=expected,
        )
    known(table, (*needs, *(("tips",) if form == "placements" else ())), f"{source}: {form}")
    convention = table.get("convention", "classical")
    if convention not in CONVENTIONS:
        raise RobotError(f"{source}: unknown DH convention.", got=convention, available=CONVENTIONS)
    rows = list(enumerate(_rows(table["joints"], keys, f"{source}: {form}.joints", source), 1))
    poses = []
    for i, row in rows:
        where = f"{source}: joint {i}"
        if form == "dh":
            a, d = (number(row.get(key, 0), f"{where}: {key}") for key in ("a", "d"))
            alpha, theta = (_angle(row, key, where) for key in ("alpha", "theta"))
            poses.append(dh_step(convention, a, alpha, d, theta))
        else:
            before, after = (
                _pose(row.get(key, {}), f"{where}: {key}") for key in ("before", "after")
            )
            poses.append((before, after))
    links = [str(row.get("link", f"link_{i}")) for i, row in rows]
    names = [str(row.get("name", f"joint_{i}")) for i, row in rows]
    kinds = [_kind(row, f"{source}: joint {i}") for i, row in rows]
    own = [k for k, (_, row) in enumerate(rows) if "mimic" not in row]
    found: dict[str, Any] = {
        "joint_names": tuple(names[k] for k in own),
        "link_names": tuple(links),
        "joint_types": tuple(kinds[k] for k in own),
        "before": torch.stack([before for before, _ in poses]),
        "after": torch.stack([after for _, after in poses]),
    }
    if form == "placements":
        found["parents"] = tuple(_parent(row, i, links, source) for i, row in rows)
        follow = {names[k]: j for j, k in enumerate(own)}
        found["mimics"] = tuple(
            _mimic(row["mimic"], i - 1, names[i - 1], kinds[i - 1], follow, source)
            for i, row in rows
            if "mimic" in row
        )
        found["tips"] = tuple(
            _tip(row, links, f"{source}: tip {k}")
            for k, row in enumerate(table.get("tips") or (), start=1)
        )
    return found


def _parent(row: Mapping[str, Any], i: int, links: Sequence[str], source: str) -> int:
    """The link (from 0) that carries joint i (from 1): the one before, unless another is named."""
    if "parent" not in row:
        return i - 2
    name = row["parent"]
    if name is None:
        return -1
    if str(name) not in links[: i - 1]:
        raise RobotError(
            f"{source}: joint {i}: there is no such link before it to carry it.",
            got=name,
            available=list(links[: i - 1]),
            hint="null is the base",
        )
    return links.index(str(name))


def _mimic(
    data: Any, link: int, name: str, kind: JointType, follow: Mapping[str, int], source: str
) -> Mimic:
    where = f"{source}: joint {link + 1}: mimic"
    known(data, ("joint", "ratio", "offset"), where)
    if str(data.get("joint")) not in follow:
        raise RobotError(
            f"{where}: there is no such joint to follow.",
            got=data.get("joint"),
            available=list(follow),
        )
    ratio, offset = (
        number(data.get(key, default), f"{where}: {key}")
        for key, default in (("ratio", 1.0), ("offset", 0.0))
    )
    return Mimic(link, name, kind, follow[str(data["joint"])], ratio, offset)


def _tip(data: Any, links: Sequence[str], where: str) -> Tip:
    known(data, ("name", "link", "pose"), where)
    if str(data.get("link")) not in links:
        raise RobotError(
            f"{where}: there is no such link.", got=data.get("link"), available=list(links)
        )
    placed = _pose(data.get("pose", {}), f"{where}: pose")
    name = str(data["link"])
    return Tip(str(data.get("name", name)), links.index(name), placed)


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
