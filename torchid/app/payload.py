"""`torchid payload`: what the last link carries, from logs without and with it."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from torchid.app import options as opt
from torchid.app.output import open_output, progress_bar


def payload_command(
    robot: opt.RobotArgument,
    logs: opt.LogArguments,
    loaded: Annotated[
        list[Path],
        typer.Option(
            "--loaded", metavar="LOG", help="Logs with the payload. May be given several times."
        ),
    ],
    effects: opt.FittedEffects = opt.FITTED,
    model: Annotated[
        Literal["general", "symmetric", "point_mass"],
        typer.Option(help="All ten parameters; symmetric about the tool's z axis; a point mass."),
    ] = "general",
    cutoff: Annotated[
        str,
        typer.Option(
            metavar="HZ|auto|none",
            help="Cut-off of the zero-phase filter; `auto` chooses it on the logs without payload.",
        ),
    ] = "auto",
    columns: opt.Columns = None,
    topic: opt.Topic = None,
    gain: opt.Gain = None,
    rows: Annotated[
        Literal["all", "moving"],
        typer.Option(
            help="Rows fitted. At rest friction can hold any torque, and so part of a payload's."
        ),
    ] = "moving",
    method: opt.Method = "huber",
    signs: Annotated[
        Literal["bounded", "free"],
        typer.Option(help="Coefficients physics forbids to be negative: hold at zero, or leave."),
    ] = "bounded",
    tip: opt.Tip = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    seed: opt.Seed = 0,
    quiet: opt.Quiet = False,
    threads: opt.Threads = None,
    device_name: opt.Device = "cpu",
) -> None:
    """Estimate mass, centre of mass and inertia of what the last link carries.

    LOG... are without the payload, --loaded with it, best on the same trajectories.

    Example: `torchid payload panda.yaml empty1.parquet empty2.parquet --loaded full1.parquet
    --loaded full2.parquet --out result`
    """
    output = open_output(json_file, out, quiet, threads)
    from torchid.identification.identify import Settings, identify
    from torchid.identification.payload import estimate_payload, record
    from torchid.report.identification import payload_headline, payload_tables
    from torchid.robot.library import load_robot

    settings = Settings(
        effects=opt.effect_names(effects),
        cutoff=opt.cutoff_hz(cutoff),
        rows=rows,
        method=method,
        signs=signs,
    )
    found = load_robot(robot, tip=tip)
    empty = opt.read_logs(logs, gain, found, columns, topic)
    full = opt.read_logs(loaded, gain, found, columns, topic)
    where = opt.device(device_name)
    with progress_bar(output) as progress:
        without = identify(found, empty, settings=settings, device=where, progress=progress)
        # One filter for both: what it does to the parameters then cancels in their difference.
        same = replace(settings, cutoff=without.cutoff)
        carrying = identify(found, full, settings=same, device=where, progress=progress)
    payload = estimate_payload(without, carrying, model=model)
    noticed = dict.fromkeys(
        [
            *(f"without payload: {w}" for w in without.warnings),
            *(f"with payload: {w}" for w in carrying.warnings),
            *payload.warnings,
        ]
    )
    output.say(*payload_tables(payload))
    output.warn(noticed)
    output.say(f"\n{payload_headline(payload)}")
    data = {**record(payload), "cutoff_hz": without.cutoff, "seed": seed}
    output.write_json({**data, "warnings": list(noticed)}, "payload.json")
