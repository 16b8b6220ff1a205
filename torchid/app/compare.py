"""`torchid compare`: results of the same kind, of runs, sessions or robots of one type."""

from pathlib import Path
from typing import Annotated

import typer

from torchid.app import options as opt
from torchid.app.output import Drawn
from torchid.app.signature import command
from torchid.errors import TorchidError


@command
def compare_command(
    *,
    results: Annotated[list[Path], typer.Argument(metavar="RESULT...")],
    on: opt.LogFiles = None,
    robot: opt.RobotOption = None,
    logs: opt.Reading,
    part: opt.Part,
    seed: opt.Seed = 0,
    output: Annotated[Drawn, "compare.json"],
) -> None:
    """Which coefficients agree between results, which differ and by what spread, which are never
    determined; how far apart the torques are, or which servos go nearest to a log.

    Example: `torchid compare monday/identification.json tuesday/identification.json
    friday/identification.json --on test.parquet --out compared`

    Args:
        results: Two or more identification.json, gap.json or sets.json.
        on: Compare torque along this log, in place of random motion; of servos positions (with
            --robot). May be given several times.
        robot: Where the results do not record it.
    """
    from torchid.fleet.compare import common_robot, compared, read_results
    from torchid.report.compare import report_of_comparison

    read = read_results(results)
    arm = common_robot(read, part.choice) if robot is None else opt.load(robot, part)
    if on and arm is None:
        raise TorchidError("torque along a log needs the robot.", expected="--robot ROBOT")
    log = logs.read(on, arm) if on and arm is not None else None
    with output.progress("comparing"):
        comparison = compared(read, arm, on=log, seed=seed)
    output.give(comparison, "compare.json", report_of_comparison, seed=seed)
