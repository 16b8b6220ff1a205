"""Whether masses, inertias, centres of mass and places of joints are in the units they should be.

Files with kg mm^2 for kg m^2, g for kg or mm for m hold bodies that are feasible, and a thousand
times too large or too dense. Two numbers of a link tell: its radius of gyration, about 0.3 of its
length, and its density, that of a body with its inertia, about 1000 kg/m^3. In makers' models of
arms, hands, legs and humanoids the medians are within a factor of 3 and of 6 of these. Wrong units
move both by powers of ten, and together they say which. What all links have in common shows in the
medians; a single link has to be one that no body can be, or nearly. An <inertial> that is merged
with others is looked at by itself. Links of the density of steel are told, too: an export of solid
parts. Makers' links that matter reach half of that.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.errors import RobotError
from torchid.feasibility.plausibility import (
    DENSITIES,
    Bodies,
    Finding,
    add_gravity_loads,
    bodies,
    each,
    outside_box,
    own_inertial_findings,
)
from torchid.results.words import listed
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.robot.shapes import (
    LinkShapes,
    joint_points,
    link_lengths,
    link_shapes,
    own_inertials,
)
from torchid.typing import Bool, Float, Tensor

UNITS = "units"
"""Kind of these findings, see `torchid.feasibility.plausibility`."""
_GYRATION, _DENSITY = 0.3, 1000.0
_SCATTER = (0.3, 0.6)
"""Standard deviations of their decimal logarithms in makers' models, roughly."""
_LIGHTEST = 50.0
"""Median density of links below which something is wrong [kg/m^3]: toy models have 60."""
_OUTSIDE, _FAR_OUTSIDE = 0.6, 3.0
"""Radius of gyration over the size of a link, of which it is half at most: that of a light body
with shapes, and of any."""
_ROOM = 1.05
"""The same, of a light body of which only the joints are known, and nearer than its end may be."""

_MISTAKES = {
    "inertias 10 times too large": (0.5, -1.5),
    "inertias 1000 times too large, as g m^2 for kg m^2 are": (1.5, -4.5),
    "inertias in kg cm^2 for kg m^2, 1e4 times too large": (2.0, -6.0),
    "inertias in kg mm^2 for kg m^2, 1e6 times too large": (3.0, -9.0),
    "inertias in g cm^2 for kg m^2, 1e7 times too large": (3.5, -10.5),
    "inertias in g mm^2 for kg m^2, 1e9 times too large": (4.5, -13.5),
    "inertias 10 times too small": (-0.5, 1.5),
    "inertias 1000 times too small": (-1.5, 4.5),
    "inertias 1e6 times too small": (-3.0, 9.0),
    "masses in g for kg": (-1.5, 7.5),
    "masses in g for kg, and inertias in g m^2": (0.0, 3.0),
    "masses in g for kg, and inertias in kg mm^2": (1.5, -1.5),
    "masses in g for kg, and inertias in g cm^2": (2.0, -3.0),
    "masses in g for kg, and inertias in g mm^2": (3.0, -6.0),
    "places of joints in mm for m": (-3.0, 0.0),
    "places of joints in cm for m": (-2.0, 0.0),
    "lengths in mm for m, and inertias in kg mm^2": (0.0, -9.0),
}
"""By which powers of ten a mistake moves the radius of gyration over the length, and density."""


def nominal_findings(robot: Robot) -> tuple[Finding, ...]:
    """What a robot's own file shows beside its merged links: units, and the <inertial> elements.

    Raises:
        RobotError: the file is no longer what the robot was read from.
    """
    return (*unit_findings(robot), *own_inertial_findings(own_inertials(robot)))


