"""Repeats of one motion: what differs between them is what the arm does not repeat, its noise.

Two trajectories may have followed one reference, started at other instants and stopped at others;
or one trajectory may run through several periods. Both are found from positions alone: at every lag
l the mean of |q_a(t) - q_b(t + l)|^2 over the overlap follows from one correlation by FFT. At the
best lags the stretches are kept in which q and dq agree. The lag is then refined to a fraction of a
sample and the second signal is shifted by it in the frequency domain, because an alignment error d
looks like noise of size d * dtau/dt.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import torch

from torchid.design.motion import measurements
from torchid.design.segments import Samples as SegmentSamples
from torchid.design.segments import Segment, segments_of
from torchid.errors import LogError
from torchid.log.model import Log
from torchid.results.record import Col
from torchid.typing import Bool, Float, Int, Samples, Signals, Tensor

POSITION_AGREES = 0.01
"""RMS difference of q over a second, of every joint, relative to the standard deviation of that
joint's q over the trajectory (a tenth of the liveliest joint's at least). A range is two to four
standard deviations, so this is about 0.3 % of the range."""

VELOCITY_AGREES = 0.05
"""The same of dq, relative to its RMS."""

SHORTEST = 2.0
"""Stretch that is worth comparing [s]."""

MOVES = 0.3
"""Share of the trajectory's standard deviation that q must have within a stretch: two dwells agree
at every lag, and say nothing about a moving arm."""

_COARSE = 25.0  # rate at which lags are searched [Hz]; an arm's positions lie below 5 Hz
_FINE = 50.0  # rate at which agreement is judged [Hz]


@dataclass(frozen=True)
class Pair:
    """Two stretches in which the arm moved alike.

    Attributes:
        a, b: segments, by their number in the list; equal for two periods of one.
        rows_a, rows_b: samples, equally many.
        shift: fraction of a sample by which b is to be read later than `rows_b`.
    """

    a: int
    rows_a: slice
    b: int
    rows_b: slice
    shift: float


@dataclass(frozen=True)
class Repeats:
    """All repeats found; each segment is compared with the one before it that it repeats."""

    pairs: tuple[Pair, ...] = ()

    def __len__(self) -> int:
        return len(self.pairs)

    def groups(self, count: int) -> tuple[int, ...]:
        """Number of each of the segments' motion: the first segment that it repeats."""
        group = list(range(count))
        for pair in self.pairs:
            group[pair.b] = group[pair.a]
        return tuple(group)

    def differences(self, signals: Sequence[Float[Tensor, "_ n"]]) -> list[Float[Tensor, "_ n"]]:
        """(b - a) / sqrt(2) of any signal, a pair: noise of the size that it has in either.

        Args:
            signals: (T, n) a segment, in the segments' order; e.g. torque, or better torque less
                the model's, in which what the motions differ by cancels.
        """
        out = []
        for pair in self.pairs:
            shifted = delayed(signals[pair.b].T, -pair.shift).T[pair.rows_b]
            out.append((shifted - signals[pair.a][pair.rows_a]) / math.sqrt(2))
        return out

    def segments(
        self, segments: Sequence[Segment], signals: Sequence[Float[Tensor, "_ n"]]
    ) -> list[Segment]:
        """The differences of signals as the torque of segments, with the motion and time of a, so
        that they can be taken to rows like any other."""
        return [
            Segment(
                name=segments[p.a].name,
                rate=segments[p.a].rate,
                band=segments[p.a].band,
                motion=segments[p.a].motion.part(p.rows_a),
                tau=difference,
                own_velocity=segments[p.a].own_velocity,
            )
            for p, difference in zip(self.pairs, self.differences(signals), strict=True)
        ]


def counterparts(samples: SegmentSamples, repeats: Repeats) -> list[Int[Tensor, " N"]]:
    """For every pair of stretches, each sample's counterpart where the arm moved alike, -1 where
    there is none."""
    t, bounds, segments = samples.t, samples.bounds, samples.segments
    out = []
    for pair in repeats.pairs:
        a, b = (segments[k].motion.require("t", "repeats") for k in (pair.a, pair.b))
        # How much later b is than a, on the motion's clock.
        later = float(b[pair.rows_b.start] - a[pair.rows_a.start])
        later += pair.shift / segments[pair.b].rate
        counterpart = torch.full((len(t),), -1)
        sides = ((pair.a, a[pair.rows_a], pair.b, later), (pair.b, b[pair.rows_b], pair.a, -later))
        for own, clock, other, shift in sides:
            rows = torch.arange(len(t))[bounds[own]]
            rows = rows[(t[rows] >= clock[0]) & (t[rows] <= clock[-1])]
            first, last = bounds[other].start, bounds[other].stop
            there = ((t[rows] + shift - t[first]) / samples.interval).round().long() + first
            inside = (there >= first) & (there < last)
            counterpart[rows[inside]] = there[inside]
        out.append(counterpart)
    return out


