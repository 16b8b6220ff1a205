"""Two logs of the same commands on one clock.

A simulator's log begins elsewhere than the arm's, has another rate, and may have another clock: the
one that its time step was set wrong by. What both were commanded tells which instants belong
together; where one of them holds no commands, the motion does. Commands may be numbered otherwise
or turned round on one side, so every joint of one is held against every joint of the other.

All trajectories have one rate of the clocks: a step or a ramp alone fits any. A command that stands
throughout a trajectory is a step at its first sample, so there the first samples belong together.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import minimize

from torchid.errors import LogError
from torchid.log.model import Log
from torchid.pair.record import ClockRecord
from torchid.typing import Float, Tensor

FINE, ROUGH = 4000, 500
"""Instants of the grids on which clocks are told, and on which their rates are sought first."""

WIDEST = 10.0
"""Largest rate of one clock over the other, and its inverse the smallest [1]."""

EXACT_RATES = (1.0, 2.0, 0.5, 4.0, 0.25, 5.0, 0.2, 10.0, 0.1)
"""Rates that people confuse, which are tried as they are."""

MOST_CYCLES = 60.0
"""Of a motion whose rate is sought: of a longer one fewer are looked at."""

CANDIDATES = 3
"""Rates that are polished, the likeliest ones,"""
WORSE = 0.05
"""... as far as their likeness is not worse by more [1]."""

OVERLAP = 0.4
"""Share of the shorter log that must lie in both."""

ALIKE = {"u": 0.95, "q": 0.8}
"""Mean correlation of commands, and of motions, from which both logs are of the same commands."""

SAME_CLOCK = 0.01
"""Difference of the clocks' rates below which they are one: crystals differ by 1e-4."""

SHORTEST = 40
"""Samples of a trajectory that can be aligned."""

STANDS = 1e-6
"""Standard deviation below which a signal stands."""

EXACT = 1e-9
"""Of a correlation from 1, below which nothing is left to be sought."""

Clock = tuple[float, float, float]
"""Likeness, rate, and start [s]."""


@dataclass(frozen=True, eq=False)
class AlignedTrajectory:
    """One trajectory of both on the grid of the slower log.

    Attributes:
        name: of the arm's trajectory.
        dt: [s], of the arm's clock.
        t: (T,) [s], of the arm's log.
        simulated, real: signals (T, n) that both have, by name: q, and u, tau, dq where they do.
        clock: that took them together.
    """

    name: str
    dt: float
    t: Float[Tensor, " T"]
    simulated: dict[str, Float[Tensor, "T n"]]
    real: dict[str, Float[Tensor, "T n"]]
    clock: ClockRecord


def aligned_trajectories(simulated: Log, real: Log) -> list[AlignedTrajectory]:
    """The trajectories of two logs, the k-th of one with the k-th of the other.

    Raises:
        LogError: other numbers of joints or trajectories, or other commands.
    """
    if simulated.n != real.n:
        problem = "the simulator's log has another number of joints than the arm's."
        raise LogError(problem, got=simulated.n, expected=real.n)
    if simulated.trajectory_count != real.trajectory_count:
        raise LogError(
            "the k-th trajectory of the simulator belongs to the k-th of the arm.",
            got=f"{simulated.trajectory_count} of the simulator",
            expected=real.trajectory_count,
        )
    pairs = list(zip(simulated.trajectories(), real.trajectories(), strict=True))
    shortest = min(x.samples for pair in pairs for x in pair)
    if shortest < SHORTEST:
        got, expected = f"{shortest} samples", f"{SHORTEST} at least"
        raise LogError("a trajectory is too short to be aligned.", got=got, expected=expected)
    return [_on_grid(*pair, clock) for pair, clock in zip(pairs, _clocks(pairs), strict=True)]


def _on_grid(simulated: Log, real: Log, clock: ClockRecord) -> AlignedTrajectory:
    """Both where they overlap, on the grid of the slower log."""
    ts, tr = (x.t.numpy() - float(x.t[0]) for x in (simulated, real))
    dt = max(_step(ts) / clock.rate, _step(tr))
    first = max(0.0, -clock.start_s / clock.rate)
    last = min(tr[-1], (ts[-1] - clock.start_s) / clock.rate)
    grid = np.arange(first, last + 1e-9, dt)
    common: list[str] = [
        k for k in ("q", "u", "tau", "dq") if k in simulated.signals and k in real.signals
    ]
    of_simulated, of_real = (
        {k: torch.from_numpy(_interpolated(at, t, log.signals[k].numpy())) for k in common}
        for log, t, at in ((simulated, ts, grid * clock.rate + clock.start_s), (real, tr, grid))
    )
    instants = torch.from_numpy(grid + float(real.t[0]))
    return AlignedTrajectory(real.names[0], dt, instants, of_simulated, of_real, clock)