def unit_findings(robot: Robot) -> tuple[Finding, ...]:
    """What in a robot's nominal parameters looks like another unit, like a power of ten, or like
    solid metal.

    Links without mass, and points, are passed over. Shapes are read from the robot's file where a
    link looks too small for its matter.

    Raises:
        RobotError: the file is no longer what the robot was read from.
    """
    if robot.parameters is None or robot.floating:
        return ()
    merged = [one for one in own_inertials(robot) if not one.alone and one.moving_link is not None]
    place = [*range(robot.n_links), *(one.moving_link for one in merged)]
    names = [*robot.link_names, *(one.link for one in merged)]
    rows = [*robot.parameters.pi]
    for one in merged:
        j = one.inertia_about_com
        rows.append(InertialParameters.from_com(j.new_tensor(one.mass), j.new_zeros(3), j).pi)
    parameters = InertialParameters(torch.stack(rows))
    own, mass, total = bodies(parameters), parameters.mass, robot.parameters.mass.sum()
    whole = torch.arange(len(place)) < robot.n_links
    lengths = size = link_lengths(robot)[place]
    known = own.gyration > 0
    ball = mass / (4 / 3 * math.pi * (2.5**0.5 * own.gyration) ** 3)
    # 6.0: how many times denser flat and thin links may be than balls of their radii of gyration
    density = own.density.minimum(torch.maximum(6.0 * ball, own.density.clamp(max=_DENSITY)))
    at = torch.stack([own.gyration / size / _GYRATION, density / _DENSITY], -1).log10()
    common = _common(at, known & whole)
    away = torch.zeros_like(mass)
    away[whole] = outside_box(robot.parameters.com, joint_points(robot).transpose(-1, -2))
    # Of a link that is one of those, its parts are, too.
    rest = known if common is None else known & ~common[1][place]
    # Sizes of a link that its centre of mass may be beyond its joints and its shapes
    sizes_away = 5.0
    odd = rest & (own.gyration > _OUTSIDE * size) | (away > sizes_away * size)
    shapes = _read_shapes(robot) if bool(odd.any()) else None
    drawn = torch.zeros_like(known)
    if shapes is not None:
        sides = (shapes.boxes[..., 1] - shapes.boxes[..., 0]).norm(dim=-1).nan_to_num(0.0)[place]
        size = torch.maximum(size, sides)
        drawn = sides > 0
        inside = torch.where(
            drawn[whole], outside_box(robot.parameters.com, shapes.boxes), torch.inf
        )
        away[whole] = torch.minimum(away[whole], inside)
    strayed = (away > sizes_away * size) & (mass > 0)  # what is merged there makes inertias, too
    rest = rest & ~strayed[place]
    inertia = mass * own.gyration**2
    matters = (mass > 0.01 * total) | (inertia > 0.01 * inertia[whole].nan_to_num(0.0).amax())
    light = (density < torch.where(drawn, DENSITIES[0], _LIGHTEST)) & matters
    most = torch.where(light, torch.where(drawn, _OUTSIDE, _ROOM), _FAR_OUTSIDE)
    bad = rest & ((own.gyration > most * size) & (whole | matters) | (ball > DENSITIES[1]) & whole)
    # The sum of links that are merged says nothing beside the one that is wrong.
    parts = {place[k] for (k,) in each(bad & ~whole)}
    out = []
    if common is not None:
        words, links = common
        out.append(_finding(names, links, _as_bodies(own, links), f"they look like {words}"))
    usual = mass * (own.gyration / lengths / _GYRATION) ** 2
    alone: dict[str, Bool[Tensor, " K"]] = {}
    for (link,) in each(bad):
        if link not in parts:
            alone.setdefault(_nearest(at[link]), torch.zeros_like(known))[link] = True
    for words, links in alone.items():
        other = f"or like another mass: {_from_to(usual[links])} kg has this inertia"
        out.append(
            _finding(
                names, links, _as_bodies(own, links), f"they look like {words}, {other}", place
            )
        )
    if bool(strayed.any()):
        far = (away / size)[strayed]
        # The centre of a link is about a fifth of it from its joints, the farthest of them half.
        unit = "mm" if float(far.max()) > 150 or float(far.median()) > 70 else "cm"
        said = (
            f"centres of mass up to {float(away[strayed].max()):.3g} m beyond links of up to "
            f"{float(size[strayed].max()):.2g} m"
        )
        out.append(_finding(names, strayed, said, f"they look like {unit} for m"))
    return tuple(out or _too_heavy(robot, own, density))


