"""`torchid withheld own`: check the diagnosis on one's own arm."""

from dataclasses import dataclass
from typing import Annotated

import typer

import torchid
from torchid.app import options as opt
from torchid.app.output import Kept
from torchid.app.signature import Switch, command
from torchid.gap.settings import GapSettings


@dataclass(frozen=True)
class Workers:
    """Who does the work.

    Attributes:
        jobs: Processes, of one thread each (default: all cores).
    """

    jobs: Annotated[int | None, typer.Option(min=1)] = None

    @property
    def count(self) -> int:
        """Of processes; all cores that this one may use, by default."""
        from joblib import cpu_count

        return self.jobs or cpu_count()


@command
def own_command(
    *,
    trials: opt.Trials,
    settings: Annotated[GapSettings, opt.GAP.only("background parameters seed")],
    force: Switch = False,
    workers: Workers,
    output: Annotated[Kept, "own.json"],
) -> None:
    """Check the diagnosis on your own arm: withhold what it accepted.

    Every effect accepted on LOG... is taken out of the corrected model and sought again on logs
    that took no part (--held-out; else the second half of every trajectory).

    Example: `torchid withheld own panda.urdf run1.parquet run2.parquet --held-out run3.parquet`

    Args:
        force: Go on with a log that looks wrong, too.
    """
    from torchid.report.withheld import report_of_own_check

    found, log, apart, _ = trials.open(output)
    with output.progress() as progress, trials.line_to_mend():
        result = torchid.withheld_own(
            found, log, untouched=apart, settings=settings, force=force,
            jobs=workers.count, progress=progress,
        )  # fmt: skip
    output.say(*([result.first.doubt] if result.first.doubt else []))
    output.give(result, "own.json", report_of_own_check, seed=settings.seed)
