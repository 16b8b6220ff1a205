"""From a simulator and logs of the real arm to a diagnosis: the whole procedure as one call.

    pose -> Problem | explain -> Explained | decide -> Decision | describe -> the answer

The model as given is the simulator; the gap is the measured torque minus the model's. Everything
that is reported belongs to one model, the answered one: its coefficients are fitted on all data,
and how far it closes the gap is judged by its terms fitted without each fold, on that fold.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from msgspec import structs

from torchid.design.columns import Model
from torchid.design.segments import Segment
from torchid.effects.inertia import Payload
from torchid.effects.motion import Motion
from torchid.effects.registry import EVENTS
from torchid.errors import LogError
from torchid.gap.cause_records import body_cause, valued
from torchid.gap.causes.explain import WITH_BODIES, Explained, explain, of_asked_log
from torchid.gap.causes.search import JUDGED
from torchid.gap.describe.checked import Decision, decide
from torchid.gap.describe.claims import claims_of
from torchid.gap.describe.closing import budget, residuals
from torchid.gap.describe.covariance import covariance_of
from torchid.gap.describe.findings import Findings, Taken, describe_findings
from torchid.gap.describe.friction import friction_laws
from torchid.gap.describe.known import after_log, known_of
from torchid.gap.describe.model import Explanation
from torchid.gap.describe.shares import shares_of
from torchid.gap.describe.unnamed import causes_of_few_runs, small_effects, without_name
from torchid.gap.describe.unseen import next_experiment, not_testable
from torchid.gap.describe.verdict import Left, status_of, warnings_of
from torchid.gap.describe.where import where
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.early import Watch, telling
from torchid.gap.pose import pose
from torchid.gap.problem import Problem
from torchid.gap.record import Budget, Known
from torchid.gap.rows import LogRows, kept
from torchid.gap.settings import GapSettings
from torchid.gap.stacked import LEFT_OUT, MISFIT, beside, earlier_of, errors_of, why_left_out
from torchid.identification.knowledge import known_names
from torchid.log.model import Log
from torchid.parallel.pace import Pace
from torchid.results.answer import NotTestable, ordered
from torchid.results.cause import LINK, Cause
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.statistics.criteria import SHORTEST_LOG, UNLIKELY
from torchid.tensors import give_back_memory
from torchid.typing import Float, Tensor

STAGES = {
    "checking the log": 11, "preparing": 4, "what effects do": 5, "adding causes": 10,
    WITH_BODIES: 10, "exchanging causes": 26, "judging": 10, "locating": 3, "done": 0,
}  # fmt: skip
"""That are told as progress, with about the share of the time that each takes [1]."""
SEARCH = ("adding causes", WITH_BODIES, "exchanging causes", *JUDGED)
"""Those whose time goes with what is found; of others with the length of the log."""
MUST = ("what effects do", *JUDGED)
"""Those without which there is no answer."""


def diagnose_torque(
    robot: Robot,
    log: Log,
    *,
    held_out: Log | None = None,
    settings: GapSettings | None = None,
    pace: Pace | None = None,
    watch: Watch | None = None,
    force: bool = False,
    before: Log | LogRows | None = None,
) -> TorqueDiagnosis:
    """A diagnosis of logs with torques; arguments and errors are those of `torchid.diagnose`, and
    `pace` hears which of `STAGES` begins, and says how much time there is.

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
    pace = pace or Pace(None, STAGES)
    pace("preparing")
    problem = pose(robot, log, held_out, settings, force)
    # Of an arm that stands nothing but a push is told.
    before = None if problem.data.stands else before
    earlier = None if before is None else earlier_of(before, problem, force)
    left_out = "" if earlier is None else why_left_out(earlier, problem)
    earlier = None if left_out else earlier
    del log, held_out, before  # a long one is searched in part, and is now let go
    give_back_memory()
    # Of no torque, or of an arm that stands still, there is nothing to say yet.
    tells = bool(problem.data.keep.any()) and not problem.data.stands
    told = telling(watch, robot) if tells and watch is not None else None
    asked = problem if earlier is None else beside(problem, earlier)
    explained = explain(asked, told, pace)
    if earlier is not None and max(both := _errors(explained)) > MISFIT:
        # One model does not hold for both logs. If one does for the log that is asked, it is that.
        alone = explain(problem, told, pace)
        (own,) = _errors(alone)
        if max(both) > math.hypot(MISFIT, own):
            left_out = (
                f"{LEFT_OUT} {earlier.source}. Together {both[0]:.0%} of its "
                f"torque and {both[1]:.0%} of that of the log that is asked are unexplained, "
                f"{own:.0%} of the latter alone."
            )
            earlier, explained = None, alone
    explained = of_asked_log(explained, problem)
    problem = explained.search.library.problem
    if not explained.found.fit.terms:
        problem.data.require_motion()
    found = Explanation.of(problem, explained.search, explained.found.fit)
    decision = decide(found, claims_of(explained))
    pace("locating")
    result = describe_diagnosis(decision, explained, pace)
    pace("done")
    if earlier is not None:
        return replace(result, since=earlier.source)
    return replace(result, warnings=(left_out, *result.warnings)) if left_out else result


