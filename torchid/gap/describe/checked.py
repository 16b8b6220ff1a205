"""What is answered of an explanation, and what it is worth on data that it was not fitted on.

What is less likely than not stays in the model without a name, as long as something else has one.
A held-out log takes part in no choice: it judges what was chosen, and a cause that does no good
there loses its name.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch

from torchid.gap.describe.claims import Claim, unsure
from torchid.gap.describe.closing import Closing, closing, levels
from torchid.gap.describe.model import Explanation, refitted
from torchid.gap.describe.noise import Noise, noise_of
from torchid.gap.describe.shares import Shares
from torchid.gap.describe.traces import traces
from torchid.gap.diagnosis import Trace, alien_joints, worse_than_none
from torchid.gap.folds import FEW
from torchid.gap.wanted import BASE
from torchid.results.cause import JudgedOn
from torchid.robot.model import torque_unit
from torchid.typing import Bool, Float, Tensor


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

    @cached_property
    def alien(self) -> Bool[Tensor, " n"]:
        """Joints whose torque follows neither model."""
        return alien_joints(self.shown)


@dataclass(frozen=True, eq=False)
class Decision:
    """The answered explanation.

    Attributes:
        found: which.
        checked: on data that it was not fitted on.
        claims: its causes.
        dropped: an explanation none of whose causes is likely, and these; nothing of it is
            answered.
        least: (n,) torque that is worth a name [N m; N].
        taken_back: whether something that the evidence had has left for the harm that it did: it
            was no explanation, but the gap is there.
    """

    found: Explanation
    checked: Checked
    claims: tuple[Claim, ...]
    dropped: tuple[Explanation, tuple[Claim, ...]] | None
    least: Float[Tensor, " n"]
    taken_back: bool

    def unnamed_squares(self, taken: Shares) -> Float[Tensor, " n"]:
        """What causes without a name take (n,) of the mean squares of the error, on data that was
        not fitted."""
        far = self.checked.far
        squares = taken.of_bars(far.rms_before.square(), far.rms_after.square())
        return squares[[one.unnamed for one in self.claims]].sum(0)


def decide(found: Explanation, claims: Sequence[Claim]) -> Decision:
    """The answer that an explanation is.

    Args:
        found: the explanation.
        claims: its causes, as sure as the log makes them.
    """
    checked = check(found)
    # Where most joints' torque follows neither model nothing is confirmed, on no joint; nor where
    # the model as given is worse than none there, and other bodies altogether take its place.
    replaced = any(t.name == BASE for t in found.terms) and worse_than_none(checked.shown)
    shrinks = checked.far.shrinks * (not (replaced or bool(checked.alien.any())))
    told, dropped, taken_back = [one.beside(shrinks) for one in claims], None, False
    told = [one.as_known(*found.solution.largest(one.term)) for one in told]
    least = found.least
    if unsure(told):
        dropped, taken_back = (found, tuple(told)), not all(one.unnamed for one in claims)
        found, told = found.dropped(), []
        checked = check(found)
    if found.problem.judged is not None:
        _, in_turn = levels(in_turn_shown(found, checked.noise))
        names = [s.name for s in found.problem.data.segments]
        judged = JudgedOn.by_names(names, "left out in turn")
        left_out = judged.error(float(in_turn.norm()), torque_unit(found.problem.robot))
        checked = replace(checked, far=replace(checked.far, left_out=left_out))
    return Decision(found, checked, tuple(told), dropped, least, taken_back)


def in_turn_shown(found: Explanation, noise: Noise) -> list[Trace]:
    """The log that was searched by models that were fitted without each fold."""
    problem, folds = found.problem, found.problem.folds
    after = [found.solution.without(folds.fitted(k)) for k in range(folds.count)]
    start, band = [found.solution.start], problem.data.band
    return traces(problem.data.samples, folds, start, after, band, reach=noise.reach)


def check(found: Explanation) -> Checked:
    """Models fitted without each fold, or on all data where a log was held out, and what they
    do."""
    problem, solution = found.problem, found.solution
    data, folds, seed, band = problem.data, problem.folds, problem.settings.seed, problem.data.band
    base = refitted(problem.given, data, problem.wanted)
    noise = noise_of(problem, solution, found.least)
    if problem.judged is None:
        # Each fold is shown by models that were fitted on the others.
        samples, parts = data.samples, folds
        fits = [folds.fitted(k) for k in range(folds.count)]
        after, again = ([x.without(f) for f in fits] for x in (solution, base))
        motions = problem.repeats.groups(len(data.segments)) if folds.whole else None
    else:
        # The held-out log is shown by models that were fitted on all of the other log.
        samples, parts = problem.judged.samples, None
        after, again = [solution.model], [base.model]
        count = len(samples.segments)
        motions = tuple(range(count)) if count >= FEW else None
    start = again if problem.fitted_first else [solution.start]
    shown, other = (
        traces(samples, parts, start, x, band, reach=noise.reach) for x in (after, again)
    )
    # Whatever is noise is part of what is left: the same instants, the same band.
    noise = noise.at_most(torch.minimum(*levels(shown)))
    far = closing(shown, noise.floor, seed, noise.unpredicted, motions)
    other_far = closing(other, noise.floor, seed, motions=motions)
    return Checked(shown, other, noise, far, other_far)
