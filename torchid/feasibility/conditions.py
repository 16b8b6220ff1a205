"""What a set of parameters is asked to meet beside physics: where the links' matter can be.

Positive masses (2.22) and inertia tensors that a body can have (2.23)-(2.26) need no data. Boxes of
the centres of mass (2.27), cylinders and spheres of the links' shapes, and the total mass (2.31)
come from the robot's yaml:

    bounds:
      normal: {...}                      its `com` box is the links' geometry, unless said otherwise
      total_mass: [13, 18]
      geometry:
        cylinder_radius: [..], cylinder_length: [..]      one a link, about the box's long side
        cylinders: [{link: 1, axis: y, radius: 0.04, centre: [0, 0, 0]}]
        spheres: [{link: 7, radius: 0.1, centre: [0, 0, 0]}]
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch

from torchid.errors import RobotError
from torchid.feasibility.bounds import bounds_groups, finite_tensor, read_bounds
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

GEOMETRY_GROUP = "normal"
"""Group of bounds whose CoM boxes are the links' geometry: the report draws them so."""


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions on the centres of mass and on the total mass; what is unknown is infinite.

    Attributes:
        com_box: (n, 3, 2) lower and upper [m], in the link frames.
        round_centre: (n, 3) centre of each link's cylinder or sphere [m].
        round_axes: (n, 3) 1 for the axes in which the radius counts: two for a cylinder, three for
            a sphere.
        round_radius: (n,) [m].
        total_mass: (2,) [kg].
    """

    com_box: Float[Tensor, "n 3 2"]
    round_centre: Float[Tensor, "n 3"]
    round_axes: Float[Tensor, "n 3"]
    round_radius: Float[Tensor, " n"]
    total_mass: Float[Tensor, "2"]

    def to(self, device: torch.device | str) -> "Conditions":
        """These conditions on another device."""
        return Conditions(*(tensor.to(device) for tensor in vars(self).values()))


def physics_only(n: int) -> Conditions:
    """No condition on the centres of mass or on the total mass."""
    return Conditions(
        torch.tensor([-torch.inf, torch.inf], dtype=torch.float64).repeat(n, 3, 1),
        torch.zeros(n, 3, dtype=torch.float64),
        torch.zeros(n, 3, dtype=torch.float64),
        torch.full((n,), torch.inf, dtype=torch.float64),
        torch.tensor([-torch.inf, torch.inf], dtype=torch.float64),
    )


def conditions(
    robot: Robot,
    *,
    com_box: Float[Tensor, "n 3 2"] | None = None,
    shapes: bool = False,
    total_mass: tuple[float, float] | None = None,
) -> Conditions:
    """The conditions for a robot.

    Args:
        robot: whose `bounds` may hold groups, `geometry` and `total_mass`.
        com_box: boxes to use; those of the group `normal` if None, or none where there is no
            such group.
        shapes: whether the cylinders and spheres of `geometry` are checked too.
        total_mass: interval of the sum of the masses [kg]; not checked if None.

    Raises:
        RobotError: `shapes` for a robot without geometry, or a geometry that cannot be read; a
            total mass whose bounds are crossed.
    """
    none = physics_only(robot.n_links)
    if com_box is None and GEOMETRY_GROUP in bounds_groups(robot):
        com_box = read_bounds(robot, GEOMETRY_GROUP).com
    box = none.com_box if com_box is None else com_box
    if total_mass is not None and not total_mass[0] < total_mass[1]:
        raise RobotError("the interval of the total mass is empty.", got=list(total_mass))
    total = none.total_mass if total_mass is None else torch.tensor(total_mass, dtype=box.dtype)
    asked = replace(none, com_box=box, total_mass=total)
    if shapes:
        _add_round_shapes(robot, asked)
    return asked


def _add_round_shapes(robot: Robot, asked: Conditions) -> None:
    """Fill in the cylinders and spheres of the robot's yaml."""
    n, centre, axes, radius = (
        robot.n_links,
        asked.round_centre,
        asked.round_axes,
        asked.round_radius,
    )
    geometry = robot.bounds.get("geometry")
    where = f"robot '{robot.name}': bounds geometry"
    if not isinstance(geometry, Mapping):
        raise RobotError(
            f"robot '{robot.name}' has no shapes of its links.",
            expected="bounds: {geometry: {cylinders: [{link, axis, radius}], spheres: [...]}}",
        )
    if "cylinder_radius" in geometry:
        # By radius and length, about the axis in which the box is that long.
        tables = []
        for key in ("cylinder_radius", "cylinder_length"):
            values = finite_tensor(geometry.get(key), (n,), f"{where}.{key}")
            if not bool((values > 0).all()):
                raise RobotError(f"{where}: {key} must be positive.", got=geometry[key])
            tables.append(values)
        if not torch.isfinite(asked.com_box).all():
            raise RobotError(f"{where}: cylinders by length need the boxes of the centres of mass.")
        low, high = asked.com_box.unbind(-1)
        axes.fill_(1.0)
        axes[torch.arange(n), (high - low - tables[1].unsqueeze(-1)).abs().argmin(-1)] = 0.0
        centre.copy_(asked.com_box.mean(-1))
        radius.copy_(tables[0])
    for key, default in (("cylinders", None), ("spheres", "all")):
        entries = geometry.get(key, [])
        if not isinstance(entries, list):
            raise RobotError(f"{where}: {key} must be a list.", got=entries)
        for entry in entries:
            link, *shape = _entry(entry, default, n, where)
            axes[link], radius[link], centre[link] = shape


def _entry(
    entry: Any, default: str | None, n: int, where: str
) -> tuple[int, Tensor, Tensor, Tensor]:
    """Link (from 0), axes (3,) in which the radius counts, radius, centre (3,)."""
    expected = "{link: 1, axis: x|y|z (cylinders), radius: m, centre: [x, y, z]}"
    axis = entry.get("axis", default) if isinstance(entry, Mapping) else None
    known = ("x", "y", "z") if default is None else (default,)
    if axis not in known or "radius" not in entry or "link" not in entry:
        raise RobotError(f"{where}: not a cylinder or sphere.", got=entry, expected=expected)
    link = entry["link"]
    radius = finite_tensor(entry["radius"], (), f"{where}.radius")
    if not isinstance(link, int) or not 1 <= link <= n or not radius > 0:
        raise RobotError(f"{where}: no such link or no such radius.", got=entry, expected=expected)
    axes = torch.ones(3, dtype=torch.float64)
    if axis != "all":
        axes["xyz".index(str(axis))] = 0.0
    centre = finite_tensor(entry.get("centre", [0.0, 0.0, 0.0]), (3,), f"{where}.centre")
    return link - 1, axes, radius, centre
