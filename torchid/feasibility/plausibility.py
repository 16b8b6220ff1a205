"""Whether a set of parameters looks like an arm: warnings beyond feasibility, never verdicts.

A feasible set belongs to *some* body. What follows asks whether that body could be a robot's link:

| what          | value                                         | suspicious                       |
|---------------|-----------------------------------------------|----------------------------------|
| density       | mass over the volume of the inertia ellipsoid | outside 100 .. 12000 kg/m^3      |
| shape_density | mass over the volume of the link's shapes     | outside 100 .. 12000 kg/m^3      |
| inertia_size  | spread of the matter along an axis            | more than the link's box allows  |
| gyration      | largest radius of gyration                    | over the arm's reach, below 1 mm |
| com_distance  | CoM to the link's box, or to its joints       | outside; over a link's length    |
| boundary      | degree of a condition                         | within 0.001 of 0                |
| bound         | a parameter on or outside its bound           | within 0.001 of the interval     |
| gravity_load  | torque that holds the arm, over the limit     | more than 1                      |
| copied        | principal inertias, the same for all links    | to 1e-6                          |
| own_*         | an <inertial> of the URDF before merging      | not a body's                     |
| units         | masses and lengths of the robot's file        | off by a power of ten            |

The inertia ellipsoid is the uniform one with the link's mass and inertia: its squared semi-axes are
5/m times the eigenvalues of S = tr(I)/2 E - I. Densities: steel has 7850, copper 8960 and lead
11340 kg/m^3, and nothing heavier is built into arms; light wood has 150 and only rigid foam has
less than 100. A hollow link is between them, since a shell's ellipsoid is at most 2.2 times the
shell's volume. Spread: matter with mean c between a and b has a variance of at most (b - c)(c - a)
(Bhatia and Davis 2000), so a larger one is impossible in that box, not only unusual.
"""

import math
from dataclasses import dataclass

import torch

from torchid.feasibility.bounds import Bounds
from torchid.feasibility.findings import (
    ROUNDING,
    Finding,
    add_boundaries,
    add_bounds,
    add_copies,
    add_gravity_loads,
    each,
)
from torchid.feasibility.margins import Feasibility, inertia_eigenvalues
from torchid.feasibility.sets import ParameterSets
from torchid.robot.inertia import InertialParameters, symmetric
from torchid.robot.model import Robot
from torchid.robot.shapes import LinkShapes, joint_points, link_lengths, reach
from torchid.typing import Float, Tensor

LEAD = 12000.0
"""Density that nothing an arm is built of has [kg/m^3]."""

DENSITIES = (100.0, LEAD)
"""Mean densities that a link of an arm may have [kg/m^3]."""
SMALLEST_GYRATION = 1e-3
"""Radius of gyration below which a link is a point [m]."""
_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Bodies:
    """Uniform ellipsoids with the mass and inertia of the links; nan where there is none.

    Attributes:
        semi_axes: (K, n, 3) ascending [m].
        density: (K, n) [kg/m^3]; infinite for a flat or point-like link.
        gyration: (K, n) largest radius of gyration about an axis through the CoM [m].
    """

    semi_axes: Float[Tensor, "K n 3"]
    density: Float[Tensor, "K n"]
    gyration: Float[Tensor, "K n"]


def bodies(parameters: InertialParameters) -> Bodies:
    """The equivalent ellipsoids of parameters (K, n, 10)."""
    mass = parameters.mass
    eigenvalues = inertia_eigenvalues(parameters)
    second = (eigenvalues.sum(-1, keepdim=True) / 2 - eigenvalues).flip(-1)
    size = second.abs().amax(-1, keepdim=True)
    # What is 0 but for rounding is a flat or point-like link, not an impossible one.
    second = torch.where(second.abs() <= ROUNDING * size, torch.zeros_like(second), second)
    body = (mass > 0) & (second >= 0).all(-1)
    per_mass = second / mass.unsqueeze(-1)
    semi_axes = torch.where(body.unsqueeze(-1), (5 * per_mass).sqrt(), torch.nan)
    volume = 4 / 3 * math.pi * semi_axes.prod(-1)
    gyration = torch.where(body, eigenvalues[..., 2].clamp(min=0).div(mass).sqrt(), torch.nan)
    return Bodies(semi_axes, mass / volume, gyration)


def plausibility(
    robot: Robot,
    sets: ParameterSets,
    feasibility: Feasibility,
    *,
    shapes: LinkShapes | None = None,
    bounds: Bounds | None = None,
    seed: int = 0,
) -> tuple[tuple[Finding, ...], ...]:
    """What is not plausible in each of K sets.

    Args:
        robot: whose joints, limits and gravity count.
        sets: K sets.
        feasibility: of the sets, for what is on a boundary.
        shapes: of the links; where unknown the distances of the joints are used.
        bounds: the sets were searched in; nothing is said of bounds if None.
        seed: of the poses in which the arm's weight is held.
    """
    found: list[list[Finding]] = [[] for _ in sets.ids]
    own = bodies(sets.parameters)
    _densities(found, own, sets.parameters.mass, shapes)
    _sizes(found, own, sets.parameters, robot, shapes)
    _gyrations(found, own, robot, shapes)
    _distances(found, sets.parameters, robot, shapes)
    add_boundaries(found, feasibility)
    if bounds is not None:
        add_bounds(found, sets, bounds)
    add_gravity_loads(found, sets.parameters, robot, seed)
    add_copies(found, sets.parameters)
    return tuple(tuple(one) for one in found)


