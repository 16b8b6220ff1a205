"""Where the matter of each link can be: boxes of the shapes in a URDF or MJCF, and, for a robot
without shapes, the lengths of its links.

A link's shapes are its <collision> elements; where it has none, or they cannot be read, its
<visual> ones. Links behind fixed joints move with the link before them, so their shapes are put
together in that link's frame, as `torchid.robot.assemble` puts their masses together. A box is
known only if all shapes of all those links are: part of a link would say nothing about where its
centre of mass can be.
"""

import math
from pathlib import Path

import torch

from torchid.robot.config_files import is_urdf
from torchid.robot.inertia import InertialParameters, six
from torchid.robot.mjcf_shapes import mjcf_shapes
from torchid.robot.model import JointType, Robot
from torchid.robot.solids import LinkShapes
from torchid.robot.urdf_shapes import OwnInertial, own_inertials, urdf_shapes
from torchid.typing import Float, Tensor

__all__ = [
    "SHORTEST",
    "LinkShapes",
    "OwnInertial",
    "joint_points",
    "link_lengths",
    "link_shapes",
    "own_inertials",
    "reach",
    "typical_bodies",
]

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
        return mjcf_shapes(path, robot)
    return None


def joint_points(robot: Robot) -> Float[Tensor, "L 2 3"]:
    """Origins (L, 2, 3) of each link's own joint and of the furthest joint that it carries (of the
    tip for a last link), in the link's frame [m]."""
    own = torch.linalg.inv(robot.after)[:, :3, 3]
    return torch.stack([own, next_origins(robot)], 1)


def next_origins(robot: Robot) -> Float[Tensor, "L 3"]:
    """Of the joints that each link carries the origin of the furthest from its own, in its frame
    [m]; of the tip for a link that carries none."""
    own = torch.linalg.inv(robot.after)[:, :3, 3]
    tips = {tip.link: tip.pose[:3, 3] for tip in robot.ends}
    out = []
    for link in range(robot.n_links):
        found = [robot.before[k, :3, 3] for k, above in enumerate(robot.parents) if above == link]
        found = found or [tips[link]]
        away = torch.stack([(point - own[link]).norm() for point in found])
        out.append(found[int(away.argmax())])
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
    return longest + _slides(robot)


def _slides(robot: Robot) -> float:
    limits = robot.limits.position
    if limits is None:
        return 0.0
    slides = torch.tensor([kind is JointType.PRISMATIC for kind in robot.joint_types])
    furthest = limits.abs().amax(-1)
    return float(furthest[slides & torch.isfinite(furthest)].sum())
