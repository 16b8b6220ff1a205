"""`torchid gap`: where simulator and arm disagree, which effects cause it, how far it shrinks."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from torchid.app.options import (
    Columns,
    Gain,
    HeldOut,
    HeldOutFraction,
    Json,
    LogArguments,
    Out,
    Quiet,
    Report,
    RobotArgument,
    Seed,
    Threads,
    Tip,
    Topic,
    number,
    read_both,
)
from torchid.app.output import Output, open_output, progress_bar
from torchid.app.page import hashed, log_inputs, robot_input, write_report
from torchid.errors import TorchidError

if TYPE_CHECKING:
    from torchid.gap.diagnosis import Diagnosis
    from torchid.report.page.origin import InputFile


def gap_command(
    robot: RobotArgument,
    logs: LogArguments,
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
    held_out: HeldOut = None,
    held_out_fraction: HeldOutFraction = 0.0,
    columns: Columns = None,
    topic: Topic = None,
    gain: Gain = None,
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
    tip: Tip = None,
    json_file: Json = None,
    out: Out = None,
    report: Report = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
) -> None:
    """Find where a simulator's torque and the arm's disagree, which unmodelled effects cause it,
    and how far the gap shrinks with them.

    Example: `torchid gap panda.urdf run1.parquet run2.parquet --held-out run3.parquet
    --out result --save-model corrected.yaml --report gap.html`
    """
    output = open_output(json_file, out, quiet, threads, report)
    if save_model is not None:
        _refuse_missing_folder(save_model)
    from torchid.gap.settings import GapSettings
    from torchid.robot.library import load_robot

    settings = GapSettings(
        effects=searched(effects),
        background=names(background),
        parameters=parameters,
        cutoff=_cutoff(cutoff),
        max_effects=max_effects,
        held_out_fraction=held_out_fraction,
        rollout=rollout,
        seed=seed,
    )
    if held_out and held_out_fraction:
        raise TorchidError("--held-out and --held-out-fraction exclude each other.")
    found = load_robot(robot, tip=tip)
    files = hashed(output, [robot_input(robot), *log_inputs(logs, held_out)])
    log, apart = read_both(logs, held_out, gain, found, columns, topic)
    from torchid.gap.diagnose import diagnose
    from torchid.gap.record import record

    with progress_bar(output, lines=True) as progress:
        result = diagnose(
            found,
            log,
            held_out=apart,
            settings=settings,
            progress=progress,
        )
    _show(result, output)
    output.write_json({**record(result), "seed": seed}, "gap.json")
    _save_model(result, save_model, output)
    _draw(result, output)
    _report(result, output, files)


def searched(text: str) -> tuple[str, ...] | None:
    """The --effects option: names, or None for `all`.

    Raises:
        TorchidError: no name at all.
    """
    if text.strip() == "all":
        return None
    found = names(text)
    if not found:
        raise TorchidError(
            "--effects leaves nothing to search over.", got=text, hint="`all` for the whole library"
        )
    return found


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas; `none` for none. The settings check that they exist."""
    if text.strip() in ("", "none"):
        return ()
    return tuple(name.strip() for name in text.split(","))


def _cutoff(text: str) -> float | Literal["auto"]:
    if text == "auto":
        return "auto"
    value = number("--cutoff", text, "a frequency in Hz, or `auto`")
    if value <= 0:
        raise TorchidError("--cutoff must be positive.", got=text)
    return value


def _refuse_missing_folder(path: Path) -> None:
    """Before any work is done."""
    if path.is_dir() or not path.parent.is_dir():
        raise TorchidError(
            "--save-model needs a file in a folder that exists.", got=path, expected="FILE.yaml"
        )


def _show(result: "Diagnosis", output: Output) -> None:
    """The verdict first, then what it rests on."""
    from rich.markup import escape

    from torchid.report.gap import remarks, tables
    from torchid.report.gap_words import verdict

    output.say(f"[bold]{escape(verdict(result))}[/]\n")
    for table in tables(result):
        output.say(table)
    for remark in remarks(result):
        output.say(escape(remark))
    output.warn(result.warnings)


def _save_model(result: "Diagnosis", path: Path | None, output: Output) -> None:
    if path is None:
        return
    from torchid.robot.writer import write_robot

    write_robot(result.corrected, path)
    output.say(f"corrected robot written to {path}")


def _draw(result: "Diagnosis", output: Output) -> None:
    """Figures for --out."""
    if output.folder is None:
        return
    from torchid.report.figures import save
    from torchid.report.gap_figures import figures

    for old in output.folder.glob("gap_joint_*.png"):
        old.unlink()  # of an earlier run, whose worst joints may have been others
    drawn = [save(f, output.folder / f"{name}.png") for name, f in figures(result).items()]
    output.say(f"written to {output.folder}: gap.json, " + ", ".join(p.name for p in drawn))


def _report(result: "Diagnosis", output: Output, files: "Sequence[InputFile]") -> None:
    from torchid.report.page.gap import gap_page

    asked = result.settings
    settings = {k: v for k, v in asked.items() if k not in ("seed", "only")}
    settings["effects"] = asked["effects"] or "all"
    write_report(
        output,
        lambda origin: gap_page(result, origin),
        files=files,
        seeds={"seed": asked["seed"]},
        settings=settings | {"band of the report [Hz]": result.band, "cut-off [Hz]": result.cutoff},
    )
