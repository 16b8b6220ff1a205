"""Writing a robot as torchid's yaml, so that reading it gives the same robot to the last bit."""

import math
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from torch import Tensor

from torchid.files import atomic_write
from torchid.robot.knowledge import to_mapping as knowledge_mapping
from torchid.robot.library import as_robot
from torchid.robot.model import LIMITS, Robot, RobotLike
from torchid.robot.origin import origin_of
from torchid.robot.yaml_file import CONVENTIONS, dh_step
from torchid.typing import Float


def write_robot(robot: RobotLike, path: str | Path) -> None:
    """Write a robot's yaml (format in docs/robots.md), in place of the file only when complete.

    Numbers are written so that they are read back exactly, and inertial parameters as they are
    stored: masses, first moments, inertias about the link frames' origins. The kinematics are a DH
    table where one gives the same poses exactly, otherwise placements. What the reader of the
    robot noticed goes into comments.

    Args:
        robot: one robot, not a batch of candidates.
        path: the file, *.yaml.

    Raises:
        TorchidError: the file cannot be written.

    >>> from tempfile import TemporaryDirectory
    >>> import torchid
    >>> robot = torchid.load_robot("3r")
    >>> with TemporaryDirectory() as folder:
    ...     write_robot(robot, Path(folder) / "arm.yaml")
    ...     again = torchid.load_robot(Path(folder) / "arm.yaml")
    >>> bool((again.parameters.pi == robot.parameters.pi).all())
    True
    """
    robot = as_robot(robot)
    text = robot_yaml(robot)
    with atomic_write(Path(path)) as file:
        file.write(text)


def robot_yaml(robot: Robot) -> str:
    """The text that `write_robot` writes."""
    body = yaml.safe_dump(
        to_mapping(robot), sort_keys=False, default_flow_style=None, allow_unicode=True, width=200
    )
    # Whatever separates lines would end a comment: all white space becomes one blank.
    comments = [f"# warning: {' '.join(warning.split())}\n" for warning in robot.warnings]
    return "".join(comments) + body


def to_mapping(robot: Robot) -> dict[str, Any]:
    """Content of the robot's yaml as plain Python values; the inverse of `from_mapping`."""
    out: dict[str, Any] = {"name": robot.name}
    out |= _dh(robot) or _placements(robot)
    out |= _unless_empty("file", dict(origin_of(robot)))
    out["gravity"] = robot.gravity.tolist()
    if not _is_identity(robot.tool):
        out["tool"] = robot.tool.tolist()
    out |= _unless_empty("floating", robot.floating)
    known = {name: getattr(robot.limits, name) for name in LIMITS}
    out |= _unless_empty(
        "limits", {name: value.tolist() for name, value in known.items() if value is not None}
    )
    if robot.parameters is not None:
        parameters = robot.parameters
        if parameters.pi.ndim != 2:
            raise ValueError("a robot's yaml holds one set of parameters, not a batch.")
        out["parameters"] = {
            "mass": parameters.mass.tolist(),
            "first_moment": parameters.first_moment.tolist(),
            "inertia_about_link_frame": parameters.inertia_about_link_frame.tolist(),
        }
    if robot.compensated is not None:
        out["compensated"] = robot.compensated.tolist()
    out |= _unless_empty("effects", [_plain(record) for record in robot.effects])
    if robot.drive_gain is not None:
        out["drive_gain"] = robot.drive_gain.tolist()
    if robot.basis != Robot.basis:
        out["basis"] = robot.basis
    if robot.knowledge is not None:
        out["knowledge"] = knowledge_mapping(robot.knowledge)
    return out | _unless_empty("bounds", _plain(robot.bounds))


def _unless_empty(key: str, value: Any) -> dict[str, Any]:
    return {key: value} if value else {}


def _dh(robot: Robot) -> dict[str, Any]:
    """A DH table with exactly the robot's poses; empty where there is none."""
    if not robot.is_serial or robot.tips:
        return {}
    for convention in CONVENTIONS:
        rows = [
            _dh_row(convention, before, after)
            for before, after in zip(robot.before, robot.after, strict=True)
        ]
        exact = [row for row in rows if row is not None]
        if len(exact) == robot.n:
            return {"dh": {"convention": convention, "joints": _named(robot, exact)}}
    return {}


