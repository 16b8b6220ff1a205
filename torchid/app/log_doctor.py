"""`torchid log doctor`: what is wrong with a log, before anything is fitted to it."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from torchid.app import options as opt
from torchid.app.output import open_output
from torchid.errors import TorchidError


def doctor_command(
    robot: opt.RobotArgument,
    logs: opt.LogArguments,
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
    columns: opt.Columns = None,
    topic: opt.Topic = None,
    gain: opt.Gain = None,
    tip: opt.Tip = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    seed: opt.Seed = 0,
    quiet: opt.Quiet = False,
    threads: opt.Threads = None,
) -> None:
    """Examine a log before anything is fitted to it: units, signs, joint order, gains, gravity,
    lag, velocities, clock, dropouts, saturation, excitation; with evidence, and what to change.

    Example: `torchid log doctor panda.yaml run1.parquet --apply mended.parquet`
    """
    output = open_output(json_file, out, quiet, threads)
    if apply is not None and any(
        apply.exists() and log.exists() and apply.samefile(log) for log in logs
    ):
        raise TorchidError(
            f"--apply would write over the log '{apply}'.", expected="the name of a new file"
        )
    from torchid.doctor.conclusion import conclusion
    from torchid.doctor.examine import examine
    from torchid.doctor.flag import columns_flag
    from torchid.doctor.record import record
    from torchid.log.readers import open_log, write_log
    from torchid.log.table import Request
    from torchid.report.log import choices, doctor_tables, fine, torque_figure
    from torchid.robot.library import load_robot

    found = load_robot(robot, tip=tip)
    result = examine(found, opt.read_logs(logs, gain, found, columns, topic), fix or ())
    if apply is not None:
        write_log(result.mended(), apply)
    # The fixes as --columns, where the logs have columns of our names.
    flag = None
    if result.repairs and not (columns or topic):
        read = [open_log(log, Request())[0] for log in logs]
        own = [set() if table is None else set(table.columns) for table in read]
        flag = columns_flag(result.repairs, found.n, set.intersection(*own))
    output.say(*doctor_tables(result), fine(result), f"\n{escape(conclusion(result))}")
    if result.undecided:
        output.say(escape(choices(result)))
    if apply is not None:
        count = len(result.repairs)
        output.say(f"written to {apply}: a copy with {count} fix{'es' if count != 1 else ''}")
    elif result.repairs:
        output.say("--apply FILE writes a copy with the fixes that can be applied")
    if flag is not None:
        output.say(escape(f'or read the log with --columns "{flag}"'))
    output.write_json({**record(result, flag), "seed": seed}, "doctor.json")
    output.draw(
        lambda: {} if (figure := torque_figure(result)) is None else {"doctor": figure},
        "doctor.json",
    )
