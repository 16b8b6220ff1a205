"""A robot inside a result's JSON, so that the result can be used without the robot's file."""

import math
from collections.abc import Mapping
from typing import Any

from torchid.errors import TorchidError
from torchid.json_data import plain
from torchid.robot.model import Robot
from torchid.robot.writer import to_mapping
from torchid.robot.yaml_file import from_mapping

KEY = "model"


def robot_record(robot: Robot) -> dict[str, Any]:
    """The robot's yaml as JSON-ready data, without bounds; infinite limits are null."""
    out = to_mapping(robot)
    out.pop("bounds", None)
    return {**plain(out)}


def recorded_robot(data: Mapping[str, Any], source: str, key: str = KEY) -> Robot | None:
    """The robot that a result's data hold under `key`, or None.

    Raises:
        TorchidError: an entry that is no robot.
    """
    entry = data.get(key)
    if entry is None:
        return None
    if not isinstance(entry, Mapping):
        raise TorchidError(f"'{source}': '{key}' is not a robot.", got=type(entry).__name__)
    limits = {
        name: [[-math.inf if low is None else low, math.inf if high is None else high]
               for low, high in bounds]
        for name, bounds in (entry.get("limits") or {}).items()
    }  # fmt: skip
    return from_mapping({**entry, **({"limits": limits} if limits else {})}, source)
