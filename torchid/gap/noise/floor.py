"""How small the residual can become: the noise, its size and its spectrum.

With repeats of a motion the noise is what differs between them. That holds everything that does not
repeat, dropped samples, another load and drift too, so it is checked three times: the mean over
blocks against the median, which a few bad seconds do not move; the difference itself, which no
motion can predict if it is noise; and its size against what a flexible predictor leaves of the
residual. Where they disagree the lower one is the noise and the difference is said to be a
non-repeatable effect.

Without repeats there is a bracket. Below: the level of the spectrum above the fit's cut-off, where
little but noise is left, continued to all frequencies as if the noise were white. Above: what the
flexible predictor leaves.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.gap.blocks import block_numbers, block_sums
from torchid.gap.diagnosis import NoiseFloor
from torchid.gap.flexible import OutOfFold, predict_out_of_fold
from torchid.gap.passages import Passage, Rows, sliding
from torchid.gap.repeats import Repeats
from torchid.gap.spectrum import bandwidth, white_level
from torchid.gap.whitener import Whitener, fit_whitener
from torchid.typing import Bool, Float, Int, Samples, Tensor

BLOCK_SECONDS = 2.0
UNEVEN = 1.3
"""Mean over median of the blocks' variance (as it would be with equal noise in all), above which
the noise is not the same everywhere, if that is significant too."""

SIGNIFICANT = 4.0
"""Standard errors."""

WORST = 3.0
"""A block whose variance exceeds the median by this factor is left out of an uneven noise's
spectrum, and named."""

CLIPPED = 4.5
"""Times the median of absolute values: 3 standard deviations of a normal variable."""

FULL = 0.2
FEWEST_BLOCKS = 5
"""Share of a block's rows that count, and blocks of which so many do, for a median over blocks."""

ABOVE = 1.15
"""RMS of repeats' difference over what the flexible predictor leaves, above which they disagree."""

_FEWEST_ROWS = 20  # of a repeat that is worth filtering
_FEWEST_IN_ALL = 100  # rows of repeats; fewer say less than the bracket
_NORMAL = 1.645  # 90 % of a normal variable


class NoFloorError(ValueError):
    """Neither repeats that are long enough, nor a flexible prediction."""


@dataclass(frozen=True)
class Floor:
    """Noise of the residual.

    Attributes:
        low, high: (n,) bracket of its RMS in the fit's rows [N m; N]; with repeats a 90 %
            interval.
        report: the same in the band of the report, with source and notes.
        whitener: of the fit's rows.
    """

    low: Float[Tensor, " n"]
    high: Float[Tensor, " n"]
    report: NoiseFloor
    whitener: Whitener

    @property
    def rms(self) -> Float[Tensor, " n"]:
        """One number a joint: the geometric mean of the bracket."""
        return (self.low * self.high).sqrt()


@dataclass(frozen=True)
class _Size:
    """Noise in some rows: its interval, the rows that are usual, and what is unusual."""

    low: Tensor
    high: Tensor
    keep: Bool[Tensor, "n N"]
    uneven: dict[int, str]


def noise_floor(
    passages: Sequence[Passage],
    residual: Sequence[Samples],
    rows: Rows,
    report: Rows,
    flexible: OutOfFold | None = None,
    repeats: Repeats | None = None,
) -> Floor:
    """The noise floor of a residual, from repeats or as a bracket.

    Args:
        passages: in the wide band, with the model's torque in their motion.
        residual: (T, n) a passage, measured less model torque, in the wide band.
        rows: of the fit.
        report: rows of the same passages in the band of the report.
        flexible: what can be predicted of the residual in `rows`; needed without repeats, a check
            with them.
        repeats: among the passages.

    Raises:
        NoFloorError: no flexible prediction, and no repeats or too short ones.
    """
    bracket = None if flexible is None else _bracket(passages, residual, rows, report, flexible)
    found = None if repeats is None else _from_repeats(passages, residual, rows, report, repeats)
    if found is None:
        if bracket is None:
            raise NoFloorError("a noise floor needs repeats or a flexible prediction.")
        return bracket
    return found if bracket is None else _lower(found, bracket)


