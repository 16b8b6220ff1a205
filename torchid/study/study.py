"""The report's study of one robot as one call: excite, simulate, identify, validate, extract six
scenarios, classify, validate the sets, compare internal wrenches, and carry a payload."""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import torch

from torchid.extraction.convex.certificate import Certificate, certificate_where_possible
from torchid.extraction.extract import Extraction, extract
from torchid.extraction.problem import Problem, extraction_problem, two_step
from torchid.extraction.settings import SearchSettings
from torchid.feasibility.bounds import read_bounds
from torchid.feasibility.conditions import conditions
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import joined, nominal_set
from torchid.identification.base_parameters import nominal_values
from torchid.identification.identify import Settings, identify
from torchid.identification.values import plain_effects
from torchid.parallel.workers import Workers, each
from torchid.robot.library import load_robot
from torchid.study.motions import (
    excitation,
    new_motion,
    payload_part,
    sets_on_motion,
    sets_torque,
    simulated,
    state,
    with_real,
)
from torchid.study.result import ScenarioResult, Study
from torchid.study.settings import StudySettings
from torchid.wrenches.compare import compare
from torchid.wrenches.deviation import alike, wrench_errors

Report = Callable[[str, int, int], None]

_BELOW = 1e-6
"""Share of phi_min by which a feasible set's loss may be below it: the solver's rounding."""


