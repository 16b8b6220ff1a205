"""The report's study of one robot as one call: excite, simulate, identify, validate, extract six
scenarios, classify, validate the sets, compare internal wrenches, and carry a payload."""

import time
from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import torch

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.excitation.synthetic import HonestNoise, PaperNoise, synthetic_log
from torchid.excitation.trajectories import (
    paper_trajectories_3r,
    random_trajectory,
    sinusoid,
    trajectory_log,
)
from torchid.extraction.convex.certificate import certificate_where_possible
from torchid.extraction.extract import Extraction, extract
from torchid.extraction.problem import Problem, Target, extraction_problem, two_step
from torchid.extraction.settings import SearchSettings
from torchid.feasibility.bounds import read_bounds
from torchid.feasibility.conditions import conditions
from torchid.feasibility.margins import feasibility
from torchid.feasibility.sets import ParameterSets, joined, nominal_set
from torchid.identification.base_parameters import nominal_values
from torchid.identification.identify import Settings, identify
from torchid.identification.payload import estimate_payload, with_payload
from torchid.identification.values import plain_effects
from torchid.log.model import Log
from torchid.parallel.workers import Workers, each
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor
from torchid.wrenches.deviation import wrench_errors
from torchid.wrenches.regressor import wrench_norms
from torchid_study.result import PayloadResult, ScenarioResult, SetsOnMotion, Study
from torchid_study.settings import MotionSettings, Scenario, StudySettings
from torchid_study.wrenches.alike import alike
from torchid_study.wrenches.compare import compare


def excitation(robot: Robot, settings: MotionSettings) -> Log:
    """The planned exciting trajectories (eq. 5.1)."""
    if settings.source == "table_5_1":
        return trajectory_log(paper_trajectories_3r(), settings.rate)
    trajectory = random_trajectory(
        robot, settings.seed, count=settings.count, duration=settings.duration
    )
    return trajectory_log(trajectory, settings.rate)


def new_motion(robot: Robot, settings: MotionSettings) -> Log:
    """A sinusoid within the limits (eq. 5.2), planned."""
    motion = sinusoid(robot, settings.seed, duration=settings.duration)
    return trajectory_log(motion, settings.rate)


def simulated_log(robot: Robot, motion: Log, settings: MotionSettings) -> Log:
    """The report's log of a motion: noise, if any, is on the trajectory."""
    noise = None if settings.noise_db is None else PaperNoise(snr_db=settings.noise_db)
    return synthetic_log(robot, motion, noise, settings.seed + 1)


def state(motion: Log) -> tuple[Tensor, Tensor, Tensor]:
    """q, dq, ddq (T, n) of a planned motion."""
    assert motion.dq is not None
    assert motion.ddq is not None
    return motion.q, motion.dq, motion.ddq


def sets_torque(robot: Robot, sets: ParameterSets, motion: Log) -> Float[Tensor, "K T n"]:
    """Joint torques (K, T, n) of whole sets, rigid body and effects [N m; N]."""
    signals = state(motion)
    rigid = inverse_dynamics(robot, *signals, InertialParameters(sets.parameters.pi.unsqueeze(1)))
    start = 0
    for effect in sets.effects:
        columns = effect.columns(Motion(*signals))
        stop = start + columns.shape[-1]
        rigid[..., effect.joint] += sets.coefficients[:, start:stop] @ columns.T
        start = stop
    return rigid


def with_real(sets: ParameterSets, real: ParameterSets) -> ParameterSets:
    """The true set before the others, under the name `real`, with the others' effects."""
    names = real.coefficient_names()
    order = [names.index(name) for name in sets.coefficient_names()]
    coefficients = real.coefficients[:, order]
    first = replace(real, ids=("real",), effects=sets.effects, coefficients=coefficients)
    return joined([first, sets])


def sets_on_motion(robot: Robot, sets: ParameterSets, motion: Log) -> SetsOnMotion:
    """Sets, the real one first, along a planned motion."""
    return SetsOnMotion(
        motion,
        sets.ids,
        sets_torque(robot, sets, motion),
        *wrench_norms(robot, *state(motion), sets.parameters),
    )


