"""From a simulator and logs of the real arm to a diagnosis: the whole procedure as one call.

The model as given is the simulator. The gap is the measured torque minus the model's. Effects are
sought on all rows; what they close is judged on trajectories (or stretches) left out of the search,
which is run again for every one of them.
"""

from collections.abc import Sequence
from dataclasses import asdict, replace

from torchid.errors import LogError
from torchid.gap.candidates import Evaluator
from torchid.gap.case import (
    Case,
    FoldModels,
    Progress,
    make_case,
    noise_at,
    refitted_model,
    with_noise,
)
from torchid.gap.closing import Closing, budget, closing
from torchid.gap.detectable import not_testable
from torchid.gap.diagnosis import Budget, Diagnosis, HowFar, NoiseFloor, Parametric, Status
from torchid.gap.findings import Findings, dated, findings, next_experiment
from torchid.gap.folds import Folds, Model, make_folds, traces, with_after
from torchid.gap.noise import STRUCTURE, Noise, dry_friction
from torchid.gap.passages import Rows, reach, sliding
from torchid.gap.prepare import report_band
from torchid.gap.remarks import remarks, unrelated
from torchid.gap.select import Search
from torchid.gap.settings import GapSettings
from torchid.gap.solve import Solution, fitted_on, settled, solve
from torchid.gap.stability import stable, unconfirmed
from torchid.gap.where import where
from torchid.log.model import Log
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

