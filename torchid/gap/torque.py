"""From a simulator and logs of the real arm to a diagnosis: the whole procedure as one call.

    prepare -> Data | search -> Explanation | validate -> traces | noise -> Noise | localise | judge

The model as given is the simulator; the gap is the measured torque minus the model's. Everything
that is reported belongs to one model, the answered one: its coefficients are fitted on all data,
and how far it closes the gap is judged by its terms fitted without each fold, on that fold.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from torchid.design.columns import Columns, Model
from torchid.design.repeats import Repeats, find_repeats
from torchid.effects.friction import TorqueOffset
from torchid.effects.phase import JointElasticity
from torchid.effects.registry import EVENTS, KINDS
from torchid.effects.transient import Contact
from torchid.errors import LogError, TorchidError
from torchid.gap.data import Data, prepare
from torchid.gap.diagnosis import HowFar, TorqueDiagnosis, Trace
from torchid.gap.localise.where import where
from torchid.gap.noise.floor import Noise, noise_of, sliding_only
from torchid.gap.record import Budget, Parametric, Status
from torchid.gap.search.evidence import fit_terms
from torchid.gap.search.explain import Explanation, explained, without_terms
from torchid.gap.search.joint_fits import joint_fits
from torchid.gap.search.known import after_log, known_of
from torchid.gap.search.small import small_effects
from torchid.gap.search.solve import Solution, solved
from torchid.gap.search.terms import BASE, Term, Wanted, fixed_terms
from torchid.gap.search.told import Told, next_experiment, not_testable, told
from torchid.gap.settings import GapSettings
from torchid.gap.validate.closing import Closing, budget, closing, levels, residuals
from torchid.gap.validate.folds import FEW, Folds, make_folds, traces
from torchid.identification.base_parameters import base_parameters
from torchid.identification.identify import refuse_repeated
from torchid.identification.knowledge import known_later, known_names
from torchid.log.model import Log
from torchid.log.sampling import sampling_rate
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import Robot, joint_list
from torchid.simulation.two_models import rollouts
from torchid.statistics.autocorrelation import integrated_time
from torchid.statistics.blocks import block_length, block_numbers
from torchid.typing import Float, Int, Tensor

Progress = Callable[[str, int, int], None]

EXCESS = 1.35
"""Held-out variance of a joint, relative to its noise, from which something is unexplained where a
flexible predictor agrees [1]: noise is known to a few ten per cent."""

CLEAR_EXCESS = 2.0
"""The same from which it is, whatever a predictor says [1]."""

STRUCTURE = 0.25
"""Predictable share of a joint's noise variance from which structure is worth saying [1]."""

SHORTEST = 8.0
"""Length of all samples below which `no gap` cannot be said [s]."""


@dataclass(frozen=True, eq=False)
class Checked:
    """What the answered model does on data it was not fitted on.

    Attributes:
        shown: torque before and after.
        refitted: torque before, and of the model with base parameters refitted.
        noise: beside the answered model.
        far: closed share.
        refitted_far: of base parameters alone.
    """

    shown: list[Trace]
    refitted: list[Trace]
    noise: Noise
    far: Closing
    refitted_far: Closing


def diagnose_torque(
    robot: Robot,
    log: Log,
    *,
    held_out: Log | None = None,
    settings: GapSettings | None = None,
    progress: Progress | None = None,
) -> TorqueDiagnosis:
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
    >>> found = diagnose_torque(robot, torchid.Log(t, q, dq=dq, tau=tau), settings=settings)
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
    block = _blocks(data, at_start)
    found = explained(at_start, data, wanted, settings, folds.parts, block)
    if not found.terms:
        data.require_motion()

    say("judging", 0, 1)
    fitted_first = robot.parameters is None
    checked = check(found, data, None, folds, repeats, settings, fitted_first)
    # What makes a fold worse that it was not fitted on leaves, and what is less likely there than
    # not, until nothing does. Of the first something was there that it took the place of.
    least = found.question.least(found.empty.losses / found.question.normal.rows.clamp(min=1.0))
    taken = False
    said = told(found)
    while True:
        gone = harmful(found, checked, least)
        taken |= bool(gone)
        if gone:
            found = without_terms(found, gone, data, block)
            said = told(found)
        elif not said.unsure:
            break
        while said.unsure:
            found = without_terms(found, said.unsure[:1], data, block, small=True)
            said = told(found)
        checked = check(found, data, None, folds, repeats, settings, fitted_first)
    if judged is not None:
        # A held-out log takes part in no choice: it judges what was chosen.
        checked = check(found, data, judged, folds, repeats, settings, fitted_first)
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
    if not (said.findings or said.parametric):
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
            for f in said.findings
        )
        said = replace(said, findings=tuple(changed))
    small = small_effects(found, data, block, robot)
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
            hidden=known is not None and any(j.hides for j in known.joints),
        ),
        joints=joints,
        regimes=regimes,
        findings=said.findings,
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
        warnings=tuple(
            dict.fromkeys(warnings_of(found, data, judged, checked, folds, settings, robot))
        ),
        joint_fits=joint_fits(found, said, data, block),
        residual=residuals(checked.shown),
        small=small,
        knowledge=known,
    )
    if settings.rollout:
        say("simulating forwards", 0, 1)
        on, here = (data, True) if judged is None else (judged, False)
        replayed = rollouts(
            result.robot, result.corrected, on.segments, seed=settings.seed, fitted_here=here
        )
        result = replace(result, how_far=replace(result.how_far, rollout=replayed))
    say("done", 1, 1)
    return result