def run_study(
    settings: StudySettings,
    *,
    checkpoints: Path | None = None,
    resume: bool = False,
    device: torch.device | str = "cpu",
    workers: Workers = 1,
    report: Report | None = None,
) -> Study:
    """Run a study.

    Args:
        settings: from `load_study`.
        checkpoints: folder for the extractions' checkpoints, one a scenario. They are left there:
            whoever has saved the study removes them (`remove_checkpoints`).
        resume: continue from checkpoints found there; searches that were over are not repeated.
        device: where populations are evaluated.
        workers: who searches, a scenario at a time; see torchid.parallel.workers. The result is the
            same, bit for bit, for any number of them.
        report: called with (part, done, in all).

    Raises:
        TorchidError: settings that do not fit the robot.
    """
    clock = _Clock(report)
    robot = load_robot(settings.robot)
    clock.start("identification")
    motion = excitation(robot, settings.excitation)
    log = simulated(robot, motion, settings.excitation)
    validation = simulated(robot, new_motion(robot, settings.validation), settings.validation)
    # The report's least squares: every row, no filter, no weights, no bounds on signs.
    paper = Settings(
        effects=settings.effects, cutoff=None, reversal=0.0, method="ols", signs="free"
    )
    result = identify(robot, log, held_out=validation, settings=paper, device=device)
    effects = plain_effects(result.effects, "a study")
    target = two_step(result.base, effects, result.values)
    clock.start("certificates")
    # By group of bounds: the problem, its phi_min if it can be had, and what to know of it.
    geometry = read_bounds(robot, settings.geometry).com
    asked = conditions(robot, com_box=geometry, total_mass=settings.total_mass)
    problems: dict[str, Problem] = {}
    certificates: dict[str, Certificate] = {}
    warnings: list[str] = []
    for group in dict.fromkeys(scenario.bounds for scenario in settings.scenarios):
        problem = extraction_problem(robot, target, read_bounds(robot, group), asked)
        problems[group] = problem
        certificates[group], notes = certificate_where_possible(problem)
        warnings += notes
    searches = [
        _Search(
            problems[scenario.bounds],
            replace(settings.search, penalty=scenario.penalty),
            None if checkpoints is None else checkpoints.absolute() / f"{scenario.id}.npz",
            resume,
            device,
        )
        for scenario in settings.scenarios
    ]
    clock.stop()
    every_extraction = each(_searched, searches, workers, "extractions", report)
    scenarios = []
    test = new_motion(robot, settings.sets_motion)
    for scenario, found in zip(settings.scenarios, every_extraction, strict=True):
        clock.took(f"extraction {scenario.id}", found.seconds)
        best = replace(found.sets.part([found.best]), ids=(scenario.id,))
        torque = sets_torque(robot, with_real(best, nominal_set(robot)), test)
        rms = (torque[1] - torque[0]).square().mean(0).sqrt()
        own = ScenarioResult(
            scenario=scenario,
            extraction=found,
            feasibility=feasibility(found.sets, found.problem.conditions),
            best=best,
            torque_rms=rms,
            torque_relative=float((rms / torque[0].square().mean(0).sqrt()).max()),
        )
        scenarios.append(own)
        # A feasible set with less loss than is possible is a fault, never to be passed over.
        proof = certificates.get(scenario.bounds)
        least = proof.phi_min * (1 - _BELOW) if proof is not None else -math.inf
        below = int((own.feasibility.feasible & (found.phi < least)).sum())
        if below:
            said = "sets are feasible and have a loss below phi_min"
            warnings.append(f"{scenario.id}: {below} {said}")
    clock.start("wrenches")
    shown = with_real(joined([s.best for s in scenarios]), nominal_set(robot))
    reference = new_motion(robot, settings.wrench_motion)
    every = joined([s.extraction.sets for s in scenarios])
    real = robot.require_parameters("the study")
    errors = wrench_errors(robot, *state(reference), every.parameters, real)
    runs = settings.search.runs
    comparison = compare(
        errors.force_rms.amax(-1),
        [s.feasibility.reasons(k) for s in scenarios for k in range(runs)],
        torch.cat([s.feasibility.degree for s in scenarios]),
        cluster=alike(errors.force_rms, torch.arange(len(errors.force_rms)) // runs),
    )
    on_sets, on_reference = (sets_on_motion(robot, shown, plan) for plan in (test, reference))
    clock.start("payload")
    payload = payload_part(robot, settings, reference)
    return Study(
        settings=settings,
        robot=robot,
        excitation=motion,
        log=log,
        identification=result,
        truth=nominal_values(robot, result.base),
        validation=validation,
        scenarios=tuple(scenarios),
        certificates=MappingProxyType(certificates),
        sets_motion=on_sets,
        wrench_motion=on_reference,
        errors=errors,
        comparison=comparison,
        payload=payload,
        seconds=MappingProxyType(clock.stop()),
        warnings=tuple(dict.fromkeys(warnings)),
    )


def remove_checkpoints(settings: StudySettings, checkpoints: Path) -> None:
    """Remove what `run_study` has left in the folder, and the folder if nothing else is in it."""
    for scenario in settings.scenarios:
        (checkpoints / f"{scenario.id}.npz").unlink(missing_ok=True)
    with suppress(OSError):
        checkpoints.rmdir()


@dataclass(frozen=True, eq=False)
class _Search:
    """A scenario's extraction.

    Attributes:
        problem, settings, checkpoint, resume, device: as `extract` takes them.
    """

    problem: Problem
    settings: SearchSettings
    checkpoint: Path | None
    resume: bool
    device: torch.device | str


def _searched(job: _Search) -> Extraction:
    """What it finds; its checkpoint is kept."""
    return extract(
        job.problem,
        job.settings,
        checkpoint=job.checkpoint,
        resume=job.resume,
        keep=True,
        device=job.device,
    )


class _Clock:
    """Seconds of each part, and progress."""

    def __init__(self, report: Report | None):
        self._report = report
        self._seconds: dict[str, float] = {}
        self._part, self._began = "", 0.0

    def took(self, part: str, seconds: float) -> None:
        """A part that was timed where it was done."""
        self._seconds[part] = seconds

    def start(self, part: str, done: int = 0, total: int = 1) -> None:
        """The next part begins."""
        self.stop()
        self._part, self._began = part, time.monotonic()
        if self._report is not None:
            self._report(part, done, total)

    def stop(self) -> dict[str, float]:
        """Seconds of all parts so far."""
        if self._part:
            self._seconds[self._part] = time.monotonic() - self._began
            self._part = ""
        return self._seconds
