"""Robots in yaml: kinematics, and whatever else is known (format in docs/robots.md)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

import torch
from torch import Tensor

from torchid.errors import RobotError
from torchid.robot.inertia import InertialParameters, parallel_axis
from torchid.robot.knowledge import Knowledge
from torchid.robot.knowledge import from_mapping as knowledge_of
from torchid.robot.model import LIMITS, STANDARD_GRAVITY, Basis, Limits, Robot
from torchid.robot.origin import read_origin
from torchid.robot.yaml_kinematics import read_kinematics
from torchid.robot.yaml_values import known, numbers, parsed_yaml

_KINEMATICS = ("dh", "placements")
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
)
_KNOWLEDGE = "knowledge"
_FILE = "file"
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
    known(data, ("name", *_KINEMATICS, *_REST, _KNOWLEDGE, _FILE, *_BESIDE), source)
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
    return Robot(
        name=str(data["name"]),
        **kinematics,
        gravity=gravity,
        floating=_floating(data.get("floating", False), source),
        tool=tool,
        limits=_limits(data.get("limits") or {}, n, source),
        parameters=_parameters(data.get("parameters"), links, source),
        effects=read_effects(data.get("effects") or (), n, source),
        drive_gain=None if gain is None else numbers(gain, (n,), f"{source}: drive_gain"),
        bounds=_bounds(data.get("bounds") or {}, source),
        basis=basis,
        source=source,
        file=read_origin(data.get(_FILE) or {}, source) if data.get(_FILE) else {},
        knowledge=_knowledge(data.get(_KNOWLEDGE), links, source),
    )


def _limits(data: Any, n: int, source: str) -> Limits:
    known(data, LIMITS, f"{source}: limits")
    given = {key: data[key] for key in LIMITS if data.get(key) is not None}
    return Limits(
        **{key: _interval(value, n, f"{source}: limits.{key}") for key, value in given.items()}
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


def _knowledge(data: Any, n: int, source: str) -> Knowledge | None:
    return None if data is None else knowledge_of(data, n, source)


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


def _floating(data: Any, source: str) -> bool:
    if not isinstance(data, bool):
        raise RobotError(f"{source}: floating is true or false.", got=data)
    return data


def _bounds(data: Any, source: str) -> Mapping[str, Any]:
    if not isinstance(data, Mapping):
        raise RobotError(f"{source}: bounds must be a mapping of groups.", got=data)
    return MappingProxyType(dict(data))
