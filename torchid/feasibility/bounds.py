"""Bounds of the physical parameters: the groups of a robot's yaml (tables A.5, A.6)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch

from torchid.effects.base import JointEffect
from torchid.effects.registry import KINDS
from torchid.errors import RobotError
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor

COEFFICIENT_KEYS = {k.bounds_key: k.coefficients[0].name for k in KINDS.values() if k.bounds_key}
"""Keys of a group of bounds, beside mass, com and inertia: coefficients of effects."""

_NOT_GROUPS = ("geometry", "total_mass")


@dataclass(frozen=True, eq=False)
class Bounds:
    """Lower and upper bounds of a robot's parameters; the last axis is (lower, upper).

    Attributes:
        name: of the group.
        mass: (n, 2) [kg].
        com: (n, 3, 2) centre of mass in the link frame [m].
        inertia: (n, 6, 2) barycentric inertia, xx xy xz yy yz zz in link axes [kg m^2].
        coefficients: for each coefficient of an effect, e.g. Fv, (n, 2).
    """

    name: str
    mass: Float[Tensor, "n 2"]
    com: Float[Tensor, "n 3 2"]
    inertia: Float[Tensor, "n 6 2"]
    coefficients: Mapping[str, Tensor]

    def box(self, effects: Sequence[JointEffect] = ()) -> Float[Tensor, "D 2"]:
        """Bounds of the search variables: masses, centres of mass, barycentric inertias, then the
        effects' coefficients, link by link within each.

        Raises:
            RobotError: a coefficient without bounds.
        """
        rows = [self.mass, self.com.reshape(-1, 2), self.inertia.reshape(-1, 2)]
        for effect in effects:
            for c in effect.coefficients:
                if c.name not in self.coefficients:
                    key = next((k for k, v in COEFFICIENT_KEYS.items() if v == c.name), c.name)
                    raise RobotError(
                        f"the bounds '{self.name}' have none for {c.name} of {effect.name}.",
                        expected=f"{key}: [n numbers] in `lower` and `upper`",
                        available=list(self.coefficients) or ["(no effects)"],
                    )
                rows.append(self.coefficients[c.name][effect.joint].reshape(1, 2))
        return torch.cat(rows)


def bounds_groups(robot: Robot) -> list[str]:
    """Names of the groups of bounds in the robot's yaml."""
    return [name for name in robot.bounds if name not in _NOT_GROUPS]


def read_bounds(robot: Robot, group: str) -> Bounds:
    """A group of bounds of the robot's yaml.

    Raises:
        RobotError: no such group; mass, com or inertia missing; a wrong size; a value that is not
            a finite number; lower not below upper.
    """
    if group not in bounds_groups(robot):
        raise RobotError(
            f"robot '{robot.name}' has no bounds '{group}'.",
            available=[*bounds_groups(robot), "from-robot", "wide", "none"],
            hint='`bounds="from-robot"` derives them from its parameters and shapes, '
            '`bounds="wide"` from the size of its links',
        )
    data = robot.bounds[group]
    where = f"robot '{robot.name}': bounds {group}"
    sides = [data.get(side) for side in ("lower", "upper")] if isinstance(data, Mapping) else []
    if not sides or not all(isinstance(side, Mapping) for side in sides):
        raise RobotError(f"{where}: must have `lower` and `upper`, each with mass, com, inertia.")
    n = robot.n_links
    shapes = {"mass": (n,), "com": (n, 3), "inertia": (n, 6)}
    known = {key: (n,) for key in COEFFICIENT_KEYS if key in data["lower"] or key in data["upper"]}
    given = {key: _pair(data, key, shape, where) for key, shape in {**shapes, **known}.items()}
    coefficients = {COEFFICIENT_KEYS[key]: given[key] for key in known}
    return Bounds(group, given["mass"], given["com"], given["inertia"], coefficients)


def read_total_mass(robot: Robot) -> tuple[float, float] | None:
    """`total_mass: [lo, hi]` of the robot's bounds [kg], or None where nothing is known.

    Raises:
        RobotError: not two numbers in order.
    """
    data = robot.bounds.get("total_mass")
    if data is None:
        return None
    where = f"robot '{robot.name}': bounds total_mass"
    values = finite_tensor(data, (2,), where)
    if not values[0] < values[1]:
        raise RobotError(f"{where}: the lower bound is not below the upper.", got=data)
    return float(values[0]), float(values[1])


def _pair(data: Mapping[str, Any], key: str, shape: tuple[int, ...], where: str) -> Tensor:
    sides = []
    for side in ("lower", "upper"):
        if key not in data[side]:
            raise RobotError(f"{where}: `{side}` has no '{key}'.", available=list(data[side]))
        sides.append(finite_tensor(data[side][key], shape, f"{where}.{side}.{key}"))
    pair = torch.stack(sides, -1)
    wrong = ~(pair[..., 0] < pair[..., 1])
    if bool(wrong.any()):
        place = wrong.nonzero()[0].tolist()
        entry = pair[tuple(place)].tolist()
        problem = "equal" if entry[0] == entry[1] else "crossed"
        raise RobotError(
            f"{where}: {key} of link {place[0] + 1}: the bounds are {problem}.",
            got=entry,
            expected="lower < upper",
        )
    return pair


def finite_tensor(data: Any, shape: tuple[int, ...], where: str) -> Tensor:
    """Numbers of a yaml entry as a tensor of that shape.

    Raises:
        RobotError: not numbers, another shape, or values that are not finite.
    """
    try:
        values = torch.tensor(data, dtype=torch.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise RobotError(f"{where}: not numbers, or rows of unequal length.", got=data) from error
    if tuple(values.shape) != shape:
        raise RobotError(f"{where}: wrong size.", got=tuple(values.shape), expected=shape)
    if not torch.isfinite(values).all():
        raise RobotError(f"{where}: not all finite.", got=data)
    return values
