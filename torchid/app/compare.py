"""`torchid compare`: results of the same kind, of runs, sessions or robots of one type."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchid.app import options as opt
from torchid.app.output import Computed
from torchid.app.signature import command
from torchid.errors import TorchidError

if TYPE_CHECKING:
    from torchid.compare.diagnoses import GapComparison
    from torchid.compare.identifications import Comparison
    from torchid.compare.sets import SetComparison
    from torchid.log.model import Log
    from torchid.robot.model import Robot


@command
def compare_command(
    *,
    results: Annotated[list[Path], typer.Argument(metavar="RESULT...")],
    on: opt.LogFiles = None,
    robot: opt.RobotOption = None,
    logs: opt.Reading,
    tip: opt.Tip = None,
    seed: opt.Seed = 0,
    where: Computed,
) -> None:
    """Which parameters agree between results within their intervals, which drift, which are never
    determined; whether standard deviations hold from run to run; how far apart the torques are.

    Example: `torchid compare monday/identification.json tuesday/identification.json
    friday/identification.json --on test.parquet --out compared`

    Args:
        results: Two or more identification.json, gap.json or sets.json, in the order of time.
        on: Compare torque along this log, in place of random motion. May be given several times.
        robot: Where the results do not record it.
    """
    output = where.open()
    from torchid.compare import reading
    from torchid.compare.diagnoses import compare_diagnoses
    from torchid.compare.identifications import compare_identifications
    from torchid.compare.record import record
    from torchid.compare.sets import compare_sets, robot_of
    from torchid.report import compare
    from torchid.report.compare_figures import figures
    from torchid.robot.library import load_robot
    from torchid.robot.record import recorded_robot

    read = reading.read_results(results)
    arm = None if robot is None else load_robot(robot, tip=tip)

    def log(arm: "Robot | None") -> "Log | None":
        if not on:
            return None
        if arm is None:
            raise TorchidError("torque along a log needs the robot.", expected="--robot ROBOT")
        return logs.read(on, arm)

    compared: "Comparison | GapComparison | SetComparison"
    if read[0].schema == reading.IDENTIFICATION:
        every = [reading.read_identification(r) for r in read]
        arm = arm or next((r.robot for r in every if r.robot is not None), None)
        compared = found = compare_identifications(every, robot=arm, on=log(arm), seed=seed)
        verdict, tables = compare.verdict(found), compare.tables(found)
    elif read[0].schema == reading.GAP:
        recorded = (recorded_robot(r.data, str(r.path)) for r in read)
        arm = arm or next((r for r in recorded if r is not None), None)
        compared = gaps = compare_diagnoses(read, on=log(arm), seed=seed)
        verdict, tables = compare.gap_verdict(gaps), compare.gap_tables(gaps)
    else:
        arm = arm or robot_of(read, tip)
        compared = sets = compare_sets(read, arm, on=log(arm), seed=seed)
        verdict, tables = compare.set_verdict(sets), compare.set_tables(sets)
    output.verdict(verdict)
    output.say(*tables)
    output.warn(compared.notes)
    output.write_json({**record(compared), "seed": seed}, "compare.json")
    output.draw(lambda: figures(compared), "compare.json")