def _too_heavy(robot: Robot, own: Bodies, density: Float[Tensor, " K"]) -> list[Finding]:
    """Links of the density of steel, most of them or one alone, and an arm that cannot hold itself.

    Args:
        robot: with its n links.
        own: they, and those merged in them.
        density: theirs, of thin links at most what balls may have (K,) [kg/m^3].
    """
    assert robot.parameters is not None
    mass, n = robot.parameters.mass, robot.n_links
    finite, density = own.density[:n] < torch.inf, density[:n]
    # Share of the moving mass that one link alone must have to be too heavy: motors are dense
    least_share = 0.1
    links = finite & (mass > least_share / 2 * mass.sum())
    # Density of links that hold housing, motor and gear, from which on they are too heavy [kg/m^3]
    solid = 4500.0
    if bool(links.any()) and float(density[links].quantile(0.5)) > solid:
        links &= own.density[:n] > solid
    else:
        links = finite & (mass > least_share * mass.sum()) & (density > solid)
    out = []
    if bool(links.any()):
        said = (
            f"{float(mass[links].sum()):.3g} of the {float(mass.sum()):.3g} kg that move, with "
            f"inertias of bodies of {_from_to(own.density[:n][links])} kg/m^3"
        )
        words = "nearly solid steel; compare their mass with the maker's"
        out.append(_finding(robot.link_names, links, said, words))
    loads: list[list[Finding]] = [[]]
    add_gravity_loads(loads, InertialParameters(robot.parameters.pi.unsqueeze(0)), robot, 0)
    for load in loads[0]:
        # 3.0: torque that holds the arm over the limit: arms whose springs bear their weight have
        # 1.7
        if load.value > 3.0:
            words = f"{load.sentence}: the masses, or the limit, may be wrong, or in another unit"
            out.append(replace(load, what=UNITS, sentence=words))
    return out


def shape_findings(robot: Robot, shapes: LinkShapes | None) -> tuple[Finding, ...]:
    """Shapes that are as much larger than the links as meshes in mm are, one sentence for all."""
    if shapes is None:
        return ()
    sides = (shapes.boxes[..., 1] - shapes.boxes[..., 0]).norm(dim=-1)
    # 100.0: size of a link's shapes over its length; makers' links have up to 14
    large = sides > 100.0 * link_lengths(robot)
    if not bool(large.any()):
        return ()
    said = f"shapes of up to {float(sides[large].max()):.3g} m"
    words = 'they look like meshes in mm: scale="0.001 0.001 0.001"'
    return (_finding(robot.link_names, large, said, words),)


def _common(
    at: Float[Tensor, "L 2"], known: Bool[Tensor, " L"]
) -> tuple[str, Bool[Tensor, " L"]] | None:
    """What the medians of the links show, and the links that share it; None where they are
    usual."""
    if int(known.sum()) < 2:
        return None
    middle = at[known].quantile(0.5, dim=0)
    low, high = (math.log10(x / _DENSITY) for x in (_LIGHTEST, DENSITIES[1]))
    # 1.4: decimal logarithm by which the median of radii of gyration over lengths may be off
    if low < float(middle[1]) < high and abs(float(middle[0])) < 1.4:
        return None
    return _nearest(middle), known & ((at - middle).norm(dim=-1) < at.norm(dim=-1))


def _nearest(at: Float[Tensor, "2"]) -> str:
    """The mistake that is nearest to a place, by what makers' links scatter by; two mistakes at
    once count as further."""
    scale = at.new_tensor(_SCATTER)

    def distance(words: str) -> float:
        away = float(((at - at.new_tensor(_MISTAKES[words])) / scale).norm())
        return away + 0.5 * ("and inertias" in words)

    return min(_MISTAKES, key=distance)


def _read_shapes(robot: Robot) -> LinkShapes | None:
    try:
        return link_shapes(robot)
    except RobotError:
        return None


def _as_bodies(own: Bodies, links: Bool[Tensor, " L"]) -> str:
    density, gyration = own.density[links], own.gyration[links]
    return (
        f"masses and inertias of bodies of {float(density.quantile(0.5)):.2g} kg/m^3, with radii "
        f"of gyration of up to {1e3 * float(gyration.max()):.3g} mm"
    )


def _from_to(values: Float[Tensor, " K"]) -> str:
    low, high = (f"{float(f'{float(x):.2g}'):g}" for x in values.aminmax())
    return low if low == high else f"{low} to {high}"


def _finding(
    names: Sequence[str],
    links: Bool[Tensor, " K"],
    said: str,
    words: str,
    place: Sequence[int] | None = None,
) -> Finding:
    """What is found of links by these names, each merged into the moving link of its `place`, or
    one itself."""
    numbers = [link for (link,) in each(links)]
    # 6: links that are named in a sentence
    who = listed((f"'{names[k]}'" for k in numbers), most=6)
    at = numbers if place is None else [place[k] for k in numbers]
    link = at[0] + 1 if len(numbers) == 1 else None
    return Finding(link, UNITS, len(numbers), 0.0, f"{who}: {said}: {words}")