def read(
    robot: Robot, log: Log, held_out: Log | None, settings: GapSettings
) -> tuple[Data, Data | None]:
    """The logs as data: the one searched, and the one held out.

    Raises:
        LogError: logs that do not fit the robot or each other.
    """
    if log.tau is not None and (held_out is None or held_out.tau is not None):
        refuse_repeated(log, held_out)
    cutoff = None if settings.cutoff == "auto" else settings.cutoff
    # What is searched and what is held out have one rate, the lower of the two.
    rates = [] if held_out is None else [*sampling_rate(log), *sampling_rate(held_out)]
    rate = min(rates, default=math.inf)
    data = prepare(
        robot, log, cutoff, widest=settings.report_band, gain_std=settings.gain_std, rate=rate
    )
    if held_out is None:
        return data, None
    judged = prepare(
        robot, held_out, data.samples.cutoff, data.end + 1.0, data.band, data.gain_std, rate
    )
    return data, judged


def wanted_of(robot: Robot, settings: GapSettings) -> Wanted:
    """What the settings look for on a robot.

    Raises:
        TorchidError: a background on a robot whose parameters are given and trusted.
    """
    free = settings.parameters == "free" or robot.parameters is None
    if settings.background and not free:
        raise TorchidError(
            "a background is fitted with the base parameters, and this robot's are given.",
            got=", ".join(settings.background),
            hint="list them as `effects` of the robot, or refit: `parameters='free'`",
        )
    return Wanted(
        names=tuple(KINDS) if settings.effects is None else settings.effects,
        free=free,
        background=settings.background,
        inertial=settings.parameters != "trusted",
        only=settings.only,
        base=base_parameters(robot, basis="report"),
        knowledge=known_later(robot) if settings.parameters == "auto" else None,
    )


def pushes(wanted: Wanted) -> Wanted:
    """Of an arm that stands nothing but a push: whatever else its torque is, gravity and what
    friction holds, is fitted with it."""
    names = tuple(name for name in wanted.names if name == Contact.name)
    return replace(
        wanted, names=names, free=True, background=(TorqueOffset.name,), inertial=False,
        knowledge=None,
    )  # fmt: skip


def start_of(robot: Robot) -> Model:
    """The model as given; where it has no parameters, without inertia."""
    if robot.parameters is None:
        zero = torch.zeros(robot.n, PARAMETERS_PER_LINK, dtype=torch.float64)
        robot = robot.with_parameters(InertialParameters(zero))
    return Model.of(robot)


def refitted(columns: Columns, data: Data, wanted: Wanted) -> Solution:
    """The columns' model with base parameters, and the background, fitted anew."""
    terms = fixed_terms(columns, replace(wanted, free=True))
    x = [torch.zeros(len(t.at), dtype=torch.float64) for t in terms]
    return solved(columns, terms, x, data, wanted, _blocks(data, None))


def _blocks(data: Data, columns: Columns | None) -> Int[Tensor, " N"]:
    """Block (N,) of every sample: several times as long as what a model leaves is correlated."""
    bounds = data.samples.bounds
    time = 1.0
    if columns is not None:
        times = integrated_time(columns.gap * data.keep, bounds)
        time = float(times.median())
    return block_numbers(bounds, block_length(len(data.samples), time))


