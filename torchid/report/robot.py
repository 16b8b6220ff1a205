"""A robot as tables and as plain data."""

from typing import Any

from rich.text import Text

from torchid.feasibility.units import unit_findings
from torchid.json_data import picked, plain
from torchid.report.table import Cell, Report, Table
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


def _tree_table(robot: Robot) -> Table:
    """The links as they carry one another, each branch to its end."""
    rows = []
    ends = {tip.link: tip.name for tip in robot.ends}

    def walk(parent: int, depth: int) -> None:
        for i in [k for k, above in enumerate(robot.parents) if above == parent]:
            drive, name = robot.drives[i], robot.link_names[i]
            joint = str(drive.coordinate + 1)
            if drive in robot.mimics:
                moves = f"{drive.joint} = {drive.ratio:g} x joint {joint}"
                joint, moves = "", moves + (f" {drive.offset:+g}" if drive.offset else "")
            else:
                moves = drive.joint
            end = ends.get(i, "")
            rows.append((joint, moves, str(i + 1), "  " * depth + name, end))
            walk(i, depth + 1)

    walk(-1, 0)
    columns = ("", "joint", "", "link, behind the one that carries it", "tip")
    title = f"{count(robot.n_links, 'link')}, {count(len(robot.ends), 'tip')}"
    return Table(title, columns, rows, "rprpp")


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
    rows = []
    for i in range(robot.n):
        limits = (_interval(_limit(getattr(robot.limits, name), i)) for name in _LIMITS)
        kind = "prismatic" if robot.joint_types[i] is JointType.PRISMATIC else "revolute"
        rows.append((str(i + 1), robot.joint_names[i], kind, *limits))
    slides = [kind is JointType.PRISMATIC for kind in robot.joint_types]
    units = {
        name: both[0] if not any(slides) else both[1] if all(slides) else " or ".join(both)
        for name, both in _LIMITS.items()
    }
    columns = ("", "joint", "type", *(f"{name} [{unit}]" for name, unit in units.items()))
    joints = Table(f"{robot.name}: {count(robot.n, 'joint')}", columns, rows, "p" * 7)
    p, tree = robot.parameters, [] if robot.is_serial else [_tree_table(robot)]
    if p is None:
        return [joints, *tree]
    links, margins = [], p.consistency_margin().tolist()
    for i, name in enumerate(robot.link_names):
        fine = margins[i] >= 0
        verdict: Cell = "no body" if not p.pi[i].any() else "yes"
        verdict = verdict if fine else Text.assemble(("no", "red"), f" ({margins[i]:.1e})")
        vectors = (
            " ".join(f"{v:.4g}" for v in x[i].tolist()) for x in (p.com, p.inertia_about_com)
        )
        links.append((str(i + 1), name, f"{float(p.mass[i]):.5g}", *vectors, verdict))
    columns = ("", "link", "mass [kg]", "CoM [m]", "inertia about CoM [kg m^2]", "consistent")
    return [joints, *tree, Table("links (axes of the link frame)", columns, links, "p" * 6)]


def _limit(limits: Tensor | None, i: int) -> list[float | None] | None:
    return None if limits is None else plain(limits[i])


def _interval(limits: list[float | None] | None) -> str:
    if limits is None or limits == [None, None]:
        return "-"
    low, high = limits
    if low is not None and high is not None and abs(low + high) < 1e-12:
        return f"±{high:.5g}"
    return " .. ".join("∞" if v is None else f"{v:.5g}" for v in (low, high))
