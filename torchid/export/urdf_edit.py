"""A copy of a URDF with other dynamics: <inertial> and <dynamics> are written, the rest stays."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchid.errors import TorchidError
from torchid.export.exact_text import number, text
from torchid.export.joint_dynamics import JointDynamics
from torchid.export.xml_tree import (
    XmlFile,
    child,
    child_or_new,
    children,
    comment,
    read_xml,
    relocated,
    replace,
)
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.robot.tree import choose_chain
from torchid.robot.urdf import urdf_tree
from torchid.robot.xml_numbers import parse_xml

TENSOR = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def edited_urdf(
    original: Path, tip: str | None, robot: Robot, joints: Sequence[JointDynamics], folder: Path
) -> XmlFile:
    """The original with the robot's parameters and the joints' damping and friction.

    The reader merges links behind fixed joints into the link that moves them, and the result's
    parameters are those of the whole. So the whole is written into that link, and the <inertial> of
    the merged ones is taken away, with a comment in its place: the total is exact, whereas shares
    of it are not in the result.

    Args:
        original: the user's file, which is only read.
        tip: as the robot was read with.
        robot: parameters in the frames of the original's links.
        joints: attributes of its n joints.
        folder: where the copy will lie, for relative references to meshes.
    """
    file = read_xml(original)
    chain = choose_chain(urdf_tree(parse_xml(original), str(original), []), tip)
    links = {node.get("name", "").strip(): node for node in children(file.root, "link")}
    by_name = {node.get("name", "").strip(): node for node in children(file.root, "joint")}
    parameters = robot.require_parameters("an export")
    for i, (group, joint) in enumerate(zip(chain.groups[1:], chain.joints, strict=True)):
        for name in [name for name in group.poses if name != group.link]:
            for inertial in children(links[name], "inertial"):
                mass = child(inertial, "mass")
                had = "" if mass is None else f" ({mass.get('value', '').strip()} kg)"
                said = comment(f"inertial{had} is part of that of link '{group.link}'")
                replace(inertial, said)
        _write_inertial(links[group.link], parameters, i, group.link)
        # <dynamics>, where it is there or needed.
        values, element = joints[i], by_name[joint.name]
        if child(element, "dynamics") is not None or values.damping or values.friction:
            node = child_or_new(element, "dynamics")
            node.set("damping", number(values.damping))
            node.set("friction", number(values.friction))
    if folder.resolve() != original.parent.resolve():
        for node in file.root.iter("{*}mesh", "{*}texture"):
            if node.get("filename"):
                node.set("filename", relocated(node.get("filename"), original.parent, folder))
    return file


def _write_inertial(link: Any, parameters: InertialParameters, i: int, name: str) -> None:
    """About the centre of mass, in axes parallel to the link frame's."""
    refuse_moment_without_mass(parameters, i, name)
    inertial = child_or_new(link, "inertial", first=True)
    place = child_or_new(inertial, "origin", first=True)
    place.attrib.pop("quat_xyzw", None)
    place.set("xyz", text(parameters.com[i]))
    place.set("rpy", "0 0 0")
    child_or_new(inertial, "mass").set("value", number(parameters.mass[i]))
    tensor = child_or_new(inertial, "inertia")
    for key, value in zip(TENSOR, parameters.inertia_about_com[i].tolist(), strict=True):
        tensor.set(key, number(value))


def refuse_moment_without_mass(parameters: InertialParameters, i: int, name: str) -> None:
    """Raise TorchidError for a first moment without a mass: it has no centre of mass to write."""
    if float(parameters.mass[i]) == 0 and bool(parameters.first_moment[i].any()):
        raise TorchidError(
            f"link '{name}' has a first moment and no mass: no centre of mass can be written.",
            got=parameters.first_moment[i].tolist(),
            hint="--to yaml and --to c write first moments as they are",
        )
