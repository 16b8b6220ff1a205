"""From a simulator and logs of the real arm to a diagnosis: the whole procedure as one call.

The model as given is the simulator. The gap is the measured torque minus the model's. Effects are
sought on all rows; what they close is judged on trajectories (or stretches) left out of the search,
which is run again for every one of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import torch

from torchid.effects.registry import KINDS, nominal_effects
from torchid.errors import LogError, TorchidError
from torchid.gap.candidates import Bank, Evaluator, rescaled
from torchid.gap.closing import Closing, budget, closing
from torchid.gap.detectable import not_testable
from torchid.gap.diagnosis import Diagnosis, HowFar, NoiseFloor, Parametric, Status
from torchid.gap.findings import Findings, findings, next_experiment
from torchid.gap.folds import Folds, Model, make_folds, traces
from torchid.gap.noise import STRUCTURE, Noise, noise_of
from torchid.gap.passages import Rows
from torchid.gap.prepare import SAME_RATE, Prepared, prepare, report_band
from torchid.gap.problem import Term
from torchid.gap.select import Search
from torchid.gap.settings import GapSettings
from torchid.gap.solve import Solution, settled, solve
from torchid.gap.task import Task, banks_of
from torchid.gap.where import where
from torchid.identification.base_parameters import base_parameters
from torchid.identification.identify import refuse_repeated
from torchid.log.model import Log
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Bool, Tensor

EXCESS = 1.35
"""Held-out variance of a joint, relative to its noise, above which something is unexplained if a
flexible predictor agrees,"""
CLEAR_EXCESS = 2.0
"""and above which it is, whatever that says: the noise is known to a few ten per cent."""

EXPLAINED = 0.9
"""Share of the gap that what explains it may close: the interval's upper end, at least."""

ROUNDS = 3
SETTLED = 0.9
"""Without repeats: searches after the first at most, each with the noise that the last one left,
and the ratio of two of them from which it has settled."""

EVENTS = ("contact", "dropped_samples")
"""Effects of one log, not of the arm."""

SHORTEST = 8.0
"""Seconds of rows below which `no gap` cannot be said."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class _Case:
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


def diagnose(
    robot: Robot,
    log: Log,
    *,
    held_out: Log | None = None,
    settings: GapSettings | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Where the simulator disagrees with the arm, which effects cause it, how far they close it.

    Args:
        robot: the simulator: nominal parameters and effects. Without parameters they are fitted
            first, together with `settings.background`.
        log: trajectories of the real arm.
        held_out: trajectories that take part in no choice. If None, every trajectory (or stretch)
            is left out in turn.
        settings: how; defaults if None.
        progress: called with (stage, done, total).

    Raises:
        LogError: logs that do not fit the robot or cannot be used.
    """
    settings = settings or GapSettings()
    if held_out is None and settings.held_out_fraction > 0:
        log, held_out = log.split(1 - settings.held_out_fraction)
    elif held_out is not None and settings.held_out_fraction > 0:
        raise LogError(
            "both a held-out log and a held-out fraction are given.", expected="one of them"
        )
    say = progress or (lambda stage, done, total: None)
    case = _case(robot, log, held_out, settings, say)
    keep = case.keep
    say("searching for effects", 0, 1)
    whole = solve(case.evaluator, case.plain, keep, case.task, case.banks)
    for _ in range(0 if case.noise.repeated else ROUNDS):
        # Without repeats the noise is what a predictor leaves of the gap; of a smaller one, less.
        better = _with_noise(case, whole, settings, say)
        ratio = better.noise.size / case.noise.size
        if not whole.terms or bool((ratio > SETTLED).all()):
            break
        case = better
        whole = solve(case.evaluator, case.plain, keep, case.task, case.banks)
    folds, models = _held_out_models(case, whole, settings, say)
    say("judging", 0, 1)
    found = _answer(case, whole, folds, models, settings)
    if settings.rollout:
        say("simulating forwards", 0, 1)
        found = _with_rollout(found, case, settings)
    say("done", 1, 1)
    return found


