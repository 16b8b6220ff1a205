"""Whether a set of parameters looks like an arm: warnings beyond feasibility, never verdicts.

A feasible set belongs to *some* body. What follows asks whether that body could be a robot's link:

| what          | value                                         | suspicious                       |
|---------------|-----------------------------------------------|----------------------------------|
| density       | mass over the volume of the inertia ellipsoid | outside 100 .. 12000 kg/m^3      |
| shape_density | mass over the volume of the link's shapes     | outside 100 .. 12000 kg/m^3      |
| inertia_size  | spread of the matter along an axis            | more than the link's box allows  |
| com_distance  | CoM to the link's box, or to its joints       | outside; over a link's length    |
| bound         | a parameter on or outside its bound           | within 0.001 of the interval     |
| gravity_load  | torque that holds the arm, over the limit     | more than 1                      |
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
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.dynamics.forward import gravity_torque
from torchid.feasibility.bounds import Bounds
from torchid.feasibility.margins import inertia_eigenvalues
from torchid.feasibility.sets import ParameterSets
from torchid.results.record import Real
from torchid.robot.inertia import InertialParameters, symmetric
from torchid.robot.model import Robot
from torchid.robot.shapes import LinkShapes, OwnInertial, joint_points, link_lengths
from torchid.typing import Float, Tensor

ROUNDING = 1e-9


@dataclass(frozen=True)
class Finding:
    """Something about a set that is not plausible.

    Attributes:
        link: number of the link (from 1), or None for the whole arm.
        what: kind, see `torchid.feasibility.plausibility`.
        value: what was found [kg/m^3, m, N m, -]; infinite where there is no end to it.
        threshold: what it was compared with, in the same unit.
        sentence: for people.
        name: of the URDF's link, for what was found in one.
    """

    link: int | None
    what: str
    value: Real
    threshold: Real
    sentence: str
    name: str | None = None


def own_inertial_findings(inertials: tuple[OwnInertial, ...]) -> tuple[Finding, ...]:
    """The <inertial> elements of a URDF that no body has and that a link's own check does not see:
    those merged with others, of the base, or off the chain. No mass and no inertia is none."""
    findings = []
    for own in inertials:
        wrong = None if own.alone else _not_a_body(own)
        if wrong is None:
            continue
        what, value, said = wrong
        link = None if own.moving_link is None else own.moving_link + 1
        where = "not part of a moving link" if link is None else f"merged into link {link}"
        sentence = f"the <inertial> of '{own.link}' ({where}) {said}"
        findings.append(Finding(link, what, value, 0.0, sentence, own.link))
    return tuple(findings)


def _not_a_body(own: OwnInertial) -> tuple[str, float, str] | None:
    """What, by how much, and in words: why no body has this mass and inertia."""
    if own.mass < 0:
        return "own_mass", own.mass, f"has a negative mass ({own.mass:.3g} kg)"
    values = torch.linalg.eigvalsh(symmetric(own.inertia_about_com))
    low, excess = float(values[0]), float(values[2] - values[0] - values[1])
    slack = ROUNDING * float(values.abs().max())
    if low < -slack:
        said = f"is not positive definite (eigenvalue {low:.3g} kg m^2)"
        return "own_eigenvalue", low, said
    if excess > slack:
        said = f"breaks the triangle inequality{by_percent(values.tolist())}"
        return "own_triangle", -excess / 2, said
    return None


def by_percent(eigenvalues: Sequence[float]) -> str:
    """By how much the largest of three principal inertias exceeds the sum of the others, in words;
    empty where that sum is not positive."""
    percent = excess_percent(eigenvalues)
    return "" if percent is None else f" (by {percent:.2g} %)"


def excess_percent(eigenvalues: Sequence[float]) -> float | None:
    """By how much the largest principal inertia exceeds the sum of the others [%]; negative where
    it does not, None where that sum is not positive."""
    low, middle, high = eigenvalues
    return 100 * (high / (low + middle) - 1) if low + middle > 0 else None


def outside_box(com: Float[Tensor, "*batch 3"], ends: Float[Tensor, "*#batch 3 K"]) -> Tensor:
    """By how much centres of mass are outside the boxes of points (...) [m]."""
    low, high = ends.amin(-1).to(com), ends.amax(-1).to(com)
    return torch.maximum(low - com, com - high).clamp(min=0).norm(dim=-1)


def each(mask: Tensor) -> list[list[int]]:
    """Indices of what is true."""
    return mask.nonzero().tolist()


def add_bounds(findings: list[list[Finding]], sets: ParameterSets, bounds: Bounds) -> None:
    """Search variables on or outside their bounds."""
    values = sets.search_vector
    low, high = bounds.box(sets.effects).to(values).unbind(-1)
    share = (values - low) / (high - low)
    names = search_names(sets)
    n = sets.parameters.mass.shape[-1]
    # Share of an interval between bounds that counts as on one of them
    on_boundary = 1e-3
    for k, i in each((share < on_boundary) | (share > 1 - on_boundary)):
        value, place = float(values[k, i]), float(share[k, i])
        limit, side = (float(low[i]), "lower") if place < 0.5 else (float(high[i]), "upper")
        within = -on_boundary <= place <= 1 + on_boundary
        word = "on" if within else "outside"
        sentence = f"{names[i]} = {value:.4g} is {word} its {side} bound {limit:.4g}"
        # Masses, centres of mass, inertias: one, three and six a link.
        own = (i, (i - n) // 3, (i - 4 * n) // 6)[(i >= n) + (i >= 4 * n)]
        link = None if i >= 10 * n else own + 1
        findings[k].append(Finding(link, "bound", value, limit, sentence))


def search_names(sets: ParameterSets) -> list[str]:
    """Names of the search variables in the order of `Bounds.box`: m1.., c1x.., I1xx.., Fv1.. ."""
    links = range(1, sets.parameters.mass.shape[-1] + 1)
    entries = ("xx", "xy", "xz", "yy", "yz", "zz")
    return [
        *(f"m{i}" for i in links),
        *(f"c{i}{axis}" for i in links for axis in "xyz"),
        *(f"I{i}{entry}" for i in links for entry in entries),
        *sets.coefficient_names(),
    ]


def add_gravity_loads(
    findings: list[list[Finding]], parameters: InertialParameters, robot: Robot, seed: int
) -> None:
    """Torque limits below what holds the arm's own weight in one of many random poses."""
    limits = robot.limits.torque
    if limits is None:
        return
    generator = torch.Generator().manual_seed(seed)
    span = torch.tensor([-math.pi, math.pi], dtype=torch.float64).repeat(robot.n, 1)
    if robot.limits.position is not None:
        known = torch.isfinite(robot.limits.position).all(-1, keepdim=True)
        span = torch.where(known, robot.limits.position, span)
    # 256: poses, drawn within the limits
    share = torch.rand(256, robot.n, generator=generator, dtype=torch.float64)
    q = span[:, 0] + share * (span[:, 1] - span[:, 0])
    strongest = limits.abs().amax(-1)
    # Sets at a time whose weight is held
    at_once = 64
    for first in range(0, len(findings), at_once):
        pi = parameters.pi[first : first + at_once].detach().cpu().double()
        torque = gravity_torque(robot, q.unsqueeze(1), InertialParameters(pi)).abs().amax(0)
        for k, joint in each((torque > strongest) & (strongest > 0)):
            needed, limit = float(torque[k, joint]), float(strongest[joint])
            sentence = (
                f"joint {joint + 1}: holding the arm's own weight takes up to {needed:.3g}, and "
                f"its limit is {limit:.3g}"
            )
            one = Finding(joint + 1, "gravity_load", needed / limit, 1.0, sentence)
            findings[first + k].append(one)


