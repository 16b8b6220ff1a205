"""A check of sets: conditions gathered, verdicts and findings, and its record
(schema torchid.feasibility/1)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from torchid.feasibility.bounds import Bounds, bounds_groups, read_bounds, read_total_mass
from torchid.feasibility.conditions import GEOMETRY_GROUP, Conditions, conditions, physics_only
from torchid.feasibility.derived_bounds import named_bounds
from torchid.feasibility.findings import Finding, own_inertial_findings
from torchid.feasibility.margins import (
    LINK_CONDITIONS,
    Feasibility,
    feasibility,
    inertia_eigenvalues,
)
from torchid.feasibility.plausibility import Bodies, bodies, plausibility
from torchid.feasibility.sets import ParameterSets, nominal_set, read_sets
from torchid.json_data import picked, plain
from torchid.robot.model import Robot
from torchid.robot.shapes import LinkShapes, link_shapes, own_inertials
from torchid.typing import Float, Tensor

SCHEMA = "torchid.feasibility/1"
NO_GEOMETRY = "none"


@dataclass(frozen=True, eq=False)
class Check:
    """K sets of a robot, checked.

    Attributes:
        robot: whose conditions were used.
        sets: K sets.
        conditions: beside physics.
        geometry: where the boxes of the centres of mass are from, in words; `none`.
        round_shapes: whether cylinders and spheres were checked.
        feasibility: margins, degrees, verdicts.
        eigenvalues: (K, n, 3) of the barycentric inertias, ascending [kg m^2].
        bodies: equivalent ellipsoids.
        findings: what is not plausible in each set.
        warnings: about the robot and its shapes.
    """

    robot: Robot
    sets: ParameterSets
    conditions: Conditions
    geometry: str
    round_shapes: bool
    feasibility: Feasibility
    eigenvalues: Float[Tensor, "K n 3"]
    bodies: Bodies
    findings: tuple[tuple[Finding, ...], ...]
    warnings: tuple[str, ...]


def check(
    robot: Robot,
    sets: ParameterSets | str | Path | None = None,
    *,
    geometry: str | None = None,
    round_shapes: bool = False,
    total_mass: tuple[float, float] | Literal["robot"] | None = "robot",
    bounds: str | None = None,
    seed: int = 0,
) -> Check:
    """Whether parameters can belong to a real arm: by how much, and why not.

    Args:
        robot: whose bounds, shapes, joints and limits count.
        sets: what is checked; of a file, as `read_sets` reads it; the robot's own nominal
            parameters if None.
        geometry: group of bounds whose boxes of the centres of mass are the links' geometry, or
            `none`. If None: `normal` where the robot has it, else the boxes of the shapes in the
            file it was read from, else none.
        round_shapes: check the cylinders and spheres of the robot's yaml too.
        total_mass: interval of the sum of the masses [kg]; the robot's, where it has one; or None.
        bounds: group of bounds, or `from-robot`: parameters that lie on them are told.
        seed: of the poses in which the arm's weight is held.

    Returns:
        Margins, reasons and degree of every set, and what is not plausible though not forbidden.

    Raises:
        RobotError: no nominal parameters, no such group, no such shapes, an empty interval.
        TorchidError: a file that holds no sets of this robot.

    >>> import torchid
    >>> found = check(torchid.load_robot("kuka_lwr4"))  # with the parameters that the report has
    >>> found.feasibility.feasible.tolist(), found.feasibility.reasons(0)
    ([False], ('inertia_3', 'inertia_4', 'inertia_7', 'com_7z'))
    """
    also: Sequence[Finding] = ()
    if sets is None:
        sets, also = nominal_set(robot), own_inertial_findings(own_inertials(robot))
    elif not isinstance(sets, ParameterSets):
        sets = read_sets(Path(sets), robot)
    return check_sets(
        robot,
        sets,
        geometry=geometry,
        round_shapes=round_shapes,
        total_mass=read_total_mass(robot) if total_mass == "robot" else total_mass,
        bounds=None if bounds is None else named_bounds(robot, bounds),
        also=also,
        seed=seed,
    )


def check_sets(
    robot: Robot,
    sets: ParameterSets,
    *,
    geometry: str | None = None,
    round_shapes: bool = False,
    total_mass: tuple[float, float] | None = None,
    bounds: Bounds | None = None,
    also: Sequence[Finding] = (),
    seed: int = 0,
) -> Check:
    """Check sets against physics and against what a robot's description says.

    Args:
        robot: whose bounds, shapes, joints and limits count.
        sets: K sets.
        geometry: group of bounds whose boxes of the centres of mass are the links' geometry, or
            `none`. If None: `normal` where the robot has it, else the boxes of the shapes in the
            file it was read from, else none.
        round_shapes: check the cylinders and spheres of the robot's yaml too.
        total_mass: interval of the sum of the masses [kg]; not checked if None.
        bounds: of a search; parameters on them are found.
        also: findings that hold for every set.
        seed: of the poses in which the arm's weight is held.

    Raises:
        RobotError: no such group, no such shapes, or an interval that is empty.
    """
    shapes = link_shapes(robot)
    box, words = _com_boxes(robot, geometry, shapes)
    asked = conditions(robot, com_box=box, shapes=round_shapes, total_mass=total_mass)
    verdicts = feasibility(sets, asked)
    found = plausibility(robot, sets, verdicts, shapes=shapes, bounds=bounds, seed=seed)
    said = [w for w in robot.warnings if "physically consistent" not in w]
    return Check(
        robot=robot,
        sets=sets,
        conditions=asked,
        geometry=words,
        round_shapes=round_shapes,
        feasibility=verdicts,
        eigenvalues=inertia_eigenvalues(sets.parameters),
        bodies=bodies(sets.parameters),
        findings=tuple((*one, *also) for one in found),
        warnings=(*said, *(() if shapes is None else shapes.warnings)),
    )


def _com_boxes(
    robot: Robot, geometry: str | None, shapes: LinkShapes | None
) -> tuple[Float[Tensor, "n 3 2"], str]:
    """Boxes of the centres of mass, infinite where unknown, and where they are from."""
    if geometry is None and GEOMETRY_GROUP in bounds_groups(robot):
        geometry = GEOMETRY_GROUP
    if geometry is not None and geometry != NO_GEOMETRY:
        return read_bounds(robot, geometry).com, f"bounds '{geometry}'"
    free = physics_only(robot.n).com_box
    if geometry == NO_GEOMETRY or shapes is None or not any(shapes.known):
        return free, NO_GEOMETRY
    kinds = " and ".join(dict.fromkeys(kind for kind in shapes.kinds if kind is not None))
    lacking = [str(i) for i, known in enumerate(shapes.known, start=1) if not known]
    without = f", unknown for links {', '.join(lacking)}" if lacking else ""
    return shapes.boxes.where(shapes.boxes.isfinite(), free), f"shapes ({kinds}){without}"


def record(check: Check) -> dict[str, Any]:
    """JSON-ready data; every number is finite or null."""
    total = plain(check.conditions.total_mass)
    return {
        "schema": SCHEMA,
        "robot": check.robot.name,
        "conditions": {
            "geometry": check.geometry,
            "com_box": plain(check.conditions.com_box),
            "round_shapes": check.round_shapes,
            "total_mass": None if total == [None, None] else total,
        },
        "n_sets": len(check.sets),
        "n_feasible": int(check.feasibility.feasible.sum()),
        "sets": [_set(check, k) for k in range(len(check.sets))],
        "warnings": list(check.warnings),
    }


def _set(check: Check, k: int) -> dict[str, Any]:
    found = check.feasibility
    margins = (found.margins[k], found.total_mass[k], found.coefficients[k])
    degrees = (found.degrees[k], found.total_mass_degree[k], found.coefficient_degrees[k])
    return {
        "id": check.sets.ids[k],
        "feasible": bool(found.feasible[k]),
        "reasons": list(found.reasons(k)),
        "margins": _named(*margins, found.coefficient_reasons),
        "degree": plain(found.degree[k]),
        "degrees": _named(*degrees, found.coefficient_reasons),
        "total_mass": plain(check.sets.parameters.mass[k].sum()),
        "links": [_link(check, k, i) for i in range(check.robot.n)],
        "plausibility": [
            picked(f, "link name what value threshold sentence") for f in check.findings[k]
        ],
    }


def _named(links: Tensor, total: Tensor, coefficients: Tensor, names: Sequence[str]) -> Any:
    """Values by the names of the reasons; conditions that were not asked for are left out.

    `inertia` is the smaller of the eigenvalue's and the triangle's.
    """
    out: dict[str, float] = {}
    for link, (mass, eigenvalue, triangle, *com, shape) in enumerate(links.tolist(), start=1):
        out[f"mass_{link}"] = mass
        out[f"inertia_{link}"] = min(eigenvalue, triangle)
        out |= {f"com_{link}{axis}": c for axis, c in zip("xyz", com, strict=True)}
        out[f"shape_{link}"] = shape
    out["total_mass"] = float(total)
    out |= dict(zip(names, coefficients.tolist(), strict=True))
    return {name: plain(value) for name, value in out.items() if value != math.inf}


def _link(check: Check, k: int, i: int) -> dict[str, Any]:
    found = check.feasibility
    mass, _, triangle, *com, shape = plain(found.margins[k, i])
    degrees = zip(LINK_CONDITIONS, found.degrees[k, i].tolist(), strict=True)
    eigenvalues = check.eigenvalues[k, i].tolist()
    return {
        "link": i + 1,
        "name": check.robot.link_names[i],
        "mass": mass,
        "com": plain(check.sets.parameters.com[k, i]),
        "inertia_eigenvalues": plain(eigenvalues),
        "violation": found.inertia_violation(k, i),
        "triangle_margin": triangle,
        "triangle_excess_percent": excess_percent(eigenvalues),
        "com_margins": com,
        "shape_margin": shape,
        "degrees": {name: plain(degree) for name, degree in degrees if degree != math.inf},
        "density": plain(check.bodies.density[k, i]),
        "semi_axes": plain(check.bodies.semi_axes[k, i]),
        "gyration": plain(check.bodies.gyration[k, i]),
    }


def excess_percent(eigenvalues: Sequence[float]) -> float | None:
    """By how much the largest principal inertia exceeds the sum of the others [%]; negative where
    it does not, None where that sum is not positive."""
    low, middle, high = eigenvalues
    return 100 * (high / (low + middle) - 1) if low + middle > 0 else None
