"""From a simulator and logs of the real arm to a diagnosis: the whole procedure as one call.

    pose -> Problem | search -> Explanation | decide -> Decision | localise, describe -> the answer

The model as given is the simulator; the gap is the measured torque minus the model's. Everything
that is reported belongs to one model, the answered one: its coefficients are fitted on all data,
and how far it closes the gap is judged by its terms fitted without each fold, on that fold.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.design.columns import Model
from torchid.effects.registry import EVENTS
from torchid.errors import LogError
from torchid.gap.adapter import events_of, explanation_of, judged_of, likely_beside
from torchid.gap.causes.explain import explain
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.early import Watch, telling
from torchid.gap.friction import friction_laws
from torchid.gap.localise.where import where
from torchid.gap.problem import Problem
from torchid.gap.record import Budget, Known, Parametric
from torchid.gap.search.findings import (
    Findings,
    describe_findings,
    next_experiment,
    not_testable,
)
from torchid.gap.search.joint_fits import joint_fits
from torchid.gap.search.known import after_log, known_of
from torchid.gap.search.shares import shares_of
from torchid.gap.search.terms import Term
from torchid.gap.search.unnamed import causes_of_few_runs, small_effects, terms_without_name
from torchid.gap.settings import GapSettings
from torchid.gap.validate.bodies import with_bodies_nearest
from torchid.gap.validate.closing import budget, residuals
from torchid.gap.validate.decide import Decision, decide
from torchid.gap.validate.judge import status_of, warnings_of
from torchid.gap.validate.pose import pose
from torchid.identification.knowledge import known_names
from torchid.log.model import Log
from torchid.parallel.workers import Progress, in_shares
from torchid.results.answer import NotTestable, ordered
from torchid.robot.model import Robot
from torchid.statistics.criteria import SHORTEST_LOG, UNLIKELY

STAGES = {
    "preparing": 10, "searching for effects": 55, "judging": 18, "locating": 9, "done": 0,
}  # fmt: skip
"""That are told as progress, with about the share of the time that each takes [%]."""


def diagnose_torque(
    robot: Robot,
    log: Log,
    *,
    held_out: Log | None = None,
    settings: GapSettings | None = None,
    progress: Progress | None = None,
    watch: Watch | None = None,
    force: bool = False,
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
    say = in_shares(progress, STAGES)
    say("preparing")
    problem = pose(robot, log, held_out, settings, force)
    del log, held_out  # a long one is searched in part, and may now be let go
    say("searching for effects")
    # Of no torque, or of an arm that stands still, there is nothing to say yet.
    tells = bool(problem.data.keep.any()) and not problem.data.stands
    told = telling(watch, robot) if tells and watch is not None else None
    explained = explain(problem, told, events_of(problem))
    found = explanation_of(explained, problem)
    if not found.terms:
        problem.data.require_motion()
    say("judging")
    decision = decide(found, judged_of(explained, found, problem), problem)
    say("locating")
    likely = likely_beside(explained, decision.found)
    result = describe_diagnosis(decision, problem, likely)
    say("done")
    return result


def describe_diagnosis(
    decision: Decision, problem: Problem, likely: Sequence[Term]
) -> TorqueDiagnosis:
    """The answer, from a decision, and candidates beside it, the likeliest first: where, which, how
    far, and what this log could not show."""
    found, checked, data, settings = (
        decision.found, decision.checked, problem.data, problem.settings
    )  # fmt: skip
    taken = shares_of(found, fitted_first=problem.fitted_first)
    # What is recommended is a robot of bodies; what that costs is said.
    corrected, cost = found.solution.model, torch.zeros(problem.robot.n)
    if any(t.of_links for t in found.solution.terms):
        robot, cost = with_bodies_nearest(corrected.robot, data.segments)
        corrected = replace(corrected, robot=robot)
    named = describe_findings(found, decision.judged, taken, checked.far, corrected.robot)
    said = with_refit(named, decision, problem)
    joints, regimes = where(checked.shown, checked.noise.floor, settings.seed, band=data.band)
    unseen = not_testable(found, data)
    # What was known, and what is now: the corrected model holds laws, for a push is no part of it.
    after = after_log(found, problem)
    lasting = tuple(p for p in corrected.effects if p[0].name not in EVENTS)
    recommended = Model(corrected.robot, lasting).described()
    known = known_of(found, problem, after, decision.least)
    said = with_changes(said, known)
    small = small_effects(found, problem, decision.misfit)
    of_few = causes_of_few_runs(found, problem, decision.misfit, likely)
    unnamed = terms_without_name(found, decision.judged, taken.of_all(checked.far.less)[0])
    if decision.dropped is not None:
        every = terms_without_name(*decision.dropped, [math.nan] * len(decision.dropped[1]))
        unnamed = tuple(e for e in every if e.how_sure >= UNLIKELY)
    hides = known is not None and any(j.hides for j in known.joints)
    far, shares = checked.far, Budget(0.0, 0.0, 0.0)
    if not (said.effects or said.parametric):
        far = replace(far, closed=None, closed_ci95=None)  # nothing is there that could close it
    if far.closed is not None:
        shares = budget(checked.refitted, checked.shown, checked.noise.floor)
    return TorqueDiagnosis(
        robot=problem.given.model.described(),
        corrected=replace(recommended, knowledge=after),
        status=status_of(
            said,
            replace(checked, far=far),
            found.question.least(far.rms_before.square()),
            decision.unnamed_squares(taken),
            hides or is_poor(decision, problem, unseen),
            shown=all(map(found.question.shows, found.terms)),
            taken=decision.taken_back,
            small=bool(small),
        ),
        joints=joints,
        regimes=regimes,
        findings=said.effects,
        parametric=said.parametric,
        how_far=far,
        budget=shares,
        floor=checked.noise.floor,
        not_testable=tuple(unseen),
        next_experiment=next_experiment(found, said, problem.block),
        traces=tuple(checked.shown),
        band=data.band,
        cutoff=data.samples.cutoff,
        settings=settings,
        refitted=problem.wanted.free,
        warnings=ordered(warnings_of(found, checked, problem, cost)),
        friction=friction_laws(decision, problem, taken),
        joint_fits=joint_fits(found, said, problem),
        residual=residuals(checked.shown),
        small=small,
        suspects=(*unnamed, *of_few),
        knowledge=known,
    )


def with_refit(said: Findings, decision: Decision, problem: Problem) -> Findings:
    """With parameters always refitted: whether that alone closes a part of the gap."""
    far = decision.checked.refitted_far
    given = problem.wanted.free and not problem.fitted_first
    if not given or far.closed is None or far.closed_ci95 is None or far.closed_ci95[0] <= 0:
        return said
    return replace(said, parametric=(*said.parametric, Parametric((), far.closed, None)))


def with_changes(said: Findings, known: Known | None) -> Findings:
    """Of what the model has already: what it was, and what it is now."""
    of = {} if known is None else {c.name: c for c in known.coefficients}
    changed = (
        replace(f, changed=tuple(of[n] for n in known_names(f.effect) if n in of))
        for f in said.effects
    )
    return replace(said, effects=tuple(changed))


def is_poor(decision: Decision, problem: Problem, unseen: list[NotTestable]) -> bool:
    """Whether a log is too short, or could not have shown most of what is looked for."""
    places = {t.key for t in decision.found.question.candidates.terms if not t.inertial}
    places |= {(x.effect, x.joints) for x in unseen}
    return len(unseen) > 0.5 * len(places) or problem.data.seconds < SHORTEST_LOG
