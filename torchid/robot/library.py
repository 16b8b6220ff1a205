"""Find a robot by built-in name or by path."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchid.errors import RobotError, TorchidError
from torchid.files import add_input
from torchid.robot.config_files import (
    URDF_FILES,
    built_in_robots,
    config_folder,
    is_urdf,
    names_robot,
    require_robot_file,
)
from torchid.robot.floating import on_moving_base
from torchid.robot.model import Robot, RobotLike
from torchid.robot.sidecar import sidecar_path, with_sidecar
from torchid.robot.tree import Base, Choice
from torchid.robot.yaml_file import read_yaml


def load_robot(
    name: str | Path,
    *,
    tip: str | None = None,
    root: str | None = None,
    lock: Mapping[str, float] | None = None,
    base: Base = "fixed",
) -> Robot:
    """A robot by built-in name, or from a torchid .yaml, .urdf or .xml (MJCF) file.

    A URDF or MJCF is read whole, with all its branches, unless a part is chosen. A xacro
    file of any name is a program and is not run: the error has the line that expands it.

    Args:
        name: `3r`, `kuka_lwr4`, ... or a path.
        tip: for URDF and MJCF: the last link of a chain, which alone is read.
        root: for URDF and MJCF: the link that is the base of what is read.
        lock: for URDF and MJCF: joints that are held, and where [rad or m].
        base: for URDF and MJCF: whether the base is held, or moves and is measured: its pose is
            then six coordinates before those of the joints (`torchid.robot.floating`).

    Raises:
        RobotError: no such robot, or a file that cannot be read as one; no such link or joint.

    >>> load_robot("3r").joint_names
    ('joint_1', 'joint_2', 'joint_3')
    """
    text, path = str(name), require_robot_file(name)
    suffix = path.suffix.lower()
    for file in (path, sidecar_path(path)):
        add_input(file)
    if suffix in (".yaml", ".yml"):
        chosen = {"tip": tip, "root": root, "lock": lock or None}
        for option, given in (chosen | {"base": None if base == "fixed" else base}).items():
            if given is not None:
                raise RobotError(
                    f"`{option}=...` chooses a part of a URDF or MJCF; '{text}' is read whole.",
                    got=given,
                )
        return read_yaml(path)
    if is_urdf(path):
        from torchid.robot.urdf import read_urdf as read
    else:
        from torchid.robot.mjcf import read_mjcf as read
    robot = with_sidecar(read(path, tip=tip, root=root, lock=lock, base=base), path)
    return on_moving_base(robot) if base == "moving" else robot


def as_robot(robot: RobotLike) -> Robot:
    """A robot as it is, or of its name or file: what every public function takes for one.

    Raises:
        RobotError: as `load_robot`, or something else.
    """
    if isinstance(robot, Robot):
        return robot
    if isinstance(robot, str | Path):
        return load_robot(robot)
    raise RobotError(
        "this is no robot.",
        got=type(robot).__name__,
        expected="a Robot, or a name or file that `torchid.load_robot` takes",
    )


def load_both(params: str, robot: str | None, choice: Choice) -> tuple[Robot, Robot]:
    """The robot whose parameters are asked about, and another one, or the same one without it.

    Args:
        params: name or file of the first.
        robot: of the second, if it is another.
        choice: of the part of those of the two that can branch.
    """
    both = [params] if robot is None else [params, robot]
    # A part is chosen of the files that can branch; where none can, the reader refuses it.
    trees = [name for name in both if Path(name).suffix.lower() in (*URDF_FILES, ".xml")]
    pair = [
        load_robot(name, **(choice if name in trees or not trees else Choice()).options)
        for name in both
    ]
    return pair[0], pair[-1]


def named_record(robot: Robot) -> dict[str, Any]:
    """A robot's name, and what `load_robot` finds it again by: its built-in name or its file, and
    how its part was chosen."""
    path = Path(robot.source)
    source = path.stem if path.parent == config_folder("robots") else robot.source
    chosen = {
        "tip": robot.tip,
        "root": robot.root,
        "lock": dict(robot.locked) or None,
        "base": "moving" if robot.floating else None,
    }
    part = {f"robot_{key}": value for key, value in chosen.items() if value is not None}
    return {"robot": robot.name, "robot_source": source, **part}


def named_robot(result: Path, data: Mapping[str, Any], choice: Choice | None = None) -> Robot:
    """The robot that a result's data name, as `named_record` writes it: its file or built-in name,
    and the part that it records unless another is chosen.

    Args:
        result: file of the data; the robot may lie beside it.
        data: of the result.
        choice: in place of the recorded one.

    Raises:
        TorchidError: it names none, or one that is not where it was.
    """
    source, name = data.get("robot_source"), data.get("robot")
    recorded = Choice(
        data.get("robot_tip"),
        data.get("robot_root"),
        data.get("robot_lock") or {},
        data.get("robot_base") or "fixed",
    )
    for place in (source, name):
        if not isinstance(place, str):
            continue
        for file in (place, str(result.parent / place)):
            if file in built_in_robots() or (names_robot(file) and Path(file).is_file()):
                return load_robot(file, **(choice or recorded).options)
    raise TorchidError(
        f"`robot=...` is needed: the robot of '{result}' was not found.",
        got=source or name,
    )
