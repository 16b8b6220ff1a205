"""Where the matter of each link can be: boxes of the shapes in a URDF or MJCF, and, for a robot
without shapes, the lengths of its links.

A link's shapes are its <collision> elements; where it has none, or they cannot be read, its
<visual> ones. Links behind fixed joints move with the link before them, so their shapes are put
together in that link's frame, as `torchid.robot.assemble` puts their masses together. A box is
known only if all shapes of all those links are: part of a link would say nothing about where its
centre of mass can be.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from torchid.errors import RobotError
from torchid.robot.config_files import is_urdf
from torchid.robot.inertia import InertialParameters, six
from torchid.robot.model import JointType, Robot
from torchid.robot.solids import (
    LinkShapes,
    Solid,
    assembled,
    box,
    capsule,
    cylinder,
    find_mesh,
    mesh_vertices,
    points,
)
from torchid.robot.tree import Tree, with_joints_held
from torchid.robot.xml_numbers import (
    attribute,
    child,
    inertial_values,
    number,
    numbers,
    origin,
    parse_xml,
)
from torchid.typing import Float, Inertia6, Tensor

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
    tree, elements = _tree_of(path, robot)
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
    # One sentence for all links whose shapes are unknown; there may be many, for one reason.
    names = ", ".join(f"'{name}'" for name in problems)
    said = tuple(f"shapes of {names} are unknown: {why}" for why in [*problems.values()][:1])
    return assembled(
        parts,
        said,
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
    tree, elements = _tree_of(path, robot)
    inertials = {name: e.find("inertial") for name, e in elements.items()}
    given = {name: inertial for name, inertial in inertials.items() if inertial is not None}
    groups = [set(_group(tree, link)) for link in robot.link_names]
    own = []
    for name, inertial in given.items():
        where = f"{path}: link '{name}'"
        moving = next((i for i, group in enumerate(groups) if name in group), None)
        alone = moving is not None and len(groups[moving] & given.keys()) == 1
        own.append(OwnInertial(name, moving, alone, *inertial_values(inertial, where)))
    return tuple(own)


def _tree_of(path: Path, robot: Robot) -> tuple[Tree, dict[str, Any]]:
    """A URDF's tree with the robot's joints held, and its <link> elements by name."""
    from torchid.robot.urdf import urdf_tree  # MuJoCo's import takes .15 s

    root, source = parse_xml(path), str(path)
    tree, _ = with_joints_held(urdf_tree(root, source, []), robot.locked)
    return tree, {attribute(link, "name", source): link for link in root.findall("link")}


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
        elements = element.findall(tag)
        if not elements:
            continue
        try:
            solids = tuple(_solid(shape, placed, where, path) for shape in elements)
        except RobotError as error:
            problem = problem or error.problem
        else:
            return _OwnShapes(solids, tag)
    mass = element.find("inertial/mass")
    if problem is None and mass is not None and float(mass.get("value", "0")) != 0:
        problem = f"{where} {_BARE}"
    return _OwnShapes(problem=problem)


def _solid(shape: Any, placed: Tensor, where: str, path: Path) -> Solid:
    geometry = child(shape, "geometry", where)
    pose = placed @ origin(shape, where)
    solid = next((e for tag in _GEOMETRIES if (e := geometry.find(tag)) is not None), None)
    if solid is None:
        raise RobotError(f"{where}: <{shape.tag}> has a geometry that is not known.")
    if solid.tag == "mesh":
        return points(pose, _corners(solid, where, path))
    if solid.tag == "box":
        attribute(solid, "size", where)
        size = torch.tensor(numbers(solid, "size", 3, where), dtype=torch.float64)
        if bool((size < 0).any()):
            raise RobotError(f"{where}: <box size> is negative.", got=size.tolist())
        return box(pose, size / 2)
    radius = _size(solid, "radius", where)
    if solid.tag == "sphere":
        return capsule(pose, radius, 0.0)
    length = _size(solid, "length", where)
    return (cylinder if solid.tag == "cylinder" else capsule)(pose, radius, length)


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


SHORTEST = 0.1
"""Length that every link is given at least [m]: a joint's housing."""

PER_METRE = 10.0
"""Typical mass of a link of which nothing but the joints is known [kg/m]: arms that carry 3 to 12
kg have 10 to 14 by their makers' files (LWR IV+, UR10e, xMate7 Pro, Baxter), small ones 1 to 3."""

TYPICAL_DENSITY = 1000.0
"""Typical mass of a link over the volume of its shapes [kg/m^3]: a housing of aluminium that is
partly empty, with motors and gears of steel in it."""


