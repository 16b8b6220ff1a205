"""`torchid extract`: physical parameter sets from base parameters."""

import sys
import time
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from torchid.app import options as opt
from torchid.app.output import Output, open_output, progress_bar, stage
from torchid.app.problems import (
    BoundsOption,
    GeometryOption,
    LossOption,
    ResultArgument,
    ShapesOption,
    TotalMassOption,
    build_problem,
)
from torchid.errors import TorchidError
from torchid.json_data import write_json

if TYPE_CHECKING:
    from torchid.extraction.convex.certificate import Certificate
    from torchid.extraction.extract import SearchSettings
    from torchid.extraction.problem import Problem
    from torchid.report.extraction import Found


def extract_command(
    robot: opt.RobotArgument,
    result: ResultArgument = None,
    method: Annotated[
        Literal["cma-es", "log-cholesky", "sdp"],
        typer.Option(help="Population search (Algorithm 1), gradient, or convex optimum."),
    ] = "cma-es",
    bounds: BoundsOption = None,
    penalty: Annotated[
        Literal["full", "partial"],
        typer.Option(help="Full loss phi + xi gamma, or phi alone (sets may be infeasible)."),
    ] = "full",
    loss: LossOption = "two-step",
    geometry: GeometryOption = None,
    shapes: ShapesOption = False,
    total_mass: TotalMassOption = None,
    runs: Annotated[int, typer.Option(help="Independent starts.")] = 30,
    stages: Annotated[int, typer.Option(help="Stages of Algorithm 1.")] = 25,
    generations: Annotated[int, typer.Option(help="Generations of each stage.")] = 100,
    population: Annotated[
        int | None, typer.Option(help="Of each run (default: 4 + 3 ln D).")
    ] = None,
    schedule: Annotated[
        Literal["linear", "geometric"], typer.Option(help="xi = 10 k, or ten times more a stage.")
    ] = "linear",
    engine: Annotated[
        Literal["batched", "cma"],
        typer.Option(help="Ours, all runs at once; or pycma."),
    ] = "batched",
    polish: Annotated[bool, typer.Option(help="Gradient polish after the search.")] = True,
    proof: Annotated[
        bool, typer.Option("--certificate/--no-certificate", help="Least loss possible, beside it.")
    ] = True,
    search_anyway: Annotated[
        bool,
        typer.Option("--search-anyway", help="Also where no point of the bounds can be feasible."),
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue from the checkpoint in --out.")
    ] = False,
    tip: opt.Tip = None,
    json_file: opt.Json = None,
    out: opt.Out = None,
    seed: opt.Seed = 0,
    quiet: opt.Quiet = False,
    threads: opt.Threads = None,
    device_name: opt.Device = "cpu",
) -> None:
    """Extract physical parameter sets that give the identified base parameters, and classify them.

    Example: `torchid extract kuka_lwr4 --bounds normal --runs 50 --stages 35 --out sets`
    """
    output = open_output(json_file, out, quiet, threads)
    from rich.markup import escape

    from torchid.errors import MissingExtraError
    from torchid.extraction.convex.certificate import certificate_where_possible
    from torchid.extraction.extract import SearchSettings, require_possible
    from torchid.extraction.log_cholesky.extract import extract_log_cholesky
    from torchid.feasibility.sets import to_record
    from torchid.report.extraction import (
        Found,
        extraction_record,
        headline,
        judged,
        loss_notes,
        search_figure,
        tables,
    )
    from torchid.robot.library import load_robot

    settings = SearchSettings(
        runs, stages, generations, population, penalty, schedule, engine, polish, seed
    )
    if resume and out is None:
        raise TorchidError("--resume needs --out, where the checkpoint is.", expected="--out DIR")
    arm = load_robot(robot, tip=tip)
    problem, values, notes = build_problem(
        arm, result, bounds=bounds, geometry=geometry, shapes=shapes, total_mass=total_mass,
        loss=loss,
    )  # fmt: skip
    if penalty == "full" and not search_anyway:
        require_possible(problem)
    proven = None
    if proof or method == "sdp":
        try:
            proven, told = certificate_where_possible(problem)
            notes = (*notes, *told)
        except MissingExtraError as error:  # Clarabel; a search can do without
            output.warn((f"no certificate of the least loss: {error}",))
    if method == "sdp":
        found = _convex(problem, proven, search_anyway)
    elif method == "log-cholesky":
        began = time.monotonic()
        made = extract_log_cholesky(problem, runs=runs, seed=seed)
        sets = problem.sets(made.p, [f"run_{k + 1}" for k in range(len(made.p))])
        done = zip(sets.ids, made.converged.tolist(), strict=True)
        short = ", ".join(name for name, converged in done if not converged)
        if short:
            short = f"not converged, so their loss may be larger than it need be: {short}"
            notes = (*notes, short)
        taken = time.monotonic() - began
        found = Found(problem, "log-cholesky", *judged(problem, sets), None, taken)
    else:
        found = _searched(problem, settings, output, resume, opt.device(device_name))
    notes = (*notes, *loss_notes(found, values))
    output.say(*tables(found, proven))
    output.warn(notes)
    output.say(f"\n{escape(headline(found, proven))}")
    output.write_json(extraction_record(found, proven, notes), "extraction.json")
    if out is not None:
        write_json(to_record(found.sets, problem.robot), out / "sets.json")
    search = found.search
    if search is not None:
        output.draw(lambda: {"search": search_figure(search, proven)})


