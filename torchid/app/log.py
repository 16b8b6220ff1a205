"""`torchid log`: what a log is, before anything is computed from it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torchid.app.log_doctor import doctor_command
from torchid.app.options import Columns, Json, LogArguments, Quiet, Tip, Topic
from torchid.app.output import Output, open_output

if TYPE_CHECKING:
    from torchid.log.overview import Overview

log_app = typer.Typer(
    name="log", no_args_is_help=True, help="What a log is, before anything is computed from it."
)


log_app.command("doctor")(doctor_command)


@log_app.command("show")
def show_command(
    logs: LogArguments,
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            metavar="ROBOT",
            help="The robot it is of: joints by name, and what only a robot can tell is checked.",
        ),
    ] = None,
    columns: Columns = None,
    topic: Topic = None,
    tip: Tip = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            help="Write what was read as .parquet, .csv or .npz, in our columns and units.",
        ),
    ] = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Print what a log is seen as: format, joints, sampling, ranges, units, and what is odd.

    Example: `torchid log show run1.csv --columns "q=pos_{j} deg,tau=eff_{j},t=time ms" --out
    run1.parquet`
    """
    output = open_output(json_file, None, quiet)
    from torchid.gap.data.repeated import repeated_motion
    from torchid.log.mapping import read_mapping
    from torchid.log.overview import look_at, overview_record
    from torchid.log.readers import write_log
    from torchid.log.table import Request

    checked, joints = _of_robot(robot, tip)
    request = Request(None if columns is None else read_mapping(columns), topic, joints)
    seen = look_at(logs, request, **checked)
    repeats = repeated_motion(seen.log) if seen.problem is None else ()
    _show(seen, repeats, output)
    if out is not None:
        write_log(seen.log, out)
        output.say(f"{seen.log.samples} samples written to {out}")
    record = overview_record(seen)
    output.write_json({**record, "repeats": [dict(vars(r)) for r in repeats]}, "log.json")


def _of_robot(robot: str | None, tip: str | None) -> tuple[dict[str, Any], tuple[str, ...]]:
    """What the robot says about its logs, and the names of its joints."""
    if robot is None:
        return {}, ()
    from torchid.robot.library import load_robot
    from torchid.robot.model import JointType

    found = load_robot(robot, tip=tip)
    return {
        "robot_name": found.name,
        "position_limits": found.limits.position,
        "torque_limits": found.limits.torque,
        "prismatic": [kind is JointType.PRISMATIC for kind in found.joint_types],
    }, found.joint_names


def _show(seen: "Overview", repeats: tuple[Any, ...], output: Output) -> None:
    from rich.markup import escape

    from torchid.log.ros import topics_of
    from torchid.report.log import headline, log_tables, repeats_table, topics_table

    output.say(f"[bold]{escape(headline(seen))}[/]\n")
    for table in seen.tables:
        if table is not None and table.topic is not None:
            output.say(topics_table(topics_of(table.path), table.topic))
    for shown in log_tables(seen):
        output.say(shown)
    again = repeats_table(repeats)
    if again is not None:
        output.say(again)
    if seen.unused:
        output.say(f"not used: {escape(', '.join(seen.unused[:40]))}")
    output.warn(seen.warnings)
    if seen.problem is not None:
        output.say(f"[red]this log cannot be used as it is:[/] {escape(seen.problem)}")
