"""MJCF: a copy of a file with other dynamics, in which <inertial> and <joint> are written and the
rest stays; or, where there is no file to edit, a new one.

Files that the original includes are put in their places, because bodies may be in them.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from lxml import etree

from torchid.digits import number
from torchid.errors import TorchidError
from torchid.export.urdf import refuse_moment_without_mass
from torchid.export.xml_tree import (
    DECLARATION,
    XmlFile,
    child_or_new,
    children,
    comment,
    local,
    new_child,
    principal_axes,
    quaternion_of,
    read_xml,
    relocated_path,
    text,
)
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Robot
from torchid.robot.xml_numbers import content_of, parsed
from torchid.simulators.joint_dynamics import JointDynamics, dynamics_of_links
from torchid.typing import Tensor

_JOINTS = ("joint", "freejoint")
_UNNAMED = re.compile(r"body_(\d+)_*")
SHARP = "0.9999 0.9999 0.001"
"""solimpfriction of joints with dry friction. By MuJoCo's own, which gives way in proportion to
the inertia, a light wrist has its friction only at speeds that it hardly reaches."""
_DEGREES = 57.29577951308232
_POSES = ("quat", "axisangle", "euler", "xyaxes", "zaxis", "fullinertia", "diaginertia")
_OVERRIDES = ("boundmass", "boundinertia", "balanceinertia", "settotalmass")
"""Settings by which the compiler changes the masses and inertias that a file gives."""


def edited_mjcf(
    original: Path, robot: Robot, joints: Sequence[JointDynamics], gravity: bool, folder: Path
) -> XmlFile:
    """The original with the robot's parameters and its joints' attributes.

    The whole of bodies that move as one is written into the one with the joint; those without
    joints get an explicit <inertial> of no mass, since without one MuJoCo would take their shapes'.

    Args:
        original: the user's file, which is only read.
        robot: parameters in the frames of the original's bodies, and gravity.
        joints: attributes of its n joints.
        gravity: whether the robot's gravity is written too.
        folder: where the copy will lie, for relative references to meshes.

    Raises:
        TorchidError: a body of the chain that is not written out in the file, or parameters of a
            massless link between two joints of one body.
    """
    file = read_xml(original)
    # The content of included files in the place of each <include>.
    while (found := next(file.root.iter("{*}include"), None)) is not None:
        path = original.parent / (found.get("file") or "")
        content = parsed(content_of(path), path, strip_cdata=False)
        parent, tail = found.getparent(), found.tail
        nodes = [comment(f"content of {found.get('file')}"), *content]
        at = parent.index(found)
        parent.remove(found)
        for k, node in enumerate(nodes):
            parent.insert(at + k, node)
            node.tail = node.tail if k and (node.tail or "").strip() == "" else tail
        nodes[-1].tail = tail
    angles = []
    for compiler in children(file.root, "compiler"):
        # Without what would change the masses and inertias that are written.
        for name in _OVERRIDES:
            compiler.attrib.pop(name, None)
        if compiler.get("inertiafromgeom") == "true":
            compiler.set("inertiafromgeom", "auto")
        angles += [compiler.get("angle")] if compiler.get("angle") else []
    degrees = not angles or angles[-1] == "degree"
    if robot.locked:
        raise TorchidError(
            "joints that are held have no place in an MJCF.",
            got=", ".join(robot.locked),
            hint="the formats urdf and yaml take them",
        )
    _write_chain(Bodies(file.root, str(original)), robot, joints, degrees)
    if gravity:
        child_or_new(file.root, "option", first=True).set("gravity", text(robot.gravity))
    if folder.resolve() != original.parent.resolve():
        _relocate(file.root, original.parent, folder)
    return file


def attributes_of(joint: JointDynamics) -> dict[str, tuple[float, ...]]:
    """Numbers of the attributes of a <joint>."""
    curve = (joint.quadratic, joint.cubic)
    return {
        "damping": (joint.damping, *(curve if any(curve) else ())),
        "frictionloss": (joint.friction,),
        "armature": (joint.armature,),
        "stiffness": (joint.stiffness,),
    } | ({"springref": (joint.rest,)} if joint.stiffness else {})


def _write_chain(
    bodies: "Bodies", robot: Robot, joints: Sequence[JointDynamics], degrees: bool
) -> None:
    """Inertials and joints of the chain; a body with several joints is several links."""
    parameters = robot.require_parameters("an export")
    dynamics = dynamics_of_links(robot, joints)
    waiting: list[int] = []
    for i, name in enumerate(robot.link_names):
        waiting.append(i)
        body = bodies.find(name)
        if body is None:
            if bool(parameters.pi[i].any()):
                raise TorchidError(
                    f"'{name}' lies between two joints of one body, where MJCF has no place for "
                    "its mass.",
                    got=parameters.pi[i].tolist(),
                    hint="the format urdf writes a new file with a link there",
                )
            continue
        body.attrib.pop("gravcomp", None)
        body.attrib.update(_gravcomp(robot, i))
        node = _inertial_of(body)
        for key, value in _inertial(parameters, i, name).items():
            # Axes parallel to the body's are what MuJoCo takes without being told.
            if key != "quat" or not value.startswith("1.0 "):
                node.set(key, value)
        for fixed in _fixed_below(body):
            _write_massless(fixed, name)
        own = [node for node in _members(body) if local(node) in _JOINTS]
        if len(own) != len(waiting):
            raise bodies.not_written(name)
        for node, k in zip(own, waiting, strict=True):
            # All of them, so that defaults of a class do not count.
            turns = degrees and robot.drives[k].joint_type is JointType.REVOLUTE
            for key, values in attributes_of(dynamics[k]).items():
                unit = _DEGREES if turns and key == "springref" else 1.0
                node.set(key, text(unit * x for x in values))
            if dynamics[k].friction:
                node.set("solimpfriction", SHARP)
        waiting = []
    if waiting:
        raise bodies.not_written(robot.link_names[-1])


class Bodies:
    """The <body> elements of a file, by name or by their order."""

    def __init__(self, root: Any, source: str):
        self.source = source
        worlds = children(root, "worldbody")
        self.all = [b for world in worlds for b in world.iter("{*}body")]
        self.named = {b.get("name"): b for b in self.all if b.get("name")}

    def find(self, link: str) -> Any | None:
        """The element of a link; None for a link between two joints of one body."""
        if link in self.named:
            return self.named[link]
        unnamed = _UNNAMED.fullmatch(link)
        if unnamed is not None and int(unnamed[1]) <= len(self.all):
            found = self.all[int(unnamed[1]) - 1]
            return None if found.get("name") else found
        if "/" in link:
            return None
        raise self.not_written(link)

    def not_written(self, link: str) -> TorchidError:
        """A body that MuJoCo makes and the file does not spell out."""
        return TorchidError(
            f"{self.source}: the body '{link}' and its joints are not written out in it.",
            expected="<body> elements; <attach>, <replicate> and <composite> make others",
            available=list(self.named),
            hint="without the original, a new file is written: `robot=...`, the robot's yaml",
        )


def _members(body: Any) -> list[Any]:
    """What belongs to a body: its children, and those of its <frame>s."""
    out = []
    for node in body:
        out += _members(node) if local(node) == "frame" else [node]
    return out


def _fixed_below(body: Any) -> list[Any]:
    """Bodies without joints that move with a body."""
    out = []
    for node in _members(body):
        if local(node) == "body" and not any(local(n) in _JOINTS for n in _members(node)):
            out += [node, *_fixed_below(node)]
    return out


def _inertial(parameters: InertialParameters, i: int, name: str) -> dict[str, str]:
    """Attributes of a link's <inertial>, about its centre of mass in its principal axes."""
    refuse_moment_without_mass(parameters, i, name)
    moments, turn = principal_axes(parameters, i)
    return {
        "pos": text(parameters.com[i]),
        "mass": number(parameters.mass[i]),
        "quat": text(turn),
        "diaginertia": text(moments),
    }


