"""Regimes of the gap that are no part of the time: lines over the angle, high frequency, slow
drift, and transients.

What the joint's own motion explains linearly is taken out before lines, drifts of coefficients and
transients are sought: they are small beside an error of friction or gravity.
"""

import math
from dataclasses import dataclass

import torch

from torchid.gap.localise.regimes import BRIEF, CRAWL, RARE, STILL, Pool, masks
from torchid.gap.localise.resampling import Draws, Look, best_of, flipped, linear, quadratic
from torchid.gap.record import Interval
from torchid.log.filtering import ALL_PASSES, frequencies, low_pass
from torchid.statistics.resampling import LEVEL
from torchid.typing import Float, Tensor

LOWEST_WAVE = 3.0
"""Wave number [1/rad or 1/m] below which a line cannot be told from gravity."""

FEW = (1, 2, 4, 8)
"""Numbers of windows that hold much of the energy."""

STANDS_OUT = 2.0
"""Squared gap of a transient's window over that of the mean window, at least."""

_MOST_LINES = 5
_NEIGHBOURS = 15


def remainder(pool: Pool) -> Float[Tensor, "K L n"]:
    """The gap less its regression, joint by joint, on 1, q, sin q, cos q, dq, sgn dq, ddq and the
    model's torque."""
    one = torch.ones_like(pool.q)
    columns = (
        one, pool.q, pool.q.sin(), pool.q.cos(), pool.dq, pool.sign, pool.ddq, pool.load,
    )  # fmt: skip
    x = torch.stack(columns, -1).flatten(0, 1).permute(1, 0, 2)
    x = x / x.norm(dim=1, keepdim=True).clamp(min=1e-300)
    y = pool.flat("error").T.unsqueeze(-1)
    gram = x.mT @ x + 1e-9 * torch.eye(x.shape[-1], dtype=x.dtype)
    fitted = x @ torch.linalg.solve(gram, x.mT @ y)
    return (y - fitted).squeeze(-1).T.unflatten(0, pool.error.shape[:2])


def periodic_look(pool: Pool, rest: Tensor, draws: Draws, band: float) -> Look:
    """Lines in the spectrum over the own angle, above its smooth background."""
    joints = [_lines(pool, rest, draws, band, j) for j in range(rest.shape[-1])]
    observed, null, energies, possible = zip(*joints, strict=True)

    def energy(weights: Tensor) -> Tensor:
        return torch.cat([each(weights) for each in energies], -1)

    return Look(torch.stack(observed), torch.stack(null, -1), energy, torch.tensor(possible))


def _lines(pool: Pool, rest: Tensor, draws: Draws, band: float, j: int) -> tuple:
    """Statistic, draws, energy and possibility for one joint."""
    waves, scores = angle_scores(pool, rest, band, j)
    none = torch.zeros(pool.blocks, 1, dtype=torch.float64)
    if len(waves) < 2 * _NEIGHBOURS:
        zero = torch.zeros((), dtype=torch.float64)
        return zero, zero.expand(len(draws)), linear(none), False
    # Coherence over blocks: the squared sum over the sum of squares, and under random signs.
    own = scores.abs().square().sum(0).clamp(min=1e-300)
    ratio = scores.sum(0).abs().square() / own
    null = ((draws.signs.to(scores.dtype) @ scores).abs().square() / own).amax(-1)
    # Exponential with mean 1 without lines; a smooth background that is coherent lifts all of it.
    padded = torch.nn.functional.pad(ratio[None], (_NEIGHBOURS, _NEIGHBOURS), mode="reflect")[0]
    background = padded.unfold(0, 2 * _NEIGHBOURS + 1, 1).median(-1).values / math.log(2)
    height = ratio / background.clamp(min=1.0)
    peaks = _peaks(height, float(null.quantile(LEVEL)))
    each = quadratic(scores[:, peaks], torch.full((len(peaks),), 2.0 / rest[..., j].numel()))
    return height.max().log(), null.log(), lambda w: each(w).sum(-1, keepdim=True), True


