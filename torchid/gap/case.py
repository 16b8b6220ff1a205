"""One diagnosis in the making: rows, noise, candidates and the model they are judged against."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from torchid.effects.registry import KINDS, nominal_effects
from torchid.errors import LogError, TorchidError
from torchid.gap.bank import Bank, rescaled
from torchid.gap.candidates import Evaluator
from torchid.gap.folds import Model
from torchid.gap.noise import Noise, dry_friction, noise_of
from torchid.gap.passages import Rows, reach
from torchid.gap.prepare import SAME_RATE, Prepared, prepare, report_band
from torchid.gap.problem import Term
from torchid.gap.settings import GapSettings
from torchid.gap.solve import Solution, solve
from torchid.gap.task import Task, banks_of
from torchid.identification.base_parameters import base_parameters
from torchid.identification.identify import refuse_repeated
from torchid.log.model import Log
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Bool, Tensor

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Case:
    """One diagnosis in the making.

    Attributes:
        start: the model as given, or fitted.
        fitted: whether it had to be fitted, because the robot has no parameters.
        given, checked: the log searched, and the one held out.
        task: what is looked for.
        noise: floor and whitener.
        evaluator: of the model as given on the log searched, whitened.
        plain: the same, its rows divided by their noise only.
        banks: candidates.
    """

    start: Model
    fitted: bool
    given: Prepared
    checked: Prepared | None
    task: Task
    noise: Noise
    evaluator: Evaluator
    plain: Evaluator
    banks: tuple[Bank, ...]

    @property
    def keep(self) -> Bool[Tensor, "n N"]:
        """Rows that count."""
        return self.given.counting(self.noise.repeated)


def make_case(
    robot: Robot, log: Log, held_out: Log | None, settings: GapSettings, say: Progress
) -> Case:
    """Read, filter and whiten the logs, fit what must be fitted first, and make candidates.

    Raises:
        LogError: logs that do not fit the robot or each other.
    """
    say("reading", 0, 1)
    cutoff = None if settings.cutoff == "auto" else settings.cutoff
    if log.tau is not None and (held_out is None or held_out.tau is not None):
        refuse_repeated(log, held_out)
    given = prepare(robot, log, cutoff)
    checked = None
    if held_out is not None:
        checked = prepare(robot, held_out, given.rows.cutoff, clock=given.end + 1.0)
    if checked is not None and abs(checked.rows.rate / given.rows.rate - 1) > SAME_RATE:
        raise LogError(
            "the held-out logs have another sampling rate.",
            got=f"{checked.rows.rate:.5g} Hz",
            expected=f"{given.rows.rate:.5g} Hz",
            hint="resample one of them",
        )
    task = _task(robot, given, settings)
    start = _start(robot, given, task)
    say("measuring the noise", 0, 1)
    noise = noise_at(start, given, settings, keep=None)
    task = replace(task, whitened=noise.repeated)
    if noise.repeated:
        far = reach(given.rows, dry_friction(start.robot, start.effects, given.rows) / noise.size)
        given = given.reaching(far)
        checked = None if checked is None else checked.reaching(far)
    fitted = robot.parameters is None
    return Case(
        start, fitted, given, checked, task, noise, *_candidates(start, given, task, noise, say)
    )


def noise_at(model: Model, given: Prepared, settings: GapSettings, *, keep: Tensor | None) -> Noise:
    """Noise that a model leaves in the given rows; `keep`: where structure is looked for in it."""
    band = report_band(given.rows, settings.report_band)
    shown = Rows(given.rows.passages, band)
    return noise_of(model.robot, model.effects, given.rows, shown, keep=keep, seed=settings.seed)


def _candidates(
    start: Model, given: Prepared, task: Task, noise: Noise, say: Progress
) -> tuple[Evaluator, Evaluator, tuple[Bank, ...]]:
    say("computing candidates", 0, 1)
    keep = given.counting(noise.repeated)
    whiten = noise.whitening(given.rows, keep)
    evaluator = Evaluator(start.robot, start.effects, given.rows, whiten)
    plain = evaluator.with_whitener(noise.scaling(keep))
    return evaluator, plain, tuple(banks_of(evaluator, task))


def with_noise(case: Case, found: Solution, settings: GapSettings, say: Progress) -> Case:
    """The same case, its noise measured on what a search has left."""
    say("measuring the noise", 0, 1)
    noise = noise_at(Model(found.robot, found.effects), case.given, settings, keep=None)
    factor = case.noise.size / noise.size
    evaluator = case.evaluator.with_whitener(noise.scaling(case.keep))
    return replace(
        case,
        noise=noise,
        evaluator=evaluator,
        plain=evaluator,
        banks=tuple(rescaled(bank, factor) for bank in case.banks),
    )


def _task(robot: Robot, given: Prepared, settings: GapSettings) -> Task:
    free = settings.parameters == "free" or robot.parameters is None
    if settings.background and not free:
        raise TorchidError(
            "a background is fitted with the base parameters, and this robot's are given.",
            got=", ".join(settings.background),
            hint="list them as `effects` of the robot, or refit: --parameters free",
        )
    return Task(
        base=base_parameters(robot),
        names=tuple(KINDS) if settings.effects is None else settings.effects,
        background=settings.background,
        free=free,
        inertial=settings.parameters != "trusted",
        own_velocity=given.own_velocity,
        age=given.age,
        whitened=True,
        most=settings.max_effects,
        alpha=settings.alpha,
        seed=settings.seed,
        only=settings.only,
    )


def _start(robot: Robot, given: Prepared, task: Task) -> Model:
    """The model as given; where it has no parameters, base parameters and background fitted with
    rows weighted by each joint's torque."""
    if robot.parameters is not None:
        return Model(robot, tuple(nominal_effects(robot)))
    zero = torch.zeros(robot.n, PARAMETERS_PER_LINK, dtype=torch.float64)
    empty = Model(robot.with_parameters(InertialParameters(zero)), tuple(nominal_effects(robot)))
    size = torch.cat([p.tau for p in given.rows.passages]).std(0).clamp(min=1e-12)
    keep = given.moving
    evaluator = Evaluator(
        empty.robot, empty.effects, given.rows, lambda x, j: x * keep[j] / size[j]
    )
    return refitted_model(evaluator, keep, task)


def refitted_model(
    evaluator: Evaluator,
    keep: Bool[Tensor, "n N"],
    task: Task,
    folds: Bool[Tensor, " N"] | None = None,
) -> Model:
    """The model with base parameters, and the background, refitted on the rows that count."""
    free = replace(task, free=True)
    bare = solve(evaluator, evaluator, keep, replace(free, most=0), (), folds)
    return Model(bare.robot, bare.effects)


@dataclass(frozen=True)
class FoldModels:
    """One model a fold, and what the fold's search accepted; nothing with a held-out log."""

    before: list[Model]
    refitted: list[Model]
    after: list[Model]
    terms: list[tuple[Term, ...]]
