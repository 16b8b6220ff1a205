"""Read a URDF by MuJoCo's parser (`torchid.robot.spec`).

What a model holds beyond rigid bodies and joints of one freedom is refused or told in `warnings`;
<visual>, <collision>, <gazebo>, <mujoco> and <transmission> are not looked at.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
from lxml import etree

from torchid.errors import RobotError
from torchid.robot.assemble import assemble
from torchid.robot.model import STANDARD_GRAVITY, Robot, free_name
from torchid.robot.spec import FAILURES, listening, spec_tree
from torchid.robot.tree import Base, Choice, Following, Tree, TreeJoint
from torchid.robot.xml_numbers import (
    EXPAND,
    attribute,
    child,
    numbers,
    optional_number,
    parse_xml,
)

_WORLD = "world"
_REFUSED = ("floating", "planar")
_REFUSED_AS = "joint '{}' is {}; only revolute, continuous and prismatic joints are known"
_LIMITS = {"position": ("lower", "upper"), "velocity": ("velocity",), "effort": ("effort",)}


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
    if root.find("link") is None:
        raise RobotError(f"{source}: the robot has no links.")
    written = [_written(element, source) for element in root.findall("joint")]
    links = [attribute(link, "name", source) for link in root.findall("link")]
    if _WORLD not in links and any(joint.parent == _WORLD for joint in written):
        links.append(_WORLD)
        root.append(root.makeelement("link", {"name": _WORLD}))
        warnings.append("its link 'world' is nowhere declared: taken for what the base stands on")
    for word, names in (("links", links), ("joints", [joint.name for joint in written])):
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise RobotError(f"{source}: two {word} have the same name.", got=twice[0])
    tree = Tree(dict.fromkeys(links), tuple(written), source)
    tree = _with_numbers(tree, [*root.findall("link"), *root.findall("joint")])
    tree.root()  # there is one
    warnings += [
        f"joint '{joint.name}' has negative {key} ({getattr(joint, key):g})"
        for joint in tree.joints
        for key in ("damping", "friction")
        if getattr(joint, key) < 0
    ]
    # A sentence on limits of 0, which exporters write when nothing was entered.
    zero = {
        what: [
            f"'{joint.get('name')}'"
            for joint in root.xpath("joint[limit and @type != 'fixed']")
            if {optional_number(joint.find("limit"), key, source, finite=False) for key in keys}
            - {None}
            == {0.0}
            and (what, joint.get("type")) != ("position", "continuous")
        ]
        for what, keys in _LIMITS.items()
    }
    listed = [f"{what} of {', '.join(names)}" for what, names in zero.items() if names]
    warnings += [f"limits of 0 are not used: {'; '.join(listed)}"] if listed else []
    return tree


def _written(element: Any, source: str) -> TreeJoint:
    """What MuJoCo does not keep of a <joint>: the names, the limit of its velocity, what it
    mimics."""
    name = attribute(element, "name", source)
    where = f"{source}: joint '{name}'"
    kind = attribute(element, "type", where)
    parent, carried = (
        attribute(child(element, tag, where), "link", where) for tag in ("parent", "child")
    )
    limit, mimic = element.find("limit"), element.find("mimic")
    most: dict[str, float | None] = {}
    for key in ("velocity", "effort") if limit is not None else ():
        most[key] = value = optional_number(limit, key, where, finite=False)
        if value and value < 0:
            raise RobotError(f"{where}: <limit {key}> is negative.", got=value)
    fastest = most.get("velocity")
    following = None
    if mimic is not None:
        ratio = optional_number(mimic, "multiplier", where)
        following = Following(
            attribute(mimic, "joint", where),
            1.0 if ratio is None else ratio,
            optional_number(mimic, "offset", where) or 0.0,
        )
    return TreeJoint(
        name,
        parent,
        carried,
        velocity=(-fastest, fastest) if fastest else None,
        refused=_REFUSED_AS.format(name, kind) if kind in _REFUSED else None,
        floating=kind == "floating",
        mimic=following,
    )


def _with_numbers(tree: Tree, elements: Sequence[Any]) -> Tree:
    """The tree with the numbers that MuJoCo reads of its links and joints, which are the
    elements."""
    place = {name: name for name in tree.links}
    if _WORLD in place:  # a body of this name MuJoCo has itself
        place[_WORLD] = free_name(_WORLD, set(place))
    read = spec_tree(_parsed(tree, elements, place), tree.source)
    numbers_of = {joint.child: joint for joint in read.joints}
    joints = []
    for joint in tree.joints:
        own = numbers_of[place[joint.child]]
        if own.motion is None:
            own = replace(joint, origin=own.origin, velocity=None, mimic=None)
        else:
            own = replace(own, parent=joint.parent, child=joint.child, velocity=joint.velocity)
            own = replace(own, mimic=joint.mimic)
        joints.append(own)
    return Tree({name: read.links[k] for name, k in place.items()}, tuple(joints), tree.source)


def _parsed(tree: Tree, elements: Sequence[Any], place: Mapping[str, str]) -> Any:
    """The spec of links, inertias and joints alone, links named as `place` says; each element is on
    a line of its own, which MuJoCo's errors tell."""
    bare, turned = etree.Element("robot", name="robot"), list[tuple[str, str, list[float]]]()
    parts: list[str | TreeJoint] = [*place.values(), *tree.joints]
    for element, part in zip(elements, parts, strict=True):
        where = f"{tree.source}: {element.tag} '{element.get('name')}'"
        if isinstance(part, TreeJoint):
            body, key = place.get(part.child, part.child), "quat"
            kind = "fixed" if part.refused else element.get("type").strip()
            own = etree.SubElement(bare, "joint", name=part.name, type=kind)
            etree.SubElement(own, "parent", link=place.get(part.parent, part.parent))
            etree.SubElement(own, "child", link=body)
            kept = ["origin"] + ["axis", "limit", "dynamics"] * (kind != "fixed")
        else:
            body, key, kept = part, "iquat", ["inertial"]
            own = etree.SubElement(bare, "link", name=part)
        own.extend(deepcopy(e) for tag in kept if (e := element.find(tag)) is not None)
        _refuse_words(own, where)
        for origin in own.xpath(".//origin[@quat_xyzw]"):  # which MuJoCo does not know
            turn = numbers(origin, "quat_xyzw", 4, where) or []
            if not any(turn):
                raise RobotError(f"{where}: <origin quat_xyzw> is zero.")
            turned.append((body, key, [turn[3], *turn[:3]]))
    for element in bare.iter():
        element.text, element.tail = None, "\n" if element.getparent() is bare else None
    listening()
    try:
        spec = mujoco.MjSpec.from_string(etree.tostring(bare, encoding="unicode"))
    except FAILURES as error:
        text = " ".join(str(error).removeprefix("XML Error: ").split())
        text = text.replace("URDF body not found", "links form a cycle")
        line = re.search(r" Element '(\w+)', line (\d+)", text)
        if line is None:
            raise RobotError(f"{tree.source}: {text}") from error
        there = elements[int(line[2]) - 1]
        raise RobotError(
            f"{tree.source}: {there.tag} '{there.get('name')}': <{line[1]}>: "
            f"{text[: line.start()]}."
        ) from error
    for body, key, turn in turned:
        setattr(spec.body(body), key, turn)
    return spec


def _refuse_words(element: Any, where: str) -> None:
    """Raise RobotError for a macro, or a number which MuJoCo would take for 0."""
    for part in element.iter():
        for key, value in part.attrib.items():
            what = f"{where}: <{part.tag} {key}>"
            if "${" in value or "$(" in value:
                raise RobotError(f"{what} holds a xacro macro.", got=value, hint=EXPAND)
            if "nan" in value.lower().split():
                raise RobotError(f"{what} is not finite.", got=repr(value))