def _densities(
    found: list[list[Finding]], own: Bodies, mass: Tensor, shapes: LinkShapes | None
) -> None:
    kinds = [("density", own.density, "its inertia is that of a body")]
    if shapes is not None:
        volumes = torch.where(shapes.volumes > 0, shapes.volumes, torch.nan)
        density = torch.where(mass > 0, mass / volumes, torch.nan)
        kinds.append(("shape_density", density, "its mass in the volume of its shapes is"))
    low, high = DENSITIES
    for what, density, words in kinds:
        for k, link in each((density < low) | (density > high)):
            value = float(density[k, link])
            said = f"link {link + 1}: {words} of {value:.3g} kg/m^3"
            limit, than = (low, "less than wood") if value < low else (high, "more than lead")
            found[k].append(Finding(link + 1, what, value, limit, f"{said}, {than}"))


def _sizes(
    found: list[list[Finding]],
    own: Bodies,
    parameters: InertialParameters,
    robot: Robot,
    shapes: LinkShapes | None,
) -> None:
    """Matter spread further than the link's box allows."""
    com = parameters.com
    boxes = torch.full((robot.n_links, 3, 2), torch.nan).to(com) if shapes is None else shapes.boxes
    below, above = com - boxes[..., 0], boxes[..., 1] - com
    half = (boxes[..., 1] - boxes[..., 0]) / 2
    inside = (below >= 0) & (above >= 0)
    allowed = torch.where(inside, below * above, half.square())
    j = symmetric(parameters.inertia_about_com)
    diagonal = j.diagonal(dim1=-2, dim2=-1)
    second = diagonal.sum(-1, keepdim=True) / 2 - diagonal
    spread = second / parameters.mass.unsqueeze(-1)
    over = (spread > allowed * (1 + ROUNDING)) & (parameters.mass > 0).unsqueeze(-1)
    for k, link, axis in each(over):
        value, limit = float(spread[k, link, axis].sqrt()), float(allowed[k, link, axis].sqrt())
        sentence = (
            f"link {link + 1}: its inertia spreads its matter {1e3 * value:.0f} mm (rms) along "
            f"{_AXES[axis]}; no body in its box spreads more than {1e3 * limit:.0f} mm"
        )
        found[k].append(Finding(link + 1, "inertia_size", value, limit, sentence))
    # Semi-axes of links without a known box that are longer than it is from the CoM to the further
    # of the link's joints and a link's length beyond.
    unknown = torch.isnan(boxes).any(-1).any(-1)
    away = (joint_points(robot).to(com) - com.unsqueeze(-2)).norm(dim=-1).amax(-1)
    expected = away + link_lengths(robot).to(com)
    longest = own.semi_axes[..., 2]
    for k, link in each(unknown & (longest > expected)):
        value, limit = float(longest[k, link]), float(expected[k, link])
        sentence = (
            f"link {link + 1}: the ellipsoid of its inertia reaches {1e3 * value:.0f} mm from its "
            f"centre of mass; going by its joints, the link ends within {1e3 * limit:.0f} mm"
        )
        found[k].append(Finding(link + 1, "inertia_size", value, limit, sentence))


def _gyrations(
    found: list[list[Finding]], own: Bodies, robot: Robot, shapes: LinkShapes | None
) -> None:
    """Radii over the arm's reach, or over the diagonal of its largest box where that is longer."""
    longest = reach(robot)
    if shapes is not None and any(shapes.known):
        diagonals = (shapes.boxes[..., 1] - shapes.boxes[..., 0]).norm(dim=-1).nan_to_num(0.0)
        longest = max(longest, float(diagonals.max()))
    for k, link in each((own.gyration > longest) | (own.gyration < SMALLEST_GYRATION)):
        value = float(own.gyration[k, link])
        large = value > longest
        said = f"more than the whole arm's length ({longest:.2g} m)" if large else "that of a point"
        sentence = f"link {link + 1}: its radius of gyration is {1e3 * value:.3g} mm, {said}"
        limit = longest if large else SMALLEST_GYRATION
        found[k].append(Finding(link + 1, "gyration", value, limit, sentence))


def _distances(
    found: list[list[Finding]],
    parameters: InertialParameters,
    robot: Robot,
    shapes: LinkShapes | None,
) -> None:
    """CoM outside the link's box; where there is none, further from the box of its two joints than
    the link is long."""
    com = parameters.com
    ends = joint_points(robot).to(com)
    limits = link_lengths(robot).to(com)
    known = torch.zeros(robot.n_links, dtype=torch.bool)
    boxes = torch.stack([ends.amin(1), ends.amax(1)], -1)
    if shapes is not None:
        known = torch.isfinite(shapes.boxes).all(-1).all(-1)
        boxes = torch.where(known[:, None, None], shapes.boxes, boxes)
        limits = torch.where(known, 0.0, limits)
    outside = torch.maximum(boxes[..., 0] - com, com - boxes[..., 1]).clamp(min=0)
    away = outside.norm(dim=-1)
    for k, link in each((away > limits + ROUNDING) & (parameters.mass > 0)):
        value, limit = float(away[k, link]), float(limits[link])
        of = "the box of its shapes" if bool(known[link]) else "its joints"
        sentence = f"link {link + 1}: its centre of mass is {1e3 * value:.3g} mm outside {of}"
        if limit:
            sentence = f"{sentence}, and the link is about {1e3 * limit:.0f} mm long"
        found[k].append(Finding(link + 1, "com_distance", value, limit, sentence))
