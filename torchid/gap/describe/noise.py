"""How small the residual can become: the noise of a log, in the band of the report.

With repeats of a motion the noise is what differs between them. That holds everything that does not
repeat, so the mean over blocks is compared with the median, which a few bad seconds do not move.
Without repeats there is a bracket. Below: the level of the spectrum above the fit's cut-off, where
little but noise is left, continued to all frequencies as if the noise were white. Above: what a
flexible predictor, trained on other stretches of the log, leaves of the residual.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace as dataclass_replace

import torch
from msgspec.structs import replace

from torchid.design.columns import Columns
from torchid.design.segments import REACH, Samples, Segment, moving_samples, reach_of, when
from torchid.effects.registry import effect_torque
from torchid.gap.causes.misfit import foreseen
from torchid.gap.describe.model import Solution
from torchid.gap.problem import Problem
from torchid.gap.record import NoiseFloor
from torchid.log.filtering import ALL_PASSES, frequencies, low_pass
from torchid.statistics.differences import noise_level
from torchid.statistics.spectrum import density
from torchid.typing import Bool, Float, Tensor

BLOCK_SECONDS = 2.0
"""Length of the blocks of which mean and median are compared, and which are resampled [s]: several
times the correlation of a gap at 8 Hz; a collision lasts less, and a minute holds thirty."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise beside a model.

    Attributes:
        floor: in the band of the report.
        structure: (n,) share of the noise's variance that a flexible predictor still finds in what
            the model leaves, where that is significant; else 0.
        unpredicted: (n,) RMS of what it leaves, in the band of the report [N m; N].
        reach: (n,) how near to a reversal nothing counts for how far the gap closes [s]: what a
            joint did while it may have stuck would be a gap of its own.
        uneven: (n,) joints whose noise is not the same everywhere.
    """

    floor: NoiseFloor
    structure: Float[Tensor, " n"]
    unpredicted: Float[Tensor, " n"]
    reach: Float[Tensor, " n"] | None
    uneven: Bool[Tensor, " n"]

    def at_most(self, left: Float[Tensor, " n"]) -> "Noise":
        """This noise, no larger than what a model leaves of the torque at the instants that count:
        noise is part of that. Where it was measured larger, a note says so.

        Args:
            left: (n,) RMS in the band of the report [N m; N].
        """
        floor = self.floor
        low, high = torch.minimum(floor.low, left), torch.minimum(floor.high, left)
        # 1.1: noise over what a model leaves, from which it is said that the measure is wrong: both
        # are known to some per cent
        over = (floor.low > 1.1 * left).nonzero().flatten().tolist()
        notes = tuple(
            f"joint {j + 1}: the noise seemed to be {float(floor.low[j]):.3g}, more than the model "
            f"leaves there, {float(left[j]):.3g}, so it is taken to be that: what was measured as "
            "noise is not the same in all of the log"
            for j in over
        )
        floor = replace(floor, low=low, high=high, notes=(*floor.notes, *notes))
        unpredicted = torch.minimum(self.unpredicted, left)
        return dataclass_replace(self, floor=floor, unpredicted=unpredicted)


def noise_of(problem: Problem, solution: Solution, least: Float[Tensor, " n"]) -> Noise:
    """Noise beside a corrected model.

    Args:
        problem: of which it is one.
        solution: the model.
        least: (n,) torque that is worth a name [N m; N].
    """
    data, columns, left = problem.data, solution.columns, solution.left
    keep, band, samples = data.keep, data.band, columns.samples
    segments, report = samples.segments, Samples(samples.segments, band)
    residual = columns.gaps
    floor = floor_of(problem.repeats.segments(segments, residual), band)
    if floor is not None:
        # A correction that is another at each repeat must not pass for noise of the log.
        other = floor_of(problem.apart, band)
        floor = floor if other is None else _smaller(floor, other)
    # How near to a reversal a joint may have stuck, beside this noise.
    size = left.square().mean(1).sqrt() if floor is None else floor.high
    reach = stuck(columns, size)
    telling = keep & moving_samples(samples, reach)
    # Where repeats tell the noise, only those samples count; else all do: presliding shows there.
    counting = keep if floor is None else telling
    looked = left * counting
    share = counting.double().mean(1).clamp(min=0.05)
    # Between the fit's cut-off and the report's nothing is predicted: all counts as noise.
    within = looked.square().mean(1) / share
    moving = None if floor is None else reach
    shown, own = (
        (x.of([r.T for r in residual]).square() * moving_samples(x, moving)).mean(1)
        for x in (report, samples)
    )
    beyond = (shown - own).clamp(min=0) / share
    # Only joints that leave more than the noise, and what would be worth a name, are worth a
    # predictor.
    known = torch.zeros_like(within) if floor is None else floor.low.square()
    above = (within > least.square()) & (within + beyond > known)
    found = foreseen(problem, looked * above.unsqueeze(1))
    predicted = found.beyond(looked).square().mean(1) / share
    unpredicted = (predicted + beyond).sqrt()
    if floor is None:
        # Without repeats the bracket: what lies beyond the cut-off, continued as white; and what
        # cannot be predicted.
        white = white_level(segments, residual, samples.cutoff)
        low = torch.minimum((white * bandwidth(report)).sqrt(), unpredicted)
        floor = NoiseFloor(low, unpredicted, "bracket")
    # The positions' own noise is noise, even where the predictor sees it or an encoder repeats it.
    low, high = (torch.maximum(x, data.positions) for x in (floor.low, floor.high))
    floor = replace(floor, low=low, high=high)
    # Of a joint without a signal all is noise.
    silent, all_of_it = ~keep.any(1), report.of([r.T for r in residual]).square().mean(1).sqrt()
    low, high = (torch.where(silent, all_of_it, x) for x in (floor.low, floor.high))
    floor = replace(floor, low=low, high=high)
    # Joints of which a note says that their noise is uneven.
    uneven = torch.tensor([bool(note) for note in floor.notes or [""] * columns.n])
    floor = replace(floor, notes=tuple(note for note in floor.notes if note))
    # The noise in the fit's band, in which structure is looked for where joints surely slide.
    part = predicted / (predicted + beyond).clamp(min=1e-300)
    noise = floor.low * floor.high * part
    # Structure: what the predictor takes away there, over the noise, where that is sure.
    taken = (looked.square() - found.beyond(looked).square()) * telling
    structure = taken.sum(1) / telling.sum(1).clamp(min=1) / noise.clamp(min=1e-300)
    sure = (found.low > 0) & (structure > 0)
    structure = torch.where(sure, structure, torch.zeros_like(structure))
    return Noise(floor, structure, unpredicted, moving, uneven)


def _smaller(one: NoiseFloor, other: NoiseFloor) -> NoiseFloor:
    """Of two measures of the same noise the smaller one, joint by joint."""
    first = one.high <= other.high
    low, high = torch.where(first, one.low, other.low), torch.where(first, one.high, other.high)
    own = zip(first.tolist(), one.notes, other.notes, strict=True)
    return NoiseFloor(low, high, one.source, tuple(a if mine else b for mine, a, b in own))


def stuck(columns: Columns, noise: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """How near to a reversal (n,) a joint may have stuck [s], where what is left says nothing: the
    further the filter carries that above the noise (n,), the larger dry friction is beside it."""
    model = columns.model
    # RMS of the model's dry friction: what jumps at a reversal.
    jumping = [p for p in model.effects if p[0].jumps and p[0].joints]
    dry = torch.zeros(columns.n, dtype=torch.float64)
    if jumping:
        torques = [effect_torque(model.robot, jumping, m, m.torque) for m in columns.motions]
        dry = torch.cat(torques).square().mean(0).sqrt()
    return reach_of(columns.samples, dry / noise.clamp(min=1e-12))


def sliding_only(
    columns: Columns, keep: Bool[Tensor, "n N"], band: float, apart: Sequence[Segment]
) -> Bool[Tensor, "n N"]:
    """The samples that count where repeats tell the noise: those in which joints surely slide.
    There what a joint did while it stuck would stand out as a gap of its own; all samples
    without."""
    floor = floor_of(apart, band)
    if floor is None:
        return keep
    return keep & moving_samples(columns.samples, stuck(columns, floor.high))


def floor_of(apart: Sequence[Segment], band: float) -> NoiseFloor | None:
    """A 90 % interval of the noise in a band, from what differs between repeats of a motion, with a
    note a joint, empty where its noise is even; None where they are too short."""
    if not apart:
        return None
    report = Samples(list(apart), band)
    differences = [s for s in apart if s.length > 2 * report.edge + report.step]
    # 100: samples of repeats below which they say less than the bracket
    if not differences or len(Samples(differences, band)) < 100:
        return None
    own = Samples(differences, band)
    x = own.of([s.tau.T for s in differences])
    counting = moving_samples(own, REACH / own.cutoff)
    length = max(4, round(BLOCK_SECONDS / own.interval))
    noise = noise_level(x, counting, own.bounds, length)
    notes = [""] * len(x)
    for j in noise.uneven.nonzero().flatten().tolist():
        worst = int(noise.variance[j].nan_to_num().argmax())
        inside = (noise.block == worst).nonzero().flatten()
        name, start = when(differences, float(own.t[inside[0]]))
        stop = start + float(own.t[inside[-1]] - own.t[inside[0]])
        notes[j] = (
            f"joint {j + 1} did not repeat well at {start:.1f} to {stop:.1f} s in {name}; its "
            f"noise is the median over {BLOCK_SECONDS:g} s blocks"
        )
    return NoiseFloor(noise.low, noise.high, "repeats", tuple(notes))


def white_level(
    segments: Sequence[Segment], residual: Sequence[Tensor], cutoff: float
) -> Float[Tensor, " n"]:
    """Spectral density (n,) [(N m)^2/Hz, one-sided] above the cut-off, as a lower bound: the
    smaller one of residual and measured torque (the model's acceleration has noise of its own,
    which grows with frequency), less two standard errors. Medians, for lines do not move them."""
    levels = []
    for signals in (residual, [p.tau for p in segments]):
        densities = [_densities(x, p, cutoff) for x, p in zip(signals, segments, strict=True)]
        every = torch.cat(densities, -1)
        # 2.0: tapered, neighbouring frequencies are not independent
        error = 2.0**0.5 / math.log(2) / math.sqrt(max(1, every.shape[-1]))
        # The median of chi^2 with two degrees of freedom is ln 2 of its mean.
        levels.append(every.median(-1).values / math.log(2) * max(0.0, 1 - 2 * error))
    return torch.minimum(*levels)


def _densities(x: Tensor, p: Segment, cutoff: float) -> Float[Tensor, "n F"]:
    """Periodogram of a tapered signal between the cut-off and the wide band's edge. Without its
    straight line the taper's side lobes are small."""
    steps = torch.arange(len(x), dtype=x.dtype) - (len(x) - 1) / 2
    straight = steps.unsqueeze(1) * (steps @ x / steps.square().sum().clamp(min=1.0))
    frequency, power = density((x - straight).cpu().numpy(), p.rate, len(x))
    # From the cut-off of the fit to where the wide band ends, or the filter begins.
    last = min(p.band, ALL_PASSES * p.rate)
    inside = (frequency >= min(cutoff, 0.5 * last)) & (frequency <= last)
    return torch.from_numpy(power[inside].T)


def bandwidth(samples: Samples) -> float:
    """Integral of the filter's squared amplitude [Hz]: variance of noise of density 1."""
    nyquist = samples.rate / 2
    chosen = low_pass(samples.rate, samples.cutoff)
    if chosen is None:
        return nyquist
    frequency = frequencies(samples.rate)
    amplitude = chosen.response(frequency)
    return float(torch.trapezoid(amplitude.square(), frequency))
