"""The report's study of one robot as one call: excite, simulate, identify, validate, extract six
scenarios, classify, validate the sets, compare internal wrenches, and carry a payload."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import torch
from msgspec import structs

from torchid.effects.base import Motion
from torchid.effects.registry import model_torque, nominal_effects
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
from torchid.extraction.record import certificate_record
from torchid.extraction.settings import SearchSettings
from torchid.feasibility.bounds import read_bounds
from torchid.feasibility.conditions import conditions
from torchid.feasibility.margins import Feasibility, feasibility
from torchid.feasibility.sets import ParameterSets, joined
from torchid.identification.base_parameters import nominal_values
from torchid.identification.identify import Identification, Settings, identify
from torchid.identification.payload import estimate_payload, with_payload
from torchid.identification.values import plain_effects
from torchid.log.model import Log
from torchid.parallel.workers import Workers, each
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor
from torchid.wrenches.deviation import wrench_errors
from torchid_study.equal_torque.setting import logged_motion
from torchid_study.result import (
    ClassRecord,
    RunsRecord,
    ScenarioRecord,
    Study,
    StudyIdentification,
    StudyPayload,
    StudyRecord,
    StudySearch,
    WrenchesRecord,
)
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


def simulated_log(robot: Robot, motion: Log, settings: MotionSettings) -> Log:
    """The report's log of a motion: noise, if any, is on the trajectory."""
    noise = None if settings.noise_db is None else PaperNoise(snr_db=settings.noise_db)
    return synthetic_log(robot, motion, noise, settings.seed + 1)


def new_motion(robot: Robot, settings: MotionSettings) -> Log:
    """A sinusoid within the limits (eq. 5.2), planned."""
    motion = sinusoid(robot, settings.seed, duration=settings.duration)
    return trajectory_log(motion, settings.rate)


def torque_error(robot: Robot, own: ParameterSets, motion: Motion) -> Float[Tensor, " n"]:
    """Root mean square difference (n,) of a whole set's torque, rigid body and effects, from the
    robot's [N m; N]."""
    values = iter(own.coefficients[0].tolist())
    effects = [(effect, [next(values) for _ in effect.coefficients]) for effect in own.effects]
    real = model_torque(robot, nominal_effects(robot), motion)
    return (model_torque(own.to_robot(robot, 0), effects, motion) - real).square().mean(0).sqrt()


