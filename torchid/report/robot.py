"""A robot as tables and as plain data."""

from typing import Any

from torchid.feasibility.units import unit_findings
from torchid.json_data import picked, plain
from torchid.report.table import Report, Table, plain_table
from torchid.results.words import count
from torchid.robot.model import JointType, Robot
from torchid.typing import Tensor

_LIMITS = {
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "acceleration": ("rad/s²", "m/s²"),
    "torque": ("N m", "N"),
}
"""Limits of a joint, and their units where it turns and where it slides."""


def robot_record(robot: Robot) -> dict[str, Any]:
    """The schema torchid.robot/1; infinite limits are null."""
    p = robot.parameters
    return {
        "schema": "torchid.robot/1",
        **picked(robot, "name source"),
        **({} if robot.is_serial else {"tree": _tree_record(robot)}),
        "joints": [
            {
                "joint": i + 1,
                "name": robot.joint_names[i],
                "type": str(robot.joint_types[i]),
                "link": robot.link_names[robot.own_links[i]],
                **{name: _limit(getattr(robot.limits, name), i) for name in _LIMITS},
            }
            for i in range(robot.n)
        ],
        "gravity": robot.gravity.tolist(),
        "parameters": None
        if p is None
        else {
            **picked(p, "mass com inertia_about_com"),
            "consistency_margin": p.consistency_margin().tolist(),
        },
        **picked(robot, "effects drive_gain"),
        "bounds": sorted(robot.bounds),
        "warnings": list(robot_warnings(robot)),
    }


def _tree_record(robot: Robot) -> dict[str, Any]:
    """Which link carries which, what follows what, and where branches end."""
    return {
        "links": [
            {
                "link": i + 1,
                "name": robot.link_names[i],
                "carried_by": None if parent < 0 else parent + 1,
                "joint": drive.coordinate + 1,
                "ratio": drive.ratio,
                "offset": drive.offset,
            }
            for i, (parent, drive) in enumerate(zip(robot.parents, robot.drives, strict=True))
        ],
        "tips": [{"name": tip.name, "link": tip.link + 1} for tip in robot.ends],
    }


def robot_warnings(robot: Robot) -> tuple[str, ...]:
    """The reader's warnings, links whose inertia no body can have, and units that look wrong."""
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
    return (*said, *(finding.sentence for finding in unit_findings(robot)))


def report_of_robot(robot: Robot) -> Report:
    """All that there is to see of a robot."""
    return Report(parts=robot_tables(robot), warnings=robot_warnings(robot))


def robot_tables(robot: Robot) -> list[Table]:
    """Joints with limits, the tree of a robot that branches, and links with parameters."""
    record, slides = robot_record(robot), [x is JointType.PRISMATIC for x in robot.joint_types]
    units = {
        name: both[0] if not any(slides) else both[1] if all(slides) else " or ".join(both)
        for name, both in _LIMITS.items()
    }
    joints = [
        {f"{key} [{units[key]}]" if key in units else key: x for key, x in joint.items()}
        for joint in record["joints"]
    ]
    tables = [plain_table(f"{robot.name}: {count(robot.n, 'joint')}", joints)]
    if tree := record.get("tree"):
        tips = ", ".join(f"{tip['name']} on link {tip['link']}" for tip in tree["tips"])
        title = f"{count(robot.n_links, 'link')}; tips: {tips}"
        tables.append(plain_table(title, tree["links"]))
    if (p := record["parameters"]) is not None:
        links = [
            {
                "link": k + 1,
                "name": name,
                "mass [kg]": p["mass"][k],
                "CoM [m]": p["com"][k],
                "inertia about CoM [kg m²]": p["inertia_about_com"][k],
                "consistent": p["consistency_margin"][k] >= 0,
            }
            for k, name in enumerate(robot.link_names)
        ]
        tables.append(plain_table("links (axes of the link frame)", links))
    return tables


def _limit(limits: Tensor | None, i: int) -> list[float | None] | None:
    return None if limits is None else plain(limits[i])