def find_repeats(segments: Sequence[Segment], back: int | None = None) -> Repeats:
    """Repeats among the segments, and periods within each (see the module).

    The work grows with the log's length and, for the coarse search, with the number of pairs of
    segments; segments of different rates are not compared.

    Args:
        segments: in the order of recording.
        back: how many before each are looked at; None: all.
    """
    pairs: list[Pair] = []
    for b, later in enumerate(segments):
        for a in reversed(range(0 if back is None else max(0, b - back), b)):
            if segments[a].rate != later.rate:
                continue
            found = _between(a, segments[a], b, later)
            pairs += found
            if found:
                break
        pairs += _between(b, later, b, later)
    return Repeats(tuple(pairs))


def delayed(x: Signals, samples: float) -> Signals:
    """Signals (..., T) later by a number of samples, not necessarily whole: x(t - samples), by the
    phase of their spectra.

    The line through the ends is taken out and the rest continued by odd reflection, which makes it
    periodic in value and slope: otherwise the step from end to beginning would ring all along.
    """
    if samples == 0.0:
        return x
    count = x.shape[-1]
    index = torch.arange(count).to(x)
    slope = (x[..., -1:] - x[..., :1]) / (count - 1)
    rest = x - (x[..., :1] + slope * index)
    rest = torch.cat([rest, -rest[..., 1:-1].flip(-1)], -1)
    spectrum = torch.fft.rfft(rest)
    angle = torch.arange(spectrum.shape[-1]).to(x) * (-2 * math.pi * samples / rest.shape[-1])
    turned = spectrum * torch.polar(torch.ones_like(angle), angle)
    back = torch.fft.irfft(turned, n=rest.shape[-1])[..., :count]
    return back + x[..., :1] + slope * (index - samples)


def _between(a: int, one: Segment, b: int, two: Segment) -> list[Pair]:
    """Agreeing stretches of two segments at the one lag where they are longest in all."""
    best: list[Pair] = []
    for lag in _lags(one, two, same=a == b):
        if _overlap(one, two, lag) <= _length(best):
            break
        found = _stretches(a, one, b, two, lag)
        if _length(found) > _length(best):
            best = found
    return best


def _overlap(one: Segment, two: Segment, lag: int) -> int:
    return min(one.length, two.length - lag) - max(0, -lag)


def _length(pairs: Sequence[Pair]) -> int:
    return sum(p.rows_a.stop - p.rows_a.start for p in pairs)


def _lags(one: Segment, two: Segment, *, same: bool) -> list[int]:
    """Lags [samples] at which q_one(t) and q_two(t + lag) differ least, coarsely."""
    step = max(1, int(one.rate / _COARSE))
    x, y = one.motion.q[::step].T, two.motion.q[::step].T
    spread = spread_of(one.motion.q).unsqueeze(-1)
    x, y = x / spread, y / spread
    shortest = round(SHORTEST * one.rate / step)
    if min(x.shape[-1], y.shape[-1]) < shortest + same:  # a motion and itself: a lag at least
        return []
    lags, difference = _difference(x, y, shortest)
    if same:
        lags, difference = lags[lags > 0], difference[lags > 0]
        # Nearby instants agree in any smooth motion: only what comes back counts.
        away = torch.nonzero(difference > 0.3 * difference.max()).flatten()
        first = int(away[0]) if len(away) else len(lags)
        lags, difference = lags[first:], difference[first:]
    if len(lags) == 0:
        return []
    wall = difference.new_full((1,), torch.inf)
    around = torch.cat([wall, difference, wall])
    lowest = torch.nonzero((difference <= around[:-2]) & (difference <= around[2:])).flatten()
    # lags to look at, of the deepest minima, and as many of those that overlap longest
    candidates = 6
    deepest = lowest[difference[lowest].argsort()][:candidates]
    # All multiples of a period are as deep as the period itself: those that overlap longest too.
    # 0.1: mean squared difference, in variances of q; 2 where there is nothing in common
    deep = lowest[difference[lowest] < 0.1]
    longest = deep[lags[deep].abs().argsort()][:candidates]
    found = {int(x) * step for x in lags[torch.cat([deepest, longest])]} | (set() if same else {0})
    return sorted(found, key=lambda lag: -_overlap(one, two, lag))