def payload_part(robot: Robot, settings: StudySettings) -> StudyPayload:
    """A payload identified from one exciting motion driven with and without it, with the noise of
    real sensors."""
    body = settings.payload
    com = torch.tensor([body.com], dtype=torch.float64)
    inertia = torch.tensor([body.inertia_about_com], dtype=torch.float64)
    mass = torch.tensor([body.mass], dtype=torch.float64)
    true = InertialParameters.from_com(mass, com, inertia).pi[0]
    # 200.0: sampling rate [Hz] of the logs of the payload part, which have the noise of real
    # sensors and are filtered: the report's 29 Hz would be too slow
    plan = excitation(robot, structs.replace(settings.excitation, rate=200.0))
    chosen = Settings(effects=settings.effects, signs="free")
    results = []
    for k, arm in enumerate((robot, with_payload(robot, true))):
        log = synthetic_log(arm, plan, HonestNoise(), settings.excitation.seed + 10 + k)
        results.append(identify(arm, log, settings=chosen))
        chosen = replace(chosen, cutoff=results[0].cutoff)
    return StudyPayload.of(estimate_payload(*results), true=true)


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
    seconds: dict[str, float] = {}

    @contextmanager
    def timed(part: str) -> Iterator[None]:
        began = time.monotonic()
        if report is not None:
            report(part, 0, 1)
        yield
        seconds[part] = time.monotonic() - began

    robot = load_robot(settings.robot)
    with timed("identification"):
        log = simulated_log(robot, excitation(robot, settings.excitation), settings.excitation)
        validation = new_motion(robot, settings.validation)
        # The report's least squares: every row, no filter, no weights, no bounds on signs.
        paper = Settings(
            effects=settings.effects, cutoff=None, reversal=0.0, method="ols", signs="free"
        )
        result = identify(
            robot,
            log,
            held_out=simulated_log(robot, validation, settings.validation),
            settings=paper,
            device=device,
        )
    with timed("certificates"):
        effects = plain_effects(result.effects, "a study")
        problems = _problems(robot, settings, two_step(result.base, effects, result.values))
        proofs = {group: certificate_where_possible(problem) for group, problem in problems.items()}
    warnings = [note for _, notes in proofs.values() for note in notes]
    scenarios = settings.scenarios
    searches: list[_Search] = [
        (problems[scenario.bounds], replace(settings.search, penalty=scenario.penalty), device)
        for scenario in scenarios
    ]
    extractions = each(_searched, searches, workers, "extractions", report)
    checked = [feasibility(e.sets, e.problem.conditions) for e in extractions]
    for scenario, extraction, verdict in zip(scenarios, extractions, checked, strict=True):
        seconds[f"extraction {scenario.id}"] = extraction.seconds
        # A feasible set with less loss than is possible is a fault, never to be passed over.
        # 1e-6: share of phi_min by which a feasible set's loss may be below it: the solver's
        # rounding
        least = proofs[scenario.bounds][0].phi_min * (1 - 1e-6)
        below = int((verdict.feasible & (extraction.phi < least)).sum())
        if below:
            said = "sets are feasible and have a loss below phi_min"
            warnings.append(f"{scenario.id}: {below} {said}")
    with timed("wrenches"):
        every = joined(
            [
                replace(e.sets, ids=tuple(f"{scenario.id}/{run}" for run in e.sets.ids))
                for scenario, e in zip(scenarios, extractions, strict=True)
            ]
        )
        reference = logged_motion(new_motion(robot, settings.wrench_motion), robot)
        real = robot.require_parameters("the study")
        wrenches = wrench_errors(robot, *reference.state, every.parameters, real)
        runs = settings.search.runs
        comparison = compare(
            wrenches.force_rms.amax(-1),
            [verdict.reasons(k) for verdict in checked for k in range(runs)],
            torch.cat([verdict.degree for verdict in checked]),
            cluster=alike(wrenches.force_rms, torch.arange(len(every)) // runs),
        )
        test = logged_motion(new_motion(robot, settings.sets_motion), robot)
        rows = [k * runs + e.best for k, e in enumerate(extractions)]
        best = replace(every.part(rows), ids=tuple(scenario.id for scenario in scenarios))
        records = tuple(
            _scenario(
                *one,
                torque_rms=torque_error(robot, best.part([k]), test),
                force_norm_difference_rms=wrenches.force_norm_rms[rows[k]],
            )
            for k, one in enumerate(zip(scenarios, extractions, checked, strict=True))
        )
    with timed("payload"):
        payload = payload_part(robot, settings)
    record = StudyRecord(
        study=settings.name,
        robot=robot.name,
        section=settings.section,
        identification=_identification(robot, log, result),
        sets=records,
        certificate={group: certificate_record(proof) for group, (proof, _) in proofs.items()},
        wrenches=WrenchesRecord(
            classes=tuple(
                ClassRecord.of(c, quartiles=(c.lower_quartile, c.upper_quartile))
                for c in comparison.classes
            ),
            unit="N, largest joint's rms against the true set, all runs of all scenarios",
        ),
        payload=payload,
        search=StudySearch.of(settings.search),
        seconds=seconds,
        warnings=tuple(dict.fromkeys(warnings)),
    )
    return Study(settings.title, record, extractions, best, every, wrenches, comparison)


def _identification(robot: Robot, log: Log, result: Identification) -> StudyIdentification:
    """Coefficients of the log, identified and true."""
    truth, errors = nominal_values(robot, result.base), result.held_out
    return StudyIdentification.of(
        result,
        names=result.base.names,
        true=truth,
        largest_error=float((result.values - truth).abs().max()),
        rows=int(log.samples * robot.n),
        validation_error_percent=() if errors is None else tuple(errors.relative_percent.tolist()),
    )


def _scenario(
    scenario: Scenario, extraction: Extraction, verdict: Feasibility, **beside: Tensor
) -> ScenarioRecord:
    """All runs of a scenario and its best set, with what is known of that set `beside`."""
    best = extraction.best
    return ScenarioRecord.of(
        scenario,
        phi=float(extraction.phi[best]),
        gamma=float(extraction.gamma[best]),
        feasible=bool(verdict.feasible[best]),
        reasons=verdict.reasons(best),
        degree=float(verdict.degree[best]),
        runs=RunsRecord.of(
            extraction,
            feasible=int(verdict.feasible.sum()),
            gamma_zero=int((extraction.gamma == 0).sum()),
            reasons=[verdict.reasons(run) for run in range(len(extraction.sets))],
            degree=verdict.degree,
        ),
        contradictions=extraction.contradictions,
        **beside,
    )


def _problems(robot: Robot, settings: StudySettings, target: Target) -> dict[str, Problem]:
    """The problem of each group of bounds."""
    geometry = read_bounds(robot, settings.geometry).com
    asked = conditions(robot, com_box=geometry, total_mass=settings.total_mass)
    return {
        group: extraction_problem(robot, target, read_bounds(robot, group), asked)
        for group in dict.fromkeys(scenario.bounds for scenario in settings.scenarios)
    }


_Search = tuple[Problem, SearchSettings, torch.device | str]
"""Of one scenario: what, how, and where."""


def _searched(job: _Search) -> Extraction:
    problem, settings, device = job
    return extract(problem, settings, device=device)
