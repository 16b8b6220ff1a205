"""`torchid gap`: where simulator and arm disagree, which effects cause it, how far it shrinks."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from torchid.app import options as opt
from torchid.app.output import open_output, progress_bar
from torchid.app.page import hashed, log_inputs, robot_input, write_report
from torchid.errors import TorchidError


def gap_command(
    robot: opt.RobotArgument,
    logs: opt.LogArguments,
    effects: Annotated[
        str,
        typer.Option(help="Effects to search over, comma-separated; `all` for the whole library."),
    ] = "all",
    background: Annotated[
        str,
        typer.Option(
            metavar="A,B,C",
            help="Effects that are part of the simulator already, on every joint, e.g. "
            "viscous_friction,coulomb_friction,torque_offset; fitted with the base parameters "
            "where the robot has no parameters.",
        ),
    ] = "none",
    parameters: Annotated[
        Literal["trusted", "free", "auto"],
        typer.Option(
            help="The robot's inertial parameters: right, to be refitted first, or one possible "
            "cause among the effects."
        ),
    ] = "auto",
    cutoff: Annotated[
        str, typer.Option(metavar="HZ|auto", help="Cut-off of the fit's zero-phase filter.")
    ] = "auto",
    held_out: opt.HeldOut = None,
    held_out_fraction: opt.HeldOutFraction = 0.0,
    columns: opt.Columns = None,
    topic: opt.Topic = None,
    gain: opt.Gain = None,
    worthwhile: Annotated[
        float,
        typer.Option(
            min=0,
            max=0.99,
            help="Least share of a joint's held-out error that a cause must take away to be named.",
        ),
    ] = 0.05,
    worthwhile_torque: Annotated[
        float,
        typer.Option(min=0, max=0.99, help="The same, as a share of the joint's torque."),
    ] = 0.01,
    max_effects: Annotated[
        int, typer.Option(min=1, help="Number of effects accepted at most.")
    ] = 20,
    rollout: Annotated[
        bool,
        typer.Option(
            "--rollout/--no-rollout", help="Simulate short motions with the model before and after."
        ),
    ] = True,
    save_model: Annotated[
        Path | None,
        typer.Option(
            "--save-model",
            metavar="FILE",
            help="Write the corrected robot, with its effects, as a .yaml.",
        ),
    ] = None,
    tip: opt.Tip = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    report: opt.Report = None,
    seed: opt.Seed = 0,
    quiet: opt.Quiet = False,
    threads: opt.Threads = None,
) -> None:
    """Find where a simulator's torque and the arm's disagree, which unmodelled effects cause it,
    and how far the gap shrinks with them.

    Example: `torchid gap panda.urdf run1.parquet run2.parquet --held-out run3.parquet
    --out result --save-model corrected.yaml --report gap.html`
    """
    output = open_output(json_file, out, quiet, threads, report)
    if save_model is not None and (save_model.is_dir() or not save_model.parent.is_dir()):
        raise TorchidError(
            "--save-model needs a file in a folder that exists.",
            got=save_model,
            expected="FILE.yaml",
        )
    from torchid.gap.settings import GapSettings
    from torchid.robot.library import load_robot

    settings = GapSettings(
        effects=opt.searched(effects),
        background=opt.names(background),
        parameters=parameters,
        cutoff=opt.auto_hz(cutoff),
        worthwhile=worthwhile,
        worthwhile_torque=worthwhile_torque,
        max_effects=max_effects,
        held_out_fraction=held_out_fraction,
        rollout=rollout,
        seed=seed,
    )
    if held_out and held_out_fraction:
        raise TorchidError("--held-out and --held-out-fraction exclude each other.")
    found = load_robot(robot, tip=tip)
    files = hashed(output, [robot_input(robot), *log_inputs(logs, held_out)])
    log, apart = opt.read_both(logs, held_out, gain, found, columns, topic)
    from rich.markup import escape

    from torchid.gap.diagnose import diagnose
    from torchid.gap.record import record
    from torchid.report.gap import gap_page, remarks, tables
    from torchid.report.gap_figures import figures
    from torchid.report.gap_words import verdict
    from torchid.robot.writer import write_robot

    with progress_bar(output, lines=True) as progress:
        result = diagnose(found, log, held_out=apart, settings=settings, progress=progress)
    output.verdict(verdict(result))
    output.say(*tables(result), *(escape(remark) for remark in remarks(result)))
    output.warn(result.warnings)
    output.write_json({**record(result), "seed": seed}, "gap.json")
    if save_model is not None:
        write_robot(result.corrected, save_model)
        output.say(f"corrected robot written to {save_model}")
    if out is not None:
        for old in out.glob("gap_joint_*.png"):
            old.unlink()  # of an earlier run, whose worst joints may have been others
    output.draw(lambda: figures(result), "gap.json")
    asked = {k: v for k, v in result.settings.items() if k not in ("seed", "only")}
    asked["effects"] = asked["effects"] or "all"
    asked |= {"band of the report [Hz]": result.band, "cut-off [Hz]": result.cutoff}
    write_report(
        output,
        lambda origin: gap_page(result, origin),
        files=files,
        seeds={"seed": seed},
        settings=asked,
    )
