"""From a robot and its logs to base parameters: the whole job as one call."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from msgspec import structs

from torchid.design.motion import Measurement, fast_speed, measurements, timed
from torchid.effects.base import Effect
from torchid.errors import IdentificationError, LogError
from torchid.identification.asked import AskedEffect, asked_effects, search_shapes
from torchid.identification.knowledge import (
    fit_root,
    inflation,
    known_before,
    over_parameters,
    pooled,
)
from torchid.identification.least_squares import Fit, fit
from torchid.identification.logs import prepared, refuse_repeated
from torchid.identification.record import FittedRows
from torchid.identification.result import Identification, findings
from torchid.identification.rows import Layout
from torchid.identification.settings import Settings
from torchid.identification.statistics import Uncertainty, jackknife
from torchid.identification.tuning import (
    CutoffChoice,
    Training,
    choose_cutoff,
    choose_reversal,
    shortened,
)
from torchid.identification.validation import (
    Prediction,
    errors,
    model_torque,
    moving_rms,
    pieces,
    predict,
)
from torchid.inputs import LogLike, RobotLike, as_log, as_robot
from torchid.log.model import Log
from torchid.parallel.workers import Progress, stage
from torchid.robot.knowledge import Knowledge
from torchid.robot.model import Robot, joint_list
from torchid.statistics.proportion import HALF_95
from torchid.typing import Bool, Float, Tensor


def identify(
    robot: RobotLike,
    log: LogLike,
    *,
    held_out: LogLike | None = None,
    settings: Settings | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
) -> Identification:
    """Identify base parameters and effects from logs, and validate them.

    Args:
        robot: kinematics, gravity; drive gains for logs of currents.
        log: one or several trajectories to fit.
        held_out: whole trajectories that take part in no choice. If None, the last
            `settings.held_out_fraction` of every trajectory of `log`.
        settings: how; defaults if None.
        device: where regressors are evaluated and filtered.
        progress: called with (stage, done, total).

    Raises:
        LogError: logs that do not fit the robot or cannot be used.
        IdentificationError: nothing to identify from, a motion that tells parameters apart by
            less than rounding does, or a result that predicts the log worse than nothing does.

    >>> import torch, torchid
    >>> robot = torchid.load_robot("3r")
    >>> t = torch.arange(2000, dtype=torch.float64) / 100
    >>> w = torch.tensor([1.9, 2.7, 3.3], dtype=torch.float64)
    >>> q, dq, ddq = (f(t[:, None] * w) * w**k for k, f in
    ...               ((0, torch.sin), (1, torch.cos), (2, lambda x: -torch.sin(x))))
    >>> log = torchid.Log(t, q, dq=dq, tau=torchid.inverse_dynamics(robot, q, dq, ddq))
    >>> result = identify(robot, log, settings=torchid.Settings(effects=()))
    >>> tau = result.predict(q, dq, ddq)
    >>> bool((tau - log.tau).norm() < 1e-3 * log.tau.norm())
    True
    """
    robot = as_robot(robot)
    log = as_log(log, robot)
    held_out = None if held_out is None else as_log(held_out, robot)
    settings = settings or Settings()
    log, kept_back, noticed = _prepared(robot, log, held_out, settings)
    asked = asked_effects(settings.effects, robot)
    # The filter is chosen with the effects whose columns are known beforehand.
    training = Training.of(robot, _on(log, device), [a.effect for a in asked if a.plain], settings)
    cutoff, choice, reversal = _chosen_filter(training, progress)
    measured = timed(measurements(training.log, cutoff, reversal))
    said: tuple[str, ...] = ()
    if not all(a.plain for a in asked):
        shaped, said = _with_shapes(asked, training, cutoff, reversal)
        training = Training.of(robot, training.log, shaped, settings)
        measured = _loaded(training, measured)
    columns = training.layout
    base, effects, order = columns.base, columns.effects, columns.back
    estimate = _estimate(training, measured, progress)
    condition = estimate.fit.scaled_condition_number
    refuse_lost(condition, training.log)
    found = _with_prior(robot, estimate, columns)
    # Errors are those of torque filtered at a cut-off of its own, where one is asked for.
    shown = settings.error_cutoff if settings.error_cutoff is not None else cutoff
    own = measured if shown == cutoff else timed(measurements(training.log, shown, reversal))
    apart: list[Measurement] = []
    if kept_back is not None:
        begin = float(log.t[0]) if held_out is None else None
        apart = _following(measured, measurements(_on(kept_back, device), shown, reversal), begin)
    report = stage(progress, "predicting")
    fitted, checked = (
        [predict(m, robot, base, effects, found.values, report) for m in part]
        for part in (own, apart)
    )
    if not settings.force:
        refuse_useless(fitted, condition, training.log, robot.free)

    lone = base.named(estimate.uncertainty.by_one_block[order])
    one_stretch = (
        "one short stretch of the log alone determines these; their standard deviations are lower "
        "bounds: " + ", ".join(lone)
    )
    result = Identification(
        robot=robot,
        base=base,
        effects=effects,
        values=found.values,
        covariance=found.covariance,
        factor=found.factor,
        rows=found.rows,
        free=found.free,
        bounded=base.named(estimate.fit.bounded[order]),
        undetermined=base.named(found.undetermined),
        dropped=base.named(estimate.dropped[order]),
        wrong_sign=base.named((columns.non_negative & (estimate.fit.x < 0))[order]),
        fit=errors(fitted, robot.free),
        held_out=errors(checked, robot.free) if checked else None,
        fit_predictions=tuple(fitted),
        held_out_predictions=tuple(checked),
        condition_number=estimate.fit.condition_number,
        scaled_condition_number=estimate.fit.scaled_condition_number,
        cutoff=cutoff,
        cutoff_choice=choice,
        reversal=reversal,
        uncertainty=estimate.uncertainty,
        settings=settings,
        knowledge=_knowledge(found, training, moving_rms(fitted)),
        warnings=(
            *robot.warnings,
            *noticed,
            *base.warnings,
            *said,
            *(w for m in measured for w in m.warnings),
            *estimate.uncertainty.warnings,
            *([one_stretch] if lone else []),
        ),
    )
    return replace(result, warnings=tuple(dict.fromkeys([*result.warnings, *findings(result)])))


def _prepared(
    robot: Robot, log: Log, held_out: Log | None, settings: Settings
) -> tuple[Log, Log | None, tuple[str, ...]]:
    """The log to fit and what is held out, even in time, and what is to be said of them."""
    if held_out is not None and settings.held_out_fraction != 0:
        raise LogError(
            "both a held-out log and a held-out fraction are given.", expected="one of them"
        )
    kept_back = held_out
    if settings.held_out_fraction != 0:
        # Where one trajectory is cut in two, the edges that the filter loses on both sides of the
        # cut, two periods of the cut-off, are the gap.
        log, kept_back = log.split(1 - settings.held_out_fraction, gap_s=0.0)
    log, noticed = prepared(log, robot)
    if kept_back is not None:
        kept_back, more = prepared(kept_back, robot)
        noticed = (*noticed, *more)
    refuse_repeated(log, kept_back)
    return log, kept_back, noticed


def _following(
    fitted: Sequence[Measurement], apart: list[Measurement], begin: float | None
) -> list[Measurement]:
    """Held-out trajectories on the clock of those that are fitted: the end of the same log, which
    began then, follows its beginning; another log, without a beginning, the whole of it."""
    last = fitted[-1]
    end = float(last.motion.require("t", "a trajectory")[-1]) + 1 / last.rate
    return timed(apart, begin, end if begin is None else 0.0)


def _chosen_filter(
    training: Training, progress: Progress | None
) -> tuple[float | None, CutoffChoice | None, Tensor]:
    """Cut-off [Hz], how it was chosen if it was, and reversal speeds (n,)."""
    settings, choice = training.settings, None
    if settings.cutoff == "auto":
        choice = choose_cutoff(training, stage(progress, "choosing the cut-off"))
        cutoff = choice.cutoff
    else:
        cutoff = settings.cutoff
    if settings.reversal == "auto":
        report = stage(progress, "choosing the reversal speed")
        reversal = choose_reversal(training, cutoff, report)
    else:
        reversal = settings.reversal * fast_speed(measurements(training.log, cutoff)).cpu()
    return cutoff, choice, reversal


def _travel(log: Log) -> tuple[list[float], str]:
    """How far each joint moves [rad; m], and the same in words."""
    moved = (log.q.amax(0) - log.q.amin(0)).tolist()
    return moved, f"the joints move over {', '.join(f'{x:.2g}' for x in moved)} rad or m"


def refuse_lost(condition: float, log: Log) -> None:
    """Raise IdentificationError where rounding alone would leave no four digits: values of
    thousands of kilograms would be printed with standard deviations as large, and look like a
    result."""
    # 1e-4: relative error at which a number is no result: four digits, as many as a good torque log
    # has. Rounding makes that of eps times the condition number of columns of length one, even of a
    # log without noise; so a fit is refused from a condition number of 4.5e11 on.
    largest = 1e-4 / torch.finfo(torch.float64).eps
    if condition > largest:
        raise IdentificationError(
            "these logs cannot tell the parameters apart: the fit is lost in rounding.",
            got=f"condition number {condition:.1e} (columns of length one); {_travel(log)[1]}",
            expected=f"below {largest:.1e}; a good motion has less than 1e3",
            hint="`torchid excite` designs a motion that tells them apart; `effects=...` with "
            "fewer names asks for less",
        )


@dataclass(frozen=True)
class _Found:
    """Base parameters in their own order, with all that is known of them; see Identification."""

    values: Float[Tensor, " B"]
    covariance: Float[Tensor, "B B"]
    factor: Float[Tensor, "C C"]
    rows: FittedRows
    free: Bool[Tensor, " B"]
    undetermined: Bool[Tensor, " B"]
    root: Float[Tensor, "D B"]


def _with_prior(robot: Robot, estimate: "_Estimate", columns: Layout) -> _Found:
    """What the log and earlier sessions say together."""
    base, effects = columns.base, columns.effects
    order = columns.back
    values = estimate.fit.x[order]
    covariance = estimate.uncertainty.covariance[order][:, order]
    factor = estimate.fit.factor[:, torch.cat([order, order.new_tensor([len(base)])])]
    free, undetermined = (m[order] for m in (estimate.fit.free, estimate.fit.undetermined))
    rows = structs.replace(estimate.rows, inflation=inflation(covariance, factor))
    root = fit_root(covariance, factor, *_dependence(estimate))
    before = known_before(robot, base, effects)
    if before is not None:  # earlier sessions count as the log's rows do
        known, expected = before
        held = ~(free | undetermined)
        values, covariance, free = pooled(known, expected, root, values)
        covariance, free = covariance * ~held * ~held.unsqueeze(1), free & ~held
        undetermined = undetermined & ~free
        root = torch.cat([known, root])
    return _Found(values, covariance, factor, rows, free, undetermined, root)


def _knowledge(found: _Found, training: Training, left: Float[Tensor, " n"]) -> Knowledge:
    """How sure the robot's model is with the log, which leaves so much of the torque."""
    c, source = training.layout, ", ".join(training.log.names)
    now = replace(over_parameters(found.root, c.base, c.effects, source), left=left)
    if c.robot.knowledge is None:
        return now
    # The rows hold what was known before; sources and the rest are put together.
    both = c.robot.knowledge.plus(now)
    return replace(both, coefficients=now.coefficients, root=now.root)


