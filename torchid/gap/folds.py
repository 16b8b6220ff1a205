"""Held-out data: whole trajectories, or, where there are too few, contiguous stretches."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.design.segments import Samples, widened
from torchid.typing import Bool, Int, Tensor

GAP = 4.0
"""Samples next to a held-out stretch that are not fitted, in periods of the cut-off: as far as the
filter reaches."""

FEW = 3
"""Different trajectories below which a fold is a stretch of each of them."""


@dataclass(frozen=True, eq=False)
class Folds:
    """Which samples are held out together.

    Attributes:
        fold: (N,) number of each sample's fold, from 0; below zero of an earlier log's, which is
            never left out.
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
