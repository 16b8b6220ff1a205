"""A robot as tables and as plain data."""

import math
from typing import Any

from rich.table import Table

from torchid.report.identification import compact
from torchid.robot.model import JointType, Robot
from torchid.typing import Tensor

_LIMITS = ("position", "velocity", "acceleration", "torque")


def robot_record(robot: Robot) -> dict[str, Any]:
    """The schema torchid.robot/1; infinite limits are null."""
    p = robot.parameters
    return {
        "schema": "torchid.robot/1",
        "name": robot.name,
        "source": robot.source,
        "joints": [
            {
                "joint": i + 1,
                "name": robot.joint_names[i],
                "type": str(robot.joint_types[i]),
                "link": robot.link_names[i],
                **{name: _limit(getattr(robot.limits, name), i) for name in _LIMITS},
            }
            for i in range(robot.n)
        ],
        "gravity": robot.gravity.tolist(),
        "parameters": None
        if p is None
        else {
            "mass": p.mass.tolist(),
            "com": p.com.tolist(),
            "inertia_about_com": p.inertia_about_com.tolist(),
            "consistency_margin": p.consistency_margin().tolist(),
        },
        "effects": [dict(e) for e in robot.effects],
        "drive_gain": None if robot.drive_gain is None else robot.drive_gain.tolist(),
        "bounds": sorted(robot.bounds),
        "warnings": list(robot_warnings(robot)),
    }


def robot_warnings(robot: Robot) -> tuple[str, ...]:
    """The reader's warnings, and links whose inertia no body can have."""
    said = list(robot.warnings)
    if robot.parameters is None:
        return tuple(said) or ("no inertial parameters: they can be identified, not simulated",)
    margins = robot.parameters.consistency_margin().tolist()
    for name, margin in zip(robot.link_names, margins, strict=True):
        if margin < 0 and not any(f"'{name}'" in w and "consistent" in w for w in said):
            said.append(
                f"link '{name}' is not physically consistent: its pseudo-inertia has the "
                f"eigenvalue {margin:.2e}"
            )
    return tuple(said)


def robot_tables(robot: Robot) -> list[Table]:
    """Joints with limits, and links with parameters."""
    joints = compact(f"{robot.name}: {robot.n} joints")
    for heading in ("", "joint", "type", *(f"{name} {_unit(name)}" for name in _LIMITS)):
        joints.add_column(heading)
    for i in range(robot.n):
        limits = (_interval(_limit(getattr(robot.limits, name), i)) for name in _LIMITS)
        kind = "prismatic" if robot.joint_types[i] is JointType.PRISMATIC else "revolute"
        joints.add_row(str(i + 1), robot.joint_names[i], kind, *limits)
    return [joints] if robot.parameters is None else [joints, _links(robot)]


def _links(robot: Robot) -> Table:
    p = robot.parameters
    assert p is not None
    table = compact("links (axes of the link frame)")
    for heading in ("", "link", "mass [kg]", "CoM [m]", "inertia about CoM [kg m^2]", "consistent"):
        table.add_column(heading)
    rows = zip(
        robot.link_names,
        p.mass.tolist(),
        p.com.tolist(),
        p.inertia_about_com.tolist(),
        p.consistency_margin().tolist(),
        strict=True,
    )
    for i, (name, mass, com, inertia, margin) in enumerate(rows, start=1):
        verdict = "yes" if margin >= 0 else f"[red]no[/] ({margin:.1e})"
        table.add_row(str(i), name, f"{mass:.5g}", _vector(com), _vector(inertia), verdict)
    return table


def _unit(limit: str) -> str:
    return {"position": "[rad]", "velocity": "[rad/s]", "acceleration": "[rad/s²]"}.get(
        limit, "[N m]"
    ).replace("[", r"\[")  # fmt: skip


def _limit(limits: Tensor | None, i: int) -> list[float | None] | None:
    if limits is None:
        return None
    return [v if math.isfinite(v) else None for v in limits[i].tolist()]


def _interval(limits: list[float | None] | None) -> str:
    if limits is None or limits == [None, None]:
        return "-"
    low, high = limits
    if low is not None and high is not None and abs(low + high) < 1e-12:
        return f"±{high:.5g}"
    return " .. ".join("∞" if v is None else f"{v:.5g}" for v in (low, high))


def _vector(values: list[float]) -> str:
    return " ".join(f"{v:.4g}" for v in values)