def link_shapes(robot: Robot) -> LinkShapes | None:
    """Shapes of the file a robot was read from, or None where such a file has none (yaml).

    Raises:
        RobotError: the file is no longer what the robot was read from.
    """
    path = Path(robot.source)
    if is_urdf(path):
        return urdf_shapes(path, robot)
    if path.suffix.lower() == ".xml":
        from torchid.robot.mjcf_shapes import mjcf_shapes

        return mjcf_shapes(path, robot)
    return None


def joint_points(robot: Robot) -> Float[Tensor, "L 2 3"]:
    """Origins (L, 2, 3) of each link's own joint and of the furthest joint that it carries (of the
    tip for a last link), in the link's frame [m]."""
    own = torch.linalg.inv(robot.after)[:, :3, 3]
    return torch.stack([own, next_origins(robot)], 1)


def next_origins(robot: Robot) -> Float[Tensor, "L 3"]:
    """Origin (L, 3) of the furthest joint that each link carries, in the link's frame [m]; of the
    tip for a link that carries none."""
    own = torch.linalg.inv(robot.after)[:, :3, 3]
    tips = {tip.link: tip.pose[:3, 3] for tip in robot.ends}
    out = []
    for link in range(robot.n_links):
        origins = [robot.before[k, :3, 3] for k, above in enumerate(robot.parents) if above == link]
        origins = origins or [tips[link]]
        away = torch.stack([(point - own[link]).norm() for point in origins])
        out.append(origins[int(away.argmax())])
    return torch.stack(out)


def link_lengths(robot: Robot) -> Float[Tensor, " L"]:
    """Lengths (L,) of the links [m]: from joint to next joint, and at least the mean of them.

    Joints that meet in a point, as in a wrist, are no distance apart though a link is between
    them: such a link is taken as long as the robot's links are on average, and none as shorter
    than `SHORTEST`.
    """
    ends = joint_points(robot)
    lengths = (ends[:, 1] - ends[:, 0]).norm(dim=-1)
    return torch.clamp(torch.maximum(lengths, lengths.mean()), min=SHORTEST)


def typical_bodies(robot: Robot) -> InertialParameters:
    """What the links of a robot without inertial parameters may weigh (L, 10).

    A link with shapes is spread evenly over their box, with `TYPICAL_DENSITY` times their volume.
    Another is a round bar with round ends from joint to joint, `PER_METRE` times its length
    (`link_lengths`) heavy, and as thick as that density makes it: 11 cm.

    Raises:
        RobotError: the file of the shapes is no longer what the robot was read from.
    """
    ends = joint_points(robot)
    mass, com = PER_METRE * link_lengths(robot), ends.mean(1)
    # Second moments per mass: d^2 / 12 along the bar, and r^2 / 4 on all sides.
    along = ends[:, 1] - ends[:, 0]
    across = torch.eye(3, dtype=torch.float64) * PER_METRE / (4 * math.pi * TYPICAL_DENSITY)
    second = along.unsqueeze(2) * along.unsqueeze(1) / 12 + across
    shapes = link_shapes(robot)
    if shapes is not None:
        sides = shapes.boxes[..., 1] - shapes.boxes[..., 0]
        known = torch.isfinite(sides).all(-1) & (sides > 0).all(-1) & (shapes.volumes > 0)
        mass = torch.where(known, TYPICAL_DENSITY * shapes.volumes, mass)
        com = torch.where(known.unsqueeze(1), shapes.boxes.mean(-1), com)
        boxed = torch.diag_embed(sides.square() / 12)
        second = torch.where(known[:, None, None], boxed, second)
    about = second.diagonal(dim1=1, dim2=2).sum(1)[:, None, None] * torch.eye(3).double() - second
    return InertialParameters.from_com(mass, com, mass.unsqueeze(1) * six(about))


def reach(robot: Robot) -> float:
    """Length of the longest branch [m]: each link at least `SHORTEST`, each prismatic joint drawn
    out as far as its limits say. No link is larger."""
    ends = joint_points(robot)
    lengths = (ends[:, 1] - ends[:, 0]).norm(dim=-1).clamp(SHORTEST)
    branches = [list(robot.ancestors(tip.link)) for tip in robot.ends]
    longest = max(
        float(robot.before[line[0], :3, 3].norm()) + float(lengths[line].sum()) for line in branches
    )
    limits = robot.limits.position
    if limits is None:
        return longest
    slides = torch.tensor([kind is JointType.PRISMATIC for kind in robot.joint_types])
    furthest = limits.abs().amax(-1)
    return longest + float(furthest[slides & torch.isfinite(furthest)].sum())
