"""How far: what the accepted effects close on data used for no choice, and what is left.

Losses are sums over joints of squared gaps in units of the joint's own squared noise, so that a
wrist counts as much as a shoulder. L0 is the model as given, L1 the one with refitted base
parameters, L* the one with the accepted effects, Ln the noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.gap.blocks import mean_bound
from torchid.gap.diagnosis import Budget, Interval, NoiseFloor, Trace
from torchid.typing import Float, Tensor

BLOCK_SECONDS = 2.0
DRAWS = 1000

SURELY_NOISE = 0.9
"""Share of what is left that is noise at most: as much may be the model's own misfit, and noise
that was measured too large would else leave no room for any."""

CLEAR = 0.02
"""Share of all that is left by which a gap shrinks that is clear even if few blocks hold it."""

FLOOR_WIDTH = 1.645
"""Standard deviations of log variance from the lower to the upper end of a floor's 90 % interval of
log RMS: twice 1.645, and half as many for the square."""


@dataclass(frozen=True)
class Closing:
    """Closed share of the closable gap.

    Attributes:
        rms_before, rms_after: (n,) [N m; N].
        gap_ci95: of (L0 - Ln) / Ln.
        improves: whether blocks after are better than before, beyond chance (one-sided 95 % of
            the resampled blocks).
        closed, closed_ci95: (L0 - L*) / (L0 - Ln); None where the gap's interval holds zero.
    """

    rms_before: Float[Tensor, " n"]
    rms_after: Float[Tensor, " n"]
    gap_ci95: Interval
    improves: bool
    closed: float | None
    closed_ci95: Interval | None

    def or_as(self, other: "Closing") -> "Closing":
        """The same where another comparison with the same gap before is as good: better if either
        says so, with an interval that holds both."""
        improves = self.improves or other.improves
        if self.closed_ci95 is None or other.closed_ci95 is None:
            return replace(self, improves=improves)
        low, high = zip(self.closed_ci95, other.closed_ci95, strict=True)
        return replace(self, improves=improves, closed_ci95=(min(low), max(high)))


def noise_variance(floor: NoiseFloor) -> Float[Tensor, " n"]:
    """Squared noise of each joint in the band of the report, the unit of losses: the middle of an
    interval measured on repeats; without repeats the upper end of the bracket."""
    low, high = floor.low.square(), floor.high.square()
    return (0.5 * (low + high) if floor.source == "repeats" else high).clamp(min=1e-24)


def closing(
    traces: Sequence[Trace],
    floor: NoiseFloor,
    seed: int,
    unpredicted: Float[Tensor, " n"] | None = None,
) -> Closing:
    """Compare before and after block by block, blocks resampled together, while joints move.

    What repeats tell of the noise has an interval of its own, from which it is drawn beside the
    blocks. But other motions may be noisier than the repeated one (an encoder's counts weigh more
    where the inertia is larger), so at most all that cannot be predicted is noise; without repeats
    it lies anywhere in its bracket. The interval of the closed share holds both ends.

    Args:
        traces: before and after, on data that took part in no choice.
        floor: of the noise in the traces' band.
        seed: of the resampling.
        unpredicted: (n,) RMS of what a flexible predictor leaves of the gap after, in this band.
    """
    blocks = [_blocks(t) for t in traces]
    before, after, counts = (torch.cat([b[k] for b in blocks]) for k in (0, 1, 2))
    unit = noise_variance(floor)
    l0, l1 = (before / unit).sum(1), (after / unit).sum(1)
    draws = _draws(len(counts), seed)
    total = counts.sum(0).clamp(min=1)
    rms = [(x.sum(0) / total).sqrt() for x in (before, after)]
    before_noise, left = l0[draws].sum(1), l1[draws].sum(1)
    gain = before_noise - left
    improves = mean_bound(l0 - l1, 0.95) > 0
    if float(gain.quantile(0.05)) > 0 and float((l0 - l1).sum()) > CLEAR * float(l0.sum()):
        improves = True  # in a few blocks: of those, mean and deviation say nothing
    ends = _noise_draws(counts, floor, unit, draws, seed)
    if unpredicted is not None and floor.source == "repeats":
        largest = torch.minimum(unpredicted.square(), after.sum(0) / total)
        ends.append((counts * (largest / unit).clamp(min=1.0))[draws].sum(1).sum(1))
    rows = counts.sum(1)[draws].sum(1).clamp(min=1)
    gap_ci = _interval((before_noise - ends[0]) / rows)
    if not gap_ci[0] > 0:
        return Closing(rms[0], rms[1], gap_ci, improves, None, None)
    # There is no more noise than what is left.
    most = [torch.minimum(noise, share * left) for noise in ends for share in (1.0, SURELY_NOISE)]
    intervals = [_interval(_share(gain, before_noise - noise)) for noise in most]
    interval = min(i[0] for i in intervals), max(i[1] for i in intervals)
    value = float((l0 - l1).sum() / (l0.sum() - torch.minimum(counts.sum(), l1.sum())))
    return Closing(rms[0], rms[1], gap_ci, improves, value, interval)


def _noise_draws(
    counts: Float[Tensor, "K n"],
    floor: NoiseFloor,
    unit: Float[Tensor, " n"],
    draws: Tensor,
    seed: int,
) -> list[Float[Tensor, " D"]]:
    """Ln of every draw: from the interval that repeats give; else of both ends of the bracket."""
    drawn = counts[draws].sum(1)
    if floor.source != "repeats":
        return [drawn.sum(1), (drawn * (floor.low.square() / unit)).sum(1)]
    low, high = (x.clamp(min=1e-12).log() for x in (floor.low, floor.high))
    generator = torch.Generator().manual_seed(seed + 1)
    z = torch.randn(drawn.shape, generator=generator, dtype=drawn.dtype)
    return [(drawn * torch.exp((high - low) / FLOOR_WIDTH * z)).sum(1)]


def budget(refitted: Sequence[Trace], traces: Sequence[Trace], floor: NoiseFloor) -> Budget:
    """Shares of the gap closed by refitted base parameters, by effects beyond them, and left.

    Where refitting alone makes held-out data worse it closes nothing. Shares of a gap that is not
    there are zero.
    """
    unit = noise_variance(floor)

    def loss(parts: Sequence[Trace], which: int) -> float:
        blocks = [_blocks(t) for t in parts]
        return float(sum((b[which] / unit).sum() for b in blocks))

    l0, l1, last = loss(traces, 0), loss(refitted, 1), loss(traces, 1)
    noise = min(float(sum(_blocks(t)[2].sum() for t in traces)), last)
    gap = l0 - noise
    if gap <= 0:
        return Budget(0.0, 0.0, 0.0)
    l1 = max(min(l0, l1), last) if last < l0 else l0
    return Budget((l0 - l1) / gap, (l1 - last) / gap, (last - noise) / gap)


def _blocks(trace: Trace) -> tuple[Tensor, Tensor, Tensor]:
    """Sums of squares (K, n) before and after, and counts (K, n), of blocks of instants that
    count."""
    length = max(1, round(BLOCK_SECONDS * trace.rate))
    count = max(1, round(len(trace.valid) / length))
    block = torch.arange(len(trace.valid)) * count // len(trace.valid)
    mask = trace.counting.double()
    squares = [(trace.measured - x).square() * mask for x in (trace.before, trace.after)]
    zero = mask.new_zeros(count, mask.shape[1])
    before, after, counts = (zero.index_add(0, block, x) for x in (*squares, mask))
    return before, after, counts


def _draws(count: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, count, (DRAWS, count), generator=generator)


def _share(gain: Float[Tensor, " D"], gap: Float[Tensor, " D"]) -> Float[Tensor, " D"]:
    """Closed shares of the draws in which there is a gap to close."""
    return torch.where(gap > 0, gain / gap, torch.nan)


def _interval(x: Float[Tensor, " D"]) -> Interval:
    ends = torch.tensor([0.025, 0.975], dtype=x.dtype)
    low, high = torch.nanquantile(x, ends).tolist()
    return low, high