def _case(
    robot: Robot, log: Log, held_out: Log | None, settings: GapSettings, say: Progress
) -> _Case:
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
    noise = _noise(start, given, settings, keep=None)
    task = replace(task, whitened=noise.repeated)
    fitted = robot.parameters is None
    return _Case(
        start, fitted, given, checked, task, noise, *_candidates(start, given, task, noise, say)
    )


def _noise(model: Model, given: Prepared, settings: GapSettings, *, keep: Tensor | None) -> Noise:
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


def _with_noise(case: _Case, found: Solution, settings: GapSettings, say: Progress) -> _Case:
    """The same case, its noise measured on what a search has left."""
    say("measuring the noise", 0, 1)
    noise = _noise(Model(found.robot, found.effects), case.given, settings, keep=None)
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
    return _refitted(evaluator, keep, task)


def _refitted(
    evaluator: Evaluator,
    keep: Bool[Tensor, "n N"],
    task: Task,
    folds: Bool[Tensor, " N"] | None = None,
) -> Model:
    """The model with base parameters, and the background, refitted on the rows that count."""
    free = replace(task, free=True)
    bare = solve(evaluator, evaluator, keep, replace(free, most=0), (), folds)
    return Model(bare.robot, bare.effects)


def _held_out_models(
    case: _Case, whole: Solution, settings: GapSettings, say: Progress
) -> tuple[Folds | None, "_Models"]:
    """Models before, with refitted parameters and after, for data they were not fitted on."""
    keep = case.keep
    if case.checked is not None:
        refitted = _refitted(case.plain, keep, case.task)
        before = refitted if case.fitted else case.start
        return None, _Models([before], [refitted], [Model(whole.robot, whole.effects)], [])
    folds = make_folds(case.given.rows, settings.folds, case.noise.groups)
    out = _Models([], [], [], [])
    for k in range(folds.count):
        say("leaving data out", k, folds.count)
        rows = folds.fitted(k)
        refitted = _refitted(case.plain, keep, case.task, rows)
        found = solve(case.evaluator, case.plain, keep, case.task, case.banks, rows)
        out.before.append(refitted if case.fitted else case.start)
        out.refitted.append(refitted)
        out.after.append(Model(found.robot, found.effects))
        out.terms.append(found.terms)
    say("leaving data out", folds.count, folds.count)
    return folds, out


@dataclass(frozen=True)
class _Models:
    """One model a fold, and what the fold's search accepted; nothing with a held-out log."""

    before: list[Model]
    refitted: list[Model]
    after: list[Model]
    terms: list[tuple[Term, ...]]


def _answer(
    case: _Case, whole: Solution, folds: Folds | None, models: _Models, settings: GapSettings
) -> Diagnosis:
    judged = case.given if case.checked is None else case.checked
    rows = judged.rows
    band = report_band(rows, settings.report_band)
    left = _noise(Model(whole.robot, whole.effects), case.given, settings, keep=case.keep)
    floor = left.report
    reversals = not case.noise.repeated
    shown = traces(rows, folds, models.before, models.after, band, reversals=reversals)
    refitted = traces(rows, folds, models.before, models.refitted, band, reversals=reversals)
    joints, regimes = where(shown, floor, settings.seed, band=band)
    found = findings(whole)
    whole, found, doubts = _stable(case, whole, found, models)
    far = closing(shown, floor, settings.seed, left.unpredicted)
    # A held-out log takes part in no choice, this one neither.
    if folds is not None and case.noise.repeated and not far.improves:
        lasting = [t for t in whole.terms if t.name in EVENTS]
        doubts += [f"{w}: not accepted" for w in _unconfirmed(whole)]
        whole = settled(case.plain, whole.problem, lasting, case.task)
        found = findings(whole)
    if case.task.free and not case.fitted:
        found = _with_refitted(found, closing(refitted, floor, settings.seed))
    excess = _excess(case, folds, models, far, floor)
    search = Search(whole.problem, list(whole.terms))
    torque = _torque_rows(case)
    hidden = not_testable(whole.problem, search.model(), case.start.robot, torque, whole.terms)
    robot = _as_robot(whole, case)
    return Diagnosis(
        robot=_described(case.start),
        corrected=robot,
        status=_status(found, far, excess, left, _poor(case, hidden)),
        joints=joints,
        regimes=regimes,
        findings=found.effects,
        parametric=found.parametric,
        how_far=HowFar(far.rms_before, far.rms_after, far.closed, far.closed_ci95),
        budget=budget(refitted, shown, floor),
        floor=floor,
        not_testable=tuple(hidden),
        next_experiment=next_experiment(whole, found, case.given.rows),
        traces=tuple(shown),
        band=band,
        cutoff=rows.cutoff,
        settings=asdict(settings),
        warnings=tuple(dict.fromkeys([*_warnings(case, folds, found, whole, settings), *doubts])),
    )


