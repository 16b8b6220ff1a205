"""`torchid identify`: base parameters from logs."""

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from torchid.app import options as opt
from torchid.app.output import open_output, progress_bar
from torchid.app.page import hashed, log_inputs, robot_input, write_report
from torchid.errors import TorchidError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from torchid.identification.identify import Identification


def identify_command(
    robot: opt.RobotArgument,
    logs: opt.LogArguments,
    effects: Annotated[
        str,
        typer.Option(
            metavar="NAME[:joint=J,SHAPE=V],..",
            help="Effects, comma-separated: on every joint, or at one place; shapes that are not "
            "given are searched. `none` for the rigid body.",
        ),
    ] = opt.FITTED,
    held_out: opt.HeldOut = None,
    held_out_fraction: opt.HeldOutFraction = 0.0,
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
    columns: opt.Columns = None,
    topic: opt.Topic = None,
    gain: opt.Gain = None,
    method: opt.Method = "huber",
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
    tip: opt.Tip = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    report: opt.Report = None,
    seed: opt.Seed = 0,
    quiet: opt.Quiet = False,
    threads: opt.Threads = None,
    device_name: opt.Device = "cpu",
) -> None:
    """Identify base parameters and friction from logs, with standard deviations and validation.

    Example: `torchid identify panda.yaml run1.parquet run2.parquet --held-out run3.parquet
    --out result --report result.html`
    """
    output = open_output(json_file, out, quiet, threads, report)
    from torchid.identification.identify import Settings, identify
    from torchid.identification.record import record
    from torchid.report.identification import headline, identification_page, tables
    from torchid.robot.library import load_robot

    fraction: float | Literal["auto"] = "auto"
    if reversal != "auto":
        fraction = opt.number("--reversal", reversal, "a fraction of the 99 % speed, or `auto`")
        if not 0 <= fraction < 1:
            raise TorchidError(
                "--reversal is a fraction of the 99 % speed.", got=reversal, expected="0..1"
            )
    settings = Settings(
        effects=_effects(effects),
        cutoff=opt.cutoff_hz(cutoff),
        reversal=fraction,
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
    log, apart = opt.read_both(logs, held_out, gain, found, columns, topic)
    with progress_bar(output, lines=True) as progress:
        result = identify(
            found,
            log,
            held_out=apart,
            settings=settings,
            device=opt.device(device_name),
            progress=progress,
        )
    output.say(*tables(result))
    output.warn(result.warnings)
    output.say(f"\n{headline(result)}")
    data = {**record(result), "seed": seed}
    output.write_json(data, "identification.json")
    if out is not None:
        for old in (*out.glob("fit_*.png"), *out.glob("held_out_*.png")):
            old.unlink()  # of an earlier run, whose trajectories may have had other names
    output.draw(lambda: _figures(result), "identification.json")
    write_report(
        output,
        lambda origin: identification_page(result, origin),
        files=files,
        seeds={"seed": seed},
        settings=data["settings"] | {"cut-off used [Hz]": result.cutoff},
    )


def _effects(text: str) -> tuple[str, ...]:
    """Effects as written; an unknown or unfit one is refused before any file is read."""
    from torchid.effects.registry import fitted_kind
    from torchid.effects.written import name_and_pairs, split_list

    written = split_list(text)
    for one in written:
        fitted_kind(name_and_pairs(one, "--effects")[0])
    return written


def _figures(result: "Identification") -> "dict[str, Figure]":
    """How well each parameter is known, and torques of every trajectory."""
    from torchid.report.identification import parameter_figure, torque_figure
    from torchid.report.table import joint_unit

    units = [joint_unit(result.robot, j) for j in range(result.robot.n)]
    drawn = {"parameters": parameter_figure(result)}
    for kind, words, predictions in (
        ("fit", "fitted data", result.fit_predictions),
        ("held_out", "held-out data", result.held_out_predictions),
    ):
        for prediction in predictions:
            name = "".join(c if c.isalnum() or c in "-_." else "_" for c in prediction.name)
            title = f"{prediction.name} ({words})"
            drawn[f"{kind}_{name}"] = torque_figure(prediction, units, title)
    return drawn
