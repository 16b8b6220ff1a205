"""Shapes of the links in a URDF, and its <inertial> elements as written.

A link's shapes are its <collision> elements; where it has none, or they cannot be read, its
<visual> ones. Links behind fixed joints move with the link before them, so their shapes are put
together in that link's frame, as `torchid.robot.assemble` puts their masses together.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from torchid.errors import RobotError
from torchid.robot.config_files import is_urdf
from torchid.robot.mesh_files import find_mesh, mesh_vertices
from torchid.robot.model import Robot
from torchid.robot.solids import LinkShapes, Solid, assembled, box, capsule, cylinder, points
from torchid.robot.tree import Tree, held
from torchid.robot.urdf import urdf_tree
from torchid.robot.xml_numbers import (
    attribute,
    child,
    inertial_values,
    number,
    numbers,
    origin,
    parse_xml,
)
from torchid.typing import Inertia6, Tensor

_TAGS = ("collision", "visual")
_GEOMETRIES = ("box", "cylinder", "capsule", "sphere", "mesh")
_BARE = "has mass and no shape."


@dataclass(frozen=True, eq=False)
class OwnInertial:
    """An <inertial> of a URDF as written, before links are merged.

    Attributes:
        link: name of the URDF's link.
        moving_link: index (from 0) of the robot's link it is part of; None for the base and for
            branches off the chain.
        alone: whether no other <inertial> is merged with it.
        mass: [kg].
        inertia_about_com: (6,) xx xy xz yy yz zz in its own axes [kg m^2].
    """

    link: str
    moving_link: int | None
    alone: bool
    mass: float
    inertia_about_com: Inertia6


@dataclass(frozen=True)
class _OwnShapes:
    """Solids of one URDF link, the element they are from, or why there are none."""

    solids: tuple[Solid, ...] = ()
    kind: str | None = None
    problem: str | None = None


def urdf_shapes(path: Path, robot: Robot) -> LinkShapes:
    """Shapes of a URDF's links. A shape that cannot be read is a warning, never an error.

    Boxes, cylinders, spheres and capsules are exact. A mesh (STL, OBJ) is the box of its corners.

    Args:
        path: the URDF.
        robot: what was read from it; its link names say which links move.

    Raises:
        RobotError: the file is not XML, or has not the robot's links.
    """
    root = parse_xml(path)
    tree, _ = held(urdf_tree(root, str(path), []), robot.locked)
    elements = dict(_named(root, str(path)))
    parts: list[tuple[list[Solid], str] | None] = []
    read: list[list[Solid]] = []
    problems: dict[str, str] = {}

    def shapes_of(link: str) -> dict[str, _OwnShapes]:
        return {
            name: _own_shapes(elements[name], placed, f"link '{name}'", path)
            for name, placed in _group(tree, link).items()
        }

    base_members = shapes_of(robot.root or tree.root())
    carried = set(base_members)
    for link in robot.link_names:
        members = shapes_of(link)
        carried |= set(members)
        solids = [solid for own in members.values() for solid in own.solids]
        kinds = dict.fromkeys(own.kind for own in members.values() if own.kind)
        troubles = {name: own.problem for name, own in members.items() if own.problem}
        parts.append((solids, " and ".join(kinds)) if solids and not troubles else None)
        read.append(solids)
        # A link of which nothing is drawn is no news; one of which a part is missing is.
        if solids or not all(problem.endswith(_BARE) for problem in troubles.values()):
            problems |= troubles
    still = base_members.values()
    unread = any(own.problem and not own.problem.endswith(_BARE) for own in still)
    base = None if unread else tuple(solid for own in still for solid in own.solids)
    return assembled(
        parts,
        _unknown(problems),
        solids=tuple(map(tuple, read)),
        base=base,
        left_out=tuple(name for name in tree.links if name not in carried),
    )


def own_inertials(robot: Robot) -> tuple[OwnInertial, ...]:
    """Every <inertial> of the URDF a robot was read from; empty for other robots.

    Those of links that are merged, of the base, and of branches off the chain are among them.

    Raises:
        RobotError: the file is no longer what the robot was read from.
    """
    path = Path(robot.source)
    if not is_urdf(path):
        return ()
    root = parse_xml(path)
    tree, _ = held(urdf_tree(root, str(path), []), robot.locked)
    elements = [(name, e.find("inertial")) for name, e in _named(root, str(path))]
    given = {name for name, inertial in elements if inertial is not None}
    groups = [set(_group(tree, link)) for link in robot.link_names]
    found = []
    for name, inertial in elements:
        if inertial is None:
            continue
        where = f"{path}: link '{name}'"
        moving = next((i for i, group in enumerate(groups) if name in group), None)
        alone = moving is not None and len(groups[moving] & given) == 1
        found.append(OwnInertial(name, moving, alone, *inertial_values(inertial, where)))
    return tuple(found)


def _named(root: Any, source: str) -> list[tuple[str, Any]]:
    return [(attribute(element, "name", source), element) for element in root.findall("link")]


def _group(tree: Tree, link: str) -> Mapping[str, Tensor]:
    """Poses (4, 4) in a moving link's frame of the links that move with it."""
    if link not in tree.links:
        raise RobotError(
            f"{tree.source}: has no link '{link}' of the robot.", available=list(tree.links)
        )
    return tree.group(link).poses


