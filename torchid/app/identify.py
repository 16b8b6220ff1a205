"""`torchid identify`: base parameters from logs."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from torchid.app.options import (
    Columns,
    Device,
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
    cutoff_hz,
    device,
    effect_names,
    number,
    read_both,
)
from torchid.app.output import Output, open_output, progress_bar
from torchid.app.page import hashed, log_inputs, robot_input, write_report
from torchid.errors import TorchidError

if TYPE_CHECKING:
    from torchid.identification.identify import Identification
    from torchid.report.page.origin import InputFile

EFFECTS = "viscous_friction,coulomb_friction,torque_offset,rotor_inertia"


def identify_command(
    robot: RobotArgument,
    logs: LogArguments,
    effects: Annotated[
        str,
        typer.Option(help="Effects on every joint, comma-separated; `none` for the rigid body."),
    ] = EFFECTS,
    held_out: HeldOut = None,
    held_out_fraction: HeldOutFraction = 0.0,
    cutoff: Annotated[
        str, typer.Option(metavar="HZ|auto|none", help="Cut-off of the zero-phase filter.")
    ] = "auto",
    reversal: Annotated[
        str,
        typer.Option(
            metavar="FRACTION|auto",
            help="Speed at which a joint's direction counts as reversed, as a fraction of its "
            "99 % speed.",
        ),
    ] = "auto",
    rows: Annotated[
        Literal["all", "moving"],
        typer.Option(help="Rows fitted: all, or while the own joint moves."),
    ] = "all",
    columns: Columns = None,
    topic: Topic = None,
    gain: Gain = None,
    method: Annotated[
        Literal["ols", "wls", "huber"], typer.Option(help="Least squares: plain, weighted, robust.")
    ] = "huber",
    covariance: Annotated[
        Literal["diagonal", "full"],
        typer.Option(help="Noise between joints, for wls and huber."),
    ] = "diagonal",
    signs: Annotated[
        Literal["bounded", "free"],
        typer.Option(
            help="Coefficients physics forbids to be negative: hold at zero or above, or only "
            "report them.",
        ),
    ] = "bounded",
    essential: Annotated[
        bool, typer.Option("--essential", help="Drop parameters that cannot be told from zero.")
    ] = False,
    error_cutoff: Annotated[
        float | None,
        typer.Option(metavar="HZ", help="Report errors under this filter, not the fit's."),
    ] = None,
    compiled: Annotated[
        bool,
        typer.Option(
            "--compile", help="Compile the regressor (needs a C++ compiler); for very long logs."
        ),
    ] = False,
    tip: Tip = None,
    json_file: Json = None,
    out: Out = None,
    report: Report = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    device_name: Device = "cpu",
) -> None:
    """Identify base parameters and friction from logs, with standard deviations and validation.

    Example: `torchid identify panda.yaml run1.parquet run2.parquet --held-out run3.parquet
    --out result --report result.html`
    """
    output = open_output(json_file, out, quiet, threads, report)
    from torchid.identification.identify import Settings, identify
    from torchid.identification.record import record
    from torchid.robot.library import load_robot

    settings = Settings(
        effects=effect_names(effects),
        cutoff=cutoff_hz(cutoff),
        reversal=_reversal(reversal),
        rows=rows,
        method=method,
        covariance=covariance,
        signs=signs,
        essential=essential,
        held_out_fraction=held_out_fraction,
        error_cutoff=error_cutoff,
        compiled=compiled,
    )
    found = load_robot(robot, tip=tip)
    files = hashed(output, [robot_input(robot), *log_inputs(logs, held_out)])
    log, apart = read_both(logs, held_out, gain, found, columns, topic)
    with progress_bar(output, lines=True) as progress:
        result = identify(
            found,
            log,
            held_out=apart,
            settings=settings,
            device=device(device_name),
            progress=progress,
        )
    _show(result, output)
    data = {**record(result), "seed": seed}
    output.write_json(data, "identification.json")
    _draw(result, output)
    _report(result, data, output, files)


def _show(result: "Identification", output: Output) -> None:
    from torchid.report.identification import headline, tables

    for table in tables(result):
        output.say(table)
    output.warn(result.warnings)
    output.say(f"\n{headline(result)}")


def _draw(result: "Identification", output: Output) -> None:
    """Figures for --out: torques of every trajectory, and how well each parameter is known."""
    if output.folder is None:
        return
    from torchid.report.figures import parameter_figure, save, torque_figure
    from torchid.robot.model import JointType

    units = ["N" if t is JointType.PRISMATIC else "N m" for t in result.robot.joint_types]
    for old in (*output.folder.glob("fit_*.png"), *output.folder.glob("held_out_*.png")):
        old.unlink()  # of an earlier run, whose trajectories may have had other names
    drawn = [save(parameter_figure(result), output.folder / "parameters.png")]
    sets: tuple[tuple[str, Any], ...] = (
        ("fit", result.fit_predictions),
        ("held_out", result.held_out_predictions),
    )
    for kind, predictions in sets:
        for prediction in predictions:
            words = "held-out data" if kind == "held_out" else "fitted data"
            figure = torque_figure(prediction, units, f"{prediction.name} ({words})")
            name = "".join(c if c.isalnum() or c in "-_." else "_" for c in prediction.name)
            drawn.append(save(figure, output.folder / f"{kind}_{name}.png"))
    output.say(f"written to {output.folder}: identification.json, " + ", ".join(
        path.name for path in drawn
    ))  # fmt: skip


def _report(
    result: "Identification", data: dict[str, Any], output: Output, files: "Sequence[InputFile]"
) -> None:
    from torchid.report.page.identification import identification_page

    write_report(
        output,
        lambda origin: identification_page(result, origin),
        files=files,
        seeds={"seed": data["seed"]},
        settings=data["settings"] | {"cut-off used [Hz]": result.cutoff},
    )


def _reversal(text: str) -> float | Literal["auto"]:
    if text == "auto":
        return "auto"
    value = number("--reversal", text, "a fraction of the 99 % speed, or `auto`")
    if not 0 <= value < 1:
        raise TorchidError("--reversal is a fraction of the 99 % speed.", got=text, expected="0..1")
    return value
