"""`torchid compare`: results of the same kind, of runs, sessions or robots of one type."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchid.app.options import (
    Columns,
    Gain,
    Json,
    Out,
    Quiet,
    Seed,
    Threads,
    Tip,
    Topic,
    read_logs,
)
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
    columns: Columns = None,
    topic: Topic = None,
    gain: Gain = None,
    tip: Tip = None,
    json_file: Json = None,
    out: Out = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
) -> None:
    """Which parameters agree between results within their intervals, which drift, which are never
    determined; whether standard deviations hold from run to run; how far apart the torques are.

    Example: `torchid compare monday/identification.json tuesday/identification.json
    friday/identification.json --on test.parquet --out compared`
    """
    output = open_output(json_file, out, quiet, threads)
    from torchid.compare.reading import read_results
    from torchid.compare.record import record
    from torchid.robot.library import load_robot

    read = read_results(results)
    found = None if robot is None else load_robot(robot, tip=tip)
    compared = _compared(read, found, tip, lambda arm: _logs(on, arm, gain, columns, topic), seed)
    _show(compared, output)
    output.write_json({**record(compared), "seed": seed}, "compare.json")
    _draw(compared, output)


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


def _logs(
    on: list[Path] | None,
    robot: "Robot | None",
    gain: str | None,
    columns: str | None,
    topic: str | None,
) -> "Log | None":
    if not on:
        return None
    if robot is None:
        raise TorchidError("torque along a log needs the robot.", expected="--robot ROBOT")
    return read_logs(on, gain, robot, columns, topic)


def _show(result: "Comparison | GapComparison | SetComparison", output: Output) -> None:
    """The verdict first, then what it rests on."""
    from rich.markup import escape

    from torchid.compare.diagnoses import GapComparison
    from torchid.compare.identifications import Comparison
    from torchid.report import compare, compare_gap

    if isinstance(result, Comparison):
        verdict, tables = compare.verdict(result), compare.tables(result)
    elif isinstance(result, GapComparison):
        verdict, tables = compare_gap.verdict(result), compare_gap.tables(result)
    else:
        verdict, tables = compare.set_verdict(result), compare.set_tables(result)
    output.say(f"[bold]{escape(verdict)}[/]\n")
    for table in tables:
        output.say(table)
    output.warn(result.notes)


def _draw(result: "Comparison | GapComparison | SetComparison", output: Output) -> None:
    if output.folder is None:
        return
    from torchid.report.compare_figures import figures
    from torchid.report.figures import save

    drawn = [save(f, output.folder / f"{name}.png") for name, f in figures(result).items()]
    output.say(f"written to {output.folder}: compare.json, " + ", ".join(p.name for p in drawn))
