"""What a URDF or MJCF cannot say about an arm, in a yaml beside it: `arm.urdf.effects.yaml`.

    of: arm.urdf
    joints: [joint_1, joint_2]
    gravity: [0, 0, -9.81]                                           # where the file cannot say it
    effects: [{effect: rotor_inertia, joint: 1, Ia: 0.4}, ...]
    knowledge: {sources: [identified from run1], coefficients: [rotor_inertia Ia1, ..], rows: [..]}

`torchid export` writes it; whoever reads the robot gets its effects on top of the file's own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from torchid.errors import RobotError
from torchid.robot.knowledge import Knowledge, from_mapping, to_mapping
from torchid.robot.model import Robot
from torchid.robot.yaml_file import read_effects
from torchid.robot.yaml_values import known, numbers, parsed_yaml

_KEYS = ("of", "joints", "gravity", "effects", "knowledge")


def sidecar_path(path: Path) -> Path:
    """Where the sidecar of a robot's file is; arm.urdf and arm.xml each have their own."""
    return path.with_name(f"{path.name}.effects.yaml")


def sidecar_yaml(
    name: str,
    joints: Sequence[str],
    effects: Sequence[Mapping[str, Any]],
    gravity: Sequence[float] | None,
    knowledge: Knowledge | None = None,
) -> str:
    """The text of a sidecar.

    Args:
        name: of the file it belongs to.
        joints: names of the chain's joints, in order.
        effects: records as in a robot's yaml.
        gravity: (3,) [m/s^2], or None where the file itself says it.
        knowledge: how sure the file and its effects are.
    """
    data: dict[str, Any] = {"of": name, "joints": list(joints)}
    if gravity is not None:
        data["gravity"] = list(gravity)
    data["effects"] = [dict(record) for record in effects]
    if knowledge is not None:
        data["knowledge"] = to_mapping(replace(knowledge, log=None))
    head = f"# What {name} cannot say; torchid reads it together with that file.\n"
    return head + yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=200)


def with_sidecar(robot: Robot, path: Path) -> Robot:
    """The robot with the sidecar of its file, where there is one.

    Raises:
        RobotError: a sidecar that cannot be read, or that is of another chain of joints.
    """
    beside = sidecar_path(path)
    if not beside.is_file():
        return robot
    data = parsed_yaml(beside)
    known(data, _KEYS, str(beside))
    if list(data.get("joints") or ()) != list(robot.joint_names):
        raise RobotError(
            f"'{beside}' belongs to another chain of joints than '{path}'.",
            got=data.get("joints"),
            expected=list(robot.joint_names),
            hint="choose the part with `tip=...`, `root=...` and `lock=...`, or remove the file",
        )
    effects = read_effects(data.get("effects") or (), robot.n, str(beside))
    gravity = robot.gravity
    if data.get("gravity") is not None:
        gravity = numbers(data["gravity"], (3,), f"{beside}: gravity")
    sure = data.get("knowledge")
    return replace(
        robot,
        effects=(*robot.effects, *effects),
        gravity=gravity,
        knowledge=None if sure is None else from_mapping(sure, robot.n_links, str(beside)),
    )