def _write_massless(body: Any, moved_by: str) -> None:
    node = _inertial_of(body)
    said = comment(f"its inertial is part of that of body '{moved_by}'")
    before = node.getprevious()
    if before is None or before.text != said.text:  # of an earlier export
        node.addprevious(said)
        said.tail = body.text if (body.text or "").strip() == "" else None
    node.set("pos", "0 0 0")
    node.set("mass", "0")
    node.set("diaginertia", "0 0 0")


def _inertial_of(body: Any) -> Any:
    """The body's <inertial>, without its inertia; a new one where it has none."""
    node = child_or_new(body, "inertial", first=True)
    for key in (*_POSES, "pos", "mass"):
        node.attrib.pop(key, None)
    return node


def _relocate(root: Any, old: Path, new: Path) -> None:
    """Folders of assets as seen from the copy's folder."""
    assets = [n for n in root.iter() if local(n) in ("mesh", "hfield", "skin", "texture", "model")]
    if not any(key.startswith("file") for node in assets for key in node.attrib):
        return
    compilers = children(root, "compiler")
    compiler = compilers[-1] if compilers else new_child(root, "compiler", first=True)
    keys = ("assetdir", "meshdir", "texturedir")
    given = {k: node.attrib.pop(k) for node in compilers for k in keys if k in node.attrib}
    for key in ("meshdir", "texturedir"):
        place = given.get(key, given.get("assetdir", "."))
        compiler.set(key, relocated_path(place or ".", old, new))
    for node in assets:
        if local(node) == "model" and node.get("file"):
            node.set("file", relocated_path(node.get("file"), old, new))


