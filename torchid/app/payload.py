"""`torchid payload`: what the last link carries, from logs without and with it."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import torchid
from torchid.app import options as opt
from torchid.app.output import Computed
from torchid.app.signature import Fields, command
from torchid.identification.settings import Settings


@command
def payload_command(
    *,
    arm: opt.ArmAndLogs,
    loaded: Annotated[list[Path], typer.Option(metavar="LOG")],
    model: Literal["general", "symmetric", "point_mass"] = "general",
    settings: Annotated[
        Settings,
        Fields(
            "signs",
            "rows",
            effects=opt.FittedEffects,
            cutoff=opt.FilterCutoff,
            method=opt.Method,
        ),
    ],
    seed: opt.Seed = 0,
    output: Computed,
    device_name: opt.Device = "cpu",
) -> None:
    """Estimate mass, centre of mass and inertia of what the last link carries.

    LOG... are without the payload, --loaded with it, best on the same trajectories.

    Example: `torchid payload panda.yaml empty1.parquet empty2.parquet --loaded full1.parquet
    --loaded full2.parquet --out result`

    Args:
        loaded: Logs with the payload. May be given several times.
        model: All ten parameters; symmetric about the tool's z axis; a point mass.
        cutoff: Cut-off of the zero-phase filter; `auto` chooses it on the logs without payload.
        rows: Rows fitted. At rest friction can hold any torque, and so part of a payload's.
        signs: Coefficients physics forbids to be negative: hold at zero, or leave.
    """
    from torchid.report.identification import payload_shown

    found = arm.load()
    empty, full = arm.read(arm.logs, found), arm.read(loaded, found)
    where = opt.device(device_name)
    with output.progress() as progress:
        carried = torchid.payload(
            found, empty, full, model=model, settings=settings, device=where, progress=progress
        )
    output.give(carried, "payload.json", payload_shown, seed=seed)
