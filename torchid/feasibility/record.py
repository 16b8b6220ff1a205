"""A check of sets: conditions gathered, verdicts and findings; its JSON has the schema
torchid.feasibility/1."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import UNSET, UnsetType

from torchid.feasibility.bounds import Bounds, bounds_groups, read_bounds, read_total_mass
from torchid.feasibility.conditions import GEOMETRY_GROUP, Conditions, conditions, physics_only
from torchid.feasibility.derived_bounds import named_bounds
from torchid.feasibility.margins import (
    LINK_CONDITIONS,
    Feasibility,
    feasibility,
    inertia_eigenvalues,
)
from torchid.feasibility.plausibility import (
    Bodies,
    Finding,
    bodies,
    excess_percent,
    plausibility,
)
from torchid.feasibility.sets import ParameterSets, nominal_set, read_sets
from torchid.feasibility.units import nominal_findings, shape_findings
from torchid.inputs import RobotLike, as_robot
from torchid.json_data import plain
from torchid.results.record import Col, Ends, Joint, Part, Real, Record, Result, Rows
from torchid.robot.model import Robot
from torchid.robot.shapes import LinkShapes, link_shapes
from torchid.typing import Float, Tensor

NO_GEOMETRY = "none"


def _least(margins: Sequence[float]) -> str:
    """The smallest margin in millimetres."""
    least = min(margins)
    return f"{1e3 * least:.1f}" if math.isfinite(least) else "-"


class LinkVerdict(Part, frozen=True, kw_only=True):
    """One link of a set.

    Attributes:
        link, name: which.
        mass, com: [kg], (3,) [m].
        inertia_eigenvalues: (3,) barycentric, ascending [kg m^2].
        violation: of the inertia, in words.
        triangle_margin, triangle_excess_percent: of the largest against the sum of the others.
        com_margins, shape_margin: to the box (3,) and to round shapes [m].
        degrees: by condition.
        density, semi_axes, gyration: of the equivalent ellipsoid [kg/m^3; m; m].
    """

    link: Annotated[Joint, Col()]
    name: Annotated[str, Col()]
    mass: Annotated[Real, Col(digits=".4g", unit="kg")]
    com: Float[Tensor, "3"]
    inertia_eigenvalues: Float[Tensor, "3"]
    violation: str | None
    triangle_margin: Real
    triangle_excess_percent: Annotated[
        float | None, Col("largest over sum of others [%]", words=lambda x: f"{100 + x:.3g}")
    ]
    com_margins: Annotated[tuple[Real, ...], Col("CoM to box [mm]", words=_least)]
    shape_margin: Annotated[Real, Col("to shape [mm]", words=lambda x: _least([x]))]
    degrees: dict[str, float | None]
    density: Real
    semi_axes: Float[Tensor, "3"]
    gyration: Real

    @property
    def inertias(self) -> Annotated[str, Col("principal inertias [kg m²]")]:
        """Its inertia's eigenvalues."""
        return " ".join(f"{v:.3g}" for v in self.inertia_eigenvalues.tolist())

    @property
    def centre(self) -> Annotated[str, Col("CoM [mm]")]:
        """Its centre of mass."""
        return " ".join(f"{1e3 * c:.1f}" for c in self.com.tolist())

    @property
    def degree(self) -> Annotated[float, Col(digits=".2g")]:
        """The smallest of its conditions; nan of no body."""
        return min((x for x in self.degrees.values() if x is not None), default=math.nan)

    @property
    def violated(self) -> Annotated[tuple[str, ...], Col()]:
        """Conditions that it misses."""
        return tuple(name for name, x in self.degrees.items() if x is None or x < 0)


class Nearest(Part, frozen=True, kw_only=True):
    """The feasible set nearest in torque to an infeasible one; see torchid.extraction."""

    status: str
    feasible: bool
    least: Real
    torque_change: Float[Tensor, " n"]
    torque_change_relative: Float[Tensor, " n"]


class SetVerdict(Part, frozen=True, kw_only=True):
    """One set.

    Attributes:
        id: of the set. feasible, reasons: the verdict, and what is violated.
        margins, degrees: by condition; degree: the smallest.
        total_mass: [kg].
        links: one by one.
        plausibility: what is not plausible, though not forbidden.
        nearest: the feasible set nearest to it, where it was asked for.
    """

    id: Annotated[str, Col("set")]
    feasible: Annotated[bool, Col()]
    reasons: Annotated[tuple[str, ...], Col("violated")]
    margins: dict[str, float | None]
    degree: Annotated[Real, Col(digits=".2g")]
    degrees: dict[str, float | None]
    total_mass: Annotated[Real, Col(digits=".4g", unit="kg")]
    links: tuple[LinkVerdict, ...]
    plausibility: Annotated[tuple[Finding, ...], Col("findings", words=lambda x: str(len(x)))]
    nearest: Nearest | UnsetType = UNSET


