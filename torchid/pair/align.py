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
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import minimize

from torchid.errors import LogError
from torchid.log.model import Log
from torchid.pair.record import ClockRecord
from torchid.typing import Float, Tensor

COARSE = 4000
"""Instants of the grid on which clocks are sought."""

_STEPS = (1, 2, 3, 4, 5, 8, 10, 16, 20)
RATIOS = tuple(sorted({a / b for a in _STEPS for b in _STEPS}))
"""Rates of one clock over the other that are tried: of time steps that people confuse."""

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


@dataclass(frozen=True, eq=False)
class Both:
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


def aligned_trajectories(simulated: Log, real: Log) -> list[Both]:
    """The trajectories of two logs, the k-th of one with the k-th of the other.

    Raises:
        LogError: other numbers of joints or trajectories, or other commands.
    """
    if simulated.n != real.n:
        raise LogError(
            "the simulator's log has another number of joints than the arm's.",
            got=simulated.n,
            expected=real.n,
        )
    if simulated.trajectory_count != real.trajectory_count:
        raise LogError(
            "the k-th trajectory of the simulator belongs to the k-th of the arm.",
            got=f"{simulated.trajectory_count} of the simulator",
            expected=real.trajectory_count,
        )
    pairs = list(zip(simulated.trajectories(), real.trajectories(), strict=True))
    shortest = min(x.samples for pair in pairs for x in pair)
    if shortest < SHORTEST:
        raise LogError(
            "a trajectory is too short to be aligned.",
            got=f"{shortest} samples",
            expected=f"{SHORTEST} at least",
        )
    return [_on_grid(*pair, clock) for pair, clock in zip(pairs, _clocks(pairs), strict=True)]


def _on_grid(simulated: Log, real: Log, clock: ClockRecord) -> Both:
    """Both where they overlap, on the grid of the slower log."""
    ts, tr = (x.t.numpy() - float(x.t[0]) for x in (simulated, real))
    dt = max(_step(ts) / clock.rate, _step(tr))
    first = max(0.0, -clock.start_s / clock.rate)
    last = min(tr[-1], (ts[-1] - clock.start_s) / clock.rate)
    grid = np.arange(first, last + 1e-9, dt)
    common = [k for k in ("q", "u", "tau", "dq") if k in simulated.signals and k in real.signals]
    return Both(
        real.names[0],
        dt,
        torch.from_numpy(grid + float(real.t[0])),
        {k: _at(grid * clock.rate + clock.start_s, ts, simulated.signals[k]) for k in common},
        {k: _at(grid, tr, real.signals[k]) for k in common},
        clock,
    )


@dataclass(frozen=True)
class _Two:
    """One trajectory's signals (T, n) on either side, with times from their first samples [s]."""

    ts: np.ndarray
    xs: np.ndarray
    tr: np.ndarray
    xr: np.ndarray

    @classmethod
    def of(cls, simulated: Log, real: Log, by: str) -> "_Two":
        ts, tr = (x.t.numpy() - float(x.t[0]) for x in (simulated, real))
        return cls(ts, simulated.signals[by].numpy(), tr, real.signals[by].numpy())

    @property
    def moves(self) -> bool:
        return bool((self.xr.std(0) > STANDS).any())

    @property
    def duration(self) -> float:
        """Of the simulator's over the arm's."""
        return float(self.ts[-1] / self.tr[-1]) or 1.0


def _clocks(pairs: Sequence[tuple[Log, Log]]) -> list[ClockRecord]:
    """The clock of each trajectory."""
    names = [real.names[0] for _, real in pairs]
    by = "u" if all(x.u is not None for pair in pairs for x in pair) else "q"
    twos = [_Two.of(*pair, by) for pair in pairs]
    moving = [two for two in twos if two.moves]
    if not moving:
        if not any(_Two.of(*pair, "q").moves for pair in pairs):
            raise LogError("the arm's log holds no motion to align by.")
        # Every command is a step at its trajectory's first sample.
        return [ClockRecord(name, 1.0, 0.0, 1.0, by) for name in names]
    ends = _alike(moving)
    shared, of_moving = float(np.median([rate for _, rate, _ in ends])), iter(ends)
    out = []
    for name, two in zip(names, twos, strict=True):
        likeness, rate, start = next(of_moving) if two.moves else (1.0, shared, 0.0)
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