def refuse_useless(
    fitted: Sequence[Prediction], condition: float, log: Log, free: Sequence[int] = ()
) -> None:
    """Raise if the fitted model is worse than none on the very log that it was fitted to: on more
    than half of the joints with torque the error over all rows is larger than the torque itself.
    On the rows that they fit least squares are not by more than their weights, and intervals say
    how little these rows determine; on those left out, at rest, a fit is that hardly any motion
    determines. `free` coordinates, which no motor drives, have no say.

    Raises:
        IdentificationError: what the log lacks.
    """
    relative = errors(fitted, free)
    percent, moving = relative.relative_percent, relative.relative_percent_moving.nan_to_num(0.0)
    # 100.0: error relative to the torque from which a model is worse than none [%]
    useless = (percent > 100.0) & percent.isfinite() & (percent > moving)
    worse = useless.nonzero().flatten().tolist()
    if 2 * len(worse) <= int(percent.isfinite().sum()):
        return
    moved, said = _travel(log)
    # 0.05: way of a joint [rad; m] below which little of its dynamics shows
    slow = [j for j, x in enumerate(moved) if x < 0.05]
    hint = f"; {joint_list(slow)} hardly move" if slow else ""
    raise IdentificationError(
        "these logs determine no model: over all rows it predicts the torque worse than zero does.",
        got=f"an error of {float(percent[worse].max()):.3g} % of the torque on "
        f"{joint_list(worse)}; condition number {condition:.1e}; {said}{hint}",
        expected="every joint moving through much of its range, slowly and fast",
        hint="`torchid excite` designs such a motion; `force=True` (`--force`) shows the numbers "
        "all the same",
    )


