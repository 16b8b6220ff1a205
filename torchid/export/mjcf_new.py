"""A new MJCF of a robot's kinematics and dynamics, where there is no file to edit."""

from collections.abc import Sequence
from typing import Any

import torch
from lxml import etree
from torch import Tensor

from torchid.export.exact_text import number, principal, quaternion_of, text
from torchid.export.joint_dynamics import JointDynamics
from torchid.export.mjcf_edit import ATTRIBUTES
from torchid.export.urdf_edit import refuse_moment_without_mass
from torchid.export.urdf_new import DECLARATION
from torchid.export.xml_tree import XmlFile
from torchid.robot.model import JointType, Robot


def new_mjcf(robot: Robot, joints: Sequence[JointDynamics]) -> XmlFile:
    """An MJCF of the chain: one body a link, a motor a joint, the site `tool`.

    Body frames are the robot's link frames, so a joint has the anchor and the axis that it has in
    them.

    Args:
        robot: with parameters.
        joints: attributes of its n joints.
    """
    root = etree.Element("mujoco", model=robot.name)
    etree.SubElement(root, "compiler", angle="radian", autolimits="true")
    etree.SubElement(root, "option", gravity=text(robot.gravity))
    body = etree.SubElement(root, "worldbody")
    parameters = robot.require_parameters("an export")
    for i, name in enumerate(robot.link_names):
        refuse_moment_without_mass(parameters, i, name)
        # Pose of the link in the previous one at q = 0.
        pose = robot.before[i].double() @ robot.after[i].double()
        body = etree.SubElement(body, "body", name=name, **_placed(pose))
        moments, turn = principal(parameters, i)
        etree.SubElement(
            body,
            "inertial",
            pos=text(parameters.com[i]),
            mass=number(parameters.mass[i]),
            quat=text(turn),
            diaginertia=text(moments),
        )
        etree.SubElement(body, "joint", **_joint(robot, i, joints[i]))
    etree.SubElement(body, "site", name="tool", **_placed(robot.tool.double()))
    actuators = etree.SubElement(root, "actuator")
    for name in robot.joint_names:
        etree.SubElement(actuators, "motor", name=name, joint=name)
    etree.indent(root)
    return XmlFile(root, DECLARATION)


def _placed(pose: Tensor) -> dict[str, str]:
    return {"pos": text(pose[:3, 3]), "quat": text(quaternion_of(pose[:3, :3]))}


def _joint(robot: Robot, i: int, values: JointDynamics) -> dict[str, str]:
    after = robot.after[i].double()
    prismatic = robot.joint_types[i] is JointType.PRISMATIC
    out: dict[str, Any] = {
        "name": robot.joint_names[i],
        "type": "slide" if prismatic else "hinge",
        # The joint frame's origin and z axis, in the link frame at q = 0.
        "pos": text(-after[:3, :3].T @ after[:3, 3]),
        "axis": text(after[2, :3]),
    }
    for key, limits in (("range", "position"), ("actuatorfrcrange", "torque")):
        known = getattr(robot.limits, limits)
        if known is not None and bool(torch.isfinite(known[i]).all()):
            out[key] = text(known[i])
    attributes = {**ATTRIBUTES, "springref": "rest"}
    sizes = {key: getattr(values, attribute) for key, attribute in attributes.items()}
    return out | {key: number(size) for key, size in sizes.items() if size}