def _alike(twos: Sequence[_Two]) -> list[tuple[float, float, float]]:
    """Likeness, rate and start of each, at the ratio at which all together are most alike."""
    found = []
    for ratio in (*RATIOS, None):  # None: both take the whole trajectory
        coarse = [_coarse(two, ratio or two.duration) for two in twos]
        score = float(np.mean([c[0] for c in coarse]))
        # Of ratios that do as well, the one that changes least comes first.
        away = abs(math.log(ratio or float(np.median([two.duration for two in twos]))))
        found.append((-round(score, 3), away, score, [c[1:] for c in coarse]))
    found.sort(key=lambda x: x[:2])
    # Between the ratios and the samples: the least squares of what is left, from the best few.
    best, most = None, -math.inf
    for _, _, score, starts in found[:3]:
        if score < found[0][2] - 0.05:
            break
        ends = [_polished(two, *at) for two, at in zip(twos, starts, strict=True)]
        total = sum(x[0] for x in ends) / len(ends)
        if best is None or total > most + EXACT:
            best, most = ends, total
        if most > 1 - EXACT:
            break
    assert best is not None
    if len(best) == 1:
        return best
    # What is as alike at the rate of all has that rate.
    rate = float(np.median([x[1] for x in best]))
    out = []
    for two, own in zip(twos, best, strict=True):
        same = _polished(two, *_coarse(two, rate)[1:], free=False)
        out.append(same if 1 - same[0] <= 2 * (1 - own[0]) + 1e-6 else own)
    return out


def _coarse(two: _Two, ratio: float) -> tuple[float, float, float]:
    """Likeness, the ratio, and the start at which the signals are most alike, of whole samples."""
    length = two.ts[-1] / ratio
    if not 0.1 < length / two.tr[-1] < 10:
        return 0.0, ratio, 0.0
    dt = max(two.tr[-1] / COARSE, _step(two.tr))
    right = _on(np.arange(0.0, two.tr[-1], dt), two.tr, two.xr)
    left = _on(np.arange(0.0, length, dt) * ratio, two.ts, two.xs)
    score, lag = _best_lag(left, right)
    return score, ratio, -lag * dt * ratio


def _best_lag(left: np.ndarray, right: np.ndarray) -> tuple[float, int]:
    """The shift of the left signals (in samples to the right) at which each of the right is most
    correlated with any of the left, whatever their sign."""
    a, b = len(left), len(right)
    size, lags = 1 << (a + b - 1).bit_length(), np.arange(-(a - 1), b)

    def spectrum(x: np.ndarray) -> np.ndarray:
        return np.fft.rfft(x, size, axis=0)

    def crossed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """sum_k x[k - lag] y[k] for all lags, of columns by their spectra."""
        return np.fft.irfft(np.conj(x) * y, size, axis=0)[lags % size]

    left, right = left - left.mean(0), right - right.mean(0)
    fl, fr, all_left, all_right = map(spectrum, (left, right, np.ones((a, 1)), np.ones((b, 1))))
    # Means and variances of what overlaps.
    count = crossed(all_left, all_right).round().clip(1)
    sl, sr = crossed(fl, all_right), crossed(all_left, fr)
    vl = (crossed(spectrum(left**2), all_right) - sl**2 / count).clip(0)
    vr = (crossed(all_left, spectrum(right**2)) - sr**2 / count).clip(0)
    moving = [[j] for j in np.flatnonzero(right.std(0) > STANDS)]
    total = np.zeros(len(lags))
    for j in moving:
        cross = np.abs(crossed(fl, fr[:, j]) - sl * sr[:, j] / count)
        squares = vl * vr[:, j]
        there = squares > 1e-6 * left.var(0) * right[:, j].var() * count**2
        total += np.where(there, cross / np.sqrt(squares.clip(1e-300)), 0).max(1) / len(moving)
    total[count[:, 0] < OVERLAP * min(a, b)] = -1
    # Of shifts that do as well, as all of a ramp do, the shortest.
    alike = np.flatnonzero(total >= total.max() - 1e-6)
    best = alike[np.abs(lags[alike]).argmin()]
    return float(total[best]), int(lags[best])


def _polished(
    two: _Two, rate: float, start: float, *, free: bool = True
) -> tuple[float, float, float]:
    """Likeness, rate and start near a first guess; the rate as it is where it is not free."""
    ts, xs, tr, xr = two.ts, two.xs, two.tr, two.xr
    grid = np.arange(0.0, tr[-1], max(tr[-1] / COARSE, _step(tr)))
    right = _on(grid, tr, xr)
    moved = np.flatnonzero(xr.std(0) > STANDS)

    def likeness(rate: float, start: float) -> float:
        at = grid * rate + start
        both = (at >= 0) & (at <= ts[-1])
        if both.sum() < OVERLAP * min(len(grid), ts[-1] / rate / (grid[1] - grid[0])):
            return 0.0
        left = _on(at[both], ts, xs)
        return min(1.0, float(np.abs(correlations(left, right[both]))[:, moved].max(0).mean()))

    begun = likeness(rate, start)
    if 1 - begun < EXACT:
        return begun, rate, start
    # In units in which both matter alike: the whole log, and its duration.
    step = _step(tr)
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


def _on(grid: np.ndarray, t: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(grid, t, column) for column in x.T], 1)


def _at(grid: np.ndarray, t: np.ndarray, x: Tensor) -> Tensor:
    return torch.from_numpy(_on(grid, t, x.numpy()))