def _from_repeats(
    passages: Sequence[Passage],
    residual: Sequence[Samples],
    rows: Rows,
    report: Rows,
    repeats: Repeats,
) -> Floor | None:
    """None where the repeats are too short, or too few."""
    edge = 2 * max(rows.edge, report.edge)
    differences = [
        p
        for p in repeats.passages(passages, residual)
        if p.samples > edge + _FEWEST_ROWS * max(rows.step, report.step)
    ]
    if not differences or len(Rows(differences, rows.cutoff)) < _FEWEST_IN_ALL:
        return None
    own, other = Rows(differences, rows.cutoff), Rows(differences, report.cutoff)
    signals = [p.tau.T for p in differences]
    x, shown = own.apply(signals), _size(other.apply(signals), other, sliding(other))
    white = white_level(differences, [p.tau for p in differences], rows.cutoff)
    noise, predictable = _unpredictable(differences, own, x, white)
    size = _size(noise, own, sliding(own))
    counting = size.keep & sliding(own)
    whitener = fit_whitener(noise, own.bounds, counting)
    usual = (noise.square() * counting).sum(-1) / counting.sum(-1).clamp(min=1)
    # Uneven noise is as large as its median block, not as the blocks that were kept.
    factor = (size.low * size.high / usual.clamp(min=1e-300)).sqrt()
    uneven = torch.tensor([j in size.uneven for j in range(len(x))])
    whitener = whitener.scaled(torch.where(uneven & (factor > 0), factor, 1.0))
    notes = {**shown.uneven, **size.uneven, **predictable}
    removed = x.square().mean(-1) - noise.square().mean(-1)
    # Of what motion predicts no predictor gets all: below there is only the white level.
    some = torch.tensor([j in predictable for j in range(len(x))])
    lows = [
        torch.where(some, torch.minimum(low, (white * bandwidth(r)).sqrt()), low)
        for low, r in ((size.low, own), (_without(shown.low, shown, removed), other))
    ]
    high = _without(shown.high, shown, removed)
    told = tuple(notes[j] for j in sorted(notes))
    both = NoiseFloor(lows[1], torch.maximum(high, lows[1]), "repeats", told)
    return Floor(lows[0], size.high, both, whitener.on(rows.bounds))


def _unpredictable(
    differences: Sequence[Passage], rows: Rows, x: Float[Tensor, "n N"], white: Float[Tensor, " n"]
) -> tuple[Float[Tensor, "n N"], dict[int, str]]:
    """The differences without what their motion predicts of them, and a note where that is
    anything. Only joints are looked at whose difference is larger than white noise would be."""
    coloured = x.square().mean(-1) > UNEVEN * white * bandwidth(rows)
    if not bool(coloured.any()):
        return x, {}
    joints = torch.nonzero(coloured).flatten().tolist()
    found = predict_out_of_fold(differences, rows, x, joints=joints)
    sure = found.interval[:, 0] > 0
    notes = {
        int(j): f"non-repeatable effect on joint {int(j) + 1}: {100 * float(found.r2[j]):.0f} % of "
        "the difference between repeats is a function of the motion or of time"
        for j in torch.nonzero(sure).flatten()
    }
    return x - found.prediction * sure.to(x).unsqueeze(-1), notes


def _without(x: Float[Tensor, " n"], size: _Size, removed: Float[Tensor, " n"]) -> Tensor:
    """An end of a size's interval, less a part of the variance that is no noise."""
    variance = size.low * size.high
    return x * ((variance - removed) / variance.clamp(min=1e-300)).clamp(1e-4, 1).sqrt()


def _size(x: Float[Tensor, "n N"], rows: Rows, counting: Bool[Tensor, "n N"]) -> _Size:
    """Noise from rows that hold nothing else, or that do in a few blocks."""
    length = max(4, round(BLOCK_SECONDS / rows.interval))
    block = block_numbers(rows.bounds, length)
    squares = x.square() * counting
    counts = block_sums(counting.to(x), block)
    total = counts.sum(-1).clamp(min=1)
    variance = block_sums(squares, block) / counts.clamp(min=1)
    variance = variance.where(counts > FULL * length, torch.nan)
    mean = squares.sum(-1) / total
    # Of the usual rows: what happens once must not make the noise look as slow as itself.
    top = CLIPPED * x.abs().median(-1, keepdim=True).values
    usual = x.clamp(-top, top)
    freedom = torch.stack([_freedom(r, rows.bounds) for r in usual]) * total / x.shape[-1]
    share = (freedom * length / total).clamp(min=1.0)
    # The median of chi^2 lies below its mean (Wilson and Hilferty 1931).
    median = variance.nanmedian(-1).values / (1 - 2 / (9 * share)) ** 3
    median = median.where(median.isfinite(), mean)
    error = (math.pi / freedom).sqrt() + (2 / freedom).sqrt()
    ratio = mean / median.clamp(min=1e-300)
    known = variance.isfinite().sum(-1) >= FEWEST_BLOCKS
    uneven = (ratio > UNEVEN) & (ratio > 1 + SIGNIFICANT * error) & known
    variance = variance.nan_to_num()
    chosen = torch.where(uneven, median, mean)
    keep = ~((variance > WORST * median.unsqueeze(-1)) & uneven.unsqueeze(-1))[:, block]
    half = _NORMAL / (2 * freedom).sqrt()
    rms = chosen.sqrt()
    notes = {
        int(j): _note(int(j), variance[j] / median[j], block, rows)
        for j in torch.nonzero(uneven).flatten()
    }
    return _Size(rms * torch.exp(-half), rms * torch.exp(half), keep, notes)


