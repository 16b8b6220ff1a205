"""Robots in yaml: a DH table, and whatever else is known (format in docs/robots.md)."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch
import yaml
from torch import Tensor

from torchid.errors import RobotError
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import STANDARD_GRAVITY, JointType, Limits, Robot
from torchid.robot.placement import dh_classical, dh_modified, pose, rotation_z

_KEYS = ("name", "dh", "gravity", "limits", "parameters", "effects", "drive_gain", "bounds", "tool")
_JOINT_KEYS = ("type", "a", "alpha", "alpha_deg", "d", "theta", "theta_deg", "name")
_EXPONENT = "yaml reads 1e-3 as text: write 1.0e-3"
_LIMIT_KEYS = ("position", "velocity", "acceleration", "torque")


def read_yaml(path: Path) -> Robot:
    """Read a robot from torchid's yaml.

    Raises:
        RobotError: not yaml, an unknown key, a wrong count, or a value that is not a number.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, ValueError) as error:  # ValueError: not UTF-8, or no such date
        raise RobotError(f"'{path}' is not valid yaml: {str(error).splitlines()[0]}") from error
    except OSError as error:
        raise RobotError(f"'{path}' cannot be read: {error.strerror}") from error
    if not isinstance(data, Mapping):
        raise RobotError(
            f"'{path}' is not a robot description.", got=type(data).__name__, expected="name, dh"
        )
    return from_mapping(data, str(path))


def from_mapping(data: Mapping[str, Any], source: str) -> Robot:
    """A Robot from the parsed content of a robot yaml; `source` names it in errors."""
    _known(data, _KEYS, source)
    for key in ("name", "dh"):
        if key not in data:
            raise RobotError(f"{source}: '{key}' is missing.", available=list(data))
    types, before, after, names = _dh(data["dh"], source)
    n = len(types)
    gravity = _numbers(data.get("gravity", STANDARD_GRAVITY), (3,), f"{source}: gravity")
    tool = _numbers(data.get("tool", torch.eye(4).tolist()), (4, 4), f"{source}: tool")
    gain = data.get("drive_gain")
    return Robot(
        name=str(data["name"]),
        joint_names=names,
        link_names=tuple(f"link_{i}" for i in range(1, n + 1)),
        joint_types=types,
        before=before,
        after=after,
        gravity=gravity,
        tool=tool,
        limits=_limits(data.get("limits") or {}, n, source),
        parameters=_parameters(data.get("parameters"), n, source),
        effects=_effects(data.get("effects") or (), n, source),
        drive_gain=None if gain is None else _numbers(gain, (n,), f"{source}: drive_gain"),
        bounds=_bounds(data.get("bounds") or {}, source),
        source=source,
    )


def _dh(dh: Any, source: str) -> tuple[tuple[JointType, ...], Tensor, Tensor, tuple[str, ...]]:
    if not isinstance(dh, Mapping) or "joints" not in dh or "convention" not in dh:
        raise RobotError(
            f"{source}: 'dh' needs 'convention' and 'joints'.",
            got=list(dh) if isinstance(dh, Mapping) else type(dh).__name__,
            expected="dh: {convention: classical|modified, joints: [{type, a, alpha, d, theta}]}",
        )
    _known(dh, ("convention", "joints"), f"{source}: dh")
    convention = dh["convention"]
    if convention not in ("classical", "modified"):
        raise RobotError(
            f"{source}: unknown DH convention.", got=convention, available=["classical", "modified"]
        )
    rows = dh["joints"]
    if not isinstance(rows, Sequence) or isinstance(rows, str) or not rows:
        raise RobotError(f"{source}: dh.joints must be a list with one entry a joint.", got=rows)
    types, before, after, names = [], [], [], []
    for i, row in enumerate(rows, start=1):
        kind, a, alpha, d, theta = _dh_row(row, f"{source}: joint {i}")
        types.append(kind)
        names.append(str(row.get("name", f"joint_{i}")))
        if convention == "classical":
            before.append(pose())
            after.append(dh_classical(a, alpha, d, theta))
        else:
            # Rz(theta) and Tz(d) commute with the joint's own motion about or along z.
            before.append(dh_modified(a, alpha) @ pose(rotation_z(theta), (0, 0, d)))
            after.append(pose())
    return tuple(types), torch.stack(before), torch.stack(after), tuple(names)


