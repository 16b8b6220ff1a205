"""`torchid gap`: where simulator and arm disagree, which effects cause it, how far it shrinks."""

from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from torchid.app import options as opt
from torchid.app.output import Output, Results, progress_bar, write_report
from torchid.app.signature import Fields, command
from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings

if TYPE_CHECKING:
    from torchid.log.model import Log
    from torchid.robot.model import Robot


@command
def gap_command(
    *,
    trials: opt.Trials,
    effects: str = "all",
    background: opt.Names = "none",
    cutoff: Annotated[str, typer.Option(metavar="HZ|auto")] = "auto",
    settings: Annotated[
        GapSettings,
        Fields(
            "rollout",
            parameters=Literal["trusted", "free", "auto"],
            held_out_fraction=opt.HeldOutFraction,
            worthwhile=opt.LessThanOne,
            worthwhile_torque=opt.LessThanOne,
            gain_std=opt.Share,
            max_effects=opt.Count,
            seed=opt.Seed,
        ),
    ],
    save_model: opt.File = None,
    results: Results,
) -> None:
    """Find where a simulator's torque and the arm's disagree, which unmodelled effects cause it,
    and how far the gap shrinks with them.

    Logs of commands u1.. and positions alone are explained by what lies between the two: servos,
    friction, set-points, stops; errors are then in mrad.

    Example: `torchid gap so101.urdf run1.parquet run2.parquet --save-model corrected.yaml`

    Example: `torchid gap panda.urdf run1.parquet run2.parquet --held-out run3.parquet
    --out result --save-model corrected.yaml --report gap.html`

    Args:
        effects: Effects to search over, comma-separated; `all` for the whole library.
        background: Effects that are part of the simulator already, on every joint, e.g.
            viscous_friction,coulomb_friction,torque_offset; fitted with the base parameters where
            the robot has no parameters.
        parameters: The robot's inertial parameters: right, to be refitted first, or one possible
            cause among the effects.
        cutoff: Cut-off of the fit's zero-phase filter.
        worthwhile: Least share of a joint's held-out error that a cause must take away to be named.
        worthwhile_torque: The same, as a share of the joint's torque.
        gain_std: How well the scale of each joint's torque is known, one standard deviation as a
            share of it: ± holds it. By default 0.05 for currents times --gain, else 0.
        rollout: Simulate short motions with the model before and after.
        save_model: Write the corrected robot, with its effects, as a .yaml.
    """
    output = results.open()
    if save_model is not None and (save_model.is_dir() or not save_model.parent.is_dir()):
        raise TorchidError(
            "--save-model needs a file in a folder that exists.",
            got=save_model,
            expected="FILE.yaml",
        )
    settings = replace(
        settings,
        effects=opt.searched(effects),
        background=opt.names(background),
        cutoff=opt.auto_hz(cutoff),
    )
    if trials.held_out and settings.held_out_fraction:
        raise TorchidError("--held-out and --held-out-fraction exclude each other.")
    found, log, apart, files = trials.open(output)
    if log.u is not None and log.tau is None and (log.current is None or found.drive_gain is None):
        _positions(output, found, log, apart, save_model, settings, asked_page=results.report)
        return
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
    output.write_json({**record(result), "seed": settings.seed}, "gap.json")
    if save_model is not None:
        write_robot(result.corrected, save_model)
        output.say(f"corrected robot written to {save_model}")
    # The worst joints of an earlier run may have been others.
    output.draw(lambda: figures(result), "gap.json", old=["gap_joint_*.png"])
    asked = {k: v for k, v in result.settings.items() if k not in ("seed", "only")}
    asked["effects"] = asked["effects"] or "all"
    asked |= {"band of the report [Hz]": result.band, "cut-off [Hz]": result.cutoff}
    write_report(
        output,
        lambda origin: gap_page(result, origin),
        files=files,
        seeds={"seed": settings.seed},
        settings=asked,
    )


def _positions(
    output: Output,
    robot: "Robot",
    log: "Log",
    apart: "Log | None",
    save_model: Path | None,
    settings: GapSettings,
    asked_page: Path | None,
) -> None:
    """The diagnosis of logs that have commands and no torques."""
    from rich.markup import escape

    from torchid.position.diagnose import diagnose_positions
    from torchid.position.model import accuracy, write_model
    from torchid.position.record import record
    from torchid.report.position import position_tables, position_verdict

    default = GapSettings(seed=settings.seed)
    changed = [
        f.name for f in fields(settings) if getattr(settings, f.name) != getattr(default, f.name)
    ]
    if changed or asked_page is not None:
        raise TorchidError(
            "these logs have commands and positions and no torques.",
            got=", ".join(f"--{name.replace('_', '-')}" for name in changed) or "--report",
            expected="of the options on how to search and report, none",
        )
    with progress_bar(output, lines=True) as progress:
        result = diagnose_positions(robot, log, progress=progress)
    output.verdict(position_verdict(result))
    output.say(*position_tables(result))
    output.warn(result.warnings)
    data = {**record(result), "seed": settings.seed}
    if apart is not None:
        whole, windows = accuracy(robot, result.servos, result.data.scale, apart)
        data["held_out"] = {"whole_mrad": whole, "windows_2s_mrad": windows}
        output.say(f"held-out logs: {whole:.1f} mrad, in windows of 2 s {windows:.1f} mrad")
    output.write_json(data, "gap.json")
    if save_model is not None:
        write_model(robot, result.servos, result.data.scale, save_model)
        output.say(escape(f"robot with its servos written to {save_model}"))