@dataclass(frozen=True)
class _SignalPair:
    """One trajectory's signals (T, n) on either side, with times from their first samples [s]."""

    ts: np.ndarray
    xs: np.ndarray
    tr: np.ndarray
    xr: np.ndarray

    @classmethod
    def of(cls, simulated: Log, real: Log, by: str) -> "_SignalPair":
        ts, tr = (x.t.numpy() - float(x.t[0]) for x in (simulated, real))
        return cls(ts, simulated.signals[by].numpy(), tr, real.signals[by].numpy())

    @property
    def moves(self) -> bool:
        return bool((self.xr.std(0) > STANDS).any())

    @property
    def duration(self) -> float:
        """Of the simulator's over the arm's."""
        return float(self.ts[-1] / self.tr[-1]) or 1.0

    @property
    def cycles(self) -> np.ndarray:
        """(n,) duration times the RMS frequency of the arm's signals."""
        speed = np.gradient(self.xr, self.tr, axis=0)
        return speed.std(0) / np.maximum(self.xr.std(0), STANDS) * self.tr[-1] / (2 * math.pi)


def _clocks(pairs: Sequence[tuple[Log, Log]]) -> list[ClockRecord]:
    """The clock of each trajectory."""
    names = [real.names[0] for _, real in pairs]
    by = "u" if all(x.u is not None for pair in pairs for x in pair) else "q"
    signals = [_SignalPair.of(*pair, by) for pair in pairs]
    moving = [pair for pair in signals if pair.moves]
    if not moving:
        if not any(_SignalPair.of(*pair, "q").moves for pair in pairs):
            raise LogError("the arm's log holds no motion to align by.")
        # Every command is a step at its trajectory's first sample.
        return [ClockRecord(name, 1.0, 0.0, 1.0, by) for name in names]
    clocks = _alike(moving)
    shared, of_moving = float(np.median([rate for _, rate, _ in clocks])), iter(clocks)
    out = []
    for name, pair in zip(names, signals, strict=True):
        likeness, rate, start = next(of_moving) if pair.moves else (1.0, shared, 0.0)
        if likeness < ALIKE[by]:
            raise LogError(
                f"the logs are of different {'commands' if by == 'u' else 'motions'}: at no shift "
                "and no ratio of their clocks are they alike.",
                got=f"a mean correlation of {likeness:.2f}",
                expected=f"{ALIKE[by]} at least",
                hint="the same commands u1.. in both logs align them whatever the arms did",
            )
        out.append(ClockRecord(name, rate, start, likeness, by))
    return out


def _alike(pairs: Sequence[_SignalPair]) -> list[Clock]:
    """The clock of each, at the rate at which all together are most alike."""
    # None: both take the whole trajectory.
    rates: list[float | None] = [*_likely_rates(pairs), None]
    usual, likely = float(np.median([pair.duration for pair in pairs])), []
    for rate in rates:
        coarse = [_coarse(pair, rate or pair.duration) for pair in pairs]
        score = float(np.mean([likeness for likeness, _, _ in coarse]))
        likely.append((score, abs(math.log((rate or usual) / usual)), coarse))
    # Of rates that do as well, the one that changes least comes first.
    likely.sort(key=lambda x: (-round(x[0], 3), x[1]))
    # Between the rates and the samples: the least squares of what is left, from the best few.
    best, most = likely[0][2], -math.inf
    for score, _, coarse in likely[:CANDIDATES]:
        if score < likely[0][0] - WORSE or most > 1 - EXACT:
            break
        clocks = [_polished(pair, clock) for pair, clock in zip(pairs, coarse, strict=True)]
        total = sum(likeness for likeness, _, _ in clocks) / len(clocks)
        if total > most + EXACT:
            best, most = clocks, total
    if len(best) == 1:
        return best
    # What is as alike at the rate of all has that rate.
    rate = float(np.median([rate for _, rate, _ in best]))
    out = []
    for pair, own in zip(pairs, best, strict=True):
        same = _polished(pair, _coarse(pair, rate), free=False)
        out.append(same if 1 - same[0] <= 2 * (1 - own[0]) + 1e-6 else own)
    return out


def _likely_rates(pairs: Sequence[_SignalPair]) -> list[float]:
    """The likeliest rates of all, by the joint that has most cycles: half the distance from one to
    the next makes its signals drift apart by a quarter of a radian at their ends."""
    pair = max(pairs, key=lambda pair: pair.cycles.max())
    joint = int(pair.cycles.argmax())
    one = replace(pair, xr=pair.xr[:, [joint]])
    step = 0.5 / (math.pi * min(max(float(pair.cycles[joint]), 1.0), MOST_CYCLES))
    count = int(math.log(WIDEST) / step)
    rates = sorted({*EXACT_RATES, *(math.exp(step * k) for k in range(-count, count + 1))})
    likeness = [0.0, *(_coarse(one, rate, ROUGH)[0] for rate in rates), 0.0]
    peaks = [
        (-likeness[k], rate)
        for k, rate in enumerate(rates, 1)
        if likeness[k] >= max(likeness[k - 1], likeness[k + 1])
    ]
    # Of those that do as well, as all do of a ramp, the ones that change least.
    peaks.sort(key=lambda x: (round(x[0], 2), abs(math.log(x[1]))))
    return [rate for _, rate in peaks[: 2 * CANDIDATES]]


