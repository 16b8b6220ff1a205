"""What a log becomes before it is fitted: segments on a common grid, and their decimated samples.

Columns that jump (signs, hysteresis, dead bands) must be computed from sharp motion and be smoothed
afterwards like the torque; so there are two bands. A `Segment` is one trajectory in the wide band,
on which all columns are evaluated. `Samples` takes any signal on segments to the narrow band of the
fit: one zero-phase filter for torque and columns alike, decimated to two and a half samples a
period of the cut-off, so that white noise stays nearly white and samples are few.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch

from torchid.design.motion import HARDLY, YIELDS, Measurement, resting_speed, timed
from torchid.effects.base import Motion
from torchid.log.filtering import ZeroPhaseFilter, extended, low_pass
from torchid.log.movement import RESTING
from torchid.typing import Bool, Float, Signals, Tensor

EDGE = 3.0
"""Length that is left out at both ends of a segment, in periods of the cut-off: beyond them the
filter sees a reflection, and most trajectories begin and end at rest, where friction can be
anything."""

REACH = 0.75
"""How far the filter carries what happens at a reversal, in periods of the cut-off."""


NEVER = 1e-3
"""A joint that travels less than this never moves [rad or m]."""


@dataclass(frozen=True, eq=False)
class Segment:
    """One trajectory in the wide band.

    Attributes:
        name: of the trajectory.
        rate: of the grid [Hz].
        band: low-pass of the signals [Hz].
        motion: q, dq, ddq, direction, age (T, n) and t (T,) [s].
        tau: (T, n) measured torque [N m; N].
        own_velocity: whether dq was measured on its own, so that it can lag behind q.
        stamp: of the first sample in the log itself [s].
        moving: (n,) speed above which joints of its log move (`Log.moving_speed`).
    """

    name: str
    rate: float
    band: float
    motion: Motion
    tau: Float[Tensor, "T n"]
    own_velocity: bool
    stamp: float = 0.0
    moving: Float[Tensor, " n"] | float = RESTING

    @property
    def length(self) -> int:
        """T."""
        return self.tau.shape[0]

    @property
    def start(self) -> float:
        """Time of the segment's first sample [s]; time runs on from one segment to the next."""
        return float(self.motion.require("t", "a segment")[0])

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.tau.shape[1]


def segments_of(measured: Sequence[Measurement], band: float, clock: float = 0.0) -> list[Segment]:
    """Segments of trajectories differentiated in the wide band (see `measurements`).

    Their time runs on from one to the next where the log's does not.

    Args:
        measured: with the wide band as their cut-off.
        band: the wide band's edge [Hz].
        clock: time at which they begin [s], at the earliest.
    """
    out = []
    for m in timed(measured, clock=clock):
        # 6.0: samples of a segment a period of the wide band's edge, at least where the log has as
        # many
        step = max(1, int(m.rate / (6.0 * band)))
        tau = m.tau
        if step > 1:
            tau = ZeroPhaseFilter(m.rate, min(1.5 * band, 0.4 * m.rate / step)).apply(tau.T).T
        motion, tau = m.motion.every(step), tau[::step].contiguous()
        stamp = float(m.t[0])
        rate, own = m.rate / step, m.own_velocity
        out.append(Segment(m.name, rate, band, motion, tau, own, stamp, m.moving))
    return out


def when(segments: Sequence[Segment], t: float) -> tuple[str, float]:
    """The trajectory at a time that runs on from one to the next, and the time of its log [s]."""
    begins = [s.start for s in segments]
    k = max((k for k, begin in enumerate(begins) if begin <= t), default=0)
    return segments[k].name, segments[k].stamp + t - begins[k]


