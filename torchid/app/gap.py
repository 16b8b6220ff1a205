"""`torchid gap`: where simulator and arm disagree, which effects cause it, how far it shrinks."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import torchid
from torchid.app import options as opt
from torchid.app.export import Simulated
from torchid.app.inputs import RECORDED, ROBOT, WRITTEN, Suffix
from torchid.app.output import Diagnosed, Output
from torchid.app.signature import Switch, command
from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings

if TYPE_CHECKING:
    from torchid.results.answer import Diagnosis


@dataclass(frozen=True, kw_only=True)
class _Trials(opt.Trials):
    """Robot and logs, which a pair of logs goes without."""

    robot: Annotated[str, typer.Argument(metavar="ROBOT"), ROBOT] = ""
    logs: Annotated[list[Path] | None, opt.LOGS, RECORDED] = None  # type: ignore[assignment]


@dataclass(frozen=True, kw_only=True)
class _Asked:
    """What is asked for besides.

    Attributes:
        save_model: Write the corrected robot, with its effects, as a .yaml.
        view: Write torques, effects and regimes over time for a viewer: .mcap for Foxglove and
            PlotJuggler (extra `view`).
        servo: What the servos are said to be, shown beside what is found of logs of commands:
            STS3215, `XL330-M288 gain=400`, `kp=12 clip=unknown`; one, or one a joint with commas.
        to: Write a corrected file of this format, or for this simulator, to --out, as `torchid
            correct` does.
        simulated: Log of the simulator, of the same commands as --real. May be given several times.
        real: Log of the arm, one for each of --simulated.
        force: Diagnose a log that looks wrong (order or sign of joints, units, lag, a run with a
            load of its own) all the same, and say so first.
        before: Earlier log of the arm: says of each cause whether it is new since that log or in
            both. May be given several times. Without it the log that the model's own file names.
        no_rows: Neither keep the log beside the model of --save-model (MODEL.rows.npz), where its
            motion is private, nor read that of ROBOT.
        calibrate: Plant so many causes, one at a time, in what the answer leaves of the log, and
            say how often each kind is named: minutes.
    """

    save_model: opt.Model = None
    view: Annotated[Path | None, typer.Option(metavar="FILE.mcap"), WRITTEN, Suffix((".mcap",))] = (
        None
    )
    servo: Annotated[str | None, typer.Option(metavar="NAME[ KEY=VALUE]..")] = None
    to: Annotated[Simulated | None, typer.Option("--to", "--for", metavar="FORMAT")] = None
    simulated: opt.LogFiles = None
    real: opt.LogFiles = None
    force: Switch = False
    before: opt.LogFiles = None
    no_rows: Switch = False
    calibrate: Annotated[int | None, typer.Option(metavar="N", min=1)] = None


@command
def gap_command(
    *,
    trials: _Trials,
    settings: Annotated[GapSettings, opt.GAP],
    asked: _Asked,
    output: Annotated[Diagnosed, "gap.json", "pair.json"],
) -> None:
    """Find where a simulator's torque and the arm's disagree, which unmodelled effects cause it,
    and how far the gap shrinks with them.

    Logs of commands u1.. and positions alone are explained by what lies between the two: servos,
    friction, set-points, stops; errors are then in mrad.

    With --simulated and --real, logs of both under the same commands are held against each other:
    faults of the simulator's set-up, and, with a ROBOT, effects that only one of them has.

    Example: `torchid gap --simulated sim.csv --real arm.csv my_arm.urdf`

    Example: `torchid gap so101.urdf run1.parquet run2.parquet --save-model corrected.yaml`

    Example: `torchid gap panda.urdf run1.parquet run2.parquet --held-out run3.parquet
    --out result --save-model corrected.yaml --report gap.html`

    Args:
        effects: Effects to search over, comma-separated; `all` for the whole library.
        cutoff: Cut-off of the fit's zero-phase filter.
    """
    paired = asked.simulated or asked.real
    for name, given in (("ROBOT", trials.robot), ("LOG...", trials.logs)):
        if not (given or paired):
            raise typer.BadParameter(f"Missing argument '{name}'.")
    if asked.to is not None and output.out is None:
        raise TorchidError("--to writes a file, and needs --out DIR.")
    if paired:
        _pair(output, trials, asked, settings)
        return
    found, log, apart, files = trials.open(output, settings.held_out_fraction)
    from torchid.report.brief import model_words
    from torchid.report.diagnosis import report_of_diagnosis

    if asked.view is not None:
        from torchid.report.view import require_viewer

        require_viewer(asked.view)
    kind = None
    if asked.to is not None:  # what writes a simulator's files takes a second to load
        from torchid.export.correct import file_format, require_field
        from torchid.report.exported import report_of_correction

        kind = file_format(asked.to)
        require_field(kind, found, log)
    # The log is handed over where it is not needed again: a long one takes half of the memory.
    handed = [log]
    if kind is None and asked.calibrate is None:
        del log
    with (
        output.progress("preparing") as progress,
        output.kept_so_far(progress) as watch,
        trials.line_to_mend(),
    ):
        result = torchid.diagnose(
            found, handed.pop(), held_out=apart, settings=settings, servo=asked.servo,
            force=asked.force, progress=progress, watch=watch,
            rows=not asked.no_rows, before=asked.before and trials.read(asked.before, found),
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
    if kind is not None and output.out is not None:
        done = torchid.correct(
            found, result, log, kind, output.out, held_out=apart, settings=settings,
            keep=trials.inputs,
        )  # fmt: skip
        output.put(output.out / "correction.json", done.save)
        to_print.append(report_of_correction(done))
    if asked.calibrate is not None:
        from joblib import cpu_count

        from torchid.gap.diagnosis import TorqueDiagnosis
        from torchid.report.withheld import report_of_calibration

        if not isinstance(result, TorqueDiagnosis):
            raise TorchidError("--calibrate plants causes of torque, and this log has none.")
        with output.progress("planting causes") as progress:
            checked = torchid.calibrate(
                result, log, count=asked.calibrate, jobs=cpu_count(), progress=progress
            )
        output.put(output.out and output.out / "calibration.json", checked.save)
        to_print.append(report_of_calibration(checked))
    for one in to_print:
        output.tell(one)


def settings_of(result: "Diagnosis", servo: str | None) -> dict[str, object]:
    """What a diagnosis was made with, for its page."""
    data = result.plain()
    if "settings" not in data:
        return {"servo": servo or "not given"}
    used = {k: v for k, v in data["settings"].items() if k not in ("seed", "only")}
    used |= {"band of the report [Hz]": data["band_hz"], "cut-off [Hz]": data["cutoff_hz"]}
    return used | {"effects": used["effects"] or "all"}


def _pair(output: Output, trials: _Trials, asked: _Asked, settings: GapSettings) -> None:
    """A simulator's logs against the arm's."""
    from torchid.log.readers import open_logs
    from torchid.report.pair import report_of_pair
    from torchid.robot.config_files import robot_file

    if not asked.simulated or not asked.real:
        raise TorchidError(
            "a simulator's log is held against the arm's.",
            got="--real alone" if asked.real else "--simulated alone",
            expected="--simulated SIM --real REAL",
        )
    others = {
        "LOG": trials.logs,
        "--held-out": trials.held_out,
        "--to": asked.to,
        "--view": asked.view,
        "--before": asked.before,
    }
    if any(others.values()):
        raise TorchidError(
            "--simulated and --real take the logs' place, and go without these.",
            got=", ".join(name for name, given in others.items() if given),
        )
    if asked.save_model is not None and not trials.robot:
        raise TorchidError("--save-model corrects the simulator's robot, and needs its ROBOT.")
    robot = trials.load() if trials.robot else None
    sides = (("simulated", asked.simulated), ("real", asked.real))
    named = [(side, str(path), path) for side, paths in sides for path in paths]
    files = output.hashed(
        [*([("robot", trials.robot, robot_file(trials.robot))] if robot else []), *named]
    )

    def read(paths: list[Path]) -> "torchid.Log":
        opened = open_logs(paths, trials.request(robot))
        return torchid.Log.concatenate([trials.with_torque(log, log.n) for _, log in opened])

    with output.progress("reading") as progress, trials.line_to_mend(asked.real):
        simulated, real = read(asked.simulated), read(asked.real)
        result = torchid.compare_pair(
            simulated, real, robot, settings=settings, force=asked.force, progress=progress
        )
    kept = output.keep(
        result, "pair.json", report_of_pair, seed=settings.seed, files=files,
        settings={} if result.of_arm is None else settings_of(result.of_arm, None),
    )  # fmt: skip
    try:
        output.put(asked.save_model, partial(result.write_corrected, rows=not asked.no_rows))
    finally:  # what differs is said where it is no model, too
        output.tell(kept)
