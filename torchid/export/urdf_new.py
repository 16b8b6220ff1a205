"""A new URDF of a robot's kinematics and dynamics, where there is no file to edit."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from lxml.etree import Element, SubElement, indent
from torch import Tensor

from torchid.effects.inertia import LinkInertia, Payload
from torchid.effects.registry import Valued
from torchid.export.exact_text import number, roll_pitch_yaw_of, text
from torchid.export.joint_dynamics import JointDynamics
from torchid.export.urdf_edit import TENSOR, refuse_moment_without_mass
from torchid.export.xml_tree import XmlFile
from torchid.robot.inertia import InertialParameters, move
from torchid.robot.model import JointType, Robot

DECLARATION = b'<?xml version="1.0" encoding="utf-8"?>\n'


def new_urdf(robot: Robot, joints: Sequence[JointDynamics]) -> XmlFile:
    """A URDF of the chain: `base`, the moving links, `tool`.

    A URDF's link frame is the moved joint frame, so link frames that are elsewhere (`after`, as in
    classical DH) are left out and the inertias are moved. Joints turn about z.

    Args:
        robot: with parameters.
        joints: attributes of its n joints.
    """
    root = Element("robot", name=robot.name)
    taken = set(robot.link_names)
    base = _free("base", taken)
    SubElement(root, "link", name=base)
    parent, behind = base, torch.eye(4, dtype=torch.float64)
    pi = robot.require_parameters("an export").pi.double()
    parameters = InertialParameters(move(pi, robot.after.double()))
    for i, name in enumerate(robot.link_names):
        refuse_moment_without_mass(parameters, i, name)
        inertial = SubElement(SubElement(root, "link", name=name), "inertial")
        SubElement(inertial, "origin", xyz=text(parameters.com[i]), rpy="0 0 0")
        SubElement(inertial, "mass", value=number(parameters.mass[i]))
        tensor = zip(TENSOR, parameters.inertia_about_com[i].tolist(), strict=True)
        SubElement(inertial, "inertia", **{key: number(value) for key, value in tensor})
        _joint(root, robot, i, (parent, name), behind @ robot.before[i].double(), joints[i])
        parent, behind = name, robot.after[i].double()
    tool = _free("tool", taken)
    SubElement(root, "link", name=tool)
    fixed = SubElement(
        root, "joint", name=_free("tool_mount", set(robot.joint_names)), type="fixed"
    )
    _mounted(fixed, behind @ robot.tool.double(), parent, tool)
    indent(root)
    return XmlFile(root, DECLARATION)


def in_joint_frames(pairs: Sequence[Valued], robot: Robot) -> tuple[Valued, ...]:
    """Effects with bodies' parameters in the frames that `new_urdf` gives the links."""
    out: list[Valued] = []
    for effect, values in pairs:
        moved = values
        if isinstance(effect, Payload | LinkInertia):
            link = robot.n - 1 if isinstance(effect, Payload) else effect.joint
            pi = torch.tensor(values, dtype=torch.float64)
            moved = move(pi, robot.after[link].double()).tolist()
        out.append((effect, moved))
    return tuple(out)


def _free(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _mounted(joint: Any, pose: Tensor, parent: str, link: str) -> None:
    angles = roll_pitch_yaw_of(pose[:3, :3])
    SubElement(joint, "origin", xyz=text(pose[:3, 3]), rpy=text(angles))
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=link)


def _joint(
    root: Any, robot: Robot, i: int, ends: tuple[str, str], origin: Tensor, values: JointDynamics
) -> None:
    limits = robot.limits.position
    known = limits is not None and bool(torch.isfinite(limits[i]).all())
    low, high = limits[i].tolist() if limits is not None and known else (0.0, 0.0)
    kind = "prismatic" if robot.joint_types[i] is JointType.PRISMATIC else "revolute"
    if kind == "revolute" and not known:
        kind = "continuous"
    joint = SubElement(root, "joint", name=robot.joint_names[i], type=kind)
    _mounted(joint, origin, *ends)
    SubElement(joint, "axis", xyz="0 0 1")
    # 0 is what exporters write for a limit that is not known; readers need the attributes.
    limit = {
        "effort": _symmetric(robot.limits.torque, i),
        "velocity": _symmetric(robot.limits.velocity, i),
    }
    if kind != "continuous":
        limit |= {"lower": number(low), "upper": number(high)}
    if kind != "continuous" or set(limit.values()) != {"0.0"}:
        SubElement(joint, "limit", **limit)
    if values.damping or values.friction:
        damping, friction = number(values.damping), number(values.friction)
        SubElement(joint, "dynamics", damping=damping, friction=friction)


def _symmetric(limits: Tensor | None, i: int) -> str:
    """URDF's one number for both directions: the smaller size; 0 where it is not known."""
    if limits is None:
        return "0.0"
    size = float(limits[i].abs().min())
    return number(size if math.isfinite(size) else 0.0)