class Samples:
    """Signals of segments, low-passed and decimated, edges left out: N samples in all.

    Args:
        segments: all on the same rate.
        cutoff: [Hz].
    """

    def __init__(self, segments: Sequence[Segment], cutoff: float):
        rates = {s.rate for s in segments}
        assert len(rates) == 1, "segments are resampled to one rate"
        self.rate = rates.pop()
        self.cutoff = cutoff
        self.segments = tuple(segments)
        # 2.5: decimated samples a period of the cut-off: the filter leaves next to nothing above it
        self.step = max(1, int(self.rate / (2.5 * cutoff)))
        if self.step > 2:
            self.step -= self.step % 2
        self._filter = low_pass(self.rate, cutoff)
        self.edge = round(EDGE * self.rate / cutoff)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.segments[0].n

    @property
    def interval(self) -> float:
        """Seconds between samples."""
        return self.step / self.rate

    @cached_property
    def bounds(self) -> tuple[slice, ...]:
        """Samples of each segment."""
        counts = [len(range(self.edge, s.length - self.edge, self.step)) for s in self.segments]
        ends = list(itertools.accumulate(counts, initial=0))
        return tuple(slice(a, b) for a, b in itertools.pairwise(ends))

    def __len__(self) -> int:
        return self.bounds[-1].stop

    def of(self, signals: Sequence[Float[Tensor, "..."]]) -> Float[Tensor, "..."]:
        """Samples (..., N) of signals (..., T_s), one tensor a segment."""
        return torch.cat([self._one(x) for x in signals], -1)

    def low_passed(self, x: Float[Tensor, "T n"]) -> Float[Tensor, "T n"]:
        """A signal of a segment through the samples' filter, on the segment's grid."""
        return x if self._filter is None else self._filter.apply(x.T).T.contiguous()

    def pick(self, signals: Sequence[Tensor]) -> Tensor:
        """Unfiltered values (N, ...) of signals (T_s, ...) at the samples' instants."""
        return torch.cat([x[self.edge : x.shape[0] - self.edge : self.step] for x in signals])

    @cached_property
    def t(self) -> Float[Tensor, " N"]:
        """Instants [s]."""
        return self.pick([s.motion.require("t", "samples") for s in self.segments])

    def _one(self, x: Signals) -> Float[Tensor, "*batch _"]:
        last = x.shape[-1] - self.edge
        if self._filter is None:
            return x[..., self.edge : last : self.step]
        tail = self._filter.tail
        padded = extended(x, tail, tail)
        # Cut at the samples' own Nyquist frequency, the spectrum would ring along all of them, and
        # what happens at a reversal would be everywhere. At twice that nothing is left to cut.
        half = self.step // 2 if self.step > 2 else 1
        finer = self._filter.decimated(padded, half, tail + self.edge, tail + last)
        return finer[..., :: self.step // half]


def still_joints(segments: Sequence[Segment]) -> tuple[int, ...]:
    """Joints, from 0, that never move; or that hardly ever do, and no farther than a push moves a
    joint that is held."""
    q, dq = (torch.cat(x) for x in zip(*((s.motion.q, s.motion.dq) for s in segments), strict=True))
    travel = q.amax(0) - q.amin(0)
    hardly = (dq.abs() > segments[0].moving).double().mean(0) < HARDLY
    return tuple(((travel < NEVER) | (hardly & (travel < YIELDS))).nonzero().flatten().tolist())


def reach_of(samples: Samples, dry: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """How far (n,) the samples' filter carries above the noise what a joint with dry friction did
    at a reversal while it may have stuck [s].

    Args:
        samples: whose filter it is.
        dry: (n,) dry friction relative to the noise.
    """
    period = samples.rate / samples.cutoff
    # 0.125: how long the direction of dry friction is wrong at a reversal, in periods of the
    # cut-off: it is known as well as the velocity, and a joint that turns may stick
    half = round(0.5 * 0.125 * period)
    pulse = torch.zeros(2 * round(8 * period) + 1, 1, dtype=torch.float64)
    middle = len(pulse) // 2
    pulse[middle - half : middle + half + 1] = 2.0
    tail = samples.low_passed(pulse)[middle:, 0].abs()
    heard = tail.flip(0).cummax(0).values.flip(0) * dry.unsqueeze(1) > 1.0
    return (heard.sum(1) / period).clamp(min=REACH) / samples.cutoff


def moving_instants(
    segment: Segment, reach: Float[Tensor, " n"] | float | None = None
) -> Bool[Tensor, "T n"]:
    """Instants at which a joint moves; all of a joint's if it hardly does. With a reach [s] those
    so near to a reversal are left out, and those twice as near to a dwell: there the joint may
    stick, and no law of sliding says with which torque."""
    dq = segment.motion.dq
    resting = resting_speed(segment.motion, segment.moving)
    moving = dq.abs() > resting
    if reach is None:
        return moving | (moving.double().mean(0) < HARDLY)
    sign = torch.sign(dq)
    turns = torch.zeros_like(sign)
    turns[1:] = (sign[1:] != sign[:-1]).to(sign)
    slow = (dq.abs() < 0.5 * resting).to(sign)
    # 0.1: time at less than half the resting speed that makes a dwell [s]
    dwells = 1 - widened(1 - slow, 0.5 * 0.1 * segment.rate)
    for j, own in enumerate(torch.as_tensor(reach).expand(segment.n).tolist()):
        column = slice(j, j + 1)
        near = widened(turns[:, column], own * segment.rate)
        near = near + widened(dwells[:, column], 2 * own * segment.rate)
        moving[:, column] &= near == 0
    return moving | (moving.double().mean(0) < HARDLY)


def moving_samples(
    samples: Samples, reach: Float[Tensor, " n"] | float | None = None
) -> Bool[Tensor, "n N"]:
    """Samples in which a joint moves; with a reach [s] those in which it surely slides."""
    return samples.pick([moving_instants(s, reach) for s in samples.segments]).T


def widened(mask: Float[Tensor, "T n"], samples: float) -> Float[Tensor, "T n"]:
    """1 wherever the mask is 1 within so many samples."""
    width = 2 * round(samples) + 1
    return torch.nn.functional.max_pool1d(mask.T.unsqueeze(1), width, 1, width // 2)[:, 0].T
