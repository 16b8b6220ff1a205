"""Robots in yaml: kinematics, and whatever else is known (format in docs/robots.md)."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

import torch
from torch import Tensor

from torchid.errors import RobotError
from torchid.robot.inertia import InertialParameters, parallel_axis
from torchid.robot.knowledge import from_mapping as knowledge_of
from torchid.robot.model import (
    LIMITS,
    STANDARD_GRAVITY,
    Basis,
    JointType,
    Limits,
    Mimic,
    Robot,
    Tip,
)
from torchid.robot.origin import read_origin
from torchid.robot.placement import dh_classical, dh_modified, pose, rotation_z
from torchid.robot.yaml_values import known, number, numbers, parsed_yaml
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
    listed = table["joints"]
    if not isinstance(listed, Sequence) or isinstance(listed, str) or not listed:
        where = f"{source}: {form}.joints"
        raise RobotError(f"{where} must be a list with one entry a joint.", got=listed)
    rows, poses = list(enumerate(listed, start=1)), []
    for i, row in rows:
        known(row, keys, f"{source}: joint {i}")
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
    kinds = []
    for i, row in rows:
        if (kind := row.get("type", "R")) not in ("R", "P"):
            where = f"{source}: joint {i}"
            raise RobotError(f"{where}: unknown joint type.", got=kind, available=["R", "P"])
        kinds.append(JointType(kind))
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
        found["mimics"] = tuple(
            _mimic(row["mimic"], i - 1, names[i - 1], kinds[i - 1], found["joint_names"], source)
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
    where, what = f"{source}: joint {i}", "link before it to carry it"
    return _place(name, links[: i - 1], where, what, "null is the base")


def _place(name: Any, names: Sequence[str], where: str, what: str, hint: str | None = None) -> int:
    """Where a name stands among those that are known.

    Raises:
        RobotError: it is none of them.
    """
    if str(name) not in names:
        raise RobotError(
            f"{where}: there is no such {what}.", got=name, available=list(names), hint=hint
        )
    return names.index(str(name))


def _mimic(
    data: Any, link: int, name: str, kind: JointType, follow: Sequence[str], source: str
) -> Mimic:
    where = f"{source}: joint {link + 1}: mimic"
    known(data, ("joint", "ratio", "offset"), where)
    followed = _place(data.get("joint"), follow, where, "joint to follow")
    ratio, offset = (
        number(data.get(key, default), f"{where}: {key}")
        for key, default in (("ratio", 1.0), ("offset", 0.0))
    )
    return Mimic(link, name, kind, followed, ratio, offset)


def _tip(data: Any, links: Sequence[str], where: str) -> Tip:
    known(data, ("name", "link", "pose"), where)
    link = _place(data.get("link"), links, where, "link")
    placed = _pose(data.get("pose", {}), f"{where}: pose")
    return Tip(str(data.get("name", links[link])), link, placed)


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


_REST = (
    "gravity",
    "limits",
    "parameters",
    "effects",
    "drive_gain",
    "bounds",
    "basis",
    "tool",
    "floating",
    "knowledge",
    "file",
)
_BESIDE = ("servo", "servos")
"""What a robot's yaml may hold and other readers take: `torchid.position`."""


def read_yaml(path: Path) -> Robot:
    """Read a robot from torchid's yaml.

    Raises:
        RobotError: not yaml, an unknown key, a wrong count, or a value that is not a number.
    """
    data = parsed_yaml(path)
    if not isinstance(data, Mapping):
        raise RobotError(
            f"'{path}' is not a robot description.",
            got=type(data).__name__,
            expected="name, dh or placements",
        )
    return from_mapping(data, str(path))


