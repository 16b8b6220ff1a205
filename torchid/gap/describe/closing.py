"""How far: what the answered model closes on data it was not fitted on, and what is left.

Errors are those that are shown: roots of the sums over joints of mean squares, E0 of the model as
given, E1 of the one with refitted base parameters, E* of the answered one, En of the noise. Shares
are of the error beyond noise, 1 - sqrt((E*^2 - En^2) / (E0^2 - En^2)). Only repeats of a motion
measure the noise; without them its lower bound is taken out of the share, and the interval spans
all that the noise may be: from there to what a flexible predictor leaves of the error after.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from torchid.gap.describe.noise import BLOCK_SECONDS
from torchid.gap.diagnosis import HowFar, Trace
from torchid.gap.record import Budget, NoiseFloor, Residual
from torchid.statistics.autocorrelation import integrated_time
from torchid.statistics.proportion import HALF_90
from torchid.statistics.resampling import (
    DRAWS,
    LEVEL,
    bootstrap_weights,
    falling_share,
    nested_weights,
    percentile_interval,
)
from torchid.typing import Float, Tensor

LEVELS = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 1.0)
"""Shares of the instants below which a size is given of what is left."""


@dataclass(frozen=True, kw_only=True)
class Closing(HowFar):
    """How far a gap closes.

    Attributes:
        improves: whether resampled blocks are better after than before (one-sided 95 %).
        shrinks: (n,) share of resampled blocks in which each joint's error is less after.
    """

    shrinks: Float[Tensor, " n"]
    improves: bool = False


def noise_variance(floor: NoiseFloor) -> Float[Tensor, " n"]:
    """Squared noise of each joint in the band of the report, in units of which joints are compared:
    the middle of an interval measured on repeats; without repeats the upper end of the bracket."""
    low, high = floor.low.square(), floor.high.square()
    return (0.5 * (low + high) if floor.source == "repeats" else high).clamp(min=1e-24)


def known_noise(floor: NoiseFloor) -> Float[Tensor, " n"]:
    """Squared noise of each joint that no model can close: as repeats measure it; without repeats
    the lower end of the bracket, for the upper one holds misfit."""
    return noise_variance(floor) if floor.source == "repeats" else floor.low.square()


def closed_share(
    before: Float[Tensor, "*D"], after: Float[Tensor, "*D"], noise: Float[Tensor, "*D"]
) -> Float[Tensor, "*D"]:
    """Share of the error beyond noise that is closed, of squared errors (*D,); NaN where there is
    no error beyond noise."""
    gap = before - noise
    left = ((after - noise).clamp(min=0) / gap.clamp(min=1e-300)).sqrt()
    return torch.where(gap > 0, 1 - left, torch.nan)


def levels(traces: Sequence[Trace]) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """RMS (n,) of the gap before and after, at the instants that count [N m; N]."""
    before, after, counts = (torch.cat(x).sum(0) for x in zip(*map(_blocks, traces), strict=True))
    total = counts.clamp(min=1)
    return (before / total).sqrt(), (after / total).sqrt()


def closing(
    traces: Sequence[Trace],
    floor: NoiseFloor,
    seed: int,
    unpredicted: Float[Tensor, " n"] | None = None,
    motions: Sequence[int] | None = None,
) -> Closing:
    """Compare before and after block by block, blocks resampled together, while joints move.

    Whether there is a gap and whether it shrinks is asked of these motions; how far it would on
    others is told by motions that are resampled with their blocks.

    What repeats tell of the noise has an interval of its own, from which it is drawn beside the
    blocks. But other motions may be noisier than the repeated one, and without repeats there is no
    more than a lower bound, so at most all that cannot be predicted is noise. The interval of the
    closed share holds both.

    Args:
        traces: before and after, on data the models were not fitted on.
        floor: of the noise in the traces' band.
        seed: of the resampling.
        unpredicted: (n,) RMS of what a flexible predictor leaves of the gap after, in this band.
        motions: number of the motion that each trace is one of, where they are different enough
            for folds of whole motions.
    """
    # Squares before and after, block by block.
    parts = [_blocks(t) for t in traces]
    before, after, counts = (torch.cat([p[k] for p in parts]) for k in (0, 1, 2))
    total = counts.sum(0).clamp(min=1)
    rms = tuple((x.sum(0) / total).sqrt() for x in (before, after))
    rng = np.random.default_rng(seed)
    # Whether there is a gap, and whether it shrinks, every joint in units of its own noise: blocks
    # are drawn, all joints together.
    unit = noise_variance(floor)
    weights = torch.from_numpy(bootstrap_weights(len(counts), DRAWS, rng))
    first, last = (weights @ (x / unit).sum(1) for x in (before, after))
    improves = bool((first - last).quantile(1 - LEVEL) > 0)
    shrinks = torch.from_numpy(falling_share((before - after).numpy(), weights.numpy()))
    low, high = (x.clamp(min=1e-12).log() for x in (floor.low, floor.high))
    z = torch.from_numpy(rng.standard_normal((DRAWS, len(unit))))
    drawn = torch.exp((high - low) / HALF_90 * z) if floor.source == "repeats" else 1.0
    rows = weights @ counts
    excess = percentile_interval(
        ((first - (rows * drawn).sum(1)) / rows.sum(1).clamp(min=1)).numpy()
    )
    # A gap that may be zero has no share that could be closed.
    if not excess[0] > 0:
        return Closing(rms[0], rms[1], None, None, shrinks=shrinks, improves=improves)
    if motions is not None:
        # How far on others: motions are drawn, and then blocks of each.
        own = np.repeat(motions, [len(p[0]) for p in parts])
        weights = torch.from_numpy(nested_weights(own, DRAWS, rng))
        rows = weights @ counts
    # Mean squares of every draw, all joints together.
    first, last = (((weights @ x) / rows.clamp(min=1)).sum(1) for x in (before, after))
    noise = known_noise(floor)
    ends = [(noise * drawn).sum(-1).expand(DRAWS)]
    if unpredicted is not None:
        largest = torch.minimum(unpredicted.square(), after.sum(0) / total)
        ends.append(torch.maximum(largest, noise).sum().expand(DRAWS))
    # There is no more noise than what is left.
    # 0.9: share of what is left that is noise at most, at one end of the interval: as much may be
    # the model's own misfit, and noise measured too large would leave no room for any
    most = [torch.minimum(e, share * last) for e in ends for share in (1.0, 0.9)]
    intervals = [percentile_interval(closed_share(first, last, e).numpy()) for e in most]
    # The share itself, from all blocks; the interval holds it and the draws at all ends.
    left = rms[1].square().sum()
    value = float(closed_share(rms[0].square().sum(), left, torch.minimum(noise.sum(), left)))
    if value != value:
        return Closing(rms[0], rms[1], None, None, shrinks=shrinks, improves=improves)
    ends_of = [*(x for pair in intervals for x in pair if x == x), value]
    interval = min(ends_of), max(ends_of)
    return Closing(rms[0], rms[1], value, interval, shrinks=shrinks, improves=improves)


def budget(refitted: Sequence[Trace], traces: Sequence[Trace], floor: NoiseFloor) -> Budget:
    """Shares of the gap closed by refitted base parameters, by effects beyond them, and left.

    Shares are of the error beyond noise and add up to one; refitting alone closes no less than
    nothing. Shares of a gap that is not there are zero.
    """
    (before, after), (_, base) = levels(traces), levels(refitted)
    first, last, alone = (float(x.square().sum()) for x in (before, after, base))
    noise = min(float(known_noise(floor).sum()), last)
    if first <= noise:
        return Budget(0.0, 0.0, 0.0)
    # Refitting closes no more than the whole model does.
    alone = max(min(first, alone), last) if last < first else first
    left, rest = (math.sqrt((x - noise) / (first - noise)) for x in (alone, last))
    return Budget(1 - left, left - rest, rest)


def residuals(traces: Sequence[Trace]) -> tuple[Residual, ...]:
    """Sizes of what is left of each joint's torque while it counts, and how long it lasts."""
    levels, out = torch.tensor(LEVELS, dtype=torch.float64), []
    ends = torch.tensor([0, *(len(t.valid) for t in traces)]).cumsum(0).tolist()
    bounds = [slice(a, b) for a, b in itertools.pairwise(ends)]
    for j in range(traces[0].measured.shape[1]):
        error = torch.cat([(t.measured - t.after)[:, j] * t.counting[:, j] for t in traces])
        counting = torch.cat([t.counting[:, j] for t in traces])
        sizes = error[counting].abs().sort().values
        known = sizes[((len(sizes) - 1) * levels).round().long()].tolist() if len(sizes) else []
        lasts = float(integrated_time(error, bounds)) / traces[0].rate
        out.append(Residual(joint=j, levels=LEVELS, sizes=tuple(known), correlation=lasts))
    return tuple(out)


def _blocks(trace: Trace) -> tuple[Tensor, Tensor, Tensor]:
    """Sums of squares (K, n) before and after, and counts (K, n), of blocks of instants that
    count."""
    # Blocks of equal length, which fill the trajectory.
    length = max(1, round(BLOCK_SECONDS * trace.rate))
    count = max(1, round(len(trace.valid) / length))
    block = torch.arange(len(trace.valid)) * count // len(trace.valid)
    mask = trace.counting.double()
    squares = [(trace.measured - x).square() * mask for x in (trace.before, trace.after)]
    zero = mask.new_zeros(count, mask.shape[1])
    before, after, counts = (zero.index_add(0, block, x) for x in (*squares, mask))
    return before, after, counts