def _dependence(estimate: "_Estimate") -> tuple[float, float, float]:
    """Rows, those that count as one, and Student's quantile over the normal one."""
    found, rows = estimate.uncertainty, estimate.rows
    count = rows.seconds * rows.per_second * len(rows.whitening)
    return count, found.correlation_seconds * rows.per_second, found.quantile() / HALF_95


def _with_shapes(
    asked: Sequence[AskedEffect], training: Training, cutoff: float | None, reversal: Tensor
) -> tuple[list[Effect], tuple[str, ...]]:
    """All effects asked for, those shapes that were not given as the training data have them, and
    what is to be said about it."""
    unknown = [a for a in asked if a.searched]
    if not unknown:
        return [a.effect for a in asked], ()
    part = replace(training, log=shortened(training.log))
    measured = timed(measurements(part.log, cutoff, reversal))
    # What searched effects of the torque see, and what their shapes are relative to.
    measured = _refitted_load(part, measured)
    given = [a.effect for a in asked if not a.searched]
    known = Training.of(training.layout.robot, part.log, given, training.settings)
    source = known.source(measured)
    fitted = fit(source, non_negative=known.non_negative)
    best = search_shapes(unknown, source, fitted, cutoff)
    chosen = {a.effect: effect for a, effect in zip(unknown, best, strict=True)}
    effects, said = [], []
    for a in asked:
        effect = chosen.get(a.effect, a.effect)
        if effect is None:
            said.append(f"left out, for these motions do not show it: {_named(a.effect)}")
            continue
        effects.append(effect)
        if a.searched:
            shapes = {s.name: s.unit for s in a.effect.shapes}
            units = {k: "" if shapes[k] == "1" else f" {shapes[k]}" for k in a.searched}
            values = ", ".join(f"{k} = {getattr(effect, k):.4g}{units[k]}" for k in a.searched)
            said.append(
                f"{_named(effect)}: {values} was searched on the training data; the standard "
                "deviations hold for this value"
            )
    return effects, tuple(said)