def _own_shapes(element: Any, placed: Tensor, where: str, path: Path) -> _OwnShapes:
    problem = None
    for tag in _TAGS:
        found = element.findall(tag)
        if not found:
            continue
        try:
            solids = tuple(_solid(shape, placed, where, path) for shape in found)
        except RobotError as error:
            problem = problem or error.problem
        else:
            return _OwnShapes(solids, tag)
    if problem is None and _weighs(element):
        problem = f"{where} {_BARE}"
    return _OwnShapes(problem=problem)


def _weighs(element: Any) -> bool:
    mass = element.find("inertial/mass")
    return mass is not None and float(mass.get("value", "0")) != 0


def _solid(shape: Any, placed: Tensor, where: str, path: Path) -> Solid:
    geometry = child(shape, "geometry", where)
    pose = placed @ origin(shape, where)
    found = next((e for tag in _GEOMETRIES if (e := geometry.find(tag)) is not None), None)
    if found is None:
        raise RobotError(f"{where}: <{shape.tag}> has a geometry that is not known.")
    if found.tag == "mesh":
        return points(pose, _corners(found, where, path))
    if found.tag == "box":
        attribute(found, "size", where)
        size = torch.tensor(numbers(found, "size", 3, where), dtype=torch.float64)
        if bool((size < 0).any()):
            raise RobotError(f"{where}: <box size> is negative.", got=size.tolist())
        return box(pose, size / 2)
    radius = _size(found, "radius", where)
    if found.tag == "sphere":
        return capsule(pose, radius, 0.0)
    length = _size(found, "length", where)
    return (cylinder if found.tag == "cylinder" else capsule)(pose, radius, length)


def _size(element: Any, key: str, where: str) -> float:
    value = number(element, key, where)
    if value < 0:
        raise RobotError(f"{where}: <{element.tag} {key}> is negative.", got=value)
    return value


def _corners(mesh: Any, where: str, path: Path) -> Tensor:
    """(V, 3) of a <mesh>, scaled [m]."""
    reference = attribute(mesh, "filename", where)
    file = find_mesh(reference, path)
    if file is None:
        raise RobotError(f"{where}: the mesh '{reference}' was not found.")
    scale = numbers(mesh, "scale", 3, where) or [1.0, 1.0, 1.0]
    return torch.as_tensor(mesh_vertices(file)) * torch.tensor(scale, dtype=torch.float64)


def _unknown(problems: Mapping[str, str]) -> tuple[str, ...]:
    """One sentence for all links whose shapes are unknown; there may be many, for one reason."""
    if not problems:
        return ()
    names = ", ".join(f"'{name}'" for name in problems)
    return (f"shapes of {names} are unknown: {next(iter(problems.values()))}",)
