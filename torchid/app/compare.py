"""`torchid compare`: results of the same kind, of runs, sessions or robots of one type."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchid.app import options as opt
from torchid.app.output import Output, open_output
from torchid.errors import TorchidError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from torchid.compare.diagnoses import GapComparison
    from torchid.compare.identifications import Comparison
    from torchid.compare.reading import Result
    from torchid.compare.sets import SetComparison
    from torchid.log.model import Log
    from torchid.robot.model import Robot


def compare_command(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT...",
            help="Two or more identification.json, gap.json or sets.json, in the order of time.",
        ),
    ],
    on: Annotated[
        list[Path] | None,
        typer.Option(
            "--on",
            metavar="LOG",
            help="Compare torque along this log, in place of random motion. May be given several "
            "times.",
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option("--robot", metavar="ROBOT", help="Where the results do not record it."),
    ] = None,
    columns: opt.Columns = None,
    topic: opt.Topic = None,
    gain: opt.Gain = None,
    tip: opt.Tip = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    seed: opt.Seed = 0,
    quiet: opt.Quiet = False,
    threads: opt.Threads = None,
) -> None:
    """Which parameters agree between results within their intervals, which drift, which are never
    determined; whether standard deviations hold from run to run; how far apart the torques are.

    Example: `torchid compare monday/identification.json tuesday/identification.json
    friday/identification.json --on test.parquet --out compared`
    """
    output = open_output(json_file, out, quiet, threads)
    from torchid.compare.reading import read_results
    from torchid.compare.record import record
    from torchid.report.compare_figures import figures
    from torchid.robot.library import load_robot

    read = read_results(results)
    found = None if robot is None else load_robot(robot, tip=tip)

    def log(arm: "Robot | None") -> "Log | None":
        if not on:
            return None
        if arm is None:
            raise TorchidError("torque along a log needs the robot.", expected="--robot ROBOT")
        return opt.read_logs(on, gain, arm, columns, topic)

    compared = _compared(read, found, tip, log, seed)
    _show(compared, output)
    output.write_json({**record(compared), "seed": seed}, "compare.json")
    output.draw(lambda: figures(compared), "compare.json")


def _compared(
    results: "Sequence[Result]",
    robot: "Robot | None",
    tip: str | None,
    log: "Callable[[Robot | None], Log | None]",
    seed: int,
) -> "Comparison | GapComparison | SetComparison":
    from torchid.compare import reading
    from torchid.compare.diagnoses import compare_diagnoses
    from torchid.compare.identifications import compare_identifications
    from torchid.compare.sets import compare_sets, robot_of
    from torchid.robot.record import recorded_robot

    recorded = (recorded_robot(r.data, str(r.path)) for r in results)
    if results[0].schema == reading.IDENTIFICATION:
        found = [reading.read_identification(r) for r in results]
        robot = robot or next((r.robot for r in found if r.robot is not None), None)
        return compare_identifications(found, robot=robot, on=log(robot), seed=seed)
    if results[0].schema == reading.GAP:
        robot = robot or next((r for r in recorded if r is not None), None)
        return compare_diagnoses(results, on=log(robot), seed=seed)
    robot = robot or robot_of(results, tip)
    return compare_sets(results, robot, on=log(robot), seed=seed)


def _show(result: "Comparison | GapComparison | SetComparison", output: Output) -> None:
    """The verdict first, then what it rests on."""
    from torchid.compare.diagnoses import GapComparison
    from torchid.compare.identifications import Comparison
    from torchid.report import compare, compare_gap

    if isinstance(result, Comparison):
        verdict, tables = compare.verdict(result), compare.tables(result)
    elif isinstance(result, GapComparison):
        verdict, tables = compare_gap.verdict(result), compare_gap.tables(result)
    else:
        verdict, tables = compare.set_verdict(result), compare.set_tables(result)
    output.verdict(verdict)
    output.say(*tables)
    output.warn(result.notes)
