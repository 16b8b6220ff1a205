"""`torchid gap`: where simulator and arm disagree, which effects cause it, how far it shrinks."""

import time
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import typer

import torchid
from torchid.app import options as opt
from torchid.app.output import Diagnosed, Output, settings_of
from torchid.app.signature import Switch, command
from torchid.gap.settings import GapSettings

WRITING = (0.5, 0.5, 2.0, 4.0)
"""Time that printing an answer takes, and that --out, --pictures and --report do [s]."""


@dataclass(frozen=True, kw_only=True)
class _Asked:
    """What is asked for besides.

    Attributes:
        save_model: Write the corrected robot, with its effects, as a .yaml.
        servo: What the servos are said to be, shown beside what is found of logs of commands:
            STS3215, `XL330-M288 gain=400`, `kp=12 clip=unknown`; one, or one a joint with commas.
        force: Diagnose a log that looks wrong (order or sign of joints, units, lag, a run with a
            load of its own) all the same, and say so first.
        before: Earlier log of the arm: says of each cause whether it is new since that log or in
            both. May be given several times. Without it the log that the model's own file names.
        no_rows: Neither keep the log beside the model of --save-model (MODEL.rows.npz), where its
            motion is private, nor read that of ROBOT.
        time: Seconds in which a whole answer is to be there, with what was not looked at. Reading,
            judging and writing, which no answer goes without, may take longer.
    """

    save_model: opt.Model = None
    servo: Annotated[str | None, typer.Option(metavar="NAME[ KEY=VALUE]..")] = None
    force: Switch = False
    before: opt.LogFiles = None
    no_rows: Switch = False
    time: Annotated[float | None, typer.Option(metavar="SECONDS", min=1)] = None

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
    trials: opt.Trials,
    settings: Annotated[GapSettings, opt.GAP],
    asked: _Asked,
    output: Annotated[Diagnosed, "gap.json"],
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
    robot, log, apart, files = trials.open(output, settings.held_out_fraction)
    from torchid.report.brief import model_words
    from torchid.report.diagnosis import report_of_diagnosis

    # The log is handed over, for it is not needed again: a long one takes half of the memory.
    handed = [log]
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
    words = model_words(result.answer, model, trials.robot, trials.as_log_options)
    # The worst joints of an earlier run may have been others.
    shown = output.keep(
        result, "gap.json", partial(report_of_diagnosis, model=words), seed=settings.seed,
        old=["joint_*.png", "gap_joint_*.png", "which.png", "planted.png"], files=files,
        settings=settings_of(result, asked.servo),
    )  # fmt: skip
    output.put(asked.save_model, partial(result.write_corrected, rows=not asked.no_rows))
    output.tell(shown)
