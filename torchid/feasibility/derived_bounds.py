"""Bounds of the physical parameters from a robot's own description: from its nominal parameters
(`--bounds from-robot`), or, where it has none, from the size of its links (`wide`, `none`).

Of nominal parameters, for link i with nominal mass m, centre of mass c and a box B of what it is
made of:

- mass: m (1 -+ mass_percent / 100);
- centre of mass: the box of the link's shapes where there is one, else c -+ com_margin;
- barycentric inertia: matter of mass at most m_max between a and b along an axis has a second
  moment about its own mean of at most m_max (b - a)^2 / 4, half of it at each end (Popoviciu's
  inequality), and products of inertia obey Cauchy and Schwarz. With l the sides of B,

      0 <= I_xx <= m_max (l_y^2 + l_z^2) / 4,    |I_xy| <= m_max l_x l_y / 4,    and so on,

  which no body in the box can break. Without shapes B holds the link's joints and c, with
  com_margin around;
- coefficients of the robot's effects: 0 to 10 times the nominal, both signs where physics allows
  both.

Without nominal parameters masses are above 0, B is what the link's matter can be in, the centre of
mass is in B, and inertias are as above:

- `wide`: mass up to 20 times that of a typical body (`typical_bodies`), and of nothing denser than
  the densest material; B is the box of the link's shapes with 5 cm around it, or the link's joints
  with its length around them;
- `none`: any body, up to a size that no link has, since searches and proofs need some: mass up to
  10 times that of a whole typical arm of this length; B reaches as far as the arm on all sides.

Both have no bounds for coefficients of effects.
"""

from collections.abc import Mapping

import torch

from torchid.effects.base import Coefficient
from torchid.effects.registry import nominal_columns
from torchid.errors import RobotError, TorchidError
from torchid.feasibility.bounds import Bounds, bounds_groups, read_bounds
from torchid.feasibility.plausibility import LEAD
from torchid.feasibility.sets import nominal_set
from torchid.robot.model import Robot
from torchid.robot.shapes import (
    LinkShapes,
    joint_points,
    link_lengths,
    link_shapes,
    reach,
    typical_bodies,
)
from torchid.typing import Float, Tensor

NAME = "from-robot"
"""Name of derived bounds, where groups of a robot's yaml have theirs."""
WIDE, NONE = "wide", "none"
"""Names of bounds that need no nominal parameters."""
WIDE_MASS, WIDE_MARGIN = 20.0, 0.05
MASS_PERCENT = 30.0
_THINNEST = 1e-3
"""Smallest side of a box [m]: a flat shape still has a thickness."""


def named_bounds(robot: Robot, name: str) -> Bounds:
    """A group of bounds of the robot's yaml, or derived ones: `from-robot`, `wide` or `none`. A
    group of the yaml that has such a name is meant by it.

    Raises:
        RobotError: see `read_bounds` and `derive_bounds`.
    """
    if name in (WIDE, NONE) and name not in bounds_groups(robot):
        return open_bounds(robot, wide=name == WIDE)
    return derive_bounds(robot) if name == NAME else read_bounds(robot, name)


def open_bounds(robot: Robot, *, wide: bool) -> Bounds:
    """Bounds `wide` or `none` (see the module), which read no nominal parameters.

    Raises:
        RobotError: the file of the shapes is no longer what the robot was read from.

    >>> from torchid import load_robot
    >>> open_bounds(load_robot("panda"), wide=True).mass.max() < 80
    tensor(True)
    """
    typical = typical_bodies(robot).mass
    if wide:
        length, ends = link_lengths(robot).view(-1, 1), joint_points(robot)
        box = torch.stack([ends.amin(1) - length, ends.amax(1) + length], -1)
        most, shapes = WIDE_MASS * typical, link_shapes(robot)
        if shapes is not None:
            known = torch.isfinite(shapes.boxes).all(-1).all(-1)
            grown = shapes.boxes + torch.tensor([-WIDE_MARGIN, WIDE_MARGIN], dtype=torch.float64)
            box = torch.where(known[:, None, None], grown, box)
            dense = LEAD * shapes.volumes
            most = torch.where(dense > typical, torch.minimum(most, dense), most)
    else:
        # 10.0: masses of any arm, over those that are typical of its size
        most = (10.0 * typical.sum()).expand(robot.n_links)
        far = reach(robot)
        box = torch.tensor([-far, far], dtype=torch.float64).expand(robot.n_links, 3, 2)
    masses = torch.stack([torch.zeros_like(most), most], -1)
    inertia = inertia_bounds(most, box[..., 1] - box[..., 0])
    return Bounds(WIDE if wide else NONE, masses, box, inertia, {})


