"""The verdict of an answer, and what a user must know beside it."""

import torch

from torchid.design.paths import same_paths
from torchid.effects.registry import EVENTS
from torchid.gap.describe.checked import Checked, Decision
from torchid.gap.describe.findings import Findings
from torchid.gap.diagnosis import UNLIKE, is_foreign
from torchid.gap.problem import Problem
from torchid.gap.record import Status
from torchid.results.cause import LINK
from torchid.results.words import listed
from torchid.robot.model import joint_list, joint_unit
from torchid.statistics.criteria import CLEAR_EXCESS, EXCESS
from torchid.typing import Float, Tensor

CHECK_FIRST = "Next time: check the log first"
"""How the warning begins that a model explains nothing of most torques."""


def status_of(
    said: Findings,
    checked: Checked,
    final: Checked,
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
        checked: on parts of the log that were left out in turn.
        final: on held-out data where there are some: an answer that does no good there explains
            nothing.
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
    # 0.25: predictable share of a joint's noise variance from which structure is worth saying
    structured = (noise.structure > 0.25) & (beyond > least)
    # Without a bound of the noise, what leaves most of the gap is no explanation of it.
    closed = 1.0 if far.closed is None or not said.causes else far.closed
    little = not measured and closed < 1 - UNLIKE
    # What has no name explains nothing.
    unexplained = little or bool((odd | clear | structured | (unnamed > least.square())).any())
    if not said.causes:
        if unexplained or taken or checked.alien.any():
            return "detected_unexplained"
        if poor:
            return "not_testable"
        if is_foreign(checked.shown):
            return "detected_unexplained"
        return "negligible" if small else "no_gap"
    helps = all(x.far.improves and x.far.closed is not None for x in (checked, final))
    if unexplained or not (shown or helps):
        return "detected_unexplained"
    bodies = all(c.effect == LINK for c in said.causes)
    return "parametric_only" if bodies else "explained"


def warnings_of(decision: Decision, cost: Float[Tensor, " n"]) -> list[str]:
    """What a user must know beside the findings.

    Args:
        decision: what is answered.
        cost: (n,) torque by which the recommended bodies differ from the fitted ones [N m; N].
    """
    found, checked, final = decision.found, decision.checked, decision.final
    problem, solution = found.problem, found.solution
    settings, judged = problem.settings, problem.judged
    alien = (checked.alien | final.alien).nonzero().flatten().tolist()
    said = (
        f"{CHECK_FIRST} (`torchid log doctor ROBOT LOG`): the model explains "
        f"nothing of the torque of {joint_list(alien)}. Is it of this robot, its joints in this "
        "order, in these units?"
    )
    out = [said] if alien else []
    out += [*problem.data.warnings, *final.noise.floor.notes]
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
    worse = final.far.rms_after > final.far.rms_before
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
        # 1.1: ratio of two speeds along one path below which they are the same
        if max(path.speed, 1 / path.speed) < 1.1:
            return (
                f"drive {first} again at the same times. {again} has its path and speed but other "
                "rests, so the noise has no upper bound."
            )
        return (
            f"record {again} again at the same speed, which bounds the noise. {first} has its path "
            f"at {1 / path.speed:.2g} times the speed: that tells friction by speed alone."
        )
    return "record one motion twice. None is repeated here, so the noise has no upper bound."
