"""`torchid log doctor`: what is wrong with a log, before anything is fitted to it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from torchid.app.options import (
    Columns,
    Gain,
    Json,
    LogArguments,
    Out,
    Quiet,
    RobotArgument,
    Seed,
    Threads,
    Tip,
    Topic,
    read_logs,
)
from torchid.app.output import Output, open_output
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
    fix: Annotated[
        list[str] | None,
        typer.Option(
            "--fix",
            metavar="NAME",
            help="Of fixes that are equally good, the one to take, by the name that is said. May "
            "be given several times; without it --apply takes none of them.",
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
    result = examine(found, read_logs(logs, gain, found, columns, topic), fix or ())
    if apply is not None:
        write_log(result.mended(), apply)
    flag = None if columns or topic else _flag(result, logs)
    _show(result, output, apply, flag)
    output.write_json({**record(result, flag), "seed": seed}, "doctor.json")
    _draw(result, output)


def _same(one: Path, other: Path) -> bool:
    return one.exists() and other.exists() and one.samefile(other)


def _flag(result: "Examination", logs: list[Path]) -> str | None:
    """The fixes as --columns, where the logs have columns of our names."""
    if not result.repairs:
        return None
    from torchid.doctor.flag import columns_flag
    from torchid.log.readers import open_log
    from torchid.log.table import Request

    tables = [open_log(log, Request())[0] for log in logs]
    names = [set() if table is None else set(table.columns) for table in tables]
    return columns_flag(result.repairs, result.robot.n, set.intersection(*names))


def _show(result: "Examination", output: Output, apply: Path | None, flag: str | None) -> None:
    from torchid.doctor.conclusion import conclusion
    from torchid.report.doctor import choices, fine, tables

    for table in tables(result):
        output.say(table)
    output.say(fine(result))
    output.say(f"\n{escape(conclusion(result))}")
    if result.undecided:
        output.say(escape(choices(result)))
    if apply is not None:
        count = len(result.repairs)
        output.say(f"written to {apply}: a copy with {count} fix{'es' if count != 1 else ''}")
    elif result.repairs:
        output.say("--apply FILE writes a copy with the fixes that can be applied")
    if flag is not None:
        output.say(escape(f'or read the log with --columns "{flag}"'))


def _draw(result: "Examination", output: Output) -> None:
    """Measured torque against what bodies explain, for --out."""
    if output.folder is None:
        return
    from torchid.report.doctor import torque_figure
    from torchid.report.figures import save

    figure = torque_figure(result)
    drawn = [] if figure is None else [save(figure, output.folder / "doctor.png").name]
    output.say(f"written to {output.folder}: " + ", ".join(["doctor.json", *drawn]))