def from_mapping(data: Mapping[str, Any], source: str) -> Robot:
    """A Robot from the parsed content of a robot yaml; `source` names it in errors."""
    known(data, ("name", *_FORMS, *_REST, *_BESIDE), source)
    if "name" not in data:
        raise RobotError(f"{source}: 'name' is missing.", available=list(data))
    kinematics = read_kinematics(data, source)
    n, links = len(kinematics["joint_types"]), len(kinematics["before"])
    gravity = numbers(data.get("gravity", STANDARD_GRAVITY), (3,), f"{source}: gravity")
    tool = numbers(data.get("tool", torch.eye(4).tolist()), (4, 4), f"{source}: tool")
    gain = data.get("drive_gain")
    basis = data.get("basis", Robot.basis)
    if basis not in get_args(Basis):
        raise RobotError(f"{source}: unknown basis.", got=basis, available=get_args(Basis))
    floating, bounds = data.get("floating", False), data.get("bounds") or {}
    if not isinstance(floating, bool):
        raise RobotError(f"{source}: floating is true or false.", got=floating)
    if not isinstance(bounds, Mapping):
        raise RobotError(f"{source}: bounds must be a mapping of groups.", got=bounds)
    limits, sure = data.get("limits") or {}, data.get("knowledge")
    known(limits, LIMITS, f"{source}: limits")
    return Robot(
        name=str(data["name"]),
        **kinematics,
        gravity=gravity,
        floating=floating,
        tool=tool,
        limits=Limits(
            **{
                key: _interval(limits[key], n, f"{source}: limits.{key}")
                for key in LIMITS
                if limits.get(key) is not None
            }
        ),
        parameters=_parameters(data.get("parameters"), links, source),
        effects=read_effects(data.get("effects") or (), n, source),
        drive_gain=None if gain is None else numbers(gain, (n,), f"{source}: drive_gain"),
        bounds=MappingProxyType(dict(bounds)),
        basis=basis,
        source=source,
        file=read_origin(data["file"], source) if data.get("file") else {},
        knowledge=None if sure is None else knowledge_of(sure, links, source),
    )


def _interval(data: Any, n: int, where: str) -> Tensor:
    """Symmetric bounds, or [lo, hi] a joint, as (n, 2)."""
    # A joint that turns for ever has infinite limits.
    if isinstance(data, Sequence) and data and isinstance(data[0], Sequence):
        bounds = numbers(data, (n, 2), where, finite=False)
    else:
        upper = numbers(data, (n,), where, finite=False)
        bounds = torch.stack([-upper, upper], -1)
    if (bounds[:, 0] >= bounds[:, 1]).any():
        raise RobotError(f"{where}: a lower limit is not below its upper limit.", got=data)
    return bounds


def _parameters(data: Any, n: int, source: str) -> InertialParameters | None:
    if data is None:
        return None
    where = f"{source}: parameters"
    moments, inertias = ("com", "first_moment"), ("inertia_about_link_frame", "inertia_about_com")
    known(data, ("mass", *moments, *inertias), where)
    given = [key for key in (*moments, *inertias) if key in data]
    choices = [(a, b) for a in moments for b in inertias]
    if "mass" not in data or tuple(given) not in choices:
        raise RobotError(
            f"{where}: needs mass, com (or first_moment) and exactly one kind of inertia.",
            got=list(data),
            expected=["mass", " | ".join(moments), " | ".join(inertias)],
        )
    moment, inertia = given
    mass = numbers(data["mass"], (n,), f"{where}.mass")
    first = numbers(data[moment], (n, 3), f"{where}.{moment}")
    tensor = numbers(data[inertia], (n, 6), f"{where}.{inertia}")
    m = mass.unsqueeze(-1)
    moved = m * first if moment == "com" else first
    if inertia == "inertia_about_com":
        own = InertialParameters(torch.cat([m, moved, tensor], -1))
        tensor = tensor + parallel_axis(mass, first if moment == "com" else own.com)
    return InertialParameters(torch.cat([m, moved, tensor], -1))


def read_effects(data: Any, n: int, source: str) -> tuple[Mapping[str, Any], ...]:
    """Records of effects on existing joints, from the parsed yaml; `source` names it in errors."""
    if not isinstance(data, Sequence) or isinstance(data, str):
        raise RobotError(f"{source}: effects must be a list of records.", got=data)
    for record in data:
        if not isinstance(record, Mapping) or "effect" not in record:
            raise RobotError(
                f"{source}: an effect needs the key 'effect'.",
                got=record,
                expected="{effect: viscous_friction, joint: 1, Fv: 0.07}",
            )
        joint = record.get("joint")
        whole = isinstance(joint, int) and not isinstance(joint, bool)
        if joint is not None and not (whole and 1 <= joint <= n):
            raise RobotError(
                f"{source}: effect '{record['effect']}' is on a joint that does not exist.",
                got=joint,
                available=list(range(1, n + 1)),
            )
    return tuple(MappingProxyType(dict(record)) for record in data)
