"""Findings about whole sets and arms: boundaries, bounds, weight against strength, copies, and the
<inertial> elements behind merged links (see `torchid.feasibility.plausibility`)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.dynamics.forward import gravity_torque
from torchid.feasibility.bounds import Bounds
from torchid.feasibility.margins import LINK_CONDITIONS, Feasibility, inertia_eigenvalues
from torchid.feasibility.sets import ParameterSets
from torchid.results.record import Real
from torchid.robot.inertia import InertialParameters, symmetric
from torchid.robot.model import Robot
from torchid.robot.shapes import OwnInertial
from torchid.typing import Tensor

ON_BOUNDARY = 1e-3
"""Degree, or share of an interval between bounds, that counts as on the boundary."""
SAME = 1e-6
"""Relative difference below which inertias are copies of one another."""
ROUNDING = 1e-9
_POSES = 256
_SETS = 64
"""Sets at a time whose weight is held."""


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
    found = []
    for own in inertials:
        wrong = None if own.alone else _not_a_body(own)
        if wrong is None:
            continue
        what, value, said = wrong
        link = None if own.moving_link is None else own.moving_link + 1
        where = "not part of a moving link" if link is None else f"merged into link {link}"
        sentence = f"the <inertial> of '{own.link}' ({where}) {said}"
        found.append(Finding(link, what, value, 0.0, sentence, own.link))
    return tuple(found)


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
    low, middle, high = eigenvalues
    return f" (by {100 * (high / (low + middle) - 1):.2g} %)" if low + middle > 0 else ""


def each(mask: Tensor) -> list[list[int]]:
    """Indices of what is true."""
    return mask.nonzero().tolist()


def add_boundaries(found: list[list[Finding]], feasibility: Feasibility) -> None:
    """Conditions whose degree is within `ON_BOUNDARY` of 0."""
    n, links = feasibility.degrees.shape[1], feasibility.degrees.flatten(1)
    total = feasibility.total_mass_degree.unsqueeze(-1)
    places = [(i + 1, f"link {i + 1}: ", name) for i in range(n) for name in LINK_CONDITIONS]
    for degrees, named in (
        (links, places),
        (total, [(None, "", "total mass")]),
        (feasibility.coefficient_degrees, [(None, "", c) for c in feasibility.coefficient_names]),
    ):
        for k, i in each(degrees.abs() < ON_BOUNDARY):
            (link, at, name), value = named[i], float(degrees[k, i])
            sentence = f"{at}the condition '{name}' is on its boundary (degree {value:.1e})"
            found[k].append(Finding(link, "boundary", value, ON_BOUNDARY, sentence))


def add_bounds(found: list[list[Finding]], sets: ParameterSets, bounds: Bounds) -> None:
    """Search variables on or outside their bounds."""
    values = sets.search_vector
    low, high = bounds.box(sets.effects).to(values).unbind(-1)
    share = (values - low) / (high - low)
    names = search_names(sets)
    n = sets.parameters.mass.shape[-1]
    for k, i in each((share < ON_BOUNDARY) | (share > 1 - ON_BOUNDARY)):
        value, place = float(values[k, i]), float(share[k, i])
        limit, side = (float(low[i]), "lower") if place < 0.5 else (float(high[i]), "upper")
        within = -ON_BOUNDARY <= place <= 1 + ON_BOUNDARY
        word = "on" if within else "outside"
        sentence = f"{names[i]} = {value:.4g} is {word} its {side} bound {limit:.4g}"
        # Masses, centres of mass, inertias: one, three and six a link.
        own = (i, (i - n) // 3, (i - 4 * n) // 6)[(i >= n) + (i >= 4 * n)]
        link = None if i >= 10 * n else own + 1
        found[k].append(Finding(link, "bound", value, limit, sentence))


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
    found: list[list[Finding]], parameters: InertialParameters, robot: Robot, seed: int
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
    share = torch.rand(_POSES, robot.n, generator=generator, dtype=torch.float64)
    q = span[:, 0] + share * (span[:, 1] - span[:, 0])
    strongest = limits.abs().amax(-1)
    for first in range(0, len(found), _SETS):
        pi = parameters.pi[first : first + _SETS].detach().cpu().double()
        torque = gravity_torque(robot, q.unsqueeze(1), InertialParameters(pi)).abs().amax(0)
        for k, joint in each((torque > strongest) & (strongest > 0)):
            needed, limit = float(torque[k, joint]), float(strongest[joint])
            sentence = (
                f"joint {joint + 1}: holding the arm's own weight takes up to {needed:.3g}, and "
                f"its limit is {limit:.3g}"
            )
            one = Finding(joint + 1, "gravity_load", needed / limit, 1.0, sentence)
            found[first + k].append(one)


def add_copies(found: list[list[Finding]], parameters: InertialParameters) -> None:
    """Principal inertias that are the same for all links."""
    values = inertia_eigenvalues(parameters)
    if values.shape[-2] < 2:
        return
    size = values.abs().amax(-1).amax(-1)
    apart = (values - values[..., :1, :]).abs().amax(-1).amax(-1)
    for (k,) in each(apart <= SAME * size):
        sentence = "all links have the same principal inertias: were they copied?"
        found[k].append(Finding(None, "copied", float(apart[k]), SAME * float(size[k]), sentence))
