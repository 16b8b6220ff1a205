"""A new URDF of a robot's kinematics and dynamics, where there is no file to edit."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from lxml import etree
from torch import Tensor

from torchid.digits import number
from torchid.effects.inertia import LinkInertia, Payload
from torchid.effects.registry import Valued
from torchid.export.exact_text import roll_pitch_yaw_of, text
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
    root = etree.Element("robot", name=robot.name)
    taken = set(robot.link_names)
    base = _free("base", taken)
    _element(root, "link", name=base)
    parent, behind = base, torch.eye(4, dtype=torch.float64)
    pi = robot.require_parameters("an export").pi.double()
    parameters = InertialParameters(move(pi, robot.after.double()))
    for i, name in enumerate(robot.link_names):
        link = _element(root, "link", name=name)
        _inertial(link, parameters, i, name)
        _joint(root, robot, i, (parent, name), behind @ robot.before[i].double(), joints[i])
        parent, behind = name, robot.after[i].double()
    tool = _free("tool", taken)
    _element(root, "link", name=tool)
    fixed = _element(root, "joint", name=_free("tool_mount", set(robot.joint_names)), type="fixed")
    _placed(fixed, behind @ robot.tool.double())
    _ends(fixed, parent, tool)
    etree.indent(root)
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


def _element(parent: Any, tag: str, **attributes: str) -> Any:
    return etree.SubElement(parent, tag, **attributes)


def _free(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _inertial(link: Any, parameters: InertialParameters, i: int, name: str) -> None:
    refuse_moment_without_mass(parameters, i, name)
    inertial = _element(link, "inertial")
    _element(inertial, "origin", xyz=text(parameters.com[i]), rpy="0 0 0")
    _element(inertial, "mass", value=number(parameters.mass[i]))
    values = zip(TENSOR, parameters.inertia_about_com[i].tolist(), strict=True)
    _element(inertial, "inertia", **{key: number(value) for key, value in values})


def _placed(element: Any, pose: Tensor) -> None:
    angles = roll_pitch_yaw_of(pose[:3, :3])
    _element(element, "origin", xyz=text(pose[:3, 3]), rpy=text(angles))


def _ends(element: Any, parent: str, link: str) -> None:
    _element(element, "parent", link=parent)
    _element(element, "child", link=link)


def _joint(
    root: Any, robot: Robot, i: int, ends: tuple[str, str], origin: Tensor, values: JointDynamics
) -> None:
    position = _interval(robot.limits.position, i)
    kind = "prismatic" if robot.joint_types[i] is JointType.PRISMATIC else "revolute"
    if kind == "revolute" and position is None:
        kind = "continuous"
    joint = _element(root, "joint", name=robot.joint_names[i], type=kind)
    _placed(joint, origin)
    _ends(joint, *ends)
    _element(joint, "axis", xyz="0 0 1")
    # 0 is what exporters write for a limit that is not known; readers need the attributes.
    limit = {
        "effort": _symmetric(robot.limits.torque, i),
        "velocity": _symmetric(robot.limits.velocity, i),
    }
    if kind != "continuous":
        low, high = position or (0.0, 0.0)
        limit |= {"lower": number(low), "upper": number(high)}
    if kind != "continuous" or set(limit.values()) != {"0.0"}:
        _element(joint, "limit", **limit)
    if values.damping or values.friction:
        attributes = {"damping": number(values.damping), "friction": number(values.friction)}
        _element(joint, "dynamics", **attributes)


def _interval(limits: Tensor | None, i: int) -> tuple[float, float] | None:
    if limits is None or not bool(torch.isfinite(limits[i]).all()):
        return None
    return float(limits[i, 0]), float(limits[i, 1])


def _symmetric(limits: Tensor | None, i: int) -> str:
    """URDF's one number for both directions: the smaller size; 0 where it is not known."""
    if limits is None:
        return "0.0"
    size = float(limits[i].abs().min())
    return number(size if math.isfinite(size) else 0.0)
