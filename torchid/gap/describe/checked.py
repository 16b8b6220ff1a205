"""What is answered of an explanation, and what it is worth on data that it was not fitted on.

What is less likely than not stays in the model without a name, as long as something else has one.
Each part of the log, left out in its turn, confirms what was fitted to the others. A held-out log
is opened when all is chosen: it says how far that goes there, and changes no name and no number.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch

from torchid.design.segments import Samples
from torchid.gap.data import Data
from torchid.gap.describe.claims import Claim, unsure
from torchid.gap.describe.closing import Closing, closing, levels
from torchid.gap.describe.model import Explanation, Solution, refitted
from torchid.gap.describe.noise import Noise, noise_of
from torchid.gap.describe.shares import Shares
from torchid.gap.describe.traces import Foretells, traces
from torchid.gap.diagnosis import Trace, alien_joints, worse_than_none
from torchid.gap.folds import FEW, Folds
from torchid.gap.wanted import BASE
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
        checked: on motions or stretches of the log that were left out in turn: what decides.
        final: on the held-out log, where there is one, which decides nothing; else the same.
        claims: its causes.
        dropped: an explanation none of whose causes is likely, and these; nothing of it is
            answered.
        least: (n,) torque that is worth a name [N m; N].
        taken_back: whether something that the evidence had has left for the harm that it did: it
            was no explanation, but the gap is there.
    """

    found: Explanation
    checked: Checked
    final: Checked
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
    problem = found.problem
    base = refitted(problem.given, problem.data, problem.wanted)
    checked = check(found, base)
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
        checked = check(found, base)
    final = checked
    if problem.judged is not None:
        final = check_held_out(found, base, checked.noise, problem.judged)
        left_out = replace(checked.far, judged=problem.left_out)
        final = replace(final, far=replace(final.far, left_out=left_out))
    return Decision(found, checked, final, tuple(told), dropped, least, taken_back)


def check(found: Explanation, base: Solution) -> Checked:
    """What models do that were fitted without each fold of the log, on that fold.

    Args:
        found: the explanation.
        base: base parameters alone, fitted anew.
    """
    problem, solution = found.problem, found.solution
    data, folds = problem.data, problem.folds
    fits = [folds.fitted(k) for k in range(folds.count)]
    after, again = ([x.without(f) for f in fits] for x in (solution, base))
    motions = problem.repeats.groups(len(data.segments)) if folds.whole else None
    noise = noise_of(problem, solution, found.least)
    return _compared(found, data.samples, folds, (after, again), noise, motions)


def check_held_out(found: Explanation, base: Solution, noise: Noise, judged: Data) -> Checked:
    """What models that were fitted to all of a log do on another.

    Args:
        found, base: as of `check`.
        noise: of the log that they were fitted to.
        judged: the other one.
    """
    count, models = len(judged.segments), ([found.solution.model], [base.model])
    motions = tuple(range(count)) if count >= FEW else None
    return _compared(found, judged.samples, None, models, noise, motions)


def _compared(
    found: Explanation,
    samples: Samples,
    folds: Folds | None,
    models: tuple[Sequence[Foretells], Sequence[Foretells]],
    noise: Noise,
    motions: Sequence[int] | None,
) -> Checked:
    """The explanation's models, and those of base parameters alone, beside the model as given."""
    problem, (after, again) = found.problem, models
    seed, band = problem.settings.seed, problem.data.band
    start = again if problem.fitted_first else [found.solution.start]
    shown, other = (
        traces(samples, folds, start, x, band, reach=noise.reach) for x in (after, again)
    )
    # Whatever is noise is part of what is left: the same instants, the same band.
    noise = noise.at_most(torch.minimum(*levels(shown)))
    far = closing(shown, noise.floor, seed, noise.unpredicted, motions)
    other_far = closing(other, noise.floor, seed, motions=motions)
    return Checked(shown, other, noise, far, other_far)