def _convex(problem: "Problem", proof: "Certificate | None", anyway: bool) -> "Found":
    from torchid.extraction.convex.certificate import certificate
    from torchid.extraction.polish.polish import polish
    from torchid.extraction.polish.region import region
    from torchid.report.extraction import Found, judged

    proof = certificate(problem) if proof is None else proof
    if not (proof.feasible or proof.conflict):
        raise TorchidError(
            "the convex solver failed on this problem.",
            got=proof.status,
            hint="--method cma-es, or log-cholesky",
        )
    if proof.sets is None or not (proof.with_conditions or anyway):
        raise TorchidError(
            "no feasible set exists within these bounds.",
            got=", ".join(proof.conflict) or proof.status,
            hint="other --bounds, --geometry or --total-mass; --search-anyway leaves the "
            "conditions out",
        )
    inside = region(problem, conditions=proof.with_conditions)
    start = problem.search_vector(proof.sets)
    # Bounds of barycentric inertias count in the program by a relaxation only: a descent within
    # the true ones can still lower the loss of its set.
    polished = problem.sets(polish(problem, inside, start), proof.sets.ids)
    own, lower = judged(problem, proof.sets), judged(problem, polished)
    better = bool(lower[-1].feasible[0]) and float(lower[1][0]) < float(own[1][0])
    return Found(problem, "sdp", *(lower if better else own), None, proof.seconds)


def _searched(
    problem: "Problem", settings: "SearchSettings", output: Output, resume: bool, where: str
) -> "Found":
    from torchid.extraction.extract import extract
    from torchid.report.extraction import Found, judged

    checkpoint = None if output.folder is None else output.folder / "checkpoint.npz"
    if checkpoint is not None and checkpoint.exists() != resume:
        output.warn(
            (
                f"there is no checkpoint in {output.folder}: the search starts anew"
                if resume
                else f"{output.folder} held the checkpoint of an interrupted search, which starts "
                "anew: --resume would have continued it",
            )
        )
    with progress_bar(output) as progress:
        try:
            found = extract(
                problem,
                settings,
                checkpoint=checkpoint,
                resume=resume,
                device=where,
                report=stage(progress, "stages"),
            )
        except KeyboardInterrupt:
            if checkpoint is not None and checkpoint.exists():
                sys.stderr.write(
                    f"interrupted; {checkpoint} is kept: the same command with --resume continues\n"
                )
            raise
    return Found(problem, "cma-es", *judged(problem, found.sets), found, found.seconds)