def _freedom(x: Float[Tensor, " N"], bounds: tuple[slice, ...]) -> Tensor:
    """Degrees of freedom of the sum of squares: N / sum over all lags of rho_k^2 (Bartlett)."""
    longest = max(b.stop - b.start for b in bounds)
    spectra = [torch.fft.rfft(x[b], n=2 * longest) for b in bounds]
    power = torch.stack([s.abs().square() for s in spectra]).sum(0)
    covariance = torch.fft.irfft(power, n=2 * longest)[:longest]
    rho = covariance / covariance[0].clamp(min=1e-300)
    # Where there is no correlation rho^2 is 1 / N, its variance.
    extra = 2 * (rho[1 : max(1, longest // 4)].square() - 1 / len(x)).sum()
    return len(x) / (1 + extra.clamp(min=0))


def _note(joint: int, excess: Float[Tensor, " K"], block: Int[Tensor, " N"], rows: Rows) -> str:
    """Which joint does not repeat, and when."""
    t = rows.pick([_time(p) for p in rows.passages])
    names = [p.name for p in rows.passages]
    worst = [int(k) for k in excess.argsort(descending=True)[:3] if excess[k] > WORST]
    places = []
    for k in worst:
        inside = torch.nonzero(block == k).flatten()
        at = next(i for i, b in enumerate(rows.bounds) if b.start <= inside[0] < b.stop)
        begin = float(_time(rows.passages[at])[0])
        first, last = float(t[inside[0]]) - begin, float(t[inside[-1]]) - begin
        places.append(f"{first:.1f} to {last:.1f} s ('{names[at]}')")
    when = f": worst at {', '.join(places)}" if places else ""
    return (
        f"non-repeatable effect on joint {joint + 1}{when}; the floor is the median over "
        f"{BLOCK_SECONDS:g} s blocks"
    )


def _time(p: Passage) -> Float[Tensor, " T"]:
    return torch.arange(p.samples).to(p.tau) / p.rate if p.motion.t is None else p.motion.t


def _bracket(
    passages: Sequence[Passage],
    residual: Sequence[Samples],
    rows: Rows,
    report: Rows,
    flexible: OutOfFold,
) -> Floor:
    signals = [r.T for r in residual]
    r = rows.apply(signals)
    left = flexible.left(r)
    high = left.square().mean(-1)
    # Between the fit's cut-off and the report's nothing was predicted: all counts as noise.
    between = report.apply(signals).square().mean(-1) - r.square().mean(-1)
    level = white_level(passages, residual, rows.cutoff)
    tops = high, high + between.clamp(min=0)
    lows = [
        torch.minimum(level * bandwidth(x), top)
        for x, top in zip((rows, report), tops, strict=True)
    ]
    return Floor(
        lows[0].sqrt(),
        tops[0].sqrt(),
        NoiseFloor(lows[1].sqrt(), tops[1].sqrt(), "bracket"),
        fit_whitener(left, rows.bounds),
    )


def _lower(found: Floor, bracket: Floor) -> Floor:
    """Where repeats differ more than the flexible predictor leaves, what it leaves."""
    worse = (found.rms > ABOVE * bracket.high) & (found.low > bracket.high)
    if not bool(worse.any()):
        return found
    low, high = (
        torch.where(worse, b, a) for a, b in ((found.low, bracket.high), (found.high, bracket.high))
    )
    shown, other = found.report, bracket.report
    limited = torch.where(worse, torch.minimum(shown.high, other.high), shown.high)
    notes = [
        f"non-repeatable effect on joint {int(j) + 1}: repeats differ by "
        f"{float(found.rms[j]):.3g} RMS where {float(bracket.high[j]):.3g} is left of the residual"
        for j in torch.nonzero(worse).flatten()
    ]
    return replace(
        found,
        low=low,
        high=high,
        report=NoiseFloor(
            torch.minimum(shown.low, limited), limited, shown.source, (*shown.notes, *notes)
        ),
        whitener=_mixed(worse, found.whitener, bracket.whitener),
    )


def _mixed(second: Bool[Tensor, " n"], a: Whitener, b: Whitener) -> Whitener:
    return replace(
        a,
        predictors=torch.where(second[:, None, None], b.predictors, a.predictors),
        std=torch.where(second[:, None], b.std, a.std),
    )
