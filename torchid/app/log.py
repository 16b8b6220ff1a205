"""`torchid log`: what a log is, and what is wrong with it, before anything is computed from it."""

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

import torchid
from torchid.app import options as opt
from torchid.app.inputs import WRITTEN, Suffix
from torchid.app.output import Drawn, Printed, as_text
from torchid.app.signature import command

PICTURE = Suffix((".png",))


@command
def doctor_command(
    *,
    arm: opt.ArmAndLogs,
    apply: Annotated[Path | None, typer.Option(metavar="FILE"), WRITTEN, opt.LOG_SUFFIX] = None,
    fix: Annotated[list[str] | None, typer.Option(metavar="NAME")] = None,
    seed: opt.Seed = 0,
    output: Annotated[Drawn, "doctor.json"],
) -> None:
    """Examine a log before anything is fitted to it: units, signs, joint order, gains, gravity,
    lag, velocities, clock, dropouts, saturation, excitation, runs that contradict each other; with
    evidence, and what to change. The exit code is 1 if something is wrong.

    Example: `torchid log doctor panda.yaml run1.parquet --apply mended.parquet`

    Args:
        apply: Write a copy of the log, all trajectories, with the fixes applied (.parquet, .csv,
            .npz). The logs themselves are never changed.
        fix: Of fixes that are equally good, the one to take, by the name that is said. May be
            given several times; without it --apply takes none of them.
    """
    from torchid.doctor.examine import record
    from torchid.doctor.flag import flag_for
    from torchid.report.doctor import report_of_examination

    robot = arm.load()
    log = arm.read(arm.logs, robot)
    with output.progress("examining the log"):
        result = torchid.examine(robot, log, fix or ())
    output.put(apply, lambda path: torchid.write_log(result.mended(), path))
    # The fixes as --columns, where the logs have columns of our names.
    flag = None if arm.columns or arm.topic else flag_for(result.repairs, robot.n, arm.logs)
    output.give(
        record(result, flag), "doctor.json", lambda _: report_of_examination(result), seed=seed
    )
    if apply is not None:
        count = len(result.repairs)
        output.say(f"{apply} is a copy with {count} fix{'es' if count != 1 else ''}")
    elif result.repairs:
        output.say("--apply FILE writes a copy with the fixes that can be applied")
    if flag is not None:
        output.say(f'or read the log with --columns "{flag}"')
    if any(check.verdict == "wrong" for check in result.checks):
        raise typer.Exit(1)


@command
def show_command(
    *,
    logs: opt.LogArguments,
    robot: opt.RobotOption = None,
    reading: opt.Reading,
    part: opt.Part,
    save: Annotated[
        Path | None, typer.Option("--save", "--out", metavar="FILE"), WRITTEN, opt.LOG_SUFFIX
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png"), WRITTEN, PICTURE] = None,
    output: Printed,
) -> None:
    """Print what a log is seen as: format, joints, sampling, ranges, units, and what is odd.

    Example: `torchid log show run1.csv --columns "q=pos_{j} deg,tau=eff_{j},t=time ms" --save
    run1.parquet`

    Args:
        robot: The robot it is of: joints by name, and what only a robot can tell is checked.
        save: Write what was read as .parquet, .csv or .npz, in our columns and units; currents
            also as torque, where the drive gains are known.
        plot: Write a picture of every channel over time; what looks wrong is
            red, with the reason.
    """
    from torchid.design.repeats import repeated_motion
    from torchid.inputs import with_drive_gain
    from torchid.log.overview import look_at, overview_record
    from torchid.report.log import report_of_log, signals_figure
    from torchid.report.panels import save as save_picture
    from torchid.robot.model import JointType

    checked: dict[str, Any] = {}
    model = None if robot is None else opt.load(robot, part)
    if model is not None:
        checked = {
            "robot_name": model.name,
            "position_limits": model.limits.position,
            "effort": model.limits.effort,
            "prismatic": [kind is JointType.PRISMATIC for kind in model.joint_types],
            "moving_base": model.floating,
        }
    request = reading.request(model)
    seen = look_at(logs, request, **checked)
    repeats = repeated_motion(seen.log) if seen.problem is None else ()
    record = overview_record(seen)
    log = reading.with_torque(seen.log, seen.log.n)
    log = log if model is None else with_drive_gain(log, model)
    output.write_json({**record, "repeats": [dict(vars(r)) for r in repeats]}, "log.json")
    output.put(save, partial(torchid.write_log, log))
    if plot is not None:
        output.put(plot, partial(save_picture, signals_figure(log, seen.odd)))
    output.tell(report_of_log(seen, repeats))
    if seen.problem is not None:
        output.say(as_text("this log cannot be used as it is: ", "red") + as_text(seen.problem))
    if save is not None:
        gained = "" if log is seen.log else ", with torque: current times the drive gains"
        output.say(f"{log.samples} samples{gained}")


LOG = doctor_command, show_command
