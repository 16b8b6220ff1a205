"""Options that `extract` and `atlas` share: whose base parameters, which bounds and conditions."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from torchid.app.options import interval
from torchid.errors import TorchidError

if TYPE_CHECKING:
    from torchid.extraction.problem import Problem
    from torchid.feasibility.bounds import Bounds
    from torchid.identification.reading import BaseValues
    from torchid.robot.model import Robot

ResultArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar="[RESULT]",
        help="JSON of `torchid identify`; without it, the base parameters of the robot's nominal "
        "parameters.",
    ),
]
BoundsOption = Annotated[
    str | None,
    typer.Option(
        "--bounds",
        metavar="GROUP|from-robot",
        help="Group of bounds in the robot's yaml, or bounds derived from its nominal parameters "
        "and shapes. Default: normal, else from-robot.",
    ),
]
GeometryOption = Annotated[
    str | None,
    typer.Option(
        "--geometry",
        metavar="GROUP|none",
        help="Bounds whose boxes of the centres of mass are the links' geometry. Default: normal "
        "where there is one, else the bounds' own.",
    ),
]
ShapesOption = Annotated[
    bool, typer.Option("--shapes", help="Centres of mass inside the links' cylinders and spheres.")
]
TotalMassOption = Annotated[
    str | None, typer.Option("--total-mass", metavar="LO,HI", help="Interval of the total mass.")
]
LossOption = Annotated[
    Literal["two-step", "one-step"],
    typer.Option(
        help="Distance to the coefficients (2.28), or to the torques of the log (2.29), by the "
        "fit's triangular factor."
    ),
]


def build_problem(
    robot: "Robot",
    result: Path | None,
    *,
    bounds: str | None,
    geometry: str | None,
    shapes: bool,
    total_mass: str | None,
    loss: str,
) -> "tuple[Problem, BaseValues, tuple[str, ...]]":
    """The problem that the options describe, the base parameters, and notes for the user."""
    from torchid.extraction.problem import extraction_problem, one_step, two_step
    from torchid.feasibility.conditions import conditions
    from torchid.identification.reading import nominal_base, read_base

    found = nominal_base(robot) if result is None else read_base(result, robot)
    limits, notes = _bounds(robot, bounds, found)
    if loss == "one-step":
        if found.factor is None:
            raise TorchidError(
                "the one-step loss needs a log.",
                got="the robot's nominal parameters",
                expected="the JSON of `torchid identify`",
            )
        target = one_step(found.base, found.effects, found.values, found.factor)
    else:
        target = two_step(found.base, found.effects, found.values, found.known)
    asked = conditions(
        robot,
        com_box=_geometry(robot, geometry, limits),
        shapes=shapes,
        total_mass=None if total_mass is None else interval("--total-mass", total_mass),
    )
    return extraction_problem(robot, target, limits, asked), found, (*notes, *_unasked(found))


def _unasked(found: "BaseValues") -> tuple[str, ...]:
    """A note on base parameters that the log did not determine."""
    names = [
        n for n, known in zip(found.base.names, found.known.tolist(), strict=True) if not known
    ]
    if len(names) == len(found.base):
        raise TorchidError("the identification determined no base parameter: nothing to reproduce.")
    if not names:
        return ()
    return (f"not determined by the log: {', '.join(names)}",)


def _bounds(
    robot: "Robot", asked: str | None, found: "BaseValues"
) -> "tuple[Bounds, tuple[str, ...]]":
    from torchid.extraction.problem import with_coefficient_bounds
    from torchid.feasibility.bounds import bounds_groups
    from torchid.feasibility.derived_bounds import NAME, named_bounds

    group = asked or ("normal" if "normal" in bounds_groups(robot) else NAME)
    limits = named_bounds(robot, group)
    full, added = with_coefficient_bounds(limits, found.base, found.effects, found.values)
    note = f"bounds of {', '.join(added)}: within twice the identified sizes" if added else ""
    return full, (note,) if note else ()


def _geometry(robot: "Robot", asked: str | None, limits: "Bounds"):  # type: ignore[no-untyped-def]
    """Boxes of the centres of mass to check: None lets the robot's own decide."""
    from torchid.feasibility.bounds import bounds_groups, read_bounds
    from torchid.feasibility.conditions import physics_only

    if asked == "none":
        return physics_only(robot.n).com_box
    if asked is not None:
        return read_bounds(robot, asked).com
    return None if "normal" in bounds_groups(robot) else limits.com