def check(
    found: Explanation,
    data: Data,
    judged: Data | None,
    folds: Folds,
    repeats: Repeats,
    settings: GapSettings,
    fitted_first: bool,
) -> Checked:
    """Models fitted without each fold, or on all data where a log was held out, and what they do.

    Args:
        found: the answered explanation.
        data, judged: the log searched, and the one held out.
        folds: of the log searched.
        repeats: among its trajectories.
        settings: the user's.
        fitted_first: whether the model before was fitted too, because the robot has no parameters.
    """
    solution = found.solution
    columns = found.question.candidates.columns.at(solution.model)
    base = refitted(columns.at(solution.start), data, solution.wanted)
    band = data.band
    noise = noise_of(columns, solution.start, solution.left, data, repeats, settings.seed)
    if judged is None:
        # Each fold is shown by models that were fitted on the others.
        fits = [folds.fitted(k) for k in range(folds.count)]
        after = [solution.without(f) for f in fits]
        again = [base.without(f) for f in fits]
        before = again if fitted_first else [solution.start]
        shown = traces(data.samples, folds, before, after, band, reach=noise.reach)
        again_shown = traces(data.samples, folds, before, again, band, reach=noise.reach)
        motions = repeats.groups(len(data.segments)) if folds.whole else None
    else:
        # The held-out log is shown by models that were fitted on all of the other log.
        before = [base.model] if fitted_first else [solution.start]
        shown = traces(judged.samples, None, before, [solution.model], band, reach=noise.reach)
        again_shown = traces(judged.samples, None, before, [base.model], band, reach=noise.reach)
        motions = tuple(range(len(shown))) if len(shown) >= FEW else None
    # Whatever is noise is part of what is left: the same instants, the same band.
    noise = noise.at_most(torch.minimum(*levels(shown)))
    return Checked(
        shown,
        again_shown,
        noise,
        closing(shown, noise.floor, settings.seed, noise.unpredicted, motions),
        closing(again_shown, noise.floor, settings.seed, motions=motions),
    )


def harmful(found: Explanation, checked: Checked, least: Float[Tensor, " n"]) -> list[Term]:
    """Terms that do no good on data that was not fitted: those of a joint that gets worse; those
    that several joints feel, where the one they are located at gets worse by what would be worth a
    name; and all that belong to the whole arm where the gap does not shrink at all; of what acts at
    ends of the travel alone, where some joint gets worse. What happened once is not asked."""
    far = checked.far
    rise = far.rms_after - far.rms_before
    own, shared = (set(x.nonzero().flatten().tolist()) for x in (rise > 0, rise >= least))
    out = []
    for term in found.terms:
        # What happened once cannot be foretold, so that held-out data say nothing about it; nor
        # have torques to say what another sensor shows.
        if any(e.event for e in term.effects) or found.question.shows(term):
            continue
        at = term.effects[0].joints if len(term.effects) == 1 else ()
        worse = shared if term.place is None else own
        # Resampled stretches may hold none of those in which it acts.
        rare = bool(term.effects) and term.effects[0].at_ends
        no_good = bool(shared) if rare else not far.improves
        if worse.intersection(at) if at else no_good:
            out.append(term)
    return out


def status_of(
    said: Told,
    checked: Checked,
    least: Float[Tensor, " n"],
    poor: bool,
    shown: bool,
    taken: bool = False,
    small: bool = False,
    hidden: bool = False,
) -> Status:
    """The verdict. What is told must shrink the gap on data it was not fitted on, by a share that
    has an interval; what is left is unexplained where it exceeds the noise there and a flexible
    predictor finds structure in it.

    Args:
        said: what is told.
        checked: on data that was not fitted.
        least: (n,) torque that is worth a name [N m; N].
        poor: whether the log could not show most effects.
        shown: whether another sensor than that of torque shows all that is told.
        taken: whether something that the evidence had was taken back for the harm that it did: it
            was no explanation, but the gap is there.
        small: whether there are causes of a size below what was asked for.
        hidden: whether what the model left open of itself could hide a cause.
    """
    far, noise = checked.far, checked.noise
    excess = (far.rms_after / noise.floor.high.clamp(min=1e-12)).square()
    # What is left must be worth as much as a cause must be.
    beyond = (far.rms_after.square() - noise.floor.high.square()).clamp(min=0).sqrt()
    excess = torch.where(beyond > least, excess, torch.zeros_like(excess))
    # Left over: well above the noise; above it, and predictable; or predictable alone.
    odd = (excess > EXCESS) & (noise.structure > 0)
    clear = (excess > CLEAR_EXCESS) & ~noise.uneven
    if noise.floor.source != "repeats":
        odd = clear = torch.zeros_like(odd)  # of the noise there is an upper bound only
    unexplained = bool((odd | clear | ((noise.structure > STRUCTURE) & (beyond > least))).any())
    if not (said.findings or said.parametric):
        if unexplained or taken:
            return "detected_unexplained"
        if poor or hidden:
            return "not_testable"
        return "negligible" if small else "no_gap"
    if unexplained or not (shown or (far.improves and far.closed is not None)):
        return "detected_unexplained"
    return "explained" if said.findings else "parametric_only"


