"""URDF: a copy of a file with other dynamics, in which <inertial> and <dynamics> are written and
the rest stays; or, where there is no file to edit, a new one.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from lxml.etree import Element, SubElement, indent

from torchid.digits import number
from torchid.effects.registry import Valued
from torchid.errors import TorchidError
from torchid.export.xml_tree import (
    DECLARATION,
    XmlFile,
    child,
    child_or_new,
    children,
    comment,
    read_xml,
    relocated_path,
    replace,
    roll_pitch_yaw_of,
    text,
)
from torchid.robot.inertia import InertialParameters, move
from torchid.robot.model import JointType, Limits, Robot, free_name
from torchid.robot.tree import Choice, choose
from torchid.robot.xml_numbers import TENSOR, parse_xml
from torchid.simulators.joint_dynamics import JointDynamics, dynamics_of_links
from torchid.typing import Tensor


def edited_urdf(
    original: Path, choice: Choice, robot: Robot, joints: Sequence[JointDynamics], folder: Path
) -> XmlFile:
    """The original with the robot's parameters and the joints' damping and friction.

    The reader merges links behind fixed joints into the link that moves them, and the result's
    parameters are those of the whole. So the whole is written into that link, and the <inertial> of
    the merged ones is taken away, with a comment in its place: the total is exact, whereas shares
    of it are not in the result.

    Args:
        original: the user's file, which is only read.
        choice: as the robot was read with.
        robot: parameters in the frames of the original's links.
        joints: attributes of its n joints.
        folder: where the copy will lie, for relative references to meshes.
    """
    from torchid.robot.urdf import urdf_tree  # MuJoCo's import takes .15 s

    file = read_xml(original)
    part = choose(urdf_tree(parse_xml(original), str(original), []), choice)
    links = {node.get("name", "").strip(): node for node in children(file.root, "link")}
    by_name = {node.get("name", "").strip(): node for node in children(file.root, "joint")}
    parameters = robot.require_parameters("an export")
    own = dynamics_of_links(robot, joints)
    for i, (group, joint) in enumerate(zip(part.groups[1:], part.joints, strict=True)):
        for name in [name for name in group.poses if name != group.link]:
            for inertial in children(links[name], "inertial"):
                mass = child(inertial, "mass")
                had = "" if mass is None else f" ({mass.get('value', '').strip()} kg)"
                said = comment(f"inertial{had} is part of that of link '{group.link}'")
                replace(inertial, said)
        written = child_or_new(links[group.link], "inertial", first=True)
        for tag, attributes in _inertial(parameters, i, group.link).items():
            node = child_or_new(written, tag, first=tag == "origin")
            node.attrib.pop("quat_xyzw", None)
            node.attrib.update(attributes)
        # <dynamics>, where it is there or needed.
        values, element = own[i], by_name[joint.name]
        if child(element, "dynamics") is not None or values.damping or values.friction:
            node = child_or_new(element, "dynamics")
            node.set("damping", number(values.damping))
            node.set("friction", number(values.friction))
    if folder.resolve() != original.parent.resolve():
        for node in file.root.iter("{*}mesh", "{*}texture"):
            if node.get("filename"):
                node.set("filename", relocated_path(node.get("filename"), original.parent, folder))
    return file


def _inertial(parameters: InertialParameters, i: int, name: str) -> dict[str, dict[str, str]]:
    """Children of a link's <inertial> and their attributes, about its centre of mass in axes
    parallel to the link frame's."""
    refuse_moment_without_mass(parameters, i, name)
    tensor = zip(TENSOR, parameters.inertia_about_com[i].tolist(), strict=True)
    return {
        "origin": {"xyz": text(parameters.com[i]), "rpy": "0 0 0"},
        "mass": {"value": number(parameters.mass[i])},
        "inertia": {key: number(value) for key, value in tensor},
    }


def refuse_moment_without_mass(parameters: InertialParameters, i: int, name: str) -> None:
    """Raise TorchidError for a first moment without a mass: it has no centre of mass to write."""
    if float(parameters.mass[i]) == 0 and bool(parameters.first_moment[i].any()):
        raise TorchidError(
            f"link '{name}' has a first moment and no mass: no centre of mass can be written.",
            got=parameters.first_moment[i].tolist(),
            hint="the formats yaml and c write first moments as they are",
        )


