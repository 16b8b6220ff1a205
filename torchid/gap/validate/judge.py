"""What an explanation is worth on data that it was not fitted on, the verdict, and its warnings."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch

from torchid.design.columns import Columns
from torchid.design.paths import same_paths
from torchid.effects.registry import EVENTS
from torchid.gap.data import Data
from torchid.gap.diagnosis import UNLIKE, Trace, alien_joints, is_foreign
from torchid.gap.folds import FEW
from torchid.gap.noise.floor import Noise, noise_of
from torchid.gap.problem import Problem
from torchid.gap.record import Status
from torchid.gap.search.explain import Explanation
from torchid.gap.search.findings import Findings
from torchid.gap.search.odds import Misfit
from torchid.gap.search.solve import Solution, solve_terms
from torchid.gap.search.terms import Wanted, fixed_terms
from torchid.gap.validate.closing import Closing, closing, known_noise, levels
from torchid.gap.validate.traces import traces
from torchid.results.words import listed
from torchid.robot.model import joint_list, joint_unit
from torchid.statistics.autocorrelation import integrated_time
from torchid.statistics.blocks import block_length, block_numbers
from torchid.statistics.criteria import CLEAR_EXCESS, EXCESS
from torchid.typing import Bool, Float, Int, Tensor

STRUCTURE = 0.25
"""Predictable share of a joint's noise variance from which structure is worth saying [1]."""

SAME_SPEED = 1.1
"""Ratio of two speeds along one path below which they are the same [1]."""


@dataclass(frozen=True, eq=False)
class Checked:
    """What the answered model does on data it was not fitted on.

    Attributes:
        shown: torque before and after.
        refitted: torque before, and of the model with base parameters refitted.
        base: that model.
        noise: beside the answered model.
        measured: the same, as it was before what is left bounded it.
        far: closed share.
        refitted_far: of base parameters alone.
    """

    shown: list[Trace]
    refitted: list[Trace]
    base: Solution
    noise: Noise
    measured: Noise
    far: Closing
    refitted_far: Closing

    @cached_property
    def alien(self) -> Bool[Tensor, " n"]:
        """Joints whose torque follows neither model."""
        return alien_joints(self.shown)


def refitted(columns: Columns, data: Data, wanted: Wanted) -> Solution:
    """The columns' model with base parameters, and the background, fitted anew."""
    terms = fixed_terms(columns, replace(wanted, free=True))
    x = [torch.zeros(len(t.at), dtype=torch.float64) for t in terms]
    return solve_terms(columns, terms, x, data, wanted, blocks_of(data, None))


def blocks_of(data: Data, columns: Columns | None) -> Int[Tensor, " N"]:
    """Block (N,) of every sample: several times as long as what a model leaves is correlated."""
    bounds = data.samples.bounds
    time = 1.0
    if columns is not None:
        times = integrated_time(columns.gap * data.keep, bounds)
        time = float(times.median())
    return block_numbers(bounds, block_length(len(data.samples), time))