def _dh_row(
    convention: str, before: Float[Tensor, "4 4"], after: Float[Tensor, "4 4"]
) -> dict[str, Any] | None:
    """The row of a DH table whose poses are these, bit by bit; None where there is none."""
    r, p = (after if convention == "classical" else before)[:3, :].split([3, 1], dim=-1)
    if convention == "classical":  # Rz(theta) Tz(d) Tx(a) Rx(alpha): p = (a c, a s, d)
        theta = math.atan2(r[1, 0], r[0, 0])
        alpha = math.atan2(r[2, 1], r[2, 2])
        along_x, d = r[:, 0] @ p[:, 0], p[2, 0]
    else:  # Rx(alpha) Tx(a) Rz(theta) Tz(d): p = (a, -d sin(alpha), d cos(alpha))
        theta = math.atan2(-r[0, 1], r[0, 0])
        alpha = math.atan2(-r[1, 2], r[2, 2])
        along_x, d = p[0, 0], r[:, 2] @ p[:, 0]
    a, d = float(along_x), float(d)
    if not all(
        torch.equal(made, given)
        for made, given in zip(
            dh_step(convention, a, alpha, d, theta), (before, after), strict=True
        )
    ):
        return None
    return {"a": a, **_angle("alpha", alpha), "d": d, **_angle("theta", theta)}


def _angle(key: str, value: float) -> dict[str, float]:
    """In whole degrees where that is the same number."""
    degrees = round(math.degrees(value))
    return {f"{key}_deg": degrees} if math.radians(degrees) == value else {key: value}


def _placements(robot: Robot) -> dict[str, Any]:
    rows = [
        # The link that carries link i, where it is not the one before.
        ({} if parent == i - 1 else {"parent": robot.link_names[parent] if parent >= 0 else None})
        | _unless_empty("before", _pose(robot.before[i]))
        | _unless_empty("after", _pose(robot.after[i]))
        | _follows(robot, i)
        for i, parent in enumerate(robot.parents)
    ]
    tips = [
        {"name": tip.name, "link": robot.link_names[tip.link]}
        | _unless_empty("pose", _pose(tip.pose))
        for tip in robot.tips
    ]
    return {"placements": {"joints": _named(robot, rows)} | _unless_empty("tips", tips)}


def _follows(robot: Robot, i: int) -> dict[str, Any]:
    """What the joint of link i mimics."""
    drive = robot.drives[i]
    if drive not in robot.mimics:
        return {}
    values = {"joint": robot.joint_names[drive.coordinate], "ratio": drive.ratio}
    return {"mimic": values | _unless_empty("offset", drive.offset)}


def _named(robot: Robot, rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows with names, where they are not the reader's own, and types in front."""
    out = []
    named = zip(robot.drives, robot.link_names, rows, strict=True)
    for i, (drive, link, row) in enumerate(named, start=1):
        names = {"name": drive.joint} if drive.joint != f"joint_{i}" else {}
        names |= {"link": link} if link != f"link_{i}" else {}
        out.append({**names, "type": drive.joint_type.value, **row})
    return out


def _pose(matrix: Float[Tensor, "4 4"]) -> dict[str, Any]:
    """{xyz, rotation} without what is zero or the identity."""
    out = {}
    if matrix[:3, 3].any():
        out["xyz"] = matrix[:3, 3].tolist()
    if not _is_identity(matrix[:3, :3]):
        out["rotation"] = matrix[:3, :3].tolist()
    return out


def _is_identity(matrix: Tensor) -> bool:
    return torch.equal(matrix, torch.eye(matrix.shape[-1], dtype=matrix.dtype))


def _plain(value: Any) -> Any:
    """Mappings, sequences, tensors and numbers of numpy as what yaml knows."""
    if isinstance(value, Mapping):
        return {_plain(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, Tensor | np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Enum):
        return _plain(value.value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(entry) for entry in value]
    return value