SHORTEST = 8.0
"""Seconds of rows below which `no gap` cannot be said."""


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

    >>> import torch, torchid
    >>> robot = torchid.load_robot("3r")
    >>> t = torch.arange(1500, dtype=torch.float64) / 100
    >>> w = torch.tensor([1.9, 2.7, 3.3], dtype=torch.float64)
    >>> q, dq, ddq = (f(t[:, None] * w) * w**k for k, f in
    ...               ((0, torch.sin), (1, torch.cos), (2, lambda x: -torch.sin(x))))
    >>> noise = 0.02 * torch.randn(1500, 3, generator=torch.Generator().manual_seed(1)).double()
    >>> tau = torchid.inverse_dynamics(robot, q, dq, ddq) + noise
    >>> tau[:, 1] += 0.5 * dq[:, 1]  # the arm has viscous friction, the model has none
    >>> settings = GapSettings(effects=("viscous_friction", "coulomb_friction"), rollout=False)
    >>> found = diagnose(robot, torchid.Log(t, q, dq=dq, tau=tau), settings=settings)
    >>> [(f.effect.name, f.effect.joint + 1) for f in found.findings]
    [('viscous_friction', 2)]
    """
    settings = settings or GapSettings()
    if held_out is None and settings.held_out_fraction > 0:
        log, held_out = log.split(1 - settings.held_out_fraction)
    elif held_out is not None and settings.held_out_fraction > 0:
        raise LogError(
            "both a held-out log and a held-out fraction are given.", expected="one of them"
        )
    say = progress or (lambda stage, done, total: None)
    case = make_case(robot, log, held_out, settings, say)
    keep = case.keep
    say("searching for effects", 0, 1)
    whole = solve(case.evaluator, case.plain, keep, case.task, case.banks)
    for _ in range(0 if case.noise.repeated else ROUNDS):
        # Without repeats the noise is what a predictor leaves of the gap; of a smaller one, less.
        better = with_noise(case, whole, settings, say)
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


def _held_out_models(
    case: Case, whole: Solution, settings: GapSettings, say: Progress
) -> tuple[Folds | None, FoldModels]:
    """Models before, with refitted parameters and after, for data they were not fitted on."""
    keep = case.keep
    if case.checked is not None:
        refitted = refitted_model(case.plain, keep, case.task)
        before = refitted if case.fitted else case.start
        return None, FoldModels([before], [refitted], [Model(whole.robot, whole.effects)], [])
    folds = make_folds(case.given.rows, settings.folds, case.noise.groups)
    out = FoldModels([], [], [], [])
    for k in range(folds.count):
        say("leaving data out", k, folds.count)
        rows = folds.fitted(k)
        refitted = refitted_model(case.plain, keep, case.task, rows)
        found = solve(case.evaluator, case.plain, keep, case.task, case.banks, rows)
        out.before.append(refitted if case.fitted else case.start)
        out.refitted.append(refitted)
        out.after.append(Model(found.robot, found.effects))
        out.terms.append(found.terms)
    say("leaving data out", folds.count, folds.count)
    return folds, out


def _fitted_on_folds(case: Case, whole: Solution, folds: Folds) -> list[Model]:
    """The answered model, its coefficients fitted without each of the folds."""
    rows = (case.keep & folds.fitted(k) for k in range(folds.count))
    return [Model(*fitted_on(case.plain, whole, own, case.task)) for own in rows]


def _answer(
    case: Case, whole: Solution, folds: Folds | None, models: FoldModels, settings: GapSettings
) -> Diagnosis:
    judged = case.given if case.checked is None else case.checked
    rows = judged.rows
    band = report_band(rows, settings.report_band)
    looked = case.keep & _telling(case, case.given.rows, whole)
    left = noise_at(Model(whole.robot, whole.effects), case.given, settings, keep=looked)
    floor = left.report
    far_from = judged.reach if case.noise.repeated else None
    shown = traces(rows, folds, models.before, models.after, band, reach=far_from)
    refitted = with_after(shown, rows, folds, models.refitted, band)
    joints, regimes = where(shown, floor, settings.seed, band=band)
    found = findings(whole)
    whole, found, doubts = stable(case, whole, found, models)
    far = closing(shown, floor, settings.seed, left.unpredicted)
    if folds is not None and whole.terms:
        # A fold may lack the motion that shows an effect: what is reported is the answer, fitted
        # without the fold. The interval holds what the folds' own searches close, too.
        shown = with_after(shown, rows, folds, _fitted_on_folds(case, whole, folds), band)
        far = closing(shown, floor, settings.seed, left.unpredicted).or_as(far)
    # A held-out log takes part in no choice, this one neither.
    if folds is not None and not far.improves:
        lasting = [t for t in whole.terms if t.effects and t.effects[0].event]
        doubts += [f"{w}: not accepted" for w in unconfirmed(whole)]
        whole = settled(case.plain, whole.problem, lasting, case.task)
        found = findings(whole)
        if not lasting:
            shown = with_after(shown, rows, folds, models.before, band)
            far = closing(shown, floor, settings.seed, left.unpredicted)
    if case.task.free and not case.fitted:
        found = _with_refitted(found, closing(refitted, floor, settings.seed))
    excess = _excess(case, whole, far, floor)
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
        findings=dated(found, case.given.rows.passages).effects,
        parametric=found.parametric,
        how_far=HowFar(far.rms_before, far.rms_after, far.closed, far.closed_ci95),
        budget=Budget(0.0, 0.0, 0.0) if far.closed is None else budget(refitted, shown, floor),
        floor=floor,
        not_testable=tuple(hidden),
        next_experiment=next_experiment(whole, found, case.given.rows),
        traces=tuple(shown),
        band=band,
        cutoff=rows.cutoff,
        settings={**asdict(settings), "refitted": case.task.free},
        warnings=tuple(
            dict.fromkeys(
                [*unrelated(shown), *remarks(case, folds, found, whole, settings), *doubts]
            )
        ),
    )


def _telling(case: Case, rows: Rows, whole: Solution) -> Bool[Tensor, "n N"]:
    """Rows in which something left means that something is missing. Not where the filter brings
    what a joint with dry friction did while it may have stuck: that a law of sliding says nothing
    there is no effect."""
    dry = dry_friction(whole.robot, whole.effects, rows)
    return sliding(rows, reach(rows, dry / case.noise.size)) | (dry == 0).unsqueeze(1)


def _excess(case: Case, whole: Solution, far: Closing, floor: NoiseFloor) -> Tensor:
    """(n,) variance of what the corrected model leaves, relative to noise: in the fit's rows;
    without repeats in the report's band, relative to what a flexible predictor leaves.

    It is that of the model which is answered, not of the folds' own: one of these may have accepted
    what the others refuse.
    """
    judged = case.given if case.checked is None else case.checked
    if not case.noise.repeated:
        return (far.rms_after / floor.high.clamp(min=1e-12)).square()
    keep = judged.counting(noise_is_known=True)
    whiten = case.noise.whitening(judged.rows, keep)
    telling = keep & _telling(case, judged.rows, whole)
    r = Evaluator(whole.robot, whole.effects, judged.rows, whiten).residual() * telling
    count = telling.sum(1).clamp(min=1)
    # Less three standard deviations of a mean of squares: few rows prove nothing.
    return r.square().sum(1) / count / (1 + 3 * (2 / count).sqrt())


def _torque_rows(case: Case) -> Tensor:
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
    # What happened once cannot be foretold elsewhere.
    once = not found.parametric and all(f.effect.event for f in found.effects)
    least = far.closed_ci95 is not None and far.closed_ci95[1] < EXPLAINED
    if unexplained or not (once or (far.improves and not least)):
        return "detected_unexplained"
    return "explained" if found.effects else "parametric_only"


def _with_refitted(found: Findings, far: Closing) -> Findings:
    """With parameters always refitted: whether that alone closes a part of the gap."""
    if far.closed is None or far.closed_ci95 is None or far.closed_ci95[0] <= 0:
        return found
    return replace(found, parametric=(*found.parametric, Parametric((), far.closed, None)))


def _poor(case: Case, hidden: Sequence[object]) -> bool:
    """Whether the log could show less than half of all effects and places, or is so short that
    nothing could be confirmed on other blocks of it."""
    places = sum(1 for bank in case.banks if bank.members[0])
    short = len(case.given.rows) * case.given.rows.interval < SHORTEST
    return len(hidden) > 0.5 * places or short


def _described(model: Model) -> Robot:
    """A model as a robot description."""
    return replace(model.robot, effects=tuple(e.record(v) for e, v in model.effects))


def _as_robot(whole: Solution, case: Case) -> Robot:
    """The corrected model as a robot description, without what happened in this log only."""
    lasting = tuple(pair for pair in whole.effects if not pair[0].event)
    return _described(Model(whole.robot, lasting))


def _with_rollout(found: Diagnosis, case: Case, settings: GapSettings) -> Diagnosis:
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
