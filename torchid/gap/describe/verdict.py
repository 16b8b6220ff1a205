"""The verdict of an answer, and what a user must know beside it.

What is left of a joint's torque is held against its noise where repeats measure that. Without them
three things are told apart: what may be noise, what is small, and what is unexplained.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.design.paths import same_paths
from torchid.effects.registry import EVENTS
from torchid.gap.describe.checked import Checked, Decision
from torchid.gap.describe.findings import Findings
from torchid.gap.diagnosis import is_foreign
from torchid.gap.problem import Problem
from torchid.gap.record import Status
from torchid.results.cause import LINK, Cause
from torchid.results.words import PAYLOAD, digits, listed, percent
from torchid.robot.model import Robot, joint_list, joint_unit
from torchid.statistics.criteria import CLEAR_EXCESS, EXCESS, LEAST_NOISES, SMALL_ERROR
from torchid.typing import Bool, Float, Tensor

CHECK_FIRST = "Next time: check the log first"
"""How the warning begins that a model explains nothing of most torques."""

NO_BODY = 1.1
"""Error of a load's body over that of any ten numbers, on one joint, from which it is in doubt."""


@dataclass(frozen=True, eq=False)
class Left:
    """What the answered model leaves on data it was not fitted on.

    Attributes:
        rms, torque: (n,) of what is left, and of the measured torque, while joints move [N m; N].
        noise: (n,) that it is held against: as repeats measure it at most, else the least.
        measured: whether repeats do.
        beyond: (n,) whether more is left than may be noise.
        unexplained: (n,) whether that is worth as much as a cause must be, and, without repeats,
            not negligible beside the torque.
    """

    rms: Float[Tensor, " n"]
    torque: Float[Tensor, " n"]
    noise: Float[Tensor, " n"]
    measured: bool
    beyond: Bool[Tensor, " n"]
    unexplained: Bool[Tensor, " n"]

    @classmethod
    def of(cls, checked: Checked, least: Float[Tensor, " n"]) -> "Left":
        """Of the motions or stretches left out in turn.

        Args:
            checked: on these.
            least: (n,) torque that is worth a name [N m; N].
        """
        rms, noise = checked.far.rms_after, checked.noise
        counting = torch.cat([t.counting for t in checked.shown])
        torque = torch.cat([t.measured for t in checked.shown]).square() * counting
        torque = (torque.sum(0) / counting.sum(0).clamp(min=1)).sqrt()
        measured = noise.floor.source == "repeats"
        bound = noise.floor.high if measured else noise.floor.low
        excess = (rms / bound.clamp(min=1e-12)).square()
        worth = (rms.square() - bound.square()).clamp(min=0).sqrt() > least
        # 0.25: predictable share of a joint's noise variance from which structure is worth saying
        structured = noise.structure > 0.25
        if measured:
            # Well above the noise; above it, and predictable; or predictable alone.
            beyond = (excess > EXCESS) & (noise.structure > 0)
            beyond |= (excess > CLEAR_EXCESS) & ~noise.uneven | structured
            return cls(rms, torque, bound, measured, beyond, beyond & worth)
        beyond = (excess > LEAST_NOISES**2) | structured
        large = rms > SMALL_ERROR * torque
        return cls(rms, torque, bound, measured, beyond, beyond & large & worth)

    def words(self, robot: Robot) -> str:
        """`1.09 N m on joint 3, 25 times the least noise`, of what is unexplained where that is
        most; where nothing is, of what is more than noise may be, with its share of the torque;
        empty where all may be noise."""
        among = self.unexplained if self.unexplained.any() else self.beyond
        if not among.any():
            return ""
        j = int(torch.where(among, self.rms, -1.0).argmax())
        times, share = float(self.rms[j] / self.noise[j]), float(self.rms[j] / self.torque[j])
        beside = f"{digits(times, 2)} times the {'' if self.measured else 'least '}noise"
        if not self.unexplained[j]:
            beside = f"{percent(share)} of its torque"
            # It is not worth a name, however large, where a saved model left as much before.
            saved = robot.knowledge is not None and robot.knowledge.left is not None
            if saved and share > SMALL_ERROR:
                beside += ", as much as the model left on its own log"
        return f"{digits(float(self.rms[j]))} {joint_unit(robot, j)} on joint {j + 1}, {beside}"


def status_of(
    said: Findings,
    checked: Checked,
    final: Checked,
    left: Left,
    least: Float[Tensor, " n"],
    unnamed: Float[Tensor, " n"],
    poor: bool,
    shown: bool,
    taken: bool = False,
    small: bool = False,
) -> Status:
    """The verdict. What is told must shrink the gap on data it was not fitted on, by a share that
    has an interval, and nothing of what is left may be unexplained. There is no gap only beside a
    model that most of the torque follows.

    Args:
        said: what is told.
        checked: on parts of the log that were left out in turn.
        final: on held-out data where there are some: an answer that does no good there explains
            nothing.
        left: what is left on parts of the log.
        least: (n,) torque that is worth a name [N m; N].
        unnamed: (n,) mean squares that terms without a name take.
        poor: whether the log could not show most effects, or the model was too unsure of itself.
        shown: whether another sensor than that of torque shows all that is told.
        taken: whether something that the evidence had was taken back for the harm that it did: it
            was no explanation, but the gap is there.
        small: whether there are causes of a size below what was asked for.
    """
    # What has no name explains nothing.
    unexplained = bool((left.unexplained | (unnamed > least.square())).any())
    if not said.causes:
        if unexplained or taken or checked.alien.any():
            return "detected_unexplained"
        if poor:
            return "not_testable"
        if is_foreign(checked.shown):
            return "detected_unexplained"
        return "negligible" if small or (left.beyond.any() and not left.measured) else "no_gap"
    helps = all(x.far.improves and x.far.closed is not None for x in (checked, final))
    if unexplained or not (shown or helps):
        return "detected_unexplained"
    bodies = all(c.effect == LINK for c in said.causes)
    return "parametric_only" if bodies else "explained"


def warnings_of(
    decision: Decision, causes: Sequence[Cause], cost: Float[Tensor, " n"], left: Left
) -> list[str]:
    """What a user must know beside the findings.

    Args:
        decision, causes: what is answered.
        cost: (n,) torque by which the recommended bodies differ from the fitted ones [N m; N].
        left: on parts of the log.
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
    if causes and left.unexplained.any():
        least = "" if left.measured else f" and more than {percent(SMALL_ERROR)} of its torque"
        out.append(f"Caution: unexplained is {left.words(problem.robot)}{least}.")
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
    if any(c.effect == PAYLOAD for c in causes):
        out += _doubt_of_load(decision)
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


def _doubt_of_load(decision: Decision) -> list[str]:
    """That a load is no body, where ten numbers that no body has explain much more."""
    found = decision.found
    if found.solution.of_load is None:
        return []
    body, numbers = (x.clamp(min=1e-300) for x in found.solution.of_load)
    # What they take of the joints' squares; what they add on some joints counts against it.
    taken = 1 - (numbers / body).square()
    worst = int(taken.argmax())
    if not min(taken[worst], taken.sum()) > 1 - NO_BODY**-2:
        return []
    unit = joint_unit(found.problem.robot, worst)
    sizes = [f"{float(x[worst]):.2g} {unit}" for x in (body, numbers)]
    return [
        "Caution: the load is no rigid body here, or not on this link: as one it leaves "
        f"{sizes[0]} on joint {worst + 1}, and ten numbers that no body has {sizes[1]}."
    ]


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
