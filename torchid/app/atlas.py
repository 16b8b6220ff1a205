"""`torchid atlas`: what the log determines of each physical parameter, and what it does not."""

from typing import TYPE_CHECKING, Annotated

import typer

from torchid.app.options import Json, Out, Quiet, RobotArgument, Threads, Tip
from torchid.app.output import open_output, progress_bar
from torchid.app.problems import (
    BoundsOption,
    GeometryOption,
    ResultArgument,
    ShapesOption,
    TotalMassOption,
    build_problem,
)

if TYPE_CHECKING:
    from torchid.identification.values import BaseValues


def atlas_command(
    robot: RobotArgument,
    result: ResultArgument = None,
    bounds: BoundsOption = None,
    geometry: GeometryOption = None,
    shapes: ShapesOption = False,
    total_mass: TotalMassOption = None,
    level: Annotated[
        float, typer.Option(help="Of the confidence region of identified base parameters.")
    ] = 0.95,
    tip: Tip = None,
    json_file: Json = None,
    out: Out = None,
    quiet: Quiet = False,
    threads: Threads = None,
) -> None:
    """The range of every physical parameter over all feasible sets with the same torque.

    Example: `torchid atlas kuka_lwr4 --bounds normal --out atlas`
    """
    output = open_output(json_file, out, quiet, threads)
    from rich.markup import escape

    from torchid.extraction.convex.atlas import atlas
    from torchid.extraction.record import atlas_record
    from torchid.report.atlas import atlas_figure, atlas_table, headline
    from torchid.report.figures import save
    from torchid.robot.library import load_robot

    arm = load_robot(robot, tip=tip)
    problem, found, notes = build_problem(
        arm, result, bounds=bounds, geometry=geometry, shapes=shapes, total_mass=total_mass,
        loss="two-step",
    )  # fmt: skip
    covariance = found.covariance
    if covariance is not None:
        covariance = covariance.clone()
        unknown = ~found.known
        covariance[unknown, unknown] = float("inf")
        notes = (*notes, *_held(found))
    with progress_bar(output) as progress:
        ranges = atlas(
            problem,
            covariance=covariance,
            level=level,
            progress=None
            if progress is None
            else (lambda done, total: progress("ends", done, total)),
        )
    output.say(atlas_table(ranges))
    output.warn(notes)
    output.say(f"\n{escape(headline(ranges, problem))}")
    output.write_json({**atlas_record(ranges, problem), "warnings": list(notes)}, "atlas.json")
    if output.folder is not None:
        save(atlas_figure(ranges, problem), output.folder / "atlas.png")


def _held(found: "BaseValues") -> tuple[str, ...]:
    """A note on values that the fit held: they have no variance, which does not make them sure."""
    if found.covariance is None:
        return ()
    held = (found.covariance.diagonal() == 0) & found.known
    names = [n for n, is_held in zip(found.base.names, held.tolist(), strict=True) if is_held]
    return (
        (f"held by the identification, and taken for exact here: {', '.join(names)}",)
        if names
        else ()
    )
