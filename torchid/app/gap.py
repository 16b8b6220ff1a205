"""`torchid gap`: where simulator and arm disagree, which effects cause it, how far it shrinks."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import torchid
from torchid.app import options as opt
from torchid.app.calibrate import planted, require_torque
from torchid.app.export import Simulated, file_for
from torchid.app.inputs import WRITTEN, Suffix
from torchid.app.output import Diagnosed, Output, settings_of
from torchid.app.pair import BothLogs, compare
from torchid.app.signature import Switch, command
from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings

if TYPE_CHECKING:
    from torchid.export.projection import Target
    from torchid.report.table import Report
    from torchid.results.answer import Diagnosis


_MOVED = {
    "simulated": "torchid pair --simulated SIM --real REAL [ROBOT]",
    "to": "torchid correct ROBOT LOG... --to FORMAT",
    "calibrate": "torchid calibrate ROBOT LOG... --causes N",
}
"""Options that became commands, which this one calls for one more release."""

WRITING = (0.5, 0.5, 2.0, 4.0)
"""Time that printing an answer takes, and that --out, --pictures and --report do [s]."""


@dataclass(frozen=True, kw_only=True)
class _Asked:
    """What is asked for besides.

    Attributes:
        save_model: Write the corrected robot, with its effects, as a .yaml.
        view: Write torques, effects and regimes over time for a viewer: .mcap for Foxglove and
            PlotJuggler (extra `view`).
        servo: What the servos are said to be, shown beside what is found of logs of commands:
            STS3215, `XL330-M288 gain=400`, `kp=12 clip=unknown`; one, or one a joint with commas.
        to: As `torchid correct`, which takes its place: a corrected file into --out.
        force: Diagnose a log that looks wrong (order or sign of joints, units, lag, a run with a
            load of its own) all the same, and say so first.
        before: Earlier log of the arm: says of each cause whether it is new since that log or in
            both. May be given several times. Without it the log that the model's own file names.
        no_rows: Neither keep the log beside the model of --save-model (MODEL.rows.npz), where its
            motion is private, nor read that of ROBOT.
        time: Seconds in which a whole answer is to be there, with what was not looked at. Reading,
            judging and writing, which no answer goes without, may take longer.
        calibrate: As `torchid calibrate`, which takes its place: plant so many causes, one at a
            time, in what the answer leaves of the log, and say how often each kind is named:
            minutes.
    """

    save_model: opt.Model = None
    view: Annotated[Path | None, typer.Option(metavar="FILE.mcap"), WRITTEN, Suffix((".mcap",))] = (
        None
    )
    servo: Annotated[str | None, typer.Option(metavar="NAME[ KEY=VALUE]..")] = None
    to: Annotated[Simulated | None, typer.Option("--to", "--for", metavar="FORMAT")] = None
    force: Switch = False
    before: opt.LogFiles = None
    no_rows: Switch = False
    time: Annotated[float | None, typer.Option(metavar="SECONDS", min=1)] = None
    calibrate: Annotated[int | None, typer.Option(metavar="N", min=1)] = None

    def seconds(self, output: Output) -> float | None:
        """Seconds left for the diagnosis, less what files take to write afterwards; None without
        `--time`."""
        if self.time is None:
            return None
        asked = True, output.out, output.pictures, output.report
        writing = sum(s for on, s in zip(asked, WRITING, strict=True) if on)
        return max(0.1, self.time - (time.monotonic() - output.started) - writing)


@command
def gap_command(
    *,
    trials: BothLogs,
    settings: Annotated[GapSettings, opt.GAP],
    asked: _Asked,
    output: Annotated[Diagnosed, "gap.json", "pair.json"],
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
        cutoff: Cut-off of the fit's zero-phase filter.
    """
    moved = {"simulated": trials.simulated, "to": asked.to, "calibrate": asked.calibrate}
    output.warn(
        f"--{name} is removed in the next release; use {_MOVED[name]}"
        for name, given in moved.items()
        if given
    )
    if trials.simulated or trials.real:
        _pair(trials, settings, asked, output)
        return
    for name, given in (("ROBOT", trials.robot), ("LOG...", trials.logs)):
        if not given:
            raise typer.BadParameter(f"Missing argument '{name}'.")
    if asked.to is not None and output.out is None:
        raise TorchidError("--to writes a file, and needs --out DIR.")
    robot, log, apart, files = trials.open(output, settings.held_out_fraction)
    if asked.calibrate is not None:
        require_torque(robot, log)
    from torchid.report.brief import model_words
    from torchid.report.diagnosis import report_of_diagnosis

    if asked.view is not None:
        from torchid.report.view import require_viewer

        require_viewer(asked.view)
    kind = None if asked.to is None else file_for(asked.to, robot, log)
    # The log is handed over where it is not needed again: a long one takes half of the memory.
    handed = [log]
    if kind is None and asked.calibrate is None:
        del log
    with (
        output.progress("preparing") as progress,
        output.kept_so_far(progress) as watch,
        trials.line_to_mend(before=asked.before),
    ):
        result = torchid.diagnose(
            robot, handed.pop(), held_out=apart, settings=settings, servo=asked.servo,
            force=asked.force, progress=progress, watch=watch,
            rows=not asked.no_rows, before=asked.before and trials.read(asked.before, robot),
            time=asked.seconds(output),
        )  # fmt: skip
    model = None if asked.save_model is None else str(asked.save_model)
    words = model_words(result.answer, model, trials.robot)
    # The worst joints of an earlier run may have been others.
    to_print = [
        output.keep(
            result, "gap.json", partial(report_of_diagnosis, model=words), seed=settings.seed,
            old=["gap_joint_*.png", "which.png", "planted.png"], files=files,
            settings=settings_of(result, asked.servo),
        )
    ]  # fmt: skip
    output.put(asked.save_model, partial(result.write_corrected, rows=not asked.no_rows))
    output.put(asked.view, partial(torchid.write_view, result))
    if kind is not None or asked.calibrate is not None:
        to_print += _moved(trials, settings, asked, output, robot, result, log, kind, apart)
    for one in to_print:
        output.tell(one)


