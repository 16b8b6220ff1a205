"""Two logs of the same commands on one clock.

A simulator's log begins elsewhere than the arm's, has another rate, and may have another clock: the
one that its time step was set wrong by. What both were commanded tells which instants belong
together; where one of them holds no commands, the motion does. Commands may be numbered otherwise
or turned round on one side, so every joint of one is held against every joint of the other.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import minimize

from torchid.errors import LogError
from torchid.log.model import Log
from torchid.typing import Float, Tensor

COARSE = 4000
"""Instants of the grid on which clocks are sought."""

RATIOS = tuple(
    sorted({a / b for a in (1, 2, 3, 4, 5, 8, 10, 16, 20) for b in (1, 2, 3, 4, 5, 8, 10, 16, 20)})
)
"""Rates of one clock over the other that are tried: of time steps that people confuse."""

OVERLAP = 0.4
"""Share of the shorter log that must lie in both."""

ALIKE = {"u": 0.95, "q": 0.8}
"""Mean correlation of commands, and of motions, from which both logs are of the same commands."""

SAME_CLOCK = 0.01
"""Difference of the clocks' rates below which they are one: crystals differ by 1e-4."""

LONGEST_STEP = 0.02
"""Of the common grid [s]."""


@dataclass(frozen=True)
class Clock:
    """Time of the simulator's log for a time of the arm's: start + rate t, both from their first
    sample.

    Attributes:
        rate: [1].
        start: [s].
        likeness: mean correlation of what both were aligned by.
        by: `u` or `q`.
    """

    rate: float
    start: float
    likeness: float
    by: str


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
    clock: Clock


def aligned(simulated: Log, real: Log) -> list[Both]:
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
    pairs = zip(simulated.trajectories(), real.trajectories(), strict=True)
    return [_aligned(s, r) for s, r in pairs]


def _aligned(simulated: Log, real: Log) -> Both:
    by = "u" if simulated.u is not None and real.u is not None else "q"
    ts, tr = (x.t.numpy() - float(x.t[0]) for x in (simulated, real))
    if min(len(ts), len(tr)) < 50:
        raise LogError(
            "a trajectory is too short to be aligned.",
            got=f"{min(len(ts), len(tr))} samples",
            expected="50 at least",
        )
    xs, xr = (x.signals[by].numpy() for x in (simulated, real))
    clock = _clock(ts, xs, tr, xr, by)
    # The grid of the slower log, where both are.
    dt = max(_step(ts) / clock.rate, _step(tr))
    first = max(0.0, -clock.start / clock.rate)
    last = min(tr[-1], (ts[-1] - clock.start) / clock.rate)
    grid = np.arange(first, last + 1e-9, dt)
    common = [
        name
        for name in ("q", "u", "tau", "dq")
        if {name} <= set(simulated.signals) & set(real.signals)
    ]
    return Both(
        real.names[0],
        dt,
        torch.from_numpy(grid + float(real.t[0])),
        {k: _at(grid * clock.rate + clock.start, ts, simulated.signals[k]) for k in common},
        {k: _at(grid, tr, real.signals[k]) for k in common},
        clock,
    )


def _clock(ts: np.ndarray, xs: np.ndarray, tr: np.ndarray, xr: np.ndarray, by: str) -> Clock:
    """The rate and start at which the signals are most alike."""
    dt = max(tr[-1] / COARSE, _step(tr))
    right = _on(np.arange(0.0, tr[-1], dt), tr, xr)
    moved = xr.std(0) > 1e-6
    if not moved.any():
        raise LogError("the arm's log holds no motion to align by.")
    found = []
    for ratio in {*RATIOS, (ts[-1] / tr[-1]) or 1.0}:
        length = ts[-1] / ratio
        if not 0.1 < length / tr[-1] < 10:
            continue
        left = _on(np.arange(0.0, length, dt) * ratio, ts, xs)
        score, lag = _best_lag(left, right)
        found.append((score, ratio, -lag * dt * ratio))
    found.sort(reverse=True)
    # Between the ratios and the samples: the least squares of what is left, from the best few.
    best = None
    for score, ratio, start in found[:3]:
        own = _polished(ts, xs, tr, xr, ratio, start)
        if best is None or own[0] > best[0] + 1e-9:
            best = own
        if score < found[0][0] - 0.05:
            break
    assert best is not None
    likeness, rate, start = best
    if likeness < ALIKE[by]:
        raise LogError(
            f"the logs are of different {'commands' if by == 'u' else 'motions'}: at no shift and "
            "no ratio of their clocks are they alike.",
            got=f"a mean correlation of {likeness:.2f}",
            expected=f"{ALIKE[by]} at least",
            hint="the same commands u1.. in both logs align them whatever the arms did",
        )
    return Clock(rate, start, likeness, by)