def _named(effect: Effect) -> str:
    joints = [str(j + 1) for j in effect.identity[1]]
    return f"{effect.name} of joint {joints[0]}" + "".join(f" with joint {j}" for j in joints[1:])


def _refitted_load(training: Training, measured: list[Measurement]) -> list[Measurement]:
    """Trajectories with the torque of a fit to them, as effects of the torque see it."""
    c, out = training.layout, []
    values = training.fit(training.source(measured)).x[c.back]
    for m in measured:
        own = values.to(m.tau)
        torque = [
            model_torque(c.robot, c.base, c.effects, own, m.motion.part(rows), load_only=True)
            for rows in pieces(m, 0, m.samples, c.effects)
        ]
        out.append(replace(m, motion=m.motion._replace(torque=torch.cat(torque))))
    return out


def _loaded(training: Training, measured: list[Measurement]) -> list[Measurement]:
    """Trajectories with the torque of the model, where an effect needs it: of a fit without those
    effects first, then of fits with them. What is left wrong shrinks each time by about the share
    of the torque that they are."""
    c = training.layout
    without = [e for e in c.effects if "torque" not in e.needs]
    if len(without) == len(c.effects):
        return measured
    first = Training.of(c.robot, training.log, without, training.settings)
    measured = _refitted_load(first, measured)
    # 2: fits from which effects of the torque take their torque, before the last one
    for _ in range(2):
        measured = _refitted_load(training, measured)
    return measured


def _on(log: Log, device: torch.device | str) -> Log:
    if torch.device(device).type == "cpu":
        return log
    moved = {name: signal.to(device) for name, signal in log.signals.items()}
    return log.replace(t=log.t.to(device), trajectory=log.trajectory.to(device), **moved)


@dataclass(frozen=True)
class _Estimate:
    fit: Fit
    uncertainty: Uncertainty
    dropped: Bool[Tensor, " B"]
    rows: FittedRows


def _estimate(
    training: Training, measured: list[Measurement], progress: Progress | None
) -> _Estimate:
    """Fit with standard deviations; with `essential`, without parameters that may be zero."""
    source = training.source(measured, stage(progress, "filtering"))

    def without(dropped: Tensor) -> _Estimate:
        fitted = training.fit(source, dropped)
        counts = (last - first for first, last in itertools.pairwise(source.boundaries))
        seconds = sum(n * step for n, step in zip(counts, source.interval, strict=True))
        rows = FittedRows(seconds, source.instants / seconds, fitted.whitening)
        return _Estimate(fitted, jackknife(source, fitted), dropped, rows)

    now = without(torch.zeros_like(training.non_negative))
    while training.settings.essential and int(now.fit.free.sum()) > 1:
        ratio = torch.where(now.fit.free, now.fit.x.abs() / now.uncertainty.std, torch.inf)
        weakest = int(ratio.argmin())
        if float(ratio[weakest]) > now.uncertainty.quantile():
            break
        dropped = now.dropped.clone()
        dropped[weakest] = True
        now = without(dropped)
    return now