def _difference(
    x: Float[Tensor, "n T"], y: Float[Tensor, "n U"], shortest: int
) -> tuple[Tensor, Tensor]:
    """Lags, and the mean over joints and overlap of (x(t) - y(t + lag))^2, by FFT."""
    count, other = x.shape[-1], y.shape[-1]
    middle = x.mean(-1, keepdim=True)
    x, y = x - middle, y - middle
    size = 2 ** math.ceil(math.log2(count + other))
    product = torch.fft.rfft(x, n=size).conj() * torch.fft.rfft(y, n=size)
    correlation = torch.fft.irfft(product.sum(0), n=size)
    lags = torch.arange(shortest - count, other - shortest + 1)
    start, stop = (-lags).clamp(min=0), torch.minimum(torch.tensor(count), other - lags)
    energies = [torch.nn.functional.pad((z * z).sum(0).cumsum(0), (1, 0)) for z in (x, y)]
    energy = energies[0][stop] - energies[0][start]
    energy = energy + energies[1][stop + lags] - energies[1][start + lags]
    return lags, (energy - 2 * correlation[lags % size]) / ((stop - start) * x.shape[0])


def spread_of(q: Samples) -> Float[Tensor, " n"]:
    """Standard deviation of each joint, a tenth of the liveliest joint's at least."""
    spread = q[:: max(1, len(q) // 2_000)].std(0)
    return spread.clamp(min=max(1e-12, 0.1 * float(spread.max())))


def _stretches(a: int, one: Segment, b: int, two: Segment, lag: int) -> list[Pair]:
    """Where two segments agree at a lag, which is refined on the way."""
    total = float(lag)
    pairs: list[Pair] = []
    # Most lags are none: whole samples and loose tolerances tell so at the least cost.
    if not _agreeing(a, one, b, two, total, looser=10.0):
        return []
    # 3: refinements, each of which leaves a small part of the last one's error
    for _ in range(3):
        pairs = _agreeing(a, one, b, two, total)
        if not pairs:
            # The coarse lag is off by up to half a coarse step: refine on what moves alike at all.
            pairs = _agreeing(a, one, b, two, total, looser=10.0)
        if not pairs:
            return []
        total += _correction(one, two, pairs) * one.rate
        if abs(total - lag) > one.rate / _COARSE:  # towards another repeat, or motion and itself
            return []
    return _agreeing(a, one, b, two, total)


def _agreeing(
    a: int, one: Segment, b: int, two: Segment, lag: float, looser: float = 1.0
) -> list[Pair]:
    """Stretches in which q and dq agree at a lag [samples], to `looser` times the tolerances."""
    whole = round(lag)
    start = max(0, -whole)
    stop = start + _overlap(one, two, whole)
    if stop - start < SHORTEST * one.rate:
        return []
    step = max(1, int(one.rate / _FINE))
    agrees = torch.ones(len(range(start, stop, step)), dtype=torch.bool)
    for x, y, tolerance in (
        (one.motion.q, two.motion.q, POSITION_AGREES),
        (one.motion.dq, two.motion.dq, VELOCITY_AGREES),
    ):
        there = _read(y, slice(start + whole, stop + whole, step), lag - whole)
        gap = (there - x[start:stop:step]) / spread_of(x)
        limit = (looser * tolerance) ** 2
        agrees &= (_local_mean(gap.square().T, one.rate / step) < limit).all(0)
        if not bool(agrees.any()):
            return []
    # 0.25: shifted by a fraction of a sample, the ends of a signal are off [s]
    shortest, margin = round(SHORTEST * one.rate), round(0.25 * one.rate)
    out = []
    for first, last in _runs(agrees):
        # Next to a trajectory's ends, odd reflection stands in for what a shift would need.
        low = max(first * step + start, margin, margin - whole)
        high = min((last - 1) * step + 1 + start, one.length - margin, two.length - margin - whole)
        rows = slice(low, high)
        if high - low >= shortest and _moves(one.motion.q, rows):
            out.append(Pair(a, rows, b, slice(low + whole, high + whole), lag - whole))
    return out


def _read(x: Float[Tensor, "_ n"], rows: slice, shift: float) -> Float[Tensor, "_ n"]:
    """Rows of a smooth signal, later by a fraction of a sample: cubic (Catmull-Rom) is enough for
    positions, and touches only what is read."""
    if shift == 0.0:
        return x[rows]
    index = torch.arange(rows.start, rows.stop, rows.step or 1)
    before, here, after, beyond = (
        x[(index + k + (0 if shift >= 0 else -1)).clamp(0, x.shape[0] - 1)] for k in range(-1, 3)
    )
    u = shift if shift >= 0 else 1 + shift
    linear = after - before
    square = 2 * before - 5 * here + 4 * after - beyond
    cube = 3 * (here - after) + beyond - before
    return here + 0.5 * u * (linear + u * (square + u * cube))


def _correction(one: Segment, two: Segment, pairs: Sequence[Pair]) -> float:
    """Seconds to add to the lag, by one step of Gauss-Newton on q_a(t) = q_b(t + lag)."""
    top = bottom = 0.0
    weight = 1 / spread_of(one.motion.q).square()
    step = max(1, int(one.rate / _FINE))
    for p in pairs:
        here, there = (slice(r.start, r.stop, step) for r in (p.rows_a, p.rows_b))
        gap = one.motion.q[here] - _read(two.motion.q, there, p.shift)
        slope = _read(two.motion.dq, there, p.shift)
        top += float((gap * slope * weight).sum())
        bottom += float((slope.square() * weight).sum())
    return top / bottom if bottom > 0 else 0.0


def _local_mean(x: Signals, rate: float) -> Signals:
    """Mean over a second around each sample, over what there is of it at the ends."""
    # 1.0: over which agreement is judged [s]
    half = max(1, round(1.0 * rate / 2))
    total = torch.nn.functional.pad(x.cumsum(-1), (1, 0))
    index = torch.arange(x.shape[-1])
    low, high = (index - half).clamp(min=0), (index + half + 1).clamp(max=x.shape[-1])
    return (total[..., high] - total[..., low]) / (high - low)


def _runs(mask: Bool[Tensor, " T"]) -> list[tuple[int, int]]:
    """First and one-past-last index of each run of True."""
    edges = torch.nn.functional.pad(mask.to(torch.int8), (1, 1)).diff()
    starts, stops = torch.nonzero(edges == 1).flatten(), torch.nonzero(edges == -1).flatten()
    return list(zip(starts.tolist(), stops.tolist(), strict=True))


def _moves(q: Samples, rows: slice) -> bool:
    """Whether some joint moves in these rows as it does in the trajectory."""
    part = q[rows][:: max(1, (rows.stop - rows.start) // 20_000)]
    return bool((part.std(0) > MOVES * spread_of(q)).any())


@dataclass(frozen=True)
class Repeat:
    """Two stretches of the same motion; equal names for two periods of one trajectory.

    Attributes:
        first, second: trajectories.
        start_first, start_second: where the stretches begin in them [s].
        duration: [s].
    """

    first: Annotated[str, Col("trajectory")]
    second: Annotated[str, Col("again in")]
    start_first: Annotated[float, Col("first from", ".2f", "s")]
    start_second: Annotated[float, Col("again from", ".2f", "s")]
    duration: Annotated[float, Col("for", ".2f", "s")]


def repeated_motion(log: Log) -> tuple[Repeat, ...]:
    """Motions that the arm made more than once; none where the log is too short or too slow.

    Args:
        log: with or without torque; it must have passed `check_log`.
    """
    try:
        even = log.even.replace(tau=torch.zeros_like(log.even.q))
        # 10.0: in which motions of a log as it is are compared [Hz]
        band = min(10.0, 0.2 * min(even.rates))
        segments = segments_of(measurements(even, band), band)
    except LogError:
        return ()
    found = []
    for pair in find_repeats(segments).pairs:
        one, two = segments[pair.a], segments[pair.b]
        found.append(
            Repeat(
                one.name,
                two.name,
                pair.rows_a.start / one.rate,
                pair.rows_b.start / two.rate,
                (pair.rows_a.stop - pair.rows_a.start) / one.rate,
            )
        )
    return tuple(found)
