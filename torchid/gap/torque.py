"""From a simulator and logs of the real arm to a diagnosis: the whole procedure as one call.

    prepare -> Data | search -> Explanation | validate -> traces | noise -> Noise | localise | judge

The model as given is the simulator; the gap is the measured torque minus the model's. Everything
that is reported belongs to one model, the answered one: its coefficients are fitted on all data,
and how far it closes the gap is judged by its terms fitted without each fold, on that fold.
"""

from collections.abc import Callable
from dataclasses import replace

from torchid.design.columns import Columns, Model
from torchid.design.repeats import find_repeats
from torchid.effects.phase import JointElasticity
from torchid.effects.registry import EVENTS
from torchid.errors import LogError
from torchid.gap.data import read
from torchid.gap.diagnosis import HowFar, TorqueDiagnosis
from torchid.gap.localise.where import where
from torchid.gap.noise.floor import sliding_only
from torchid.gap.record import Budget, Parametric, UnnamedEffect
from torchid.gap.search.explain import explained, gone_on, without_terms
from torchid.gap.search.findings import (
    describe_findings,
    judge_terms,
    next_experiment,
    not_testable,
    unsure_terms,
)
from torchid.gap.search.joint_fits import joint_fits
from torchid.gap.search.known import after_log, known_of
from torchid.gap.search.unnamed import small_effects, suspects
from torchid.gap.search.wanted import pushes, start_of, wanted_of
from torchid.gap.settings import GapSettings
from torchid.gap.validate.closing import budget, residuals
from torchid.gap.validate.folds import make_folds
from torchid.gap.validate.judge import (
    blocks_of,
    check,
    harmful,
    misfit_of,
    refitted,
    status_of,
    warnings_of,
)
from torchid.identification.knowledge import known_names
from torchid.log.model import Log
from torchid.results.answer import ordered
from torchid.robot.model import Robot
from torchid.simulation.two_models import rollouts

Progress = Callable[[str, int, int], None]

SHORTEST = 8.0
"""Length of all samples below which `no gap` cannot be said [s]."""