def _stable(
    case: _Case, whole: Solution, found: Findings, models: _Models
) -> tuple[Solution, Findings, list[str]]:
    """What searches on parts of the data find too (Meinshausen and Buehlmann 2010, stability
    selection): an effect accepted on all data stays if it, or one that cannot be told from it, was
    accepted at the same place in at least half of the folds. The others leave, and that is said."""
    if not models.terms or not whole.terms:
        return whole, found, []
    names = {
        id(term): {term.name, *accepted.ambiguous_with}
        for term, accepted in zip(found.terms, found.of_terms, strict=True)
    }
    kept, doubts = [], []
    for term in whole.terms:
        hits = sum(any(_alike(t, term, names[id(term)]) for t in fold) for fold in models.terms)
        if 2 * hits >= len(models.terms):
            kept.append(term)
            continue
        joints = term.effects[0].joints if term.effects else ()
        place = f" of joint {joints[0] + 1}" if joints else ""
        doubts.append(
            f"{term.name}{place} was found on all data, but only in {hits} of {len(models.terms)} "
            "searches on parts of it: not accepted"
        )
    if not doubts:
        return whole, found, []
    whole = settled(case.plain, whole.problem, kept, case.task)
    return whole, findings(whole), doubts


def _unconfirmed(whole: Solution) -> list[str]:
    """What stood out on the data fitted and closes nothing on others."""
    return [
        f"{t.name} stands out on the data fitted, but the gap does not shrink on others"
        for t in whole.terms
        if t.name not in EVENTS
    ]


def _alike(one: Term, two: Term, names: set[str]) -> bool:
    """Whether a fold's term is the same as `two`, or one of its alternatives at the same place."""
    if one.name not in names:
        return False
    return one.place == two.place or one.place is None or two.place is None


def _excess(
    case: _Case, folds: Folds | None, models: _Models, far: Closing, floor: NoiseFloor
) -> Tensor:
    """(n,) held-out variance of the corrected model's gap, relative to noise: in the fit's rows;
    without repeats in the report's band, relative to what a flexible predictor leaves."""
    judged = case.given if case.checked is None else case.checked
    if not case.noise.repeated:
        return (far.rms_after / floor.high.clamp(min=1e-12)).square()
    keep = judged.counting(noise_is_known=True)
    whiten = case.noise.whitening(judged.rows, keep)
    total = torch.zeros(keep.shape[0], dtype=torch.float64)
    count = torch.zeros_like(total)
    for k, model in enumerate(models.after):
        rows = torch.ones_like(keep[0]) if folds is None else folds.fold == k
        r = Evaluator(model.robot, model.effects, judged.rows, whiten).residual() * rows
        total += r.square().sum(1)
        count += (keep & rows).sum(1)
    # Less three standard deviations of a mean of squares: few rows prove nothing.
    return total / count.clamp(min=1) / (1 + 3 * (2 / count.clamp(min=1)).sqrt())


def _torque_rows(case: _Case) -> Tensor:
    """(n,) RMS of each joint's whitened torque."""
    y = case.plain.on_all([p.tau.T for p in case.given.rows.passages])
    return y.square().mean(1).sqrt()


def _status(found: Findings, far: Closing, excess: Tensor, left: Noise, poor: bool) -> Status:
    """The verdict. What is accepted must shrink the gap on data used for no choice; what is left is
    unexplained where it exceeds the noise there, or where a flexible predictor finds structure."""
    odd = (excess > EXCESS) & (left.structure > 0)
    unexplained = bool((odd | (excess > CLEAR_EXCESS) | (left.structure > STRUCTURE)).any())
    if not (found.effects or found.parametric):
        if unexplained:
            return "detected_unexplained"
        return "not_testable" if poor else "no_gap"
    least = far.closed_ci95 is not None and far.closed_ci95[1] < EXPLAINED
    if unexplained or least or not far.improves:
        return "detected_unexplained"
    return "explained" if found.effects else "parametric_only"