def new_mjcf(robot: Robot, joints: Sequence[JointDynamics]) -> XmlFile:
    """An MJCF of the robot: one body a link, a motor a joint, the site `tool`, or one a tip; an
    equality where a joint follows another.

    Body frames are the robot's link frames, so a joint has the anchor and the axis that it has in
    them.

    Args:
        robot: with parameters.
        joints: attributes of its n joints.
    """
    root = etree.Element("mujoco", model=robot.name)
    etree.SubElement(root, "compiler", angle="radian", autolimits="true")
    etree.SubElement(root, "option", gravity=text(robot.gravity))
    world = etree.SubElement(root, "worldbody")
    parameters = robot.require_parameters("an export")
    own = dynamics_of_links(robot, joints)
    bodies: list[Any] = []
    for i, name in enumerate(robot.link_names):
        # Pose of the link in the one that carries it, its joint at 0.
        pose = robot.before[i].double() @ robot.after[i].double()
        above = robot.parents[i]
        body = etree.SubElement(
            world if above < 0 else bodies[above], "body", name=name, **_placed(pose),
            **_gravcomp(robot, i),
        )  # fmt: skip
        etree.SubElement(body, "inertial", **_inertial(parameters, i, name))
        etree.SubElement(body, "joint", **_joint(robot, i, own[i]))
        bodies.append(body)
    for end in robot.ends:
        site = etree.SubElement(bodies[end.link], "site", name=end.name if robot.tips else "tool")
        site.attrib.update(_placed(end.pose.double()))
    equalities = etree.SubElement(root, "equality") if robot.mimics else None
    for mimic in robot.mimics:
        etree.SubElement(
            equalities,
            "joint",
            joint1=mimic.joint,
            joint2=robot.joint_names[mimic.coordinate],
            polycoef=f"{number(mimic.offset)} {number(mimic.ratio)} 0 0 0",
        )
    actuators = etree.SubElement(root, "actuator")
    for name in robot.joint_names:
        etree.SubElement(actuators, "motor", name=name, joint=name)
    etree.indent(root)
    return XmlFile(root, DECLARATION)


def _gravcomp(robot: Robot, i: int) -> dict[str, str]:
    """The attribute of a link's body: the share of its weight that servos do not feel, nearest in
    first moments and mass."""
    if robot.compensated is None or not bool(robot.compensated[i].any()):
        return {}
    own = robot.require_parameters("gravity compensation").pi[i, :4]
    return {"gravcomp": number(robot.compensated[i] @ own / (own @ own).clamp(min=1e-300))}


def _placed(pose: Tensor) -> dict[str, str]:
    return {"pos": text(pose[:3, 3]), "quat": text(quaternion_of(pose[:3, :3]))}


def _joint(robot: Robot, i: int, values: JointDynamics) -> dict[str, str]:
    after, drive = robot.after[i].double(), robot.drives[i]
    prismatic = drive.joint_type is JointType.PRISMATIC
    out: dict[str, Any] = {
        "name": drive.joint,
        "type": "slide" if prismatic else "hinge",
        # The joint frame's origin and z axis, in the link frame at q = 0.
        "pos": text(-after[:3, :3].T @ after[:3, 3]),
        "axis": text(after[2, :3]),
    }
    for key, limits in (("range", "position"), ("actuatorfrcrange", "torque")):
        # Limits are those of coordinates.
        known = None if drive in robot.mimics else getattr(robot.limits, limits)
        if known is not None and bool(torch.isfinite(known[drive.coordinate]).all()):
            out[key] = text(known[drive.coordinate])
    if values.friction:
        out["solimpfriction"] = SHARP
    return out | {key: text(sizes) for key, sizes in attributes_of(values).items() if any(sizes)}
