"""`torchid identify`, `torchid payload`: base parameters from logs, and what the last link
carries."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import typer
from msgspec import structs

import torchid
from torchid.app import options as opt
from torchid.app.inputs import RECORDED
from torchid.app.output import Computed, Reported
from torchid.app.signature import Parsed, command
from torchid.effects.names import DEFAULT_EFFECTS, require_effects
from torchid.effects.written import name_and_pairs, split_list
from torchid.errors import TorchidError
from torchid.identification.settings import Settings


def _effects(text: str) -> tuple[str, ...]:
    """Effects as written; an unknown or unfit one is refused before any file is read."""
    written = split_list(text)
    kinds = [name_and_pairs(one, "--effects")[0] for one in written]
    require_effects(kinds)
    if not set(kinds) <= set(DEFAULT_EFFECTS):
        from torchid.effects.registry import fitted_kind

        for kind in kinds:
            fitted_kind(kind)
    return written


def _reversal(text: str) -> float | Literal["auto"]:
    if text == "auto":
        return "auto"
    fraction = opt.number("--reversal", text, "a fraction of the 99 % speed, or `auto`")
    if not 0 <= fraction < 1:
        raise TorchidError("--reversal is a fraction of the 99 % speed.", got=text, expected="0..1")
    return fraction


_Reversal = Annotated[opt.Cutoff, typer.Option(metavar="FRACTION|auto"), Parsed(_reversal, "0")]
_WrittenEffects = Annotated[
    tuple[str, ...], typer.Option(metavar="NAME[:KEY=VALUE],.."), Parsed(_effects, "none")
]


@command
def identify_command(
    *,
    trials: opt.Trials,
    settings: Annotated[
        Settings,
        opt.FIT.only(
            "rows basis method covariance signs held_out_fraction cutoff essential force "
            "error_cutoff",
            effects=_WrittenEffects,
            reversal=_Reversal,
        ),
    ],
    seed: opt.Seed = 0,
    output: Annotated[Reported, "identification.json"],
    device_name: opt.Device = "cpu",
) -> None:
    """Identify base parameters and friction from logs, with standard deviations and validation.

    Example: `torchid identify panda.yaml run1.parquet run2.parquet --held-out run3.parquet
    --out result --report result.html`

    Args:
        effects: Effects, comma-separated: on every joint, or at one place; shapes that are not
            given are searched. `none` for the rigid body.
        cutoff: Cut-off of the zero-phase filter.
        force: Go on with a log that looks wrong (order or sign of joints, units, gravity, lag), and
            show a result that predicts its own log worse than no model does, too.
        error_cutoff: Report errors under this filter, not the fit's.
    """
    robot, log, apart, files = trials.open(output, settings.held_out_fraction)
    from torchid.report.identification import report_of_identification

    with output.progress("checking the log") as progress:
        doubts = trials.ask_first(robot, [log, apart], trials.logs, settings.force)
        result = torchid.identify(
            robot, log, held_out=apart, settings=settings, device=device_name, progress=progress
        )
    result = replace(result, warnings=(*doubts, *result.warnings))
    used = result.plain()["settings"] | {"cut-off used [Hz]": result.cutoff}
    # Trajectories of an earlier run may have had other names.
    old = ["fit_*.png", "held_out_*.png"]
    output.give(
        result, "identification.json", report_of_identification, seed=seed, old=old, files=files,
        settings=used,
    )  # fmt: skip
    file = output.json_file or (output.out and output.out / "identification.json")
    if file is not None and str(file) != "-":
        output.say(f"For a simulator: torchid export {file} --to urdf --out exported")


@dataclass(frozen=True, kw_only=True)
class _Empty(opt.ArmAndLogs):
    """Robot, and logs without payload, which a model that knows how sure it is goes without."""

    logs: Annotated[list[Path] | None, opt.LOGS, RECORDED] = None  # type: ignore[assignment]


@command
def payload_command(
    *,
    arm: _Empty,
    loaded: Annotated[list[Path], typer.Option(metavar="LOG"), RECORDED],
    model: Literal["general", "symmetric", "point_mass"] = "general",
    settings: Annotated[Settings, opt.FIT.only("signs rows method effects cutoff force")],
    seed: opt.Seed = 0,
    output: Annotated[Computed, "payload.json"],
    device_name: opt.Device = "cpu",
) -> None:
    """Estimate mass, centre of mass and inertia of what the last link carries.

    LOG... are without the payload, --loaded with it, best on the same trajectories. A robot whose
    model was fitted to logs without payload, and says how sure it is, needs none.

    Example: `torchid payload panda.yaml empty1.parquet empty2.parquet --loaded full1.parquet
    --loaded full2.parquet --out result`

    Args:
        loaded: Logs with the payload. May be given several times.
        effects: Effects on every joint, comma-separated; `none` for the rigid body.
        model: All ten parameters; symmetric about the tool's z axis; a point mass.
        cutoff: Cut-off of the zero-phase filter; `auto` chooses it on the logs without payload.
        force: Go on with a log that looks wrong (order or sign of joints, units, gravity, lag).
    """
    robot = arm.load()
    empty = arm.read(arm.logs, robot) if arm.logs else None
    full, forced = arm.read(loaded, robot), settings.force
    from torchid.report.identification import report_of_payload

    with output.progress("checking the logs") as progress:
        doubts = arm.ask_first(robot, [empty], arm.logs, forced) if empty else ()
        doubts += arm.ask_first(robot, [full], loaded, forced, loaded=True)
        carried = torchid.payload(
            robot, empty, full, model=model, settings=settings, device=device_name,
            progress=progress,
        )  # fmt: skip
    carried = structs.replace(carried, warnings=(*doubts, *carried.warnings))
    output.give(carried, "payload.json", report_of_payload, seed=seed)