def payload_part(robot: Robot, settings: StudySettings, motion: Log) -> PayloadResult:
    """A payload identified from one exciting motion driven with and without it, with the noise of
    real sensors."""
    body = settings.payload
    com = torch.tensor([body.com], dtype=torch.float64)
    inertia = torch.tensor([body.inertia_about_com], dtype=torch.float64)
    mass = torch.tensor([body.mass], dtype=torch.float64)
    true = InertialParameters.from_com(mass, com, inertia).pi[0]
    loaded = with_payload(robot, true)
    # 200.0: sampling rate [Hz] of the logs of the payload part, which have the noise of real
    # sensors and are filtered: the report's 29 Hz would be too slow
    plan = excitation(robot, replace(settings.excitation, rate=200.0))
    chosen = Settings(effects=settings.effects, signs="free")
    results = []
    for k, arm in enumerate((robot, loaded)):
        log = synthetic_log(arm, plan, HonestNoise(), settings.excitation.seed + 10 + k)
        results.append(identify(arm, log, settings=chosen))
        chosen = replace(chosen, cutoff=results[0].cutoff)
    estimate = estimate_payload(*results)
    guessed = with_payload(robot, estimate.tool.parameters.value.nan_to_num(0.0))
    arms = (robot, loaded, guessed)
    pi = torch.stack([arm.require_parameters("the study").pi for arm in arms])
    force, _ = wrench_norms(robot, *state(motion), InertialParameters(pi))
    return PayloadResult(true, estimate, force)


Report = Callable[[str, int, int], None]


def run_study(
    settings: StudySettings,
    *,
    device: torch.device | str = "cpu",
    workers: Workers = 1,
    report: Report | None = None,
) -> Study:
    """Run a study.

    Args:
        settings: from `load_study`.
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
    log = simulated_log(robot, motion, settings.excitation)
    validation = simulated_log(robot, new_motion(robot, settings.validation), settings.validation)
    # The report's least squares: every row, no filter, no weights, no bounds on signs.
    paper = Settings(
        effects=settings.effects, cutoff=None, reversal=0.0, method="ols", signs="free"
    )
    result = identify(robot, log, held_out=validation, settings=paper, device=device)
    effects = plain_effects(result.effects, "a study")
    target = two_step(result.base, effects, result.values)
    clock.start("certificates")
    problems = _problems(robot, settings, target)
    proofs = {group: certificate_where_possible(problem) for group, problem in problems.items()}
    warnings = [note for _, notes in proofs.values() for note in notes]
    certificates = {group: proof for group, (proof, _) in proofs.items()}
    clock.stop()
    searches: list[_Search] = [
        (problems[scenario.bounds], replace(settings.search, penalty=scenario.penalty), device)
        for scenario in settings.scenarios
    ]
    every_extraction = each(_searched, searches, workers, "extractions", report)
    scenarios = []
    test = new_motion(robot, settings.sets_motion)
    for scenario, extraction in zip(settings.scenarios, every_extraction, strict=True):
        clock.took(f"extraction {scenario.id}", extraction.seconds)
        own = _scenario_result(robot, scenario, extraction, test)
        scenarios.append(own)
        # A feasible set with less loss than is possible is a fault, never to be passed over.
        # 1e-6: share of phi_min by which a feasible set's loss may be below it: the solver's
        # rounding
        least = certificates[scenario.bounds].phi_min * (1 - 1e-6)
        below = int((own.feasibility.feasible & (extraction.phi < least)).sum())
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


def _problems(robot: Robot, settings: StudySettings, target: Target) -> dict[str, Problem]:
    """The problem of each group of bounds."""
    geometry = read_bounds(robot, settings.geometry).com
    asked = conditions(robot, com_box=geometry, total_mass=settings.total_mass)
    return {
        group: extraction_problem(robot, target, read_bounds(robot, group), asked)
        for group in dict.fromkeys(scenario.bounds for scenario in settings.scenarios)
    }


def _scenario_result(
    robot: Robot, scenario: Scenario, extraction: Extraction, motion: Log
) -> ScenarioResult:
    """All runs of a scenario, and its best set's torque on a new motion."""
    best = replace(extraction.sets.part([extraction.best]), ids=(scenario.id,))
    torque = sets_torque(robot, with_real(best, nominal_set(robot)), motion)
    rms = (torque[1] - torque[0]).square().mean(0).sqrt()
    return ScenarioResult(
        scenario=scenario,
        extraction=extraction,
        feasibility=feasibility(extraction.sets, extraction.problem.conditions),
        best=best,
        torque_rms=rms,
        torque_relative=float((rms / torque[0].square().mean(0).sqrt()).max()),
    )


_Search = tuple[Problem, SearchSettings, torch.device | str]
"""Of one scenario: what, how, and where."""


def _searched(job: _Search) -> Extraction:
    problem, settings, device = job
    return extract(problem, settings, device=device)


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
