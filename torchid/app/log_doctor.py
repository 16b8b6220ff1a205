"""`torchid log doctor`: what is wrong with a log, before anything is fitted to it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchid.app.options import (
    Columns,
    Gain,
    Json,
    LogArguments,
    Out,
    Output,
    Quiet,
    RobotArgument,
    Seed,
    Threads,
    Tip,
    Topic,
    open_output,
    read_logs,
)
from torchid.errors import TorchidError

if TYPE_CHECKING:
    from torchid.doctor.examine import Examination


def doctor_command(
    robot: RobotArgument,
    logs: LogArguments,
    apply: Annotated[
        Path | None,
        typer.Option(
            "--apply",
            metavar="FILE",
            help="Write a copy of the log, all trajectories, with the fixes applied "
            "(.parquet, .csv, .npz). The logs themselves are never changed.",
        ),
    ] = None,
    columns: Columns = None,
    topic: Topic = None,
    gain: Gain = None,
    tip: Tip = None,
    json_file: Json = None,
    out: Out = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
) -> None:
    """Examine a log before anything is fitted to it: units, signs, joint order, gains, gravity,
    lag, velocities, clock, dropouts, saturation, excitation; with evidence, and what to change.

    Example: `torchid log doctor panda.yaml run1.parquet --apply mended.parquet`
    """
    output = open_output(json_file, out, quiet, threads)
    if apply is not None and any(_same(apply, log) for log in logs):
        raise TorchidError(
            f"--apply would write over the log '{apply}'.", expected="the name of a new file"
        )
    from torchid.doctor.examine import examine
    from torchid.doctor.record import record
    from torchid.log.readers import write_log
    from torchid.robot.library import load_robot

    found = load_robot(robot, tip=tip)
    result = examine(found, read_logs(logs, gain, found, columns, topic))
    if apply is not None:
        write_log(result.mended(), apply)
    _show(result, output, apply)
    output.write_json({**record(result), "seed": seed}, "doctor.json")
    _draw(result, output)


def _same(one: Path, other: Path) -> bool:
    return one.exists() and other.exists() and one.samefile(other)


def _show(result: "Examination", output: Output, apply: Path | None) -> None:
    from torchid.report.doctor import fine, headline, tables

    for table in tables(result):
        output.say(table)
    output.say(fine(result))
    output.say(f"\n{headline(result)}")
    if apply is not None:
        count = len(result.repairs)
        output.say(f"written to {apply}: a copy with {count} fix{'es' if count != 1 else ''}")
    elif result.repairs:
        output.say("--apply FILE writes a copy with the fixes that can be applied")


def _draw(result: "Examination", output: Output) -> None:
    """Measured torque against what bodies explain, for --out."""
    if output.folder is None:
        return
    from torchid.report.doctor import torque_figure
    from torchid.report.figures import save

    figure = torque_figure(result)
    drawn = [] if figure is None else [save(figure, output.folder / "doctor.png").name]
    output.say(f"written to {output.folder}: " + ", ".join(["doctor.json", *drawn]))
