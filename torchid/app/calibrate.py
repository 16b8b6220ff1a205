"""`torchid calibrate`: how often a cause would be named, were it on this arm and in these logs."""

from typing import Annotated

import torchid
from torchid.app import options as opt
from torchid.app.output import Computed
from torchid.app.signature import Switch, command
from torchid.errors import TorchidError
from torchid.gap.settings import GapSettings


@command
def calibrate_command(
    *,
    trials: opt.Trials,
    causes: opt.Count = 30,
    force: Switch = False,
    settings: Annotated[GapSettings, opt.GAP],
    output: Annotated[Computed, "calibration.json"],
) -> None:
    """Plant causes, one at a time, in what `torchid gap` leaves of these logs, and say how often
    each kind is named: minutes.

    Example: `torchid calibrate my_arm.urdf run1.csv run2.csv --causes 30`

    Args:
        causes: How many: those that the answer names and what stands in their sets first.
        force: Plant in a log that looks wrong, too.
        effects: Effects to search over, comma-separated; `all` for the whole library.
        cutoff: Cut-off of the fit's zero-phase filter.
    """
    from joblib import cpu_count

    from torchid.gap.diagnosis import TorqueDiagnosis
    from torchid.report.withheld import report_of_calibration

    robot, log, apart, _ = trials.open(output, settings.held_out_fraction)
    _require_torque(robot, log)
    with output.progress("preparing") as progress, trials.line_to_mend():
        result = torchid.diagnose(
            robot, log, held_out=apart, settings=settings, force=force, progress=progress
        )
    output.say(result.answer.headline)
    assert isinstance(result, TorqueDiagnosis)
    with output.progress("planting causes") as progress:
        checked = torchid.calibrate(result, log, count=causes, jobs=cpu_count(), progress=progress)
    output.give(checked, "calibration.json", report_of_calibration, seed=settings.seed)


def _require_torque(robot: "torchid.Robot", log: "torchid.Log") -> None:
    """Raise a TorchidError of a log without torque, before it is diagnosed."""
    from torchid.design.sensor import sensor_of

    if sensor_of(log, robot) == "position":
        raise TorchidError(
            "causes are planted in torque, and this log has none.",
            got=f"{log.label}: commands and positions",
            expected="torques tau1.., or currents i1.. with drive gains",
        )
