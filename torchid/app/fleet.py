"""`torchid fleet`: many units of one robot type, many logs, one machine or several."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import torchid
from torchid.app import options as opt
from torchid.app.output import Kept, Output, Reported
from torchid.app.signature import Parsed, Switch, command
from torchid.errors import TorchidError
from torchid.fleet.settings import FleetSettings
from torchid.gap.settings import GapSettings

if TYPE_CHECKING:
    from torchid.fleet.manifest import FleetLog
    from torchid.fleet.model import FleetModel
    from torchid.parallel.store import Store
    from torchid.parallel.workers import Workers


def _part(text: str) -> tuple[int, int]:
    """--array i/n."""
    first, _, last = text.partition("/")
    if not (first.isdigit() and last.isdigit() and 1 <= int(first) <= int(last)):
        raise TorchidError("--array is no part.", got=text, expected="I/N with 1 <= I <= N")
    return int(first), int(last)


@dataclass(frozen=True, kw_only=True)
class Units(opt.Arm, opt.Reading):
    """One robot type and the logs of its units.

    Attributes:
        manifest: Table (.csv, .parquet) with the columns log, unit, session, in place of LOG...;
            paths are relative to it.
    """

    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[LOG...]",
            help="Logs, or folders of them: the folder that a log lies in is its unit, its own "
            "name the session.",
        ),
    ] = None
    manifest: opt.File = None


@dataclass(frozen=True, kw_only=True)
class Engine(opt.Crew):
    """Who does the work, and what is kept.

    Attributes:
        array: The I-th of N parts of the logs, for batch systems; the rest of the work is done by a
            run without it.
        store: Folder or URL (s3://, gs://) of what is computed already; all workers see it
            (default: DIR/store).
    """

    array: Annotated[tuple[int, int] | None, typer.Option(metavar="I/N"), Parsed(_part)] = None
    store: Annotated[str | None, typer.Option(metavar="DIR|URL")] = None

    def begin(
        self, units: Units, settings: FleetSettings, output: Output
    ) -> "tuple[FleetModel, tuple[FleetLog, ...], Workers, Store | None]":
        """What logs are reduced to, the logs, who reduces them, and where answers are kept: None
        for this run only."""
        from torchid.fleet.manifest import logs_of
        from torchid.fleet.model import FleetModel
        from torchid.parallel.store import Store, is_url

        crew = self.crew
        place = self.store or (output.out and str(output.out / "store"))
        if place is None and (self.array or self.scheduler):
            raise TorchidError(
                "what several machines compute needs a place that all of them see.",
                expected="--store DIR|URL, or --out DIR",
            )
        store = Store(place) if place else None
        if store is not None and is_url(store.place):
            _ = "" in store  # there is such a protocol
        logs = logs_of(units.logs or (), units.manifest)
        robot, gain = units.load(), units.gain
        gains = None if gain is None else tuple(opt.numbers("--gain", gain, robot.n))
        model = FleetModel(robot, settings, units.request(robot), gains)
        return model, logs, crew, store


_Hertz = Annotated[float, typer.Option(metavar="HZ")]
Reduction = Annotated[
    FleetSettings,
    opt.FIT.only("rows basis effects force", cutoff=_Hertz, reversal=None, level=None),
]


@command
def identify_command(
    *,
    units: Units,
    settings: Reduction,
    engine: Engine,
    save_model: opt.Model = None,
    unit: Annotated[str | None, typer.Option(metavar="NAME")] = None,
    seed: opt.Seed = 0,
    output: Kept,
) -> None:
    """Base parameters of every unit and of the type: means, spread from unit to unit and from day
    to day, and which units are odd.

    Every log is reduced once to triangular factors, which are kept; the answer is the same to the
    last bit for any number of workers. A log that cannot be used is a row with the reason.

    Example: `torchid fleet identify panda.yaml logs --workers 8 --out fleet`

    Args:
        effects: Effects on every joint, comma-separated; `none` for the rigid body.
        force: Use logs that look wrong, too.
        save_model: Write the type as a robot (.yaml) that says how sure it is: `torchid gap` of it
            and a new unit's log tells what is odd about that.
        unit: Write this unit in the place of the type.
    """
    from torchid.fleet.identify import fleet_identify, reduce_fleet
    from torchid.fleet.known import known_model
    from torchid.report.fleet import report_of_fleet

    if unit is not None and save_model is None:
        raise TorchidError("--unit is of a model to be written.", expected="--save-model FILE.yaml")
    model, logs, crew, store = engine.begin(units, settings, output)
    if engine.array is not None:
        assert store is not None
        with output.progress("reducing logs") as progress:
            part = reduce_fleet(
                model, logs, store, workers=crew, part=engine.array, progress=progress
            )
        _say_part(output, engine.array, [(a.log, a.verdict, a.evidence[-1:]) for a in part])
        return
    with output.progress("reducing logs") as progress:
        fleet = fleet_identify(model, logs, store=store, workers=crew, progress=progress)
    if save_model is not None:
        output.put(save_model, partial(torchid.write_robot, known_model(fleet, unit)))
    output.give(fleet.record, "fleet.json", report_of_fleet, seed=seed)


@command
def gap_command(
    *,
    units: Units,
    settings: Annotated[GapSettings, opt.GAP.only("effects background parameters seed")],
    force: Switch = False,
    engine: Engine,
    output: Reported,
) -> None:
    """Diagnose every log of a fleet: which unit has which gap, which effects are the type's, and
    which a unit's own.

    Example: `torchid fleet gap panda.urdf logs --workers 8 --out fleet --report gaps.html`

    Args:
        effects: Effects to search over, comma-separated; `all`.
        force: Use logs that look wrong, too.
    """
    from torchid.fleet.gap import fleet_gap
    from torchid.report.fleet import report_of_fleet_gap

    model, logs, crew, store = engine.begin(units, FleetSettings(force=force), output)
    with output.progress("diagnosing logs") as progress:
        gaps = fleet_gap(
            model, logs, settings=settings, store=store, workers=crew, part=engine.array,
            progress=progress,
        )  # fmt: skip
    if engine.array is not None:
        _say_part(output, engine.array, [(x.log, x.status, [x.evidence]) for x in gaps.logs])
        return
    output.give(
        gaps,
        "fleet_gap.json",
        report_of_fleet_gap,
        seed=settings.seed,
        files=output.hashed([("log", log.path, Path(log.path)) for log in logs]),
        settings={"effects": settings.effects or "all", "parameters": settings.parameters},
    )


def _say_part(
    output: Output, array: tuple[int, int], logs: Sequence[tuple[str, str, Sequence[str]]]
) -> None:
    """What became of a part of the logs: each with its verdict and why."""
    unused = [(log, *why) for log, verdict, why in logs if verdict in ("refused", "failed")]
    output.say(
        f"part {array[0]} of {array[1]}: {len(logs)} logs, {len(unused)} of them not used; the "
        "same command without --array pools all parts"
    )
    output.warn(map(": ".join, unused))


FLEET = identify_command, gap_command
