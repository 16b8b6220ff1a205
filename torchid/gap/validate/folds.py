"""Held-out data: whole trajectories, or, where there are too few, contiguous stretches.

Everything that is chosen or fitted for a fold is chosen and fitted on the other folds, selection
included.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.effects.registry import Valued
from torchid.gap.diagnosis import Trace
from torchid.gap.passages import Rows, moving_instants
from torchid.gap.prediction import predicted_torque
from torchid.log.filtering import ZeroPhaseFilter
from torchid.robot.model import Robot
from torchid.typing import Bool, Float, Int, Tensor

GAP = 4.0
"""Rows next to a held-out stretch that are not fitted, in periods of the cut-off: as far as the
filter and the whitener reach."""

FEW = 3
"""Trajectories below which a fold is a stretch of each of them."""


@dataclass(frozen=True)
class Folds:
    """Which rows are held out together.

    Attributes:
        fold: (N,) number of each row's fold, from 0.
        count: number of folds.
        whole: whether folds are whole trajectories.
        gap: rows at either side of a held-out stretch that are left out of the fit.
    """

    fold: Int[Tensor, " N"]
    count: int
    whole: bool
    gap: int

    def fitted(self, k: int) -> Bool[Tensor, " N"]:
        """Rows that fold k's model is fitted on."""
        held = (self.fold == k).double().reshape(1, 1, -1)
        if not self.whole:
            held = torch.nn.functional.max_pool1d(held, 2 * self.gap + 1, 1, self.gap)
        return held.flatten() == 0


def make_folds(rows: Rows, count: int, groups: Sequence[int]) -> Folds:
    """Folds of whole trajectories where there are at least three, else stretches.

    Args:
        rows: of the passages.
        count: folds wanted.
        groups: per passage the motion it repeats; repeats of one motion share a fold.
    """
    distinct = sorted(set(groups))
    gap = round(GAP / (rows.cutoff * rows.interval))
    fold = torch.zeros(len(rows), dtype=torch.long)
    whole = len(distinct) >= FEW
    if whole:
        count = min(count, len(distinct))
        number = {g: k % count for k, g in enumerate(distinct)}
        for own, group in zip(rows.bounds, groups, strict=True):
            fold[own] = number[group]
    else:
        for own in rows.bounds:
            length = own.stop - own.start
            fold[own] = torch.arange(length) * count // length
    return Folds(fold, count, whole, gap)


@dataclass(frozen=True)
class Model:
    """A robot's rigid body with effects."""

    robot: Robot
    effects: tuple[Valued, ...]

    def torque(self, rows: Rows, k: int) -> Float[Tensor, "T n"]:
        """Torque along passage k."""
        return predicted_torque(self.robot, self.effects, rows.passages[k], rows)


def traces(
    rows: Rows,
    folds: Folds | None,
    before: Sequence[Model],
    after: Sequence[Model],
    band: float,
    *,
    reach: Float[Tensor, " n"] | None = None,
) -> list[Trace]:
    """Torque before and after along every passage, each instant by the models of its own fold.

    Args:
        rows: of the passages.
        folds: None where all passages are held out from one pair of models.
        before, after: one model a fold.
        band: low-pass of what is reported [Hz].
        reach: (n,) how far a reversal reaches that does not count for how far the gap closes, in
            periods of the cut-off; None where all count.
    """
    out = []
    for k, passage in enumerate(rows.passages):
        edge = rows.edge
        valid = torch.zeros(passage.samples, dtype=torch.bool)
        valid[edge : passage.samples - edge] = True
        out.append(
            Trace(
                passage.name,
                passage.rate,
                passage.motion,
                _low(passage.tau, passage.rate, band),
                _predicted(rows, folds, k, before, band),
                _predicted(rows, folds, k, after, band),
                valid,
                moving_instants(passage, rows.cutoff, reach),
            )
        )
    return out


def with_after(
    shown: Sequence[Trace], rows: Rows, folds: Folds | None, after: Sequence[Model], band: float
) -> list[Trace]:
    """The same traces with other models after, one a fold."""
    return [
        replace(trace, after=_predicted(rows, folds, k, after, band))
        for k, trace in enumerate(shown)
    ]


def _predicted(
    rows: Rows, folds: Folds | None, k: int, models: Sequence[Model], band: float
) -> Float[Tensor, "T n"]:
    """Torque along passage k below the band, each instant by the model of its own fold."""
    passage = rows.passages[k]
    owner = _owner(rows, folds, k)
    tau = torch.zeros_like(passage.tau)
    done: dict[int, Tensor] = {}
    for f in owner.unique().tolist():
        model = models[f]
        if id(model) not in done:
            done[id(model)] = model.torque(rows, k)
        tau = torch.where((owner == f).unsqueeze(-1), done[id(model)], tau)
    return _low(tau, passage.rate, band)


def _owner(rows: Rows, folds: Folds | None, k: int) -> Int[Tensor, " T"]:
    """Fold of every instant of passage k."""
    samples = rows.passages[k].samples
    if folds is None:
        return torch.zeros(samples, dtype=torch.long)
    own = folds.fold[rows.bounds[k]]
    index = (torch.arange(samples) - rows.edge) // rows.step
    return own[index.clamp(0, len(own) - 1)]


def _low(x: Float[Tensor, "T n"], rate: float, band: float) -> Float[Tensor, "T n"]:
    if band >= 0.45 * rate:
        return x
    return ZeroPhaseFilter(rate, band).apply(x.T).T.contiguous()