def _best_lag(left: np.ndarray, right: np.ndarray) -> tuple[float, int]:
    """The shift of the left signals (in samples to the right) at which each of the right is most
    correlated with any of the left, whatever their sign."""
    a, b = len(left), len(right)
    size = 1 << (a + b - 1).bit_length()

    def spectrum(x: np.ndarray) -> np.ndarray:
        return np.fft.rfft(x, size, axis=0)

    lags = np.arange(-(a - 1), b)
    ones, others = spectrum(np.ones((a, 1))), spectrum(np.ones((b, 1)))

    def crossed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """sum_k x[k - lag] y[k] for all lags."""
        whole = np.fft.irfft(np.conj(x) * y, size, axis=0)
        return whole[lags % size]

    count = np.maximum(np.round(crossed(ones, others)[:, 0]), 1.0)
    left, right = left - left.mean(0), right - right.mean(0)
    fl, fr = spectrum(left), spectrum(right)
    sl, sr = crossed(fl, others), crossed(ones, fr)
    vl = crossed(spectrum(left**2), others) - sl**2 / count[:, None]
    vr = crossed(ones, spectrum(right**2)) - sr**2 / count[:, None]
    enough = count >= OVERLAP * min(a, b)
    total = np.zeros(len(lags))
    moving = right.std(0) > 1e-6
    for j in np.flatnonzero(moving):
        own = np.zeros(len(lags))
        for i in range(left.shape[1]):
            cross = crossed(fl[:, i], fr[:, j]) - sl[:, i] * sr[:, j] / count
            size2 = np.maximum(vl[:, i], 0) * np.maximum(vr[:, j], 0)
            there = size2 > (1e-6 * left[:, i].var() * right[:, j].var()) * count**2
            own = np.maximum(
                own, np.where(there, np.abs(cross) / np.sqrt(np.maximum(size2, 1e-300)), 0)
            )
        total += own
    total = np.where(enough, total / moving.sum(), -1.0)
    best = int(total.argmax())
    return float(total[best]), int(lags[best])


def _polished(
    ts: np.ndarray, xs: np.ndarray, tr: np.ndarray, xr: np.ndarray, rate: float, start: float
) -> tuple[float, float, float]:
    """Likeness, rate and start near a first guess."""
    grid = np.arange(0.0, tr[-1], max(tr[-1] / COARSE, _step(tr)))
    right = _on(grid, tr, xr)
    moved = np.flatnonzero(xr.std(0) > 1e-6)

    def likeness(rate: float, start: float) -> float:
        at = grid * rate + start
        both = (at >= 0) & (at <= ts[-1])
        if both.sum() < OVERLAP * min(len(grid), ts[-1] / rate / (grid[1] - grid[0])):
            return 0.0
        left = _on(at[both], ts, xs)
        return float(np.abs(correlations(left, right[both]))[:, moved].max(0).mean())

    # In units in which both matter alike: the whole log, and its duration.
    step = _step(tr)
    scale = np.array([2 * step / max(tr[-1], step), 2 * step])

    def loss(x: np.ndarray) -> float:
        value = likeness(rate * math.exp(x[0] * scale[0]), start + x[1] * scale[1])
        return math.log(max(1 - value, 1e-13))

    simplex = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]])
    options = {"maxiter": 80, "xatol": 1e-3, "fatol": 1e-4, "initial_simplex": simplex}
    found = minimize(loss, np.zeros(2), method="Nelder-Mead", options=options)
    x = found.x
    own = rate * math.exp(x[0] * scale[0]), start + x[1] * scale[1]
    return likeness(*own), *own


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