def check(
    found: Explanation,
    problem: Problem,
    judged: Data | None = None,
    before: Checked | None = None,
) -> Checked:
    """Models fitted without each fold, or on all data where a log was held out, and what they do.

    Args:
        found: the explanation.
        problem: of which it is one.
        judged: the log that is held out; None to leave out each fold.
        before: of this explanation on the folds, where that is known.
    """
    data, folds, seed = problem.data, problem.folds, problem.settings.seed
    repeats, fitted_first = problem.repeats, problem.fitted_first
    solution = found.solution
    columns = found.question.candidates.columns.at(solution.model)
    band = data.band
    if before is None:
        base = refitted(columns.at(solution.start), data, solution.wanted)
        least = found.question.least(found.question.mean(found.empty.losses))
        noise = noise_of(columns, solution.start, solution.left, data, repeats, least, seed)
    else:
        base, noise = before.base, before.measured
    if judged is None:
        # Each fold is shown by models that were fitted on the others.
        fits = [folds.fitted(k) for k in range(folds.count)]
        after = [solution.without(f) for f in fits]
        again = [base.without(f) for f in fits]
        start = again if fitted_first else [solution.start]
        shown = traces(data.samples, folds, start, after, band, reach=noise.reach)
        again_shown = traces(data.samples, folds, start, again, band, reach=noise.reach)
        motions = repeats.groups(len(data.segments)) if folds.whole else None
    else:
        # The held-out log is shown by models that were fitted on all of the other log.
        start = [base.model] if fitted_first else [solution.start]
        shown = traces(judged.samples, None, start, [solution.model], band, reach=noise.reach)
        again_shown = traces(judged.samples, None, start, [base.model], band, reach=noise.reach)
        motions = tuple(range(len(shown))) if len(shown) >= FEW else None
    # Whatever is noise is part of what is left: the same instants, the same band.
    measured, noise = noise, noise.at_most(torch.minimum(*levels(shown)))
    return Checked(
        shown,
        again_shown,
        base,
        noise,
        measured,
        closing(shown, noise.floor, seed, noise.unpredicted, motions),
        closing(again_shown, noise.floor, seed, motions=motions),
    )


def misfit_of(found: Explanation, checked: Checked, problem: Problem) -> Misfit:
    """What an explanation leaves without a name. Noise is white, or as repeats measure it; without
    them it is not known how much of what is left on other data is noise."""
    floor = checked.noise.floor
    noise = known_noise(floor)
    in_band = min(1.0, problem.data.samples.cutoff / problem.data.band) * noise
    measured = noise if floor.source == "repeats" else torch.zeros_like(noise)
    before, after = (x.square() - measured for x in (checked.far.rms_before, checked.far.rms_after))
    share = (after.clamp(min=0) / before.clamp(min=1e-300)).clamp(max=1.0)
    return Misfit((found.question.mean(found.fit.losses) - in_band).clamp(min=0), share)


def status_of(
    said: Findings,
    checked: Checked,
    least: Float[Tensor, " n"],
    unnamed: Float[Tensor, " n"],
    poor: bool,
    shown: bool,
    taken: bool = False,
    small: bool = False,
) -> Status:
    """The verdict. What is told must shrink the gap on data it was not fitted on, by a share that
    has an interval; what is left is unexplained where it exceeds the noise there and a flexible
    predictor finds structure in it. There is no gap only beside a model that most of the torque
    follows.

    Args:
        said: what is told.
        checked: on data that was not fitted.
        least: (n,) torque that is worth a name [N m; N].
        unnamed: (n,) mean squares that terms without a name take.
        poor: whether the log could not show most effects, or the model was too unsure of itself.
        shown: whether another sensor than that of torque shows all that is told.
        taken: whether something that the evidence had was taken back for the harm that it did: it
            was no explanation, but the gap is there.
        small: whether there are causes of a size below what was asked for.
    """
    far, noise = checked.far, checked.noise
    excess = (far.rms_after / noise.floor.high.clamp(min=1e-12)).square()
    # What is left must be worth as much as a cause must be.
    beyond = (far.rms_after.square() - noise.floor.high.square()).clamp(min=0).sqrt()
    excess = torch.where(beyond > least, excess, torch.zeros_like(excess))
    measured = noise.floor.source == "repeats"
    # Left over: well above the noise; above it, and predictable; or predictable alone.
    odd = (excess > EXCESS) & (noise.structure > 0)
    clear = (excess > CLEAR_EXCESS) & ~noise.uneven
    if not measured:
        odd = clear = torch.zeros_like(odd)  # nothing but repeats bounds the noise above
    structured = (noise.structure > STRUCTURE) & (beyond > least)
    # Without a bound of the noise, what leaves most of the gap is no explanation of it.
    little = not measured and far.closed is not None and far.closed < 1 - UNLIKE
    # What has no name explains nothing.
    unexplained = little or bool((odd | clear | structured | (unnamed > least.square())).any())
    if not (said.effects or said.parametric):
        if unexplained or taken or checked.alien.any():
            return "detected_unexplained"
        if poor:
            return "not_testable"
        if is_foreign(checked.shown):
            return "detected_unexplained"
        return "negligible" if small else "no_gap"
    if unexplained or not (shown or (far.improves and far.closed is not None)):
        return "detected_unexplained"
    return "explained" if said.effects else "parametric_only"