def _errors(explained: Explained) -> list[float]:
    """`errors_of` an explanation."""
    search, fit = explained.search, explained.found.fit
    return errors_of(search.evidence.left(fit), search.library.problem)


def describe_diagnosis(decision: Decision, explained: Explained, pace: Pace) -> TorqueDiagnosis:
    """The answer, from a decision on what was explained: where, which, how far, and what this log
    could not show, as far as there is time."""
    found, checked, final = decision.found, decision.checked, decision.final
    problem, data, settings = found.problem, found.problem.data, found.problem.settings
    falls = shares_of(found)
    taken = Taken.of(falls, checked.far, final.far)
    # What is recommended is a robot of bodies; what that costs is said.
    corrected, cost = found.solution.model, torch.zeros(problem.robot.n)
    if any(p.rows is not None or p.change is not None for p in found.solution.parts):
        robot, cost = with_bodies_nearest(corrected.robot, data.segments)
        corrected = replace(corrected, robot=robot)
    far = replace(final.far, judged=problem.judged_on)
    named = describe_findings(found, decision.claims, taken, corrected.robot)
    said = with_refit(named, decision)
    joints, regimes = where(final.shown, final.noise.floor, settings.seed, band=data.band)
    unseen = not_testable(found)
    # What was known, and what is now: the corrected model holds laws, for a push is no part of it.
    after = after_log(found)
    lasting = tuple(p for p in corrected.effects if p[0].name not in EVENTS)
    recommended = with_load_apart(Model(corrected.robot, lasting), problem).described()
    known = known_of(found, after, decision.least)
    said = with_changes(said, known, problem.robot)
    said, harmful = that_help(said, problem.robot)
    small, of_few = tuple[Cause, ...](), tuple[Cause, ...]()
    if pace.has_time("small effects"):
        small = small_effects(found, explained)
    if pace.has_time("causes of few runs"):
        of_few = causes_of_few_runs(found, explained)
    unnamed = without_name(found, decision.claims, taken.shares)
    if decision.dropped is not None:
        every = without_name(*decision.dropped, [math.nan] * len(decision.dropped[1]))
        unnamed = tuple(e for e in every if (e.how_sure or 0.0) >= UNLIKELY)
    hides = known is not None and any(j.hides for j in known.joints)
    shares = Budget(0.0, 0.0, 0.0)
    if not said.causes:
        far = replace(far, closed=None, closed_ci95=None)  # nothing is there that could close it
    if far.closed is not None:
        shares = budget(final.refitted, final.shown, final.noise.floor)
    least = found.worth(checked.far.rms_before.square())
    left = Left.of(checked, least)
    status = status_of(
        said,
        checked,
        final,
        left,
        least,
        decision.unnamed_squares(falls),
        hides or is_poor(found, unseen),
        shown=all(t.shown for t in found.terms),
        taken=decision.taken_back or harmful,
        small=bool(small),
    )
    # Of what is unexplained, or small; what else is wrong has words of its own.
    said_so = status == "negligible" or bool(left.unexplained.any())
    remainder = left.words(problem.robot) if said_so else ""
    return TorqueDiagnosis(
        robot=problem.given.model.described(),
        corrected=replace(recommended, knowledge=after),
        status=status,
        joints=joints,
        regimes=regimes,
        causes=said.causes,
        how_far=far,
        budget=shares,
        floor=final.noise.floor,
        not_testable=tuple(unseen),
        next_experiment=next_experiment(found, said.open),
        traces=tuple(final.shown),
        band=data.band,
        cutoff=data.samples.cutoff,
        settings=settings,
        refitted=problem.wanted.free,
        warnings=ordered(warnings_of(decision, said.causes, cost, left)),
        remainder=remainder,
        friction=friction_laws(decision, falls, said.causes),
        covariance=covariance_of(found.solution),
        residual=residuals(final.shown),
        small=small,
        suspects=(*unnamed, *of_few),
        knowledge=known,
        rows=kept(data.samples, problem.robot),
    )


