"""Options that `extract` and `atlas` share: whose base parameters, which bounds and conditions."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from torchid.app.options import interval

if TYPE_CHECKING:
    from torchid.extraction.problem import LossName, Problem
    from torchid.identification.values import BaseValues
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
    loss: "LossName",
) -> "tuple[Problem, BaseValues, tuple[str, ...]]":
    """The problem that the options describe, the base parameters, and notes for the user."""
    from torchid.extraction.from_identification import problem_of
    from torchid.identification.values import nominal_base, read_base

    found = nominal_base(robot) if result is None else read_base(result, robot)
    limits = None if total_mass is None else interval("--total-mass", total_mass)
    problem, notes = problem_of(
        robot, found, bounds=bounds, geometry=geometry, shapes=shapes, total_mass=limits, loss=loss
    )
    return problem, found, notes