def _moved(
    trials: BothLogs,
    settings: GapSettings,
    asked: _Asked,
    output: Output,
    robot: "torchid.Robot",
    result: "Diagnosis",
    log: "torchid.Log",
    kind: "Target | None",
    apart: "torchid.Log | None",
) -> "Iterator[Report]":
    """What `torchid correct` and `torchid calibrate` have to say of a diagnosis that there is."""
    if kind is not None and output.out is not None:
        from torchid.report.exported import report_of_correction

        done = torchid.correct(
            robot, result, log, kind, output.out, held_out=apart, settings=settings,
            keep=trials.inputs,
        )  # fmt: skip
        output.put(output.out / "correction.json", done.save)
        yield report_of_correction(done)
    if asked.calibrate is not None:
        from torchid.report.withheld import report_of_calibration

        checked = planted(result, log, asked.calibrate, output)
        output.put(output.out and output.out / "calibration.json", checked.save)
        yield report_of_calibration(checked)


def _pair(trials: BothLogs, settings: GapSettings, asked: _Asked, output: Output) -> None:
    """What `torchid pair` does."""
    if not trials.simulated or not trials.real:
        raise TorchidError(
            "a simulator's log is held against the arm's.",
            got="--real alone" if trials.real else "--simulated alone",
            expected="--simulated SIM --real REAL",
        )
    others = {
        "--calibrate": asked.calibrate,
        "LOG": trials.logs,
        "--held-out": trials.held_out,
        "--to": asked.to,
        "--view": asked.view,
        "--servo": asked.servo,
        "--pictures": output.pictures,
        "--before": asked.before,
        "--time": asked.time,
    }
    if any(others.values()):
        raise TorchidError(
            "--simulated and --real take the logs' place, and go without these.",
            got=", ".join(name for name, given in others.items() if given),
        )
    rows = not asked.no_rows
    compare(trials, settings, output, asked.save_model, force=asked.force, rows=rows)