def _peaks(height: Tensor, threshold: float) -> Tensor:
    """The highest lines above a threshold, apart from each other; at least the highest."""
    found: list[int] = []
    for k in height.argsort(descending=True).tolist():
        if found and (len(found) == _MOST_LINES or float(height[k]) < threshold):
            break
        if all(abs(k - other) > 4 for other in found):
            found.append(k)
    return torch.tensor(found)


def angle_scores(
    pool: Pool, rest: Tensor, band: float, j: int
) -> tuple[Float[Tensor, " W"], Tensor]:
    """Wave numbers, and block sums (K, W) of the gap times exp(-i k q): a histogram of the gap over
    the angle, block by block, and its Fourier transform."""
    q = pool.q[..., j]
    low, span = float(q.min()), float(q.max() - q.min())
    speed = pool.flat("dq")[:, j].abs()
    # Waves between what gravity can be, and what the band resolves at the usual speed.
    lowest = max(LOWEST_WAVE, 4 * 2 * math.pi / max(span, 1e-9))
    highest = 2 * math.pi * band / max(float(speed.median()), STILL)
    if highest < 2 * lowest:
        return torch.zeros(0), torch.zeros(pool.blocks, 0, dtype=torch.complex128)
    # The gap summed over bins of the angle, in each block; twice the travel, so that waves are
    # half a period apart.
    bins = 2 ** math.ceil(math.log2(2 * span * highest / (2 * math.pi) * 8))
    width = 2 * span / bins
    place = ((q - low) / width).long().clamp(max=bins - 1)
    histogram = torch.zeros(pool.blocks, bins, dtype=torch.float64)
    histogram.scatter_add_(1, place, rest[..., j])
    waves = torch.arange(bins // 2 + 1, dtype=torch.float64) * math.pi / span
    kept = (waves >= lowest) & (waves <= highest)
    return waves[kept], torch.fft.rfft(histogram)[:, kept]


def high_frequency_look(pool: Pool, draws: Draws, band: float) -> Look:
    """More of the squared gap above half the band than a white one would have there."""
    parts = (pool.upper.square() - white_share(pool.rate, band) * pool.error.square()).sum(1)
    observed, null = flipped(parts, draws, two_sided=False)
    possible = torch.full_like(observed, 0.5 * band < ALL_PASSES * pool.rate, dtype=torch.bool)
    return Look(observed, null, linear(parts), possible)


def white_share(rate: float, band: float) -> float:
    """Share above half the band of the energy of white noise that was filtered to the band."""
    within, half = low_pass(rate, band), low_pass(rate, 0.5 * band)
    if half is None:
        return 1.0
    f = frequencies(rate)
    whole = torch.ones_like(f) if within is None else within.response(f).square()
    return float(((1 - half.response(f)).square() * whole).sum() / whole.sum())


def drift_look(pool: Pool, rest: Tensor, draws: Draws) -> Look:
    """A trend over elapsed time, straight or saturating, of the level of the gap, its bias, or its
    part in step with the direction of motion or with the speed."""
    t = pool.t.mean(1)
    phase = (t - t.min()) / (t.max() - t.min()).clamp(min=1e-9)
    # Coefficients that may drift, and what the level of the gap has of the motion anyway.
    ones = torch.ones_like(pool.dq)
    inputs = {"bias": ones, "coulomb": pool.sign, "viscous": pool.dq}
    covariates = torch.stack(
        [ones.mean(1), *(x.square().mean(1) for x in (pool.dq, pool.ddq, pool.load))], -1
    )
    looks = []
    for trend in (phase, torch.exp(-6 * phase)):
        # The level of the gap, and each coefficient, block by block.
        level = pool.error.square().mean(1)
        looks.append(_trend(trend, level, covariates, draws, pool, None))
        for x in inputs.values():
            energy = x.square().sum(1)
            size = (rest * x).sum(1) / energy.clamp(min=1e-300)
            looks.append(_trend(trend, size, covariates[..., :1], draws, pool, energy.mean(0)))
    return best_of(looks)


def _trend(
    trend: Tensor,
    series: Tensor,
    covariates: Tensor,
    draws: Draws,
    pool: Pool,
    scale: Tensor | None,
) -> Look:
    """Correlation of block values (K, n) with a trend, both without what the covariates explain;
    residuals are permuted (Freedman and Lane 1983). `scale`: energy of a unit coefficient in a
    block; None where the series is an energy itself."""
    x = covariates.permute(1, 0, 2)
    x = x / x.norm(dim=1, keepdim=True).clamp(min=1e-300)
    both = torch.stack([trend.expand(series.shape[1], -1), series.T], -1)
    gram = x.mT @ x + 1e-9 * torch.eye(x.shape[-1], dtype=x.dtype)
    left = both - x @ torch.linalg.solve(gram, x.mT @ both)
    a, b = left[..., 0].T, left[..., 1].T
    norm = (a.norm(dim=0) * b.norm(dim=0)).clamp(min=1e-300)
    moved = torch.stack([(a * b[order]).sum(0) for order in draws.order])
    signed = (a * b).sum(0)
    if scale is None:
        later = torch.where(trend > trend.median(), 0.5, -0.5).unsqueeze(-1)
        energy = linear(torch.sign(signed) * later * pool.error.square().sum(1))
    else:
        energy = quadratic(a * b / a.norm(dim=0).clamp(min=1e-300), scale)
    possible = torch.full_like(signed, pool.blocks >= 8, dtype=torch.bool)
    # Means of neighbouring blocks of an AR(1) correlate by T/4 / (1 - T/2), T = `correlation`; that
    # widens the spread of a slope, but not of its permutations, by (1 - T/2)^-1/2.
    wide = norm / math.sqrt(max(0.1, 1 - 0.5 * pool.correlation))
    return Look(signed.abs() / wide, moved.abs() / norm, energy, possible)


@dataclass(frozen=True)
class Transients:
    """The look for transients, and their windows.

    Attributes:
        look: the statistic.
        times: per joint, (start, end) [s].
    """

    look: Look
    times: tuple[tuple[Interval, ...], ...]


def transient_look(pool: Pool, rest: Tensor, draws: Draws) -> Transients:
    """Few windows that hold more of the remainder than a Gaussian process of its spectrum would,
    once it is divided by its usual size at like speed, acceleration, load and time since reversal.
    Windows whose squared gap is not twice the mean one are left out."""
    # Evened out: what a motion like this usually leaves is one everywhere.
    even = (rest / usual_size(pool, rest)).flatten(0, 1)
    width = max(2, round(BRIEF * pool.rate))
    observed = window_energy(even.T, width)
    surrogate = surrogates(even.T, width, draws)
    total = observed.sum(-1).clamp(min=1e-300)
    gap = window_energy(pool.flat("error").T, width)
    # Windows in which the gap itself is small are none.
    observed = observed * (gap > STANDS_OUT * gap.mean(-1, keepdim=True))
    looks: list[Look] = []
    windows = observed.shape[-1]
    possible = (total > 1e-290) & (windows >= 4 * FEW[-1])
    usual = surrogate[:, :, 0].quantile(LEVEL, 0)
    chosen = observed > usual.unsqueeze(-1)
    # At least the largest, for an excess where none stands out.
    chosen |= observed >= observed.amax(-1, keepdim=True)
    energy = linear(_chosen_energy(pool, chosen, width))
    ranked = observed.sort(-1, descending=True).values
    for k, count in enumerate(FEW):
        top = ranked[:, :count].sum(-1) / total
        looks.append(Look(top.clamp(min=1e-300).log(), surrogate[..., 1 + k], energy, possible))
    times = tuple(_times(pool, row, width) for row in chosen)
    return Transients(best_of(looks), times)


def usual_size(pool: Pool, rest: Tensor) -> Tensor:
    """RMS of the remainder (K, L, n) in each combination of the regimes of time and of standstill;
    combinations that are rare count as one."""
    parts = [*masks(pool).values(), pool.dq.abs() < CRAWL * pool.high("dq")]
    # Each instant's combination of regimes, as a number; RMS of each number's instants.
    code = torch.stack([part.long() << k for k, part in enumerate(parts)]).sum(0)
    flat, squared = code.flatten(0, 1), rest.flatten(0, 1).square()
    zero = squared.new_zeros(2 ** len(parts), squared.shape[1])
    count = zero.scatter_add(0, flat, torch.ones_like(squared))
    energy = zero.scatter_add(0, flat, squared)
    rare = count < RARE * len(squared)
    shared = (energy * rare).sum(0) / (count * rare).sum(0).clamp(min=1)
    mean = torch.where(rare, shared, energy / count.clamp(min=1))
    size = mean.gather(0, flat).sqrt()
    return size.clamp(min=1e-12).unflatten(0, rest.shape[:2])


def window_energy(x: Float[Tensor, "*batch N"], width: int) -> Float[Tensor, "*batch W"]:
    """Sums of squares over windows side by side."""
    count = x.shape[-1] // width
    return x[..., : count * width].unflatten(-1, (count, width)).square().sum(-1)


def surrogates(x: Float[Tensor, "n N"], width: int, draws: Draws) -> Float[Tensor, "D n F"]:
    """Largest window energies of Gaussian processes of the same spectra, first the largest one,
    then the logarithm of the share of the FEW largest. Random phases, the same on all joints."""
    size = torch.fft.rfft(x).abs().float()  # enough for a null distribution, and twice as fast
    out = []
    for some in draws.order.chunk(32):  # a part of the draws at a time, for their memory
        turn = 2 * math.pi * torch.rand(
            len(some), 1, size.shape[-1], generator=draws.generator, dtype=size.dtype
        )  # fmt: skip
        spectrum = torch.polar(size.expand(len(some), -1, -1), turn.expand(-1, len(x), -1))
        series = torch.fft.irfft(spectrum, n=x.shape[-1])
        energy = window_energy(series, width)
        ranked = energy.topk(min(FEW[-1], energy.shape[-1]), -1).values
        total = energy.sum(-1).clamp(min=1e-30)
        shares = [(ranked[..., :c].sum(-1) / total).clamp(min=1e-30).log() for c in FEW]
        out.append(torch.stack([ranked[..., 0], *shares], -1))
    return torch.cat(out).to(x.dtype)


def _chosen_energy(pool: Pool, chosen: Tensor, width: int) -> Float[Tensor, "K n"]:
    """Squared gap in the chosen windows less what as much time usually holds, by block."""
    inside = chosen.repeat_interleave(width, -1).T.to(torch.float64)
    short = pool.blocks * pool.error.shape[1] - len(inside)
    inside = torch.nn.functional.pad(inside, (0, 0, 0, short))
    inside = inside.unflatten(0, pool.error.shape[:2])
    return ((inside - inside.mean((0, 1))) * pool.error.square()).sum(1)


def _times(pool: Pool, chosen: Tensor, width: int) -> tuple[Interval, ...]:
    """Windows that stand out, neighbours joined [s]."""
    t = pool.t.flatten()
    step = 1 / pool.rate
    out: list[Interval] = []
    for k in chosen.nonzero().flatten().tolist():
        start, end = float(t[k * width]), float(t[(k + 1) * width - 1]) + step
        if out and 0 <= start - out[-1][1] < step:
            out[-1] = (out[-1][0], end)
        else:
            out.append((start, end))
    return tuple(out)
