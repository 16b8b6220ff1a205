"""Held-out data: whole trajectories, or, where there are too few, contiguous stretches; and the
torque of models that were fitted without them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch

from torchid.design.segments import Samples, Segment, moving_instants, widened
from torchid.gap.diagnosis import Trace
from torchid.log.filtering import low_passed
from torchid.typing import Bool, Float, Int, Tensor

GAP = 4.0
"""Samples next to a held-out stretch that are not fitted, in periods of the cut-off: as far as the
filter reaches."""

FEW = 3
"""Different trajectories below which a fold is a stretch of each of them."""


@runtime_checkable
class Foretells(Protocol):
    """A model of an arm, or a file of it in a simulator."""

    def torque(self, segment: Segment, samples: Samples) -> Float[Tensor, "T n"]:
        """Torque that the motion of a segment takes [N m; N]."""


@dataclass(frozen=True, eq=False)
class Folds:
    """Which samples are held out together.

    Attributes:
        fold: (N,) number of each sample's fold, from 0.
        count: number of folds.
        whole: whether folds are whole trajectories.
        border: (N,) samples so near to another fold that the filter mixes them with it.
    """

    fold: Int[Tensor, " N"]
    count: int
    whole: bool
    border: Bool[Tensor, " N"]

    @property
    def parts(self) -> Int[Tensor, " N"]:
        """Number of every sample's fold, from 1; 0 of those at a border, which no fold is fitted or
        judged on."""
        return torch.where(self.border, 0, self.fold + 1)

    def fitted(self, k: int) -> Bool[Tensor, " N"]:
        """Samples that fold k's model is fitted on."""
        return (self.fold != k) & ~self.border


def make_folds(samples: Samples, count: int, groups: Sequence[int]) -> Folds:
    """Folds of whole trajectories where there are at least three different ones, else stretches.

    Args:
        samples: of the segments.
        count: folds wanted.
        groups: per segment the motion it repeats; repeats of one motion share a fold.
    """
    distinct = sorted(set(groups))
    fold = torch.zeros(len(samples), dtype=torch.long)
    border = torch.zeros(len(samples), dtype=torch.bool)
    if len(distinct) >= FEW:
        # Whole motions, dealt out in turn; what repeats a motion goes with it.
        count = min(count, len(distinct))
        number = {g: k % count for k, g in enumerate(distinct)}
        for own, group in zip(samples.bounds, groups, strict=True):
            fold[own] = number[group]
        return Folds(fold, count, True, border)
    # Too few motions: stretches of each, and a border between them as wide as the filter.
    gap = GAP / (samples.cutoff * samples.interval) / 2
    for own in samples.bounds:
        length = own.stop - own.start
        fold[own] = torch.arange(length) * count // length
        turns = torch.zeros(length, 1, dtype=torch.float64)
        turns[1:, 0] = (fold[own].diff() != 0).double()
        border[own] = widened(turns, gap)[:, 0] > 0
    return Folds(fold, count, False, border)


def traces(
    samples: Samples,
    folds: Folds | None,
    before: Sequence[Foretells],
    after: Sequence[Foretells],
    band: float,
    *,
    reach: Float[Tensor, " n"] | None = None,
) -> list[Trace]:
    """Torque before and after along every segment, each instant by the models of its own fold.

    Args:
        samples: of the segments.
        folds: None where all segments are held out from one pair of models.
        before, after: one model a fold, or one for all.
        band: low-pass of what is reported [Hz].
        reach: (n,) how near to a joint's reversal instants do not count for how far the gap closes
            [s]; None where all count.
    """
    out = []
    for k, segment in enumerate(samples.segments):
        owner = torch.zeros(segment.length, dtype=torch.long)
        valid = torch.zeros(segment.length, dtype=torch.bool)
        valid[samples.edge : segment.length - samples.edge] = True
        if folds is not None:
            own = samples.bounds[k]
            # Every instant belongs to the fold of the nearest sample; those at a border to none.
            index = (torch.arange(segment.length) - samples.edge) // samples.step
            index = index.clamp(0, own.stop - own.start - 1)
            owner = folds.fold[own][index]
            valid &= ~folds.border[own][index]
        torques = []
        for models in (before, after):
            # Each model's torque is computed once, and taken where its fold is.
            tau = torch.zeros_like(segment.tau)
            shared: dict[int, Tensor] = {}
            for f in owner.unique().tolist():
                model = models[f] if len(models) > 1 else models[0]
                if id(model) not in shared:
                    shared[id(model)] = model.torque(segment, samples)
                tau = torch.where((owner == f).unsqueeze(-1), shared[id(model)], tau)
            torques.append(low_passed(tau.T, segment.rate, band).T)
        out.append(
            Trace(
                segment.name,
                segment.rate,
                segment.motion,
                low_passed(segment.tau.T, segment.rate, band).T,
                torques[0],
                torques[1],
                valid,
                moving_instants(segment, reach),
                segment.stamp,
            )
        )
    return out