def _with_refitted(found: Findings, far: Closing) -> Findings:
    """With parameters always refitted: whether that alone closes a part of the gap."""
    if far.closed is None or far.closed_ci95 is None or far.closed_ci95[0] <= 0:
        return found
    return replace(found, parametric=(*found.parametric, Parametric((), far.closed, None)))


def _poor(case: _Case, hidden: Sequence[object]) -> bool:
    """Whether the log could show less than half of all effects and places, or is so short that
    nothing could be confirmed on other blocks of it."""
    places = sum(1 for bank in case.banks if bank.members[0])
    short = len(case.given.rows) * case.given.rows.interval < SHORTEST
    return len(hidden) > 0.5 * places or short


def _described(model: Model) -> Robot:
    """A model as a robot description."""
    return replace(model.robot, effects=tuple(e.record(v) for e, v in model.effects))


def _as_robot(whole: Solution, case: _Case) -> Robot:
    """The corrected model as a robot description, without what happened in this log only."""
    lasting = tuple(pair for pair in whole.effects if pair[0].name not in EVENTS)
    return _described(Model(whole.robot, lasting))


def _with_rollout(found: Diagnosis, case: _Case, settings: GapSettings) -> Diagnosis:
    from torchid.gap.rollout import rollouts

    judged = case.given if case.checked is None else case.checked
    result = rollouts(found.robot, found.corrected, judged.rows.passages, seed=settings.seed)
    result["fitted_on_these_data"] = case.checked is None
    if case.checked is None:
        result["sentences"] = [
            *result["sentences"],
            "The corrected model was fitted on these trajectories; the one before was not.",
        ]
    return replace(found, how_far=replace(found.how_far, rollout=result))


def _warnings(
    case: _Case, folds: Folds | None, found: Findings, whole: Solution, settings: GapSettings
) -> list[str]:
    checked = () if case.checked is None else case.checked.warnings
    out = [*case.given.warnings, *checked, *case.noise.notes]
    if not case.noise.repeated:
        out.append(
            "no motion is repeated, so the noise is known only between bounds: drive one "
            "trajectory twice to know it"
        )
    if len(whole.terms) >= settings.max_effects:
        out.append(f"the search ended at {settings.max_effects} effects: --max-effects")
    events = sorted({e.name for e, _ in whole.effects if e.name in EVENTS})
    if events:
        out.append(f"of this log alone, not part of the corrected model: {', '.join(events)}")
    changed = bool(found.parametric) or case.task.free
    if changed and bool((_margins(whole.robot) < 0).any()):
        out.append(
            "the corrected inertial parameters give the right torque but belong to no body: "
            "`torchid extract` finds feasible ones"
        )
    if case.fitted:
        out.append(
            "the robot has no inertial parameters: base parameters were fitted first, so the gap "
            "is what even the best rigid body leaves"
        )
    if folds is not None and not folds.whole:
        out.append(
            "fewer than three different trajectories: held-out data are stretches of the same "
            "trajectories, and intervals are wider than they look"
        )
    if settings.parameters == "auto" and not case.task.free:
        out += _modes(case, whole)
    return out


def _margins(robot: Robot) -> Tensor:
    return robot.require_parameters("a check").consistency_margin()


def _modes(case: _Case, whole: Solution) -> list[str]:
    """Whether the diagnosis with base parameters always refitted names other effects."""
    if not whole.terms:
        return []
    task = replace(case.task, free=True)
    free = solve(case.evaluator, case.plain, case.keep, task, case.banks)
    names = [
        {(t.name, t.effects[0].joints) for t in s.terms if t.effects and not t.is_inertial}
        for s in (whole, free)
    ]
    lost = sorted(f"{n} of joint {j[0] + 1}" if j else n for n, j in names[0] - names[1])
    if not lost:
        return []
    return [
        "with base parameters refitted these effects are not needed, so they hold only if the "
        f"robot's parameters are right: {', '.join(lost)}"
    ]
