"""`torchid atlas`: what the log determines of each physical parameter, and what it does not."""

from typing import Annotated

import typer

from torchid.app import options as opt
from torchid.app.output import open_output, progress_bar, stage
from torchid.app.problems import (
    BoundsOption,
    GeometryOption,
    ResultArgument,
    ShapesOption,
    TotalMassOption,
    build_problem,
)


def atlas_command(
    robot: opt.RobotArgument,
    result: ResultArgument = None,
    bounds: BoundsOption = None,
    geometry: GeometryOption = None,
    shapes: ShapesOption = False,
    total_mass: TotalMassOption = None,
    level: Annotated[
        float, typer.Option(help="Of the confidence region of identified base parameters.")
    ] = 0.95,
    tip: opt.Tip = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    quiet: opt.Quiet = False,
    threads: opt.Threads = None,
) -> None:
    """The range of every physical parameter over all feasible sets with the same torque.

    Example: `torchid atlas kuka_lwr4 --bounds normal --out atlas`
    """
    output = open_output(json_file, out, quiet, threads)
    from rich.markup import escape

    from torchid.extraction.convex.atlas import atlas
    from torchid.extraction.record import atlas_record
    from torchid.report.extraction import atlas_figure, atlas_headline, atlas_table
    from torchid.robot.library import load_robot

    arm = load_robot(robot, tip=tip)
    problem, found, notes = build_problem(
        arm, result, bounds=bounds, geometry=geometry, shapes=shapes, total_mass=total_mass,
        loss="two-step",
    )  # fmt: skip
    covariance = found.covariance
    if covariance is not None:
        # Values that the fit held have no variance, which does not make them sure.
        held = ((covariance.diagonal() == 0) & found.known).tolist()
        names = ", ".join(n for n, is_held in zip(found.base.names, held, strict=True) if is_held)
        if names:
            notes = (*notes, f"held by the identification, and taken for exact here: {names}")
        covariance = covariance.clone()
        covariance[~found.known, ~found.known] = float("inf")
    with progress_bar(output) as progress:
        ranges = atlas(
            problem, covariance=covariance, level=level, progress=stage(progress, "ends")
        )
    output.say(atlas_table(ranges))
    output.warn(notes)
    output.say(f"\n{escape(atlas_headline(ranges, problem))}")
    output.write_json({**atlas_record(ranges, problem), "warnings": list(notes)}, "atlas.json")
    output.draw(lambda: {"atlas": atlas_figure(ranges, problem)})