def warnings_of(
    found: Explanation, checked: Checked, problem: Problem, cost: Float[Tensor, " n"]
) -> list[str]:
    """What a user must know beside the findings.

    Args:
        found, checked, problem: as for `check`.
        cost: (n,) torque by which the recommended bodies differ from the fitted ones [N m; N].
    """
    solution, settings, judged = found.solution, problem.settings, problem.judged
    alien = checked.alien.nonzero().flatten().tolist()
    said = (
        "Next time: check the log first (`torchid log doctor ROBOT LOG`): the model explains "
        f"nothing of the torque of {joint_list(alien)}. Is it of this robot, its joints in this "
        "order, in these units?"
    )
    out = [said] if alien else []
    out += [*problem.data.warnings, *checked.noise.floor.notes]
    out += [] if judged is None else judged.warnings
    if checked.noise.floor.source != "repeats":
        out.append(f"Next time: {_what_bounds_noise(problem)}")
    if len(found.terms) >= settings.max_effects:
        out.append(
            f"Caution: stopped at {settings.max_effects} effects; there may be more "
            "(`max_effects=...`)."
        )
    # What holds for this log alone.
    events = sorted({e.name for e, _ in solution.model.effects if e.name in EVENTS})
    if events:
        out.append(f"For this log alone, not part of the corrected model: {', '.join(events)}.")
    if bool((cost > 0).any()):
        worst = int(cost.argmax())
        size = f"{float(cost[worst]):.2g} {joint_unit(problem.robot, worst)}"
        out.append(
            "Caution: no bodies have the fitted inertial parameters. The corrected model has those "
            f"nearest in torque, {size} from it on joint {worst + 1}, where most."
        )
    if problem.fitted_first:
        out.append(
            "The robot has no inertial parameters. Base parameters were fitted first, so the gap "
            "is what even the best rigid body leaves."
        )
    if judged is None and not problem.folds.whole:
        out.append(
            "Next time: record three different motions. With fewer, held-out data are "
            "stretches of the same motions, and intervals are wider than they look."
        )
    # Joints on which the corrected model is worse.
    worse = checked.far.rms_after > checked.far.rms_before
    if found.terms and bool(worse.any()):
        joints = joint_list(worse.nonzero().flatten().tolist())
        out.append(
            f"Caution: on data that was not fitted, the corrected model is worse on {joints}."
        )
    return out


def _what_bounds_noise(problem: Problem) -> str:
    """What to record so that the noise has an upper bound, beside what is there already."""
    segments, pairs = problem.data.segments, problem.repeats.pairs
    if pairs:
        names = listed(dict.fromkeys(segments[k].name for p in pairs for k in (p.a, p.b)), most=3)
        return f"repeat {names} for longer. That is too short to give the noise an upper bound."
    for path in same_paths(segments)[:1]:
        first, again = segments[path.a].name, segments[path.b].name
        if max(path.speed, 1 / path.speed) < SAME_SPEED:
            return (
                f"drive {first} again at the same times. {again} has its path and speed but other "
                "rests, so the noise has no upper bound."
            )
        return (
            f"record {again} again at the same speed, which bounds the noise. {first} has its path "
            f"at {1 / path.speed:.2g} times the speed: that tells friction by speed alone."
        )
    return "record one motion twice. None is repeated here, so the noise has no upper bound."