def _dh_row(row: Any, where: str) -> tuple[JointType, float, float, float, float]:
    if not isinstance(row, Mapping):
        raise RobotError(f"{where}: must be a mapping.", got=row, expected=_JOINT_KEYS)
    _known(row, _JOINT_KEYS, where)
    kind = row.get("type", "R")
    if kind not in ("R", "P"):
        raise RobotError(f"{where}: unknown joint type.", got=kind, available=["R", "P"])
    a = _number(row.get("a", 0), f"{where}: a")
    d = _number(row.get("d", 0), f"{where}: d")
    return JointType(kind), a, _angle(row, "alpha", where), d, _angle(row, "theta", where)


def _angle(row: Mapping[str, Any], key: str, where: str) -> float:
    if f"{key}_deg" in row:
        if key in row:
            raise RobotError(
                f"{where}: both {key} and {key}_deg are given.", expected="one of them"
            )
        return math.radians(_number(row[f"{key}_deg"], f"{where}: {key}_deg"))
    return _number(row.get(key, 0), f"{where}: {key}")


def _limits(data: Any, n: int, source: str) -> Limits:
    _known(data, _LIMIT_KEYS, f"{source}: limits")
    values = {}
    for key in _LIMIT_KEYS:
        if data.get(key) is not None:
            values[key] = _interval(data[key], n, f"{source}: limits.{key}")
    return Limits(**values)


def _interval(data: Any, n: int, where: str) -> Tensor:
    """Symmetric bounds, or [lo, hi] a joint, as (n, 2)."""
    # A joint that turns for ever has infinite limits.
    if isinstance(data, Sequence) and data and isinstance(data[0], Sequence):
        bounds = _numbers(data, (n, 2), where, finite=False)
    else:
        upper = _numbers(data, (n,), where, finite=False)
        bounds = torch.stack([-upper, upper], -1)
    if (bounds[:, 0] >= bounds[:, 1]).any():
        raise RobotError(f"{where}: a lower limit is not below its upper limit.", got=data)
    return bounds


def _parameters(data: Any, n: int, source: str) -> InertialParameters | None:
    if data is None:
        return None
    where = f"{source}: parameters"
    kinds = ("inertia_about_link_frame", "inertia_about_com")
    _known(data, ("mass", "com", *kinds), where)
    given = [k for k in kinds if k in data]
    if len(given) != 1 or "mass" not in data or "com" not in data:
        raise RobotError(
            f"{where}: needs mass, com and exactly one kind of inertia.",
            got=list(data),
            expected=["mass", "com", " | ".join(kinds)],
        )
    mass = _numbers(data["mass"], (n,), f"{where}.mass")
    com = _numbers(data["com"], (n, 3), f"{where}.com")
    inertia = _numbers(data[given[0]], (n, 6), f"{where}.{given[0]}")
    if given[0] == "inertia_about_com":
        return InertialParameters.from_com(mass, com, inertia)
    return InertialParameters.from_link_frame(mass, com, inertia)


def _effects(data: Any, n: int, source: str) -> tuple[Mapping[str, Any], ...]:
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


def _bounds(data: Any, source: str) -> Mapping[str, Any]:
    if not isinstance(data, Mapping):
        raise RobotError(f"{source}: bounds must be a mapping of groups.", got=data)
    return MappingProxyType(dict(data))


def _known(data: Any, keys: Sequence[str], where: str) -> None:
    if not isinstance(data, Mapping):
        raise RobotError(f"{where}: must be a mapping.", got=data, expected=list(keys))
    for key in data:
        if key not in keys:
            raise RobotError(f"{where}: unknown key.", got=key, available=list(keys))


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        hint = _EXPONENT if isinstance(value, str) else None
        raise RobotError(f"{where}: not a finite number.", got=repr(value), hint=hint)
    return float(value)


def _numbers(data: Any, shape: tuple[int, ...], where: str, *, finite: bool = True) -> Tensor:
    try:
        tensor = torch.tensor(data, dtype=torch.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise RobotError(
            f"{where}: not numbers, or rows of unequal length.", got=data, hint=_EXPONENT
        ) from error
    if tuple(tensor.shape) != shape:
        raise RobotError(
            f"{where}: wrong size.", got=tuple(tensor.shape), expected=f"{shape} for this robot"
        )
    if tensor.isnan().any() or (finite and tensor.isinf().any()):
        raise RobotError(f"{where}: not all finite.", got=data)
    return tensor