def diagnose_torque(
    robot: Robot,
    log: Log,
    *,
    held_out: Log | None = None,
    settings: GapSettings | None = None,
    progress: Progress | None = None,
) -> TorqueDiagnosis:
    """A diagnosis of logs with torques; arguments and errors are those of `torchid.diagnose`.

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

    say("preparing", 0, 1)
    # Trajectories, what they repeat, and which of them are held out together.
    data, judged = read(robot, log, held_out, settings)
    del log  # a long one is searched in part, and may now be let go
    repeats = find_repeats(data.segments)
    folds = make_folds(data.samples, settings.folds, repeats.groups(len(data.segments)))
    # What is looked for, and the model whose gap is to be explained.
    wanted = wanted_of(robot, settings)
    at_start = Columns(start_of(robot), data.samples)
    if data.stands:
        wanted = pushes(wanted)
        if not wanted.names:
            data.require_motion()
    else:
        data = data.without_silent(at_start, folds.parts)
    if robot.parameters is None:
        at_start = at_start.at(refitted(at_start, data, wanted).model)
    start = at_start.model
    # Where repeats tell the noise, only samples of sliding joints can be held against it.
    keep = sliding_only(at_start, data.keep, data.band, repeats)
    data = replace(data, keep=keep)

    say("searching for effects", 0, 1)
    elastic = JointElasticity.name
    if elastic in wanted.names and wanted.asks(elastic, range(robot.n)):
        data = data.with_swings(at_start, settings.alpha)
    block = blocks_of(data, at_start)
    found = explained(at_start, data, wanted, settings, folds.parts, block, repeats)
    if not found.terms:
        data.require_motion()

    say("judging", 0, 1)
    fitted_first = robot.parameters is None
    checked = check(found, data, None, folds, repeats, settings, fitted_first)
    # What makes a fold worse that it was not fitted on leaves, and what is less likely there than
    # not, until nothing does. Of the first something was there that it took the place of.
    least = found.question.least(found.empty.losses / found.question.normal.rows.clamp(min=1.0))
    taken = False
    while True:
        gone = harmful(found, checked, least)
        taken |= bool(gone)
        refused = list(gone)
        if gone:
            found = without_terms(found, gone, data, block)
        misfit = misfit_of(found, checked, data)
        terms = judge_terms(found, misfit)
        while unsure := unsure_terms(terms):
            refused += unsure[:1]
            found = without_terms(found, unsure[:1], data, block, small=True)
            terms = judge_terms(found, misfit)
        if not refused:
            break
        found = gone_on(found, refused, data, block)
        checked = check(found, data, None, folds, repeats, settings, fitted_first)
    if judged is not None:
        # A held-out log takes part in no choice: it judges what was chosen.
        noise = checked.measured
        checked = check(found, data, judged, folds, repeats, settings, fitted_first, noise)
    far = checked.far
    closed = max(0.0, float(1 - far.rms_after.norm() / far.rms_before.norm()))
    said = describe_findings(found, terms, closed)
    if wanted.free and robot.parameters is not None:
        # With parameters always refitted: whether that alone closes a part of the gap.
        far = checked.refitted_far
        if far.closed is not None and far.closed_ci95 is not None and far.closed_ci95[0] > 0:
            refit = Parametric((), far.closed, None)
            said = replace(said, parametric=(*said.parametric, refit))

    say("locating", 0, 1)
    # Where the gap lies, and what this log could not have shown.
    hidden = not_testable(found, start.robot, data)
    joints, regimes = where(checked.shown, checked.noise.floor, settings.seed, band=data.band)
    places = {t.key for t in found.question.candidates.terms if not t.inertial}
    places |= {(x.effect, x.joints) for x in hidden}
    poor = len(hidden) > 0.5 * len(places) or data.seconds < SHORTEST
    far = checked.far
    if not (said.effects or said.parametric):
        far = replace(far, closed=None, closed_ci95=None)  # nothing is there that could close it
        checked = replace(checked, far=far)
    shares = Budget(0.0, 0.0, 0.0)
    if far.closed is not None:
        shares = budget(checked.refitted, checked.shown, checked.noise.floor)
    # The corrected model holds laws; a push is no part of the arm.
    lasting = tuple(p for p in found.solution.model.effects if p[0].name not in EVENTS)
    corrected = Model(found.solution.model.robot, lasting).described()
    after = after_log(found, data, wanted, block)
    corrected = replace(corrected, knowledge=after)
    as_cad = settings.parameters == "auto" and not fitted_first
    known = known_of(found, wanted, after, least, as_cad=as_cad)
    if known is not None:
        # Of what the model has already: what it was, and what it is now.
        of = {c.name: c for c in known.coefficients}
        changed = (
            replace(f, changed=tuple(of[n] for n in known_names(f.effect) if n in of))
            for f in said.effects
        )
        said = replace(said, effects=tuple(changed))
    small = small_effects(found, data, block, robot, misfit)
    likely: tuple[UnnamedEffect, ...] = ()
    if not data.stands:
        listed = [*(t.key for t in found.terms), *((e.effect, e.joints) for e in small)]
        moved = () if known is None else known.moved
        likely = suspects(found, data, block, robot, misfit, listed, moved)
    result = TorqueDiagnosis(
        robot=start.described(),
        corrected=corrected,
        status=status_of(
            said,
            checked,
            found.question.least(far.rms_before.square()),
            poor,
            shown=all(map(found.question.shows, found.terms)),
            taken=taken,
            small=bool(small),
            suspected=bool(likely),
            hidden=known is not None and any(j.hides for j in known.joints),
        ),
        joints=joints,
        regimes=regimes,
        findings=said.effects,
        parametric=said.parametric,
        how_far=HowFar(far.rms_before, far.rms_after, far.closed, far.closed_ci95),
        budget=shares,
        floor=checked.noise.floor,
        not_testable=tuple(hidden),
        next_experiment=next_experiment(found, said, block),
        traces=tuple(checked.shown),
        band=data.band,
        cutoff=data.samples.cutoff,
        settings=settings,
        refitted=wanted.free,
        warnings=ordered(warnings_of(found, data, judged, checked, folds, settings, robot)),
        joint_fits=joint_fits(found, said, data, block),
        residual=residuals(checked.shown),
        small=small,
        suspects=likely,
        knowledge=known,
    )
    if settings.rollout and not robot.floating:
        say("simulating forwards", 0, 1)
        on, here = (data, True) if judged is None else (judged, False)
        replayed = rollouts(
            result.robot, result.corrected, on.segments, seed=settings.seed, fitted_here=here
        )
        result = replace(result, how_far=replace(result.how_far, rollout=replayed))
    say("done", 1, 1)
    return result
