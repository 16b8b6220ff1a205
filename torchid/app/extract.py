"""`torchid extract` and `torchid atlas`: physical parameters from base parameters."""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from torchid.app import options as opt
from torchid.app.faults import resumable
from torchid.app.output import Computed, Output, stage
from torchid.app.signature import Fields, Switch, command
from torchid.errors import TorchidError
from torchid.extraction.settings import EngineName, SearchSettings

if TYPE_CHECKING:
    from torchid.extraction.problem import LossName, Problem
    from torchid.identification.values import BaseValues
    from torchid.report.extraction import Found


@dataclass(frozen=True, kw_only=True)
class Sought:
    """Whose base parameters, under which bounds and conditions.

    Attributes:
        result: JSON of `torchid identify`; without it, the base parameters of the robot's nominal
            parameters.
        bounds: Group of bounds in the robot's yaml, or bounds derived from its nominal parameters
            and shapes. Default: normal, else from-robot.
        geometry: Bounds whose boxes of the centres of mass are the links' geometry. Default:
            normal where there is one, else the bounds' own.
        shapes: Centres of mass inside the links' cylinders and spheres.
        total_mass: Interval of the total mass.
    """

    result: Annotated[Path | None, typer.Argument(metavar="[RESULT]")] = None
    bounds: opt.Bounds = None
    geometry: opt.Group = None
    shapes: Switch = False
    total_mass: opt.TotalMass = None

    def problem(
        self, arm: opt.Arm, loss: "LossName" = "two-step"
    ) -> "tuple[Problem, BaseValues, tuple[str, ...]]":
        """The problem that the options describe, the base parameters, and notes for the user."""
        from torchid.extraction.from_identification import problem_of
        from torchid.identification.values import nominal_base, read_base

        robot = arm.load()
        found = nominal_base(robot) if self.result is None else read_base(self.result, robot)
        problem, notes = problem_of(
            robot,
            found,
            bounds=self.bounds,
            geometry=self.geometry,
            shapes=self.shapes,
            total_mass=self.total_mass,
            loss=loss,
        )
        return problem, found, notes


@command
def extract_command(
    *,
    arm: opt.Arm,
    sought: Sought,
    method: Literal["cma-es", "log-cholesky", "sdp"] = "cma-es",
    loss: Literal["two-step", "one-step"] = "two-step",
    settings: Annotated[
        SearchSettings,
        Fields(
            "runs",
            "stages",
            "generations",
            "population",
            "penalty",
            "schedule",
            "polish",
            engine=EngineName,
            seed=opt.Seed,
        ),
    ],
    certificate: bool = True,
    search_anyway: Switch = False,
    resume: Switch = False,
    output: Computed,
    device_name: opt.Device = "cpu",
) -> None:
    """Extract physical parameter sets that give the identified base parameters, and classify them.

    Example: `torchid extract kuka_lwr4 --bounds normal --runs 50 --stages 35 --out sets`

    Args:
        method: Population search (Algorithm 1), gradient, or convex optimum.
        loss: Distance to the coefficients (2.28), or to the torques of the log (2.29), by the
            fit's triangular factor.
        stages: Stages of Algorithm 1.
        generations: Generations of each stage.
        population: Of each run (default: 4 + 3 ln D).
        penalty: Full loss phi + xi gamma, or phi alone (sets may be infeasible).
        schedule: xi = 10 k, or ten times more a stage.
        engine: Ours, all runs at once; or pycma.
        polish: Gradient polish after the search.
        certificate: Least loss possible, beside it.
        search_anyway: Also where no point of the bounds can be feasible.
        resume: Continue from the checkpoint in --out.
    """
    from torchid.extraction.convex.certificate import certificate_where_possible
    from torchid.extraction.extract import require_possible
    from torchid.extraction.found import Found, best_set, judged
    from torchid.extraction.log_cholesky.extract import extract_log_cholesky
    from torchid.feasibility.sets import sets_record
    from torchid.report.extraction import headline, loss_notes, search_figure, tables

    if resume and output.out is None:
        raise TorchidError("--resume needs --out, where the checkpoint is.", expected="--out DIR")
    problem, values, notes = sought.problem(arm, loss)
    if settings.penalty == "full" and not search_anyway:
        require_possible(problem)
    proven = None
    if certificate or method == "sdp":
        with output.progress("the certificate"):
            proven, told = certificate_where_possible(problem)
        notes = (*notes, *told)
    if method == "sdp":
        with output.progress("the best set"):
            found = best_set(problem, proof=proven, search_anyway=search_anyway)
    elif method == "log-cholesky":
        began = time.monotonic()
        with output.progress("descending"):
            made = extract_log_cholesky(problem, runs=settings.runs, seed=settings.seed)
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
    output.write_json(replace(found, proof=proven, warnings=notes).plain(), "extraction.json")
    if output.out is not None:
        sets_record(found.sets, problem.robot).save(output.out / "sets.json")
        output.written.append(output.out / "sets.json")
    search = found.search
    if search is not None:
        if output.out is not None:
            # Not sooner: what was searched for is not lost where the disk is full.
            _checkpoint(output.out).unlink(missing_ok=True)
        output.draw(lambda: {"search": search_figure(search, proven)})
    output.say(*tables(found, proven))
    output.warn(notes)
    output.say(f"\n{headline(found, proven)}")


def _searched(
    problem: "Problem", settings: "SearchSettings", output: Output, resume: bool, where: str
) -> "Found":
    from torchid.extraction.extract import extract
    from torchid.extraction.found import Found, judged

    checkpoint = None if output.out is None else _checkpoint(output.out)
    if checkpoint is not None and checkpoint.exists() != resume:
        output.warn(
            (
                f"there is no checkpoint in {output.out}: the search starts anew"
                if resume
                else f"{output.out} held the checkpoint of an interrupted search, which starts "
                "anew: --resume would have continued it",
            )
        )
    with resumable(checkpoint), output.progress() as progress:
        found = extract(
            problem,
            settings,
            checkpoint=checkpoint,
            resume=resume,
            keep=True,
            device=where,
            report=stage(progress, "stages"),
        )
    return Found(problem, "cma-es", *judged(problem, found.sets), found, found.seconds)


def _checkpoint(out: Path) -> Path:
    return out / "checkpoint.npz"


@command
def atlas_command(
    *,
    arm: opt.Arm,
    sought: Sought,
    level: Annotated[float, typer.Option(min=0.01, max=0.9999)] = 0.95,
    output: Computed,
) -> None:
    """The range of every physical parameter over all feasible sets with the same torque.

    Example: `torchid atlas kuka_lwr4 --bounds normal --out atlas`

    Args:
        level: Of the confidence region of identified base parameters.
    """
    from torchid.extraction.convex.atlas import atlas
    from torchid.report.extraction import atlas_figure, atlas_headline, atlas_table

    problem, found, notes = sought.problem(arm)
    if found.held:
        held = ", ".join(found.held)
        notes = (*notes, f"held by the identification, and taken for exact here: {held}")
    with output.progress() as progress:
        ranges = atlas(problem, covariance=found, level=level, progress=stage(progress, "ends"))
    output.write_json({**ranges.plain(), "warnings": list(notes)}, "atlas.json")
    output.draw(lambda: {"atlas": atlas_figure(ranges.record)})
    output.say(atlas_table(ranges))
    output.warn(notes)
    output.say(f"\n{atlas_headline(ranges, problem)}")
