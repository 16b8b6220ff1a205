"""`torchid log`: what a log is, before anything is computed from it."""

from pathlib import Path
from typing import Annotated, Any

import typer

from torchid.app import options as opt
from torchid.app.log_doctor import doctor_command
from torchid.app.output import open_output

log_app = typer.Typer(
    name="log", no_args_is_help=True, help="What a log is, before anything is computed from it."
)


log_app.command("doctor")(doctor_command)


@log_app.command("show")
def show_command(
    logs: opt.LogArguments,
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            metavar="ROBOT",
            help="The robot it is of: joints by name, and what only a robot can tell is checked.",
        ),
    ] = None,
    columns: opt.Columns = None,
    topic: opt.Topic = None,
    tip: opt.Tip = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            help="Write what was read as .parquet, .csv or .npz, in our columns and units.",
        ),
    ] = None,
    json_file: opt.Json = None,
    quiet: opt.Quiet = False,
) -> None:
    """Print what a log is seen as: format, joints, sampling, ranges, units, and what is odd.

    Example: `torchid log show run1.csv --columns "q=pos_{j} deg,tau=eff_{j},t=time ms" --out
    run1.parquet`
    """
    output = open_output(json_file, None, quiet)
    from rich.markup import escape

    from torchid.design.repeats import repeated_motion
    from torchid.log.mapping import read_mapping
    from torchid.log.overview import look_at, overview_record
    from torchid.log.readers import write_log
    from torchid.log.ros import topics_of
    from torchid.log.table import Request
    from torchid.report.log import headline, log_tables, repeats_table, topics_table
    from torchid.robot.library import load_robot
    from torchid.robot.model import JointType

    checked: dict[str, Any] = {}
    joints: tuple[str, ...] = ()
    if robot is not None:
        found = load_robot(robot, tip=tip)
        joints = found.joint_names
        checked = {
            "robot_name": found.name,
            "position_limits": found.limits.position,
            "torque_limits": found.limits.torque,
            "prismatic": [kind is JointType.PRISMATIC for kind in found.joint_types],
        }
    request = Request(None if columns is None else read_mapping(columns), topic, joints)
    seen = look_at(logs, request, **checked)
    repeats = repeated_motion(seen.log) if seen.problem is None else ()
    output.verdict(headline(seen))
    for table in seen.tables:
        if table is not None and table.topic is not None:
            output.say(topics_table(topics_of(table.path), table.topic))
    output.say(*log_tables(seen))
    if repeats:
        output.say(repeats_table(repeats))
    if seen.unused:
        output.say(f"not used: {escape(', '.join(seen.unused[:40]))}")
    output.warn(seen.warnings)
    if seen.problem is not None:
        output.say(f"[red]this log cannot be used as it is:[/] {escape(seen.problem)}")
    if out is not None:
        write_log(seen.log, out)
        output.say(f"{seen.log.samples} samples written to {out}")
    record = overview_record(seen)
    output.write_json({**record, "repeats": [dict(vars(r)) for r in repeats]}, "log.json")