def that_help(said: Findings, robot: Robot) -> tuple[Findings, bool]:
    """Those that take something of the error away, of a joint's law all forms together, and whether
    there are others: these stay in the model, unnamed."""
    laws = [_law(c, robot) for c in said.causes]
    taken = dict.fromkeys(laws, 0.0)
    for law, cause in zip(laws, said.causes, strict=True):
        taken[law] += cause.share
    pairs = zip(laws, said.causes, strict=True)
    helping = tuple(c for law, c in pairs if not taken[law] <= 0)
    return replace(said, causes=helping), len(helping) < len(said.causes)


def _law(cause: Cause, robot: Robot) -> tuple[str, tuple[int, ...]]:
    """What takes of the error as a whole: a joint's law, whose forms may do so against each other,
    or the cause itself."""
    one = cause.effect != LINK and len(cause.at) == 1
    law = valued(cause, robot)[0].law if one else ""
    return law or cause.effect, cause.at


def with_refit(said: Findings, decision: Decision) -> Findings:
    """With parameters always refitted: whether that alone closes a part of the gap."""
    problem, far = decision.found.problem, decision.checked.refitted_far
    given = problem.wanted.free and not problem.fitted_first
    if not given or far.closed is None or far.closed_ci95 is None or far.closed_ci95[0] <= 0:
        return said
    bodies = body_cause((), share=far.closed, judged=problem.left_out)
    return replace(said, causes=tuple(sorted((*said.causes, bodies), key=lambda c: -c.share)))


def with_changes(said: Findings, known: Known | None, robot: Robot) -> Findings:
    """Numbers that the model knew, with how well they are known now."""
    of = {} if known is None else {c.name: c for c in known.coefficients}
    causes = []
    for cause in said.causes:
        names = [] if cause.effect == LINK else known_names(valued(cause, robot)[0])
        std = {
            name: of[key].after_std
            for name, key in zip(cause.std, names, strict=False)
            if cause.file and key in of
        }
        causes.append(structs.replace(cause, std=cause.std | std))
    return replace(said, causes=tuple(causes))


def is_poor(found: Explanation, unseen: Sequence[NotTestable]) -> bool:
    """Whether a log is too short, or could not have shown most of what is looked for."""
    library, data = found.search.library, found.problem.data
    places = {t.key for t in library.terms if not t.parametric}
    places |= {(x.effect, x.joints) for x in unseen}
    return len(unseen) > 0.5 * len(places) or data.seconds < SHORTEST_LOG


def with_load_apart(model: Model, problem: Problem) -> Model:
    """A corrected model with the load of the robot's file beside its link again, where nothing has
    taken its place or changed the link."""
    own, given = (r.require_parameters("a load").pi[-1] for r in (model.robot, problem.robot))
    if not any(problem.load) or not torch.equal(own.double(), given.double()):
        return model
    robot = Payload().plant(model.robot, [-x for x in problem.load])
    return Model(robot, (*model.effects, (Payload(), list(problem.load))))


def with_bodies_nearest(
    robot: Robot, segments: Sequence[Segment]
) -> tuple[Robot, Float[Tensor, " n"]]:
    """A robot with the bodies whose torque along a log is nearest to its own.

    Args:
        robot: with inertial parameters that may belong to no bodies.
        segments: of the log.

    Returns:
        The robot, and by how much the torque of its links changes (n,), RMS [N m; N]; the robot as
        it is, and zeros, where its links are bodies or none were found.
    """
    parameters = robot.require_parameters("bodies")
    unchanged = robot, torch.zeros(robot.n, dtype=torch.float64)
    if bool((parameters.consistency_margin() >= 0).all()):
        return unchanged
    # Convex programs are loaded where they are needed: a third of a second.
    from torchid.extraction.convex.nearest import nearest_feasible
    from torchid.feasibility.sets import ParameterSets

    every = [torch.cat(x) for x in zip(*(s.motion.state for s in segments), strict=True)]
    # 400: states of a log over which the torque of links that are no bodies counts
    step = max(1, len(every[0]) // 400)
    states = Motion(*(x[::step].double() for x in every))
    none = torch.zeros(1, 0, dtype=torch.float64)
    pi = parameters.pi.detach().cpu().double().unsqueeze(0)
    one = ParameterSets((robot.name,), InertialParameters(pi), (), none)
    near = nearest_feasible(robot, one, motion=states)
    if not bool(near.feasible[0]):
        return unchanged
    own = InertialParameters(near.sets.parameters.pi[0])
    return robot.with_parameters(own), near.torque_change[0]
