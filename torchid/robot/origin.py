"""The URDF or MJCF that a robot's yaml was made from, so that an export edits a copy of it."""

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from torchid.errors import RobotError
from torchid.robot.model import Robot
from torchid.robot.tree import Choice, choice_of
from torchid.robot.yaml_values import known

TREES = (".urdf", ".xml")
_PART = ("tip", "root", "lock")


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
    return {"path": str(path.resolve()), "sha256": _digest(path), **part}


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
    same = [p for p in there if _digest(p) == robot.file["sha256"]]
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


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()
