"""`torchid export`: a result's dynamics in the formats of other programs."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from torchid.app import options as opt
from torchid.app.output import Computed
from torchid.app.signature import Switch, command


@command
def export_command(
    *,
    result: Annotated[str, typer.Argument(metavar="RESULT")],
    to: Literal["urdf", "mjcf", "yaml", "csv", "c"],
    robot: opt.RobotOption = None,
    chosen: Annotated[str | None, typer.Option("--set", metavar="ID")] = None,
    name: Annotated[str | None, typer.Option(metavar="NAME")] = None,
    force: Switch = False,
    geometry: opt.Group = None,
    tip: opt.Tip = None,
    seed: opt.Seed = 0,
    output: Computed,
) -> None:
    """Write identified dynamics into a copy of your URDF or MJCF, as yaml, as a table, or as C.

    Every file is reloaded, also by Pinocchio and MuJoCo where they are installed, and its torque
    compared with the result's; what does not agree is not kept. Without --out, it is written to
    the present folder.

    Example: `torchid export sets/extraction.json --robot arm.urdf --to urdf --out identified`

    Args:
        result: JSON of `torchid identify` or `extract`, a file of parameter sets, the .yaml of
            `torchid gap --save-model`, or any robot.
        to: Format to write.
        robot: Robot of the result, and the file that a copy is edited of; the one that RESULT
            records.
        chosen: Set of a file of several; the feasible one of least loss.
        name: Of the file, without suffix; the robot's name.
        force: Write infeasible parameters, too.
        geometry: Bounds of the centres of mass that count in the check, as for `torchid check`.
    """
    from rich.markup import escape

    from torchid.export.export import export_dynamics
    from torchid.export.results import base_dynamics, load, robot_dynamics, set_dynamics
    from torchid.report.robot import (
        comparison_table,
        effect_lines,
        export_headline,
        export_record,
        export_warnings,
    )
    from torchid.robot.library import is_robot, load_both, load_robot, named_robot

    if is_robot(result):
        nominal, original = load_both(result, robot, tip)
        dynamics = robot_dynamics(nominal)
    else:
        path = Path(result)
        data = load(path)
        nominal = named_robot(path, data, tip) if robot is None else load_robot(robot, tip=tip)
        original = nominal
        if "sets" in data:
            dynamics = set_dynamics(path, data, nominal, chosen, geometry)
        else:
            dynamics = base_dynamics(path, nominal)
    done = export_dynamics(
        dynamics,
        to,
        output.out or Path(),
        name,
        nominal=nominal,
        original=original,
        geometry=geometry,
        force=force,
        seed=seed,
        keep=[Path(file) for file in (result, robot) if file is not None],
    )
    output.write_json({**export_record(done), "seed": seed}, f"export_{to}.json")
    output.say(comparison_table(done), *(escape(line) for line in effect_lines(done)))
    output.warn(export_warnings(done))
    output.say(f"\nwritten: {escape(export_headline(done))}")
