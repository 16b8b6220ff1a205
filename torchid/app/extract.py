"""`torchid extract` and `torchid atlas`: physical parameters from base parameters."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import torchid
from torchid.app import options as opt
from torchid.app.output import Drawn
from torchid.app.signature import Fields, Switch, command
from torchid.extraction.settings import SearchSettings

if TYPE_CHECKING:
    from torchid.extraction.problem import LossName, Problem
    from torchid.identification.values import BaseValues


@dataclass(frozen=True, kw_only=True)
class Sought:
    """Whose base parameters, under which bounds and conditions.

    Attributes:
        result: JSON of `torchid identify`; without it, the base parameters of the robot's nominal
            parameters.
        bounds: Group of bounds in the robot's yaml; from-robot: of its nominal parameters and
            shapes; wide: of the size of its links; none: any body. Default: normal, else
            from-robot, and wide for a robot without parameters.
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
        self, arm: opt.Arm, loss: "LossName | None" = None
    ) -> "tuple[Problem, BaseValues, tuple[str, ...]]":
        """The problem that the options describe, the base parameters, and notes for the user."""
        from torchid.identification.values import nominal_base, read_base

        robot = arm.load()
        base = nominal_base(robot) if self.result is None else read_base(self.result, robot)
        problem, notes = torchid.problem_of(
            robot,
            base,
            bounds=self.bounds,
            geometry=self.geometry,
            shapes=self.shapes,
            total_mass=self.total_mass,
            loss=loss,
        )
        return problem, base, notes


@command
def extract_command(
    *,
    arm: opt.Arm,
    sought: Sought,
    method: Literal["cma-es", "sdp", "near"] | None = None,
    loss: Literal["two-step", "one-step"] | None = None,
    settings: Annotated[
        SearchSettings, Fields("runs stages generations population penalty schedule", seed=opt.Seed)
    ],
    certificate: bool = True,
    search_anyway: Switch = False,
    engine: opt.Crew,
    output: Annotated[Drawn, "extraction.json"],
    device_name: opt.Device = "cpu",
) -> None:
    """Extract physical parameter sets that give the identified base parameters, and classify them.

    Example: `torchid extract kuka_lwr4 --bounds normal --runs 50 --stages 35 --out sets`

    Args:
        method: Population search (Algorithm 1), convex optimum, or the bodies nearest to nominal or
            typical ones with nearly the least loss. Default: near within wide or none, else cma-es.
        loss: Distance to the coefficients (2.28), or to the torques of the log (2.29), by the
            fit's triangular factor. Default: two-step; one-step within wide or none.
        stages: Stages of Algorithm 1.
        generations: Generations of each stage.
        population: Of each run (default: 4 + 3 ln D).
        penalty: Full loss phi + xi gamma, or phi alone (sets may be infeasible).
        schedule: xi = 10 k, or ten times more a stage.
        certificate: Least loss possible, beside it.
        search_anyway: Also where no point of the bounds can be feasible.
    """
    from torchid.extraction.methods import found_by
    from torchid.feasibility.derived_bounds import NONE, WIDE
    from torchid.feasibility.sets import sets_record
    from torchid.report.extraction import loss_notes, report_of_extraction

    problem, values, notes = sought.problem(arm, loss)
    # Where nothing bounds the bodies but their links' size, a search would answer any of them.
    method = method or ("near" if problem.bounds.name in (WIDE, NONE) else "cma-es")
    with output.progress() as progress:
        extraction = found_by(
            method, problem, settings, certificate=certificate, search_anyway=search_anyway,
            device=device_name, workers=engine.crew, progress=progress,
        )  # fmt: skip
    warnings = (*notes, *extraction.warnings, *loss_notes(extraction, values))
    extraction = replace(extraction, warnings=warnings)
    file = sets_record(extraction.sets, problem.robot, knowledge=problem.robot.knowledge)
    output.put(output.out and output.out / "sets.json", file.save)
    output.tell(output.keep(extraction, "extraction.json", report_of_extraction))


@command
def atlas_command(
    *,
    arm: opt.Arm,
    sought: Sought,
    level: Annotated[float, typer.Option(min=0.01, max=0.9999)] = 0.95,
    output: Annotated[Drawn, "atlas.json"],
) -> None:
    """The range of every physical parameter over all feasible sets with the same torque.

    Example: `torchid atlas kuka_lwr4 --bounds normal --out atlas`

    Args:
        level: Of the confidence region of identified base parameters.
    """
    from torchid.parallel.workers import stage
    from torchid.report.extraction import report_of_atlas

    problem, base, notes = sought.problem(arm, "two-step")
    if base.held:
        held = ", ".join(base.held)
        notes = (*notes, f"held by the identification, and taken for exact here: {held}")
    with output.progress() as progress:
        ranges = torchid.atlas(
            problem, covariance=base, level=level, progress=stage(progress, "ends")
        )
    data = {**ranges.plain(), "warnings": list(notes)}
    output.give(data, "atlas.json", lambda _: report_of_atlas(ranges, problem, notes))