def new_urdf(robot: Robot, joints: Sequence[JointDynamics]) -> XmlFile:
    """A URDF of the robot: `base`, the moving links, `tool`, or the names of several tips.

    A URDF's link frame is the moved joint frame, so link frames that are elsewhere (`after`, as in
    classical DH) are left out and the inertias are moved. Joints turn about z.

    Args:
        robot: with parameters.
        joints: attributes of its n joints.
    """
    root = Element("robot", name=robot.name)
    taken = set(robot.link_names)
    base = free_name("base", taken)
    SubElement(root, "link", name=base)
    pi = robot.require_parameters("an export").pi.double()
    parameters = InertialParameters(move(pi, robot.after.double()))
    own = dynamics_of_links(robot, joints)
    for i, name in enumerate(robot.link_names):
        inertial = SubElement(SubElement(root, "link", name=name), "inertial")
        for tag, attributes in _inertial(parameters, i, name).items():
            SubElement(inertial, tag, **attributes)
        above, origin = robot.parents[i], robot.before[i].double()
        if above >= 0:
            origin = robot.after[above].double() @ origin
        ends = (base if above < 0 else robot.link_names[above], name)
        _joint(root, robot, i, ends, origin, own[i])
    used = {drive.joint for drive in robot.drives}
    for end in robot.ends:
        tool = free_name(end.name if robot.tips else "tool", taken)
        SubElement(root, "link", name=tool)
        mount = free_name(f"{end.name}_mount" if robot.tips else "tool_mount", used)
        fixed = SubElement(root, "joint", name=mount, type="fixed")
        placed = robot.after[end.link].double() @ end.pose.double()
        _mounted(fixed, placed, robot.link_names[end.link], tool)
    indent(root)
    return XmlFile(root, DECLARATION)


def in_joint_frames(pairs: Sequence[Valued], robot: Robot) -> tuple[Valued, ...]:
    """Effects with bodies' parameters in the frames that `new_urdf` gives the links."""
    out: list[Valued] = []
    for effect, values in pairs:
        moved = values
        if (link := effect.body(robot)) is not None:
            pi = torch.tensor(values, dtype=torch.float64)
            moved = move(pi, robot.after[link].double()).tolist()
        out.append((effect, moved))
    return tuple(out)


def _mounted(joint: Any, pose: Tensor, parent: str, link: str) -> None:
    angles = roll_pitch_yaw_of(pose[:3, :3])
    SubElement(joint, "origin", xyz=text(pose[:3, 3]), rpy=text(angles))
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=link)


def _joint(
    root: Any, robot: Robot, i: int, ends: tuple[str, str], origin: Tensor, values: JointDynamics
) -> None:
    drive = robot.drives[i]
    follows = drive in robot.mimics
    # Limits are those of coordinates.
    own = Limits() if follows else robot.limits
    j, limits = drive.coordinate, own.position
    known = limits is not None and bool(torch.isfinite(limits[j]).all())
    low, high = limits[j].tolist() if limits is not None and known else (0.0, 0.0)
    kind = "prismatic" if drive.joint_type is JointType.PRISMATIC else "revolute"
    if kind == "revolute" and not known:
        kind = "continuous"
    joint = SubElement(root, "joint", name=drive.joint, type=kind)
    _mounted(joint, origin, *ends)
    SubElement(joint, "axis", xyz="0 0 1")
    # 0 is what exporters write for a limit that is not known; readers need the attributes.
    limit = {
        "effort": _symmetric(own.torque, j),
        "velocity": _symmetric(own.velocity, j),
    }
    if kind != "continuous":
        limit |= {"lower": number(low), "upper": number(high)}
    if kind != "continuous" or set(limit.values()) != {"0.0"}:
        SubElement(joint, "limit", **limit)
    if values.damping or values.friction:
        damping, friction = number(values.damping), number(values.friction)
        SubElement(joint, "dynamics", damping=damping, friction=friction)
    if follows:
        followed, ratio, offset = robot.joint_names[j], number(drive.ratio), number(drive.offset)
        SubElement(joint, "mimic", joint=followed, multiplier=ratio, offset=offset)


def _symmetric(limits: Tensor | None, i: int) -> str:
    """URDF's one number for both directions: the smaller size; 0 where it is not known."""
    if limits is None:
        return "0.0"
    size = float(limits[i].abs().min())
    return number(size if math.isfinite(size) else 0.0)
