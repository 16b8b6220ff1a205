"""Read a URDF: lxml for the file, float64 for the numbers.

What a model holds beyond rigid bodies and joints of one freedom is refused or told in `warnings`;
<visual>, <collision>, <gazebo>, <mujoco> and <transmission> are not looked at.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from torchid.errors import RobotError
from torchid.robot.assemble import assemble
from torchid.robot.inertia import InertialParameters, move
from torchid.robot.model import STANDARD_GRAVITY, JointType, Robot
from torchid.robot.tree import Base, Choice, Following, Interval, Tree, TreeJoint
from torchid.robot.xml_numbers import (
    attribute,
    child,
    inertial_values,
    numbers,
    optional_number,
    origin,
    parse_xml,
    unit_axis,
)

_MOTIONS = {
    "revolute": JointType.REVOLUTE,
    "continuous": JointType.REVOLUTE,
    "prismatic": JointType.PRISMATIC,
    "fixed": None,
}
_REFUSED = ("floating", "planar")
_REFUSED_AS = "joint '{}' is {}; only revolute, continuous and prismatic joints are known"
_RANGE = ("lower", "upper")
_LIMITS = {"position": _RANGE, "velocity": ("velocity",), "effort": ("effort",)}


def read_urdf(
    path: Path,
    *,
    tip: str | None = None,
    root: str | None = None,
    lock: Mapping[str, float] | None = None,
    base: Base = "fixed",
) -> Robot:
    """Read the robot of a URDF: the tree that its root link carries, or a part of it.

    Link frames are the URDF's child link frames. Links behind fixed joints are merged into the
    link that moves them; those fixed to the root belong to the base. `tool` and `tips` are the
    poses of the last links. Limits that only some joints have are infinite for the others.
    <dynamics> becomes `effects` viscous_friction and coulomb_friction; gravity is (0, 0, -9.81) in
    the root frame. A base that floats is taken as fixed, with a warning.

    Args:
        path: the file.
        tip: last link of a chain, which alone is read; movable branches off it are left out, with
            a warning.
        root: link that is the base of what is read.
        lock: joints that are held, and where [rad or m].
        base: whether the base is held, or moves: one that floats in the file is then the base.

    Raises:
        RobotError: a file that cannot be read, xacro or MJCF in it, a structure that is not a
            tree, a joint that is not revolute, continuous, prismatic or fixed, one that mimics a
            joint which is not there, a value that is not a number, an unknown link or joint.
    """
    path = Path(path)
    source = str(path)
    document = parse_xml(path)
    if document.tag != "robot":
        hint = None
        if document.tag == "mujoco":
            hint = "this is MJCF: give it the suffix .xml"
        elif document.tag == "sdf":
            hint = "this is SDF: convert it to URDF"
        raise RobotError(
            f"{source}: not a URDF.", got=f"<{document.tag}>", expected="<robot>", hint=hint
        )
    warnings: list[str] = []
    return assemble(
        urdf_tree(document, source, warnings),
        Choice(tip, root, dict(lock or {}), base),
        name=(document.get("name") or path.stem).strip(),
        gravity=STANDARD_GRAVITY,
        path=path,
        warnings=warnings,
    )


def urdf_tree(root: Any, source: str, warnings: list[str]) -> Tree:
    """Links and joints of a parsed URDF; what is odd about them is added to `warnings`.

    Raises:
        RobotError: see `read_urdf`.
    """
    links: dict[str, Tensor | None] = {}
    for element in root.findall("link"):
        name = attribute(element, "name", source)
        if name in links:
            raise RobotError(f"{source}: two links have the same name.", got=name)
        links[name] = _inertial(element, f"{source}: link '{name}'")
    joints: dict[str, TreeJoint] = {}
    for element in root.findall("joint"):
        joint = _joint(element, source, warnings)
        if joint.name in joints:
            raise RobotError(f"{source}: two joints have the same name.", got=joint.name)
        joints[joint.name] = joint
    if not links:
        raise RobotError(f"{source}: the robot has no links.")
    if "world" not in links and any(joint.parent == "world" for joint in joints.values()):
        links["world"] = None
        root.append(root.makeelement("link", {"name": "world"}))
        warnings.append("its link 'world' is nowhere declared: taken for what the base stands on")
    # A sentence on limits of 0, which exporters write when nothing was entered.
    limited = [
        (joint, limit)
        for joint in root.findall("joint")
        if joint.get("type") != "fixed" and (limit := joint.find("limit")) is not None
    ]
    found = {
        what: [
            f"'{joint.get('name')}'"
            for joint, limit in limited
            if {optional_number(limit, key, "", finite=False) for key in keys} - {None} == {0.0}
            and (what, joint.get("type")) != ("position", "continuous")
        ]
        for what, keys in _LIMITS.items()
    }
    said = [f"{what} of {', '.join(names)}" for what, names in found.items() if names]
    warnings += [f"limits of 0 are not used: {'; '.join(said)}"] if said else []
    return Tree(links, tuple(joints.values()), source)


def _inertial(link: Any, where: str) -> Tensor | None:
    """(10,) parameters in the link frame, or None."""
    inertial = link.find("inertial")
    if inertial is None:
        return None
    mass, tensor = inertial_values(inertial, where)
    # In the axes of the inertial frame and about its origin, the centre of mass.
    own = InertialParameters.from_com(tensor.new_tensor(mass), tensor.new_zeros(3), tensor)
    return move(own.pi, origin(inertial, where))


def _joint(element: Any, source: str, warnings: list[str]) -> TreeJoint:
    name = attribute(element, "name", source)
    where = f"{source}: joint '{name}'"
    kind = attribute(element, "type", where)
    if kind not in _MOTIONS and kind not in _REFUSED:
        raise RobotError(
            f"{where}: unknown joint type.", got=kind, available=[*_MOTIONS, *_REFUSED]
        )
    motion = _MOTIONS.get(kind)
    parent = attribute(child(element, "parent", where), "link", where)
    carried = attribute(child(element, "child", where), "link", where)
    if kind == "fixed":
        return TreeJoint(name, parent, carried, origin=origin(element, where))
    axis = element.find("axis")
    direction = None if axis is None else numbers(axis, "xyz", 3, where)
    position, velocity, torque = _limits(element, kind, where)
    # Damping and friction, 0 where not given.
    dynamics = element.find("dynamics")
    losses = dict.fromkeys(("damping", "friction"), 0.0)
    for key in losses if dynamics is not None else ():
        losses[key] = value = optional_number(dynamics, key, where) or 0.0
        if value < 0:
            warnings.append(f"joint '{name}' has negative {key} ({value:g})")
    return TreeJoint(
        name,
        parent,
        carried,
        motion,
        origin(element, where),
        unit_axis(direction or [1.0, 0.0, 0.0], where),
        position=position,
        velocity=velocity,
        torque=torque,
        damping=losses["damping"],
        friction=losses["friction"],
        refused=_REFUSED_AS.format(name, kind) if kind in _REFUSED else None,
        floating=kind == "floating",
        mimic=_following(element, where),
    )


def _following(element: Any, where: str) -> Following | None:
    """Of a <mimic>, whose ratio and offset are 1 and 0 where not given."""
    mimic = element.find("mimic")
    if mimic is None:
        return None
    ratio = optional_number(mimic, "multiplier", where)
    return Following(
        attribute(mimic, "joint", where),
        1.0 if ratio is None else ratio,
        optional_number(mimic, "offset", where) or 0.0,
    )


def _limits(
    element: Any, kind: str, where: str
) -> tuple[Interval | None, Interval | None, Interval | None]:
    """Position, velocity and torque limits; None where not given, or 0 (see `_unknown_limits`)."""
    limit = element.find("limit")
    if limit is None:
        return None, None, None
    velocity = _symmetric(limit, "velocity", where)
    torque = _symmetric(limit, "effort", where)
    if kind == "continuous":
        return None, velocity, torque
    # URDF's default for one that is missing is 0.
    low, high = (optional_number(limit, key, where, finite=False) or 0.0 for key in _RANGE)
    if low == high == 0.0:
        return None, velocity, torque
    if low >= high:
        raise RobotError(f"{where}: the lower limit is not below the upper.", got=[low, high])
    return (low, high), velocity, torque


def _symmetric(limit: Any, key: str, where: str) -> Interval | None:
    value = optional_number(limit, key, where, finite=False)
    if not value:
        return None
    if value < 0:
        raise RobotError(f"{where}: <limit {key}> is negative.", got=value)
    return (-value, value)
