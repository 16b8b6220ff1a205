"""XML files of robots: parsed from bytes, and their numbers read as float64 or refused by name."""

import math
from pathlib import Path
from shlex import quote
from typing import Any

import torch
from lxml import etree
from torch import Tensor

from torchid.errors import LARGEST, RobotError
from torchid.robot.placement import pose, quaternion, roll_pitch_yaw

TENSOR = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Attributes of a URDF's <inertia>, in torchid's order."""
_XACRO = "ros.org/wiki/xacro"
EXPAND = "expand it: `xacro a.urdf.xacro > a.urdf`"


def parse_xml(path: Path) -> Any:
    """The root element of an XML file, without comments, its own default namespace removed.

    Raises:
        RobotError: the file cannot be read or is not XML.
    """
    root = parsed(content_of(path), path, remove_comments=True, remove_pis=True)
    namespace = etree.QName(root).namespace
    if namespace is not None:
        for element in root.iter(f"{{{namespace}}}*"):
            element.tag = etree.QName(element).localname
    return root


def content_of(path: Path) -> bytes:
    """An XML file's content, or a RobotError.

    In bytes, for an encoding declaration in a str is an error. Some exporters leave blank lines
    before the declaration, which every URDF reader forgives. Xacro of any name is refused: it is a
    program, which runs code, and reads files and the environment.
    """
    require_regular(path)
    try:
        content = path.read_bytes().lstrip()
    except OSError as error:
        raise RobotError(f"'{path}' cannot be read: {error.strerror or error}.") from error
    if (macro := _macro(content, path.suffix.lower() == ".xacro")) is not None:
        plain = path.with_name(f"{path.name.split('.')[0]}.urdf")
        plain = plain if plain != path else path.with_name(f"{path.stem}_expanded.urdf")
        raise RobotError(
            f"'{path}' is a xacro file: a program, which torchid does not run.",
            got=macro,
            expected="a URDF",
            hint=f"expand it where you trust it: xacro {quote(str(path))} > {quote(str(plain))}",
        )
    return content


def require_regular(path: Path) -> None:
    """Raise RobotError for a pipe, a device or a socket, whose content may have no end."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise RobotError(f"'{path}' is no regular file.", got="a pipe, a device or a socket")


def _macro(content: bytes, named: bool) -> str | None:
    """Xacro's first element, or a macro in a file that is named so; None where there is none, as
    in what xacro has expanded."""
    root = None
    if b"xacro:" in content:
        root = etree.fromstring(content, etree.XMLParser(recover=True, resolve_entities=False))
    for element in () if root is None else root.iter(tag=etree.Element):
        # A prefix that is not declared is left in the tag.
        space, _, name = element.tag.rpartition("}")
        if _XACRO in space or name.startswith("xacro:"):
            return f"<xacro:{name.removeprefix('xacro:')}> on line {element.sourceline}"
    return "macros" if named and (b"${" in content or b"$(" in content) else None


def parsed(data: bytes, path: Path, **options: bool) -> Any:
    """The root element of an XML file's content, or a RobotError; lxml's options say what is kept
    of it."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, **options)
    try:
        return etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        raise RobotError(f"'{path}' is not valid XML: {error.args[0]}.") from error


def attribute(element: Any, name: str, where: str) -> str:
    """A required attribute that is not empty, or a RobotError."""
    value = element.get(name)
    if value is None or not value.strip():
        raise RobotError(
            f"{where}: <{element.tag}> needs the attribute '{name}'.",
            got=dict(element.attrib) or "no attributes",
        )
    return str(value).strip()


def child(element: Any, tag: str, where: str) -> Any:
    """A required child element, or a RobotError."""
    element_below = element.find(tag)
    if element_below is None:
        raise RobotError(
            f"{where}: <{element.tag}> needs a <{tag}>.",
            got=[c.tag for c in element if isinstance(c.tag, str)],
        )
    return element_below


def numbers(
    element: Any, name: str, count: int, where: str, *, finite: bool = True
) -> list[float] | None:
    """The numbers of an attribute, or None where there is no such attribute.

    Args:
        element: an lxml element.
        name: the attribute.
        count: how many numbers there must be.
        where: names the file and the element in errors.
        finite: refuse infinities too (NaN always is refused).

    Raises:
        RobotError: not numbers, a wrong count, not finite, or an unexpanded macro.
    """
    text = element.get(name)
    if text is None:
        return None
    what = f"{where}: <{element.tag} {name}>"
    if "${" in text or "$(" in text:
        raise RobotError(f"{what} holds a xacro macro.", got=text, hint=EXPAND)
    try:
        values = [float(word) for word in text.split()]
    except ValueError as error:
        raise RobotError(f"{what} is not a number.", got=repr(text)) from error
    if len(values) != count:
        raise RobotError(f"{what}: wrong count.", got=repr(text), expected=f"{count} numbers")
    if any(math.isnan(v) or (finite and abs(v) >= LARGEST) for v in values):
        raise RobotError(f"{what} is not finite.", got=repr(text))
    return values


def optional_number(element: Any, name: str, where: str, *, finite: bool = True) -> float | None:
    """A number, or None where there is no such attribute (see `numbers`)."""
    values = numbers(element, name, 1, where, finite=finite)
    return None if values is None else values[0]


def number(element: Any, name: str, where: str) -> float:
    """A required number (see `numbers`)."""
    attribute(element, name, where)
    value = optional_number(element, name, where)
    assert value is not None
    return value


def inertial_values(inertial: Any, where: str) -> tuple[float, Tensor]:
    """Mass [kg] and inertia (6,) about the centre of mass [kg m^2] of a URDF's <inertial>, in its
    own axes."""
    mass = number(child(inertial, "mass", where), "value", where)
    element = child(inertial, "inertia", where)
    tensor = [number(element, key, where) for key in TENSOR]
    return mass, torch.tensor(tensor, dtype=torch.float64)


def origin(element: Any, where: str) -> Tensor:
    """(4, 4) pose of the <origin> in an element; the identity where there is none."""
    placement = element.find("origin")
    if placement is None:
        return pose()
    position = numbers(placement, "xyz", 3, where) or [0.0, 0.0, 0.0]
    xyzw = numbers(placement, "quat_xyzw", 4, where)
    if xyzw is not None:
        if not any(xyzw):
            raise RobotError(f"{where}: <origin quat_xyzw> is zero.", got=xyzw)
        return pose(quaternion([xyzw[3], *xyzw[:3]]), position)
    rpy = numbers(placement, "rpy", 3, where) or [0.0, 0.0, 0.0]
    return pose(roll_pitch_yaw(rpy), position)
