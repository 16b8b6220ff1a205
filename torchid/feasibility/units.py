"""Whether masses, inertias, centres of mass and places of joints are in the units they should be.

Files with kg mm^2 for kg m^2, g for kg or mm for m hold bodies that are feasible, and a thousand
times too large or too dense. Two numbers of a link tell: its radius of gyration, about 0.3 of its
length, and its density, that of a body with its inertia, about 1000 kg/m^3. In makers' models of
arms, hands, legs and humanoids the medians are within a factor of 3 and of 6 of these. Wrong units
move both by powers of ten, and together they say which. What all links have in common shows in the
medians; a single link has to be one that no body can be, or nearly.
"""

import math
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
_FLAT = 6.0
"""How many times denser flat and thin links may be than balls of their radii of gyration."""
_APART = 1.4
"""Decimal logarithm by which the median of radii of gyration over lengths may be off."""
_OUTSIDE, _FAR_OUTSIDE = 0.6, 3.0
"""Radius of gyration over the size of a link, of which it is half at most: that of a light body
with shapes, and of any."""
_ROOM = 1.05
"""The same, of a light body of which only the joints are known, and nearer than its end may be."""
_AWAY = 5.0
"""Sizes of a link that its centre of mass may be beyond its joints and its shapes."""
_HEAVY = 10.0
"""Torque that holds the arm over the limit: arms whose springs bear their weight have 1.7."""
_MESHES = 100.0
"""Size of a link's shapes over its length; makers' links have up to 14."""
_MOST = 6
"""Links that are named in a sentence."""

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
    """What in a robot's nominal parameters looks like another unit, or like a power of ten.

    Links without mass, and points, are passed over. Shapes are read from the robot's file where a
    link looks too small for its matter.
    """
    parameters = robot.parameters
    if parameters is None or robot.floating:
        return ()
    own, mass, size = bodies(parameters), parameters.mass, link_lengths(robot)
    known = own.gyration > 0
    ball = mass / (4 / 3 * math.pi * (2.5**0.5 * own.gyration) ** 3)
    density = own.density.minimum(torch.maximum(_FLAT * ball, own.density.clamp(max=_DENSITY)))
    at = torch.stack([own.gyration / size / _GYRATION, density / _DENSITY], -1).log10()
    common = _common(at, known)
    found = {} if common is None else {common[0]: common[1]}
    away = outside_box(parameters.com, joint_points(robot).transpose(-1, -2))
    rest = known if common is None else known & ~common[1]
    odd = rest & (own.gyration > _OUTSIDE * size) | (away > _AWAY * size)
    shapes = _read_shapes(robot) if bool(odd.any()) else None
    drawn = torch.zeros_like(known)
    if shapes is not None:
        sides = (shapes.boxes[..., 1] - shapes.boxes[..., 0]).norm(dim=-1).nan_to_num(0.0)
        size = torch.maximum(size, sides)
        drawn = sides > 0
        inside = torch.where(drawn, outside_box(parameters.com, shapes.boxes), torch.inf)
        away = torch.minimum(away, inside)
    strayed = (away > _AWAY * size) & (mass > 0)  # what is merged there makes inertias, too
    rest = rest & ~strayed
    light = (density < torch.where(drawn, DENSITIES[0], _LIGHTEST)) & (mass > 0.01 * mass.sum())
    most = torch.where(light, torch.where(drawn, _OUTSIDE, _ROOM), _FAR_OUTSIDE)
    outside = own.gyration > most * size
    for (link,) in each(rest & (outside | (ball > DENSITIES[1]))):
        words = _nearest(at[link])
        found[words] = found.get(words, torch.zeros_like(known)).index_fill(
            0, torch.tensor(link), True
        )
    out = [_finding(robot, links, _as_bodies(own, links), words) for words, links in found.items()]
    if bool(strayed.any()):
        far = (away / size)[strayed]
        # The centre of a link is about a fifth of it from its joints, the farthest of them half.
        unit = "mm" if float(far.max()) > 150 or float(far.median()) > 70 else "cm"
        said = (
            f"centres of mass up to {float(away[strayed].max()):.3g} m beyond links of up to "
            f"{float(size[strayed].max()):.2g} m"
        )
        out.append(_finding(robot, strayed, said, f"{unit} for m"))
    loads: list[list[Finding]] = [[]]
    if not out:
        add_gravity_loads(loads, InertialParameters(parameters.pi.unsqueeze(0)), robot, 0)
    for load in loads[0]:
        if load.value > _HEAVY:
            words = f"{load.sentence}: the masses, or the limit, may be in another unit"
            out.append(replace(load, what=UNITS, sentence=words))
    return tuple(out)


def shape_findings(robot: Robot, shapes: LinkShapes | None) -> tuple[Finding, ...]:
    """Shapes that are as much larger than the links as meshes in mm are, one sentence for all."""
    if shapes is None:
        return ()
    sides = (shapes.boxes[..., 1] - shapes.boxes[..., 0]).norm(dim=-1)
    large = sides > _MESHES * link_lengths(robot)
    if not bool(large.any()):
        return ()
    said = f"shapes of up to {float(sides[large].max()):.3g} m"
    return (_finding(robot, large, said, 'meshes in mm: scale="0.001 0.001 0.001"'),)


def _common(
    at: Float[Tensor, "L 2"], known: Bool[Tensor, " L"]
) -> tuple[str, Bool[Tensor, " L"]] | None:
    """What the medians of the links show, and the links that share it; None where they are
    usual."""
    if int(known.sum()) < 2:
        return None
    middle = at[known].quantile(0.5, dim=0)
    low, high = (math.log10(x / _DENSITY) for x in (_LIGHTEST, DENSITIES[1]))
    if low < float(middle[1]) < high and abs(float(middle[0])) < _APART:
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


def _finding(robot: Robot, links: Bool[Tensor, " L"], said: str, words: str) -> Finding:
    numbers = [link for (link,) in each(links)]
    names = listed((f"'{robot.link_names[k]}'" for k in numbers), most=_MOST)
    sentence = f"{names}: {said}: they look like {words}"
    link = numbers[0] + 1 if len(numbers) == 1 else None
    return Finding(link, UNITS, len(numbers), 0.0, sentence)
