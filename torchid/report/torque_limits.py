"""What planned motions ask of the drives, for people and as data."""

import math
from typing import Any

from rich.table import Table

from torchid.excitation.torque import TorqueUse, has_torque_limits
from torchid.json_data import plain
from torchid.report.identification import compact
from torchid.robot.model import JointType, Robot


def torque_table(robot: Robot, use: TorqueUse) -> Table:
    """The largest torque of every joint beside its limit."""
    title = f"largest torque, by the {use.source}"
    table = compact(title)
    table.min_width = len(title)
    for heading in ("joint", "torque", "limit", "share"):
        table.add_column(heading, justify="right")
    for j, (size, share) in enumerate(zip(use.largest.tolist(), use.share.tolist(), strict=True)):
        unit = "N" if robot.joint_types[j] is JointType.PRISMATIC else "N m"
        low, high = use.limits[j].tolist()
        limit = f"{high:g} {unit}" if low == -high else f"{low:g} .. {high:g} {unit}"
        known = math.isfinite(min(-low, high))
        table.add_row(
            str(j + 1),
            f"{size:.3g} {unit}",
            limit if known else "none",
            f"{100 * share:.0f} %" if known else "-",
        )
    return table


def torque_record(robot: Robot, use: TorqueUse | None) -> dict[str, Any]:
    """JSON-ready; without a use, why torque limits were not checked."""
    if use is None:
        return {"checked": False, "reason": not_checked(robot) or "no torque limits"}
    joints = zip(use.largest.tolist(), plain(use.limits), use.share.tolist(), strict=True)
    return {
        "checked": True,
        "model": use.source,
        "joints": [
            {"joint": j, "largest": size, "limit": limit, "share": share}
            for j, (size, limit, share) in enumerate(joints, start=1)
        ],
    }


def not_checked(robot: Robot) -> str | None:
    """Why the robot's torque limits cannot be checked; None where it has none or they can be."""
    if not has_torque_limits(robot) or robot.parameters is not None:
        return None
    return (
        f"torque limits were not checked: robot '{robot.name}' has no inertial parameters, which "
        "predict torque."
    )