def derive_bounds(
    robot: Robot,
    *,
    mass_percent: float = MASS_PERCENT,
    com_margin: float | None = None,
    shapes: LinkShapes | None = None,
) -> Bounds:
    """Bounds from a robot's nominal parameters, its shapes or link lengths, and its effects.

    Args:
        robot: with nominal inertial parameters.
        mass_percent: by how much masses may differ from nominal, up and down; lower bounds stop
            at 0.
        com_margin: where a link has no shape: by how much each coordinate of its centre of mass
            may differ from nominal [m]; half the link's length (`link_lengths`) if None.
        shapes: of the links; those of the file the robot was read from if None.

    Raises:
        RobotError: no nominal parameters, or a link whose nominal mass is not positive.
        TorchidError: a percentage or margin that is not positive.
    """
    parameters = robot.require_parameters("deriving bounds")
    for name, value in (("mass_percent", mass_percent), ("com_margin", com_margin)):
        if value is not None and not 0 < value < float("inf"):
            raise TorchidError(f"{name} must be a positive number.", got=value)
    mass, com = parameters.mass.double(), parameters.com.double()
    if not bool((mass > 0).all()):
        link = int((~(mass > 0)).nonzero()[0])
        raise RobotError(
            f"robot '{robot.name}': bounds cannot be derived from the nominal mass of link "
            f"{link + 1} ('{robot.link_names[link]}').",
            got=float(mass[link]),
            expected="a positive mass",
            hint="give `bounds` in the robot's yaml",
        )
    share = mass_percent / 100
    mass_bounds = torch.stack([mass * max(1 - share, 0.0), mass * (1 + share)], -1)
    margin = torch.full((robot.n_links, 1), com_margin or 0.0, dtype=torch.float64)
    if com_margin is None:
        # 0.5: default margin of the centres of mass, as a share of the link's length
        # (`link_lengths`)
        margin = 0.5 * link_lengths(robot).unsqueeze(-1)
    # Boxes of the shapes, none thinner than `_THINNEST`; nan where unknown.
    boxes = torch.full((robot.n_links, 3, 2), torch.nan, dtype=torch.float64)
    shapes = link_shapes(robot) if shapes is None else shapes
    if shapes is not None:
        low, high = shapes.boxes.unbind(-1)
        grow = ((_THINNEST - (high - low)) / 2).clamp(min=0)
        boxes = torch.stack([low - grow, high + grow], -1)
    known = torch.isfinite(boxes).all(-1).all(-1)[:, None, None]
    around = torch.stack([com - margin, com + margin], -1)
    # Where there is no shape: the link's joints and centre of mass, with a margin around.
    ends = torch.cat([joint_points(robot), com.unsqueeze(1)], 1)
    extent = torch.stack([ends.amin(1) - margin, ends.amax(1) + margin], -1)
    low, high = torch.where(known, boxes, extent).unbind(-1)
    return Bounds(
        NAME,
        mass_bounds,
        torch.where(known, boxes, around),
        inertia_bounds(mass_bounds[:, 1], high - low),
        _coefficient_bounds(robot),
    )


def inertia_bounds(
    mass: Float[Tensor, "*batch"], sides: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch 6 2"]:
    """Bounds (..., 6, 2) of the barycentric inertia [kg m^2] of any body of at most this mass
    (...) [kg] in a box with these sides (..., 3) [m], in the box's axes (see the module)."""
    x, y, z = sides.unbind(-1)
    zero = torch.zeros_like(x)
    upper = torch.stack([y * y + z * z, x * y, x * z, x * x + z * z, y * z, x * x + y * y], -1)
    lower = torch.stack([zero, -x * y, -x * z, zero, -y * z, zero], -1)
    return torch.stack([lower, upper], -1) * (mass / 4)[..., None, None]


def bounds_notes(robot: Robot, bounds: Bounds, shapes: LinkShapes | None = None) -> tuple[str, ...]:
    """What a person should know of derived bounds, one sentence each: where the boxes are from,
    and which nominal parameters lie outside.

    Args:
        robot: with nominal parameters.
        bounds: derived from it.
        shapes: as given to `derive_bounds`.
    """
    own = link_shapes(robot) if shapes is None else shapes
    known = (False,) * robot.n_links if own is None else own.known
    notes = [] if own is None else list(own.warnings)
    without = [str(i) for i, k in enumerate(known, start=1) if not k]
    if without:
        many = len(without) > 1
        notes.append(
            f"link{'s' * many} {', '.join(without)}: no shape, so {'their' if many else 'its'} "
            f"centre{'s' * many} of mass may differ from nominal by a margin"
        )
    sets = nominal_set(robot)
    p = sets.parameters
    values = torch.cat([p.com, p.inertia_about_com], -1)[0].double()
    limits = torch.cat([bounds.com, bounds.inertia], 1)
    outside = (values < limits[..., 0]) | (values > limits[..., 1])
    names = ("cx", "cy", "cz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
    lying = [f"{names[k][0]}{i + 1}{names[k][1:]}" for i, k in outside.nonzero().tolist()]
    coefficients = [(effect.joint, c.name) for effect in sets.effects for c in effect.coefficients]
    for (joint, name), value in zip(coefficients, sets.coefficients[0].tolist(), strict=True):
        low, high = bounds.coefficients[name][joint].tolist()
        lying += [] if low <= value <= high else [f"{name}{joint + 1}"]
    if lying:
        notes.append(f"the nominal {', '.join(lying)} lie outside the bounds derived from the rest")
    return tuple(notes)


def _coefficient_bounds(robot: Robot) -> Mapping[str, Tensor]:
    """(n, 2) for each coefficient of the robot's effects. A joint without the effect, or with a
    nominal 0, has the bounds of the joint where it is largest; 1 in its unit where all are 0."""
    nominal: dict[str, Tensor] = {}
    kinds: dict[str, Coefficient] = {}
    for effect, values in nominal_columns(robot):
        for c, value in zip(effect.coefficients, values, strict=True):
            sizes = nominal.setdefault(c.name, torch.zeros(robot.n, dtype=torch.float64))
            sizes[effect.joint] = abs(value)
            kinds[c.name] = c
    out = {}
    coefficient_factor = 10.0
    for name, sizes in nominal.items():
        largest = coefficient_factor * sizes.max() if bool(sizes.any()) else torch.ones_like(sizes)
        upper = torch.where(sizes > 0, coefficient_factor * sizes, largest)
        lower = torch.zeros_like(upper) if kinds[name].non_negative else -upper
        out[name] = torch.stack([lower, upper], -1)
    return out