def warnings_of(
    found: Explanation,
    data: Data,
    judged: Data | None,
    checked: Checked,
    folds: Folds,
    settings: GapSettings,
    robot: Robot,
) -> list[str]:
    """What a user must know beside the findings."""
    solution = found.solution
    out = [*data.warnings, *(() if judged is None else judged.warnings), *checked.noise.floor.notes]
    # A gap larger than the torque's own variation: the log may be of another robot.
    torque = torch.cat([t.measured[t.valid] for t in checked.shown])
    gap = torch.cat([(t.measured - t.before)[t.valid] for t in checked.shown])
    useless = gap.square().mean(0) > (torque - torque.mean(0)).square().mean(0)
    if 2 * int(useless.sum()) > len(useless):
        joints = ", ".join(str(j + 1) for j in useless.nonzero().flatten().tolist())
        out.append(
            f"the model explains nothing of the torque of joints {joints}: is the log of this "
            "robot, its joints in this order, in these units? `torchid log doctor ROBOT LOG` looks"
        )
    if checked.noise.floor.source != "repeats":
        out.append(
            "no motion is repeated, so the noise is known only between bounds: drive one "
            "trajectory twice to know it"
        )
    if len(found.terms) >= settings.max_effects:
        out.append(f"the search ended at {settings.max_effects} effects: `max_effects=...`")
    # What holds for this log alone.
    events = sorted({e.name for e, _ in solution.model.effects if e.name in EVENTS})
    if events:
        out.append(f"of this log alone, not part of the corrected model: {', '.join(events)}")
    changed = any(t.inertial for t in solution.terms)
    # Corrected parameters that no body has.
    margins = solution.model.robot.require_parameters("a check").consistency_margin()
    if changed and bool((margins < 0).any()):
        out.append(
            "the corrected inertial parameters give the right torque but belong to no body: "
            "`torchid check corrected.yaml --nearest near.json` finds feasible ones near in torque"
        )
    if robot.parameters is None:
        out.append(
            "the robot has no inertial parameters: base parameters were fitted first, so the gap "
            "is what even the best rigid body leaves"
        )
    if judged is None and not folds.whole:
        out.append(
            "fewer than three different trajectories: held-out data are stretches of the same "
            "trajectories, and intervals are wider than they look"
        )
    # Joints on which the corrected model is worse.
    worse = checked.far.rms_after > checked.far.rms_before
    if found.terms and bool(worse.any()):
        joints = joint_list(worse.nonzero().flatten().tolist())
        out.append(f"on data that was not fitted the corrected model is worse on {joints}")
    return out + needs_trust(found)


def needs_trust(found: Explanation) -> list[str]:
    """Effects that are not needed once base parameters are refitted."""
    question, fit = found.question, found.fit
    base = [t for t in question.candidates.terms if t.name == BASE]
    if not base or any(t.inertial for t in found.terms):
        return []
    # A term is needed if the evidence, base parameters refitted, falls without it.
    every = fit_terms(question, [*found.terms, *base], fit.effective, fit.weight)
    lost = []
    for term in found.terms:
        rest = [t for t in found.terms if t is not term]
        without = fit_terms(question, [*rest, *base], fit.effective, fit.weight)
        if without.evidence >= every.evidence:
            joints = term.effects[0].joints if len(term.effects) == 1 else ()
            lost.append(f"{term.name} of joint {joints[0] + 1}" if joints else term.name)
    if not lost:
        return []
    return [
        "with base parameters refitted these effects are not needed, so they hold only if the "
        f"robot's parameters are right: {', '.join(lost)}"
    ]