def _coarse(pair: _SignalPair, rate: float, instants: int = FINE) -> Clock:
    """The start at which the signals are most alike, of whole samples."""
    length = pair.ts[-1] / rate
    if not 1 / WIDEST < length / pair.tr[-1] < WIDEST:
        return 0.0, rate, 0.0
    dt = max(pair.tr[-1] / instants, _step(pair.tr))
    right = _interpolated(np.arange(0.0, pair.tr[-1], dt), pair.tr, pair.xr)
    left = _interpolated(np.arange(0.0, length, dt) * rate, pair.ts, pair.xs)
    likeness, lag = _best_lag(left, right)
    return likeness, rate, -lag * dt * rate


def _best_lag(left: np.ndarray, right: np.ndarray) -> tuple[float, int]:
    """The shift of the left signals (in samples to the right) at which each of the right is most
    correlated with any of the left, whatever their sign."""
    a, b = len(left), len(right)
    size, lags = 1 << (a + b - 1).bit_length(), np.arange(-(a - 1), b)

    def crossed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(L, n, m) sum_k x[k - lag] y[k] for all lags, of every column with every column."""
        x, y = np.fft.rfft(x, size, axis=0), np.fft.rfft(y, size, axis=0)
        return np.fft.irfft(np.conj(x)[:, :, None] * y[:, None], size, axis=0)[lags % size]

    left, right = left - left.mean(0), (right - right.mean(0))[:, right.std(0) > STANDS]
    all_left, all_right = np.ones((a, 1)), np.ones((b, 1))
    # Means and variances of what overlaps.
    count = crossed(all_left, all_right).round().clip(1)
    sl, sr = crossed(left, all_right), crossed(all_left, right)
    vl = (crossed(left**2, all_right) - sl**2 / count).clip(0)
    vr = (crossed(all_left, right**2) - sr**2 / count).clip(0)
    there = vl * vr > 1e-6 * count**2 * left.var(0)[:, None] * right.var(0)
    cross = np.abs(crossed(left, right) - sl * sr / count)
    total = np.where(there, cross / np.sqrt((vl * vr).clip(1e-300)), 0).max(1).mean(1)
    total[count[:, 0, 0] < OVERLAP * min(a, b)] = -1
    # Of shifts that do as well, as all of a ramp do, the shortest.
    alike = np.flatnonzero(total >= total.max() - 1e-6)
    best = alike[np.abs(lags[alike]).argmin()]
    return float(total[best]), int(lags[best])


def _polished(pair: _SignalPair, guess: Clock, *, free: bool = True) -> Clock:
    """The clock near a first guess; the rate as it is where it is not free."""
    (_, rate, start), (ts, xs, tr, xr) = guess, (pair.ts, pair.xs, pair.tr, pair.xr)
    step = _step(tr)
    grid = np.arange(0.0, tr[-1], max(tr[-1] / FINE, step))
    right = _interpolated(grid, tr, xr)[:, xr.std(0) > STANDS]

    def likeness(rate: float, start: float) -> float:
        at = grid * rate + start
        both = (at >= 0) & (at <= ts[-1])
        if both.sum() < OVERLAP * min(len(grid), ts[-1] / rate / (grid[1] - grid[0])):
            return 0.0
        left = _interpolated(at[both], ts, xs)
        return min(1.0, float(np.abs(correlations(left, right[both])).max(0).mean()))

    begun = likeness(rate, start)
    if 1 - begun < EXACT:
        return begun, rate, start
    # In units in which both matter alike: the whole log, and its duration.
    scale = np.array([2 * step / max(tr[-1], step), 2 * step])

    def at(x: np.ndarray) -> tuple[float, float]:
        turned = rate * math.exp(x[0] * scale[0]) if free else rate
        return turned, start + x[-1] * scale[1]

    def loss(x: np.ndarray) -> float:
        return math.log(max(1 - likeness(*at(x)), 1e-13))

    simplex = np.vstack([np.zeros(1 + free), 2 * np.eye(1 + free)])
    options = {"maxiter": 80, "xatol": 1e-3, "fatol": 1e-4, "initial_simplex": simplex}
    best = at(minimize(loss, simplex[0], method="Nelder-Mead", options=options).x)
    return likeness(*best), *best


def correlations(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(n, m) of every column of one with every one of the other; 0 of what does not move."""
    left, right = left - left.mean(0), right - right.mean(0)
    sizes = np.sqrt((left**2).sum(0))[:, None] * np.sqrt((right**2).sum(0))
    return np.where(sizes > 1e-12, left.T @ right / np.maximum(sizes, 1e-300), 0.0)


def _step(t: np.ndarray) -> float:
    return float(np.median(np.diff(t)))


def _interpolated(grid: np.ndarray, t: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(grid, t, column) for column in x.T], 1)
