"""`torchid check`: whether parameters can belong to a real arm."""

from typing import Annotated

import typer

from torchid.app import options as opt
from torchid.app.inputs import MODEL
from torchid.app.output import Computed
from torchid.app.signature import Switch, command


@command
def check_command(
    *,
    params: Annotated[str, typer.Argument(metavar="PARAMS"), MODEL],
    robot: opt.RobotOption = None,
    geometry: opt.Group = None,
    shapes: Switch = False,
    total_mass: Annotated[str | None, typer.Option(metavar="LO,HI|none")] = None,
    bounds: opt.Bounds = None,
    nearest: opt.Written = None,
    part: opt.Part,
    seed: opt.Seed = 0,
    output: Annotated[Computed, "feasibility.json"],
) -> None:
    """Check whether parameters can belong to a real arm: by how much, and why not.

    Infeasible sets are a finding, not an error: the exit code is 0.

    Example: `torchid check kuka_lwr4_friction`, `torchid check sets.json --robot panda.yaml
    --nearest repaired.json`

    Args:
        params: A file of parameter sets (.json), or a robot (built-in name, .yaml, .urdf, .xml),
            whose nominal parameters are checked.
        robot: Robot whose bounds, shapes and limits count; PARAMS itself where it is a robot.
        geometry: Bounds whose boxes of the centres of mass are the links' geometry. Without it:
            `normal` where the robot has it, else the shapes in its file, else none.
        shapes: Check the yaml's cylinders and spheres too.
        total_mass: Interval of the sum of the masses [kg]; the yaml's.
        bounds: Also tell which parameters lie on these bounds.
        nearest: Write the feasible set nearest in torque to each infeasible one.
    """
    from torchid.export.nearest import nearest_sets
    from torchid.feasibility.asked import asked_about
    from torchid.feasibility.bounds import read_total_mass
    from torchid.feasibility.derived_bounds import named_bounds
    from torchid.feasibility.record import check_sets
    from torchid.report.feasibility import findings_lines, report_of_check

    asked = asked_about(params, robot, part.choice)
    examined = asked.robot
    total = None
    if total_mass is None:
        total = read_total_mass(examined)
    elif total_mass != "none":
        total = opt.total_mass(total_mass)
    check = check_sets(
        examined,
        asked.sets,
        geometry=geometry,
        round_shapes=shapes,
        total_mass=total,
        bounds=None if bounds is None else named_bounds(examined, bounds),
        also=asked.findings,
        seed=seed,
    )
    data = {**check.plain(), "seed": seed}
    data["warnings"] = [*asked.warnings, *data["warnings"]]
    repaired = None
    if nearest is not None:
        with output.progress("the nearest feasible sets"):
            repaired = nearest_sets(check, asked.others, nearest, data, seed)
        if repaired is not None and bool(repaired.feasible.any()):
            output.written.append(nearest)
    output.give(
        data, "feasibility.json", lambda _: report_of_check(check, repaired, data["warnings"])
    )
    findings = findings_lines(check)
    if findings:
        output.say("\nnot plausible, though not forbidden:")
        output.warn(findings)
    if repaired is None and nearest is not None:
        output.say(f"all sets are feasible: {nearest} was not written")