class ConditionsRecord(Part, frozen=True, kw_only=True):
    """What was checked beside physics: (n, 3, 2) boxes [m], and the total mass [kg]."""

    geometry: str
    com_box: Float[Tensor, "n 3 2"]
    round_shapes: bool
    total_mass: Ends | None


class FeasibilityRecord(Record, frozen=True, kw_only=True, tag="torchid.feasibility/1"):
    """A check as its JSON has it.

    Attributes:
        robot: its name.
        conditions: beside physics.
        n_sets, n_feasible: how many.
        sets: one by one.
        warnings: about the robot and its shapes.
        seed: of the poses, from a command.
    """

    robot: str
    conditions: ConditionsRecord
    n_sets: int
    n_feasible: int
    sets: tuple[SetVerdict, ...]
    warnings: tuple[str, ...]
    seed: int | UnsetType = UNSET

    @property
    def table(self) -> Rows[SetVerdict]:
        """The sets."""
        return Rows(self.sets)


@dataclass(frozen=True, eq=False)
class Check(Result):
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

    def __repr__(self) -> str:
        feasible = int(self.feasibility.feasible.sum())
        return f"Check('{self.robot.name}', {feasible} of {len(self.sets)} sets feasible)"

    @cached_property
    def record(self) -> FeasibilityRecord:
        """As the JSON has it."""
        total = self.conditions.total_mass
        known = bool(total.isfinite().any())
        return FeasibilityRecord(
            robot=self.robot.name,
            conditions=ConditionsRecord(
                geometry=self.geometry,
                com_box=self.conditions.com_box,
                round_shapes=self.round_shapes,
                total_mass=(float(total[0]), float(total[1])) if known else None,
            ),
            n_sets=len(self.sets),
            n_feasible=int(self.feasibility.feasible.sum()),
            sets=tuple(_set(self, k) for k in range(len(self.sets))),
            warnings=self.warnings,
        )


def check(
    robot: RobotLike,
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
    robot = as_robot(robot)
    also: Sequence[Finding] = ()
    if sets is None:
        sets, also = nominal_set(robot), nominal_findings(robot)
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
    robot.require_fixed_base("a check of bodies")
    shapes = link_shapes(robot)
    box, words = _com_boxes(robot, geometry, shapes)
    asked = conditions(robot, com_box=box, shapes=round_shapes, total_mass=total_mass)
    verdicts = feasibility(sets, asked)
    findings = plausibility(robot, sets, shapes=shapes, bounds=bounds, seed=seed)
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
        findings=tuple((*also, *shape_findings(robot, shapes), *one) for one in findings),
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
    free = physics_only(robot.n_links).com_box
    if geometry == NO_GEOMETRY or shapes is None or not any(shapes.known):
        return free, NO_GEOMETRY
    kinds = " and ".join(dict.fromkeys(kind for kind in shapes.kinds if kind is not None))
    lacking = [str(i) for i, known in enumerate(shapes.known, start=1) if not known]
    without = f", unknown for links {', '.join(lacking)}" if lacking else ""
    return shapes.boxes.where(shapes.boxes.isfinite(), free), f"shapes ({kinds}){without}"


def _set(check: Check, k: int) -> SetVerdict:
    judged = check.feasibility
    margins = (judged.margins[k], judged.total_mass[k], judged.coefficients[k])
    degrees = (judged.degrees[k], judged.total_mass_degree[k], judged.coefficient_degrees[k])
    return SetVerdict(
        id=check.sets.ids[k],
        feasible=bool(judged.feasible[k]),
        reasons=judged.reasons(k),
        margins=_named(*margins, judged.coefficient_reasons),
        degree=float(judged.degree[k]),
        degrees=_named(*degrees, judged.coefficient_reasons),
        total_mass=float(check.sets.parameters.mass[k].sum()),
        links=tuple(_link(check, k, i) for i in range(check.robot.n_links)),
        plausibility=check.findings[k],
    )


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


def _link(check: Check, k: int, i: int) -> LinkVerdict:
    judged = check.feasibility
    _, _, triangle, *com, shape = judged.margins[k, i].tolist()
    degrees = zip(LINK_CONDITIONS, judged.degrees[k, i].tolist(), strict=True)
    eigenvalues = check.eigenvalues[k, i]
    return LinkVerdict(
        link=i,
        name=check.robot.link_names[i],
        mass=float(check.sets.parameters.mass[k, i]),
        com=check.sets.parameters.com[k, i],
        inertia_eigenvalues=eigenvalues,
        violation=judged.inertia_violation(k, i),
        triangle_margin=triangle,
        triangle_excess_percent=excess_percent(eigenvalues.tolist()),
        com_margins=tuple(com),
        shape_margin=shape,
        degrees={name: plain(degree) for name, degree in degrees if degree != math.inf},
        density=float(check.bodies.density[k, i]),
        semi_axes=check.bodies.semi_axes[k, i],
        gyration=float(check.bodies.gyration[k, i]),
    )
