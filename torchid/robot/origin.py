"""The URDF or MJCF that a robot's yaml was made from, so that an export edits a copy of it; and how
exactly such a file says where its links are."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from torchid.errors import RobotError
from torchid.files import file_hash
from torchid.robot.model import Robot
from torchid.robot.tree import Choice, choice_of
from torchid.robot.yaml_values import known
from torchid.typing import Bool

TREES = (".urdf", ".xml")
_PART = ("tip", "root", "lock")
_PLACES = re.compile(
    rb"\b(?:xyz|rpy|pos|quat|euler|axis|axisangle|xyaxes|zaxis)\s*=\s*[\"']([^\"']*)[\"']"
)
"""Attributes by which a URDF or MJCF places links."""
_ROUNDED, _CLOSEST, _FARTHEST = 1.5, 1e-9, 1e-3
"""Half of the last digit of each of three angles; entries of poses that differ by less are always
the same, and by more never [-; m]."""


def origin_of(robot: Robot) -> Mapping[str, Any]:
    """The key `file` of the robot's yaml: path and digest of the file that it was read from, and
    the part of it that was chosen; empty where there is none."""
    path = Path(robot.source)
    if path.suffix.lower() not in TREES or not path.is_file():
        return robot.file
    chosen = choice_of(robot).options
    part = {key: chosen[key] for key in _PART if chosen[key]}
    if part.get("lock"):
        part["lock"] = dict(part["lock"])
    return {"path": str(path.resolve()), "sha256": file_hash(path), **part}


def read_origin(data: Any, source: str) -> Mapping[str, Any]:
    """The key `file` of a yaml.

    Raises:
        RobotError: no path with its digest, or another part than `load_robot` chooses.
    """
    known(data, ("path", "sha256", *_PART), f"{source}: file")
    if not all(isinstance(data.get(key), str) for key in ("path", "sha256")):
        raise RobotError(f"{source}: file needs a path and its sha256.", got=dict(data))
    return dict(data)


def of_own_file(robot: Robot, suffix: str) -> tuple[Robot, tuple[str, ...]]:
    """The robot of the file that this one's yaml was made from, whose copy an export edits: with
    its meshes and all names. The robot as it is, and why, where the file is lost.

    Args:
        robot: of a yaml, or of whatever file.
        suffix: of the export; a file of another format is not looked for.
    """
    path = Path(robot.file.get("path", ""))
    if path.suffix.lower() != suffix:
        return robot, ()
    there = [p for p in (path, Path(robot.source).parent / path.name) if p.is_file()]
    same = [p for p in there if file_hash(p) == robot.file["sha256"]]
    if same:
        from torchid.robot.library import load_robot

        part = Choice(robot.file.get("tip"), robot.file.get("root"), robot.file.get("lock") or {})
        return load_robot(same[0], **part.options), ()
    return robot, (
        f"'{path}', which this robot was read from, "
        + ("has changed since" if there else "is not there any more")
        + ": a new file is written, without its meshes; on the command line `--robot "
        f"{path.name}`, in Python `original=...`, edits a copy of it",
    )


def same_places(robot: Robot, other: Robot) -> Bool[Tensor, " L"]:
    """Whether links are where they are in another robot of as many, as far as the digits go that
    the numbers of their files are written with."""
    return robot.frames_apart(other) <= max(_rounding(robot), _rounding(other))


def _rounding(robot: Robot) -> float:
    """How far entries of poses may be from those that were rounded to a robot's file [-; m]."""
    path = Path(robot.source)
    if path.suffix.lower() not in TREES:
        path = Path(robot.file.get("path", ""))
    if path.suffix.lower() not in TREES or not path.is_file():
        return _CLOSEST
    numbers = b" ".join(_PLACES.findall(path.read_bytes())).split()
    mantissas = (re.split(b"[eE]", number)[0].lstrip(b"+-0.") for number in numbers)
    digits = max((len(m.replace(b".", b"")) for m in mantissas), default=0)
    # Of numbers below ten.
    return min(max(_ROUNDED * 10.0 ** (1 - digits), _CLOSEST), _FARTHEST)