LEAD = 12000.0
"""Density that nothing an arm is built of has [kg/m^3]."""

DENSITIES = (100.0, LEAD)
"""Mean densities that a link of an arm may have [kg/m^3]."""
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
    *,
    shapes: LinkShapes | None = None,
    bounds: Bounds | None = None,
    seed: int = 0,
) -> tuple[tuple[Finding, ...], ...]:
    """What is not plausible in each of K sets.

    Args:
        robot: whose joints, limits and gravity count.
        sets: K sets.
        shapes: of the links; where unknown the distances of the joints are used.
        bounds: the sets were searched in; nothing is said of bounds if None.
        seed: of the poses in which the arm's weight is held.
    """
    findings: list[list[Finding]] = [[] for _ in sets.ids]
    own = bodies(sets.parameters)
    _densities(findings, own, sets.parameters.mass, shapes)
    _sizes(findings, own, sets.parameters, robot, shapes)
    _distances(findings, sets.parameters, robot, shapes)
    if bounds is not None:
        add_bounds(findings, sets, bounds)
    add_gravity_loads(findings, sets.parameters, robot, seed)
    return tuple(tuple(one) for one in findings)


def _densities(
    findings: list[list[Finding]], own: Bodies, mass: Tensor, shapes: LinkShapes | None
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
            findings[k].append(Finding(link + 1, what, value, limit, f"{said}, {than}"))


def _sizes(
    findings: list[list[Finding]],
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
        findings[k].append(Finding(link + 1, "inertia_size", value, limit, sentence))
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
        findings[k].append(Finding(link + 1, "inertia_size", value, limit, sentence))


def _distances(
    findings: list[list[Finding]],
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
    away = outside_box(com, boxes)
    for k, link in each((away > limits + ROUNDING) & (parameters.mass > 0)):
        value, limit = float(away[k, link]), float(limits[link])
        of = "the box of its shapes" if bool(known[link]) else "its joints"
        sentence = f"link {link + 1}: its centre of mass is {1e3 * value:.3g} mm outside {of}"
        if limit:
            sentence = f"{sentence}, and the link is about {1e3 * limit:.0f} mm long"
        findings[k].append(Finding(link + 1, "com_distance", value, limit, sentence))
