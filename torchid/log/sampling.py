"""Onto a uniform time grid, which filters and derivatives need.

Positions, velocities and accelerations are interpolated by cubic splines: between samples 10 ms
apart they err by less than 1e-6 rad on an arm's motion, where monotone interpolation (PCHIP) errs
by 4e-4 rad, because it flattens every extremum, and across dropped packets they are ten times
closer too. Torques and currents step where friction changes its sign; there a spline would ring,
so they are interpolated linearly. Nothing is interpolated across a long gap: the trajectory is
split there.
"""

from typing import Any

import numpy as np
import torch

from torchid.errors import LogError
from torchid.log.filtering import ZeroPhaseFilter
from torchid.log.model import Log
from torchid.log.stamps import (
    ROUNDING,
    SMALL_GAP,
    UNIFORM,
    Steps,
    off_grid,
    regular_clock,
    stamps_of,
    typical_step,
)

SAME_STEP = 0.01  # trajectories whose steps differ by less share one step
LONG_GAP_STEPS = 20.0  # a gap longer than this, or
LONG_GAP_S = 0.25  # than this, splits the trajectory
SHORTEST_PIECE_S = 1.0  # shorter pieces are dropped

_SMOOTH = ("q", "dq", "ddq", "ql")


def resampled(log: Log) -> tuple[Log, tuple[int, ...]]:
    """The log on a uniform grid, one a trajectory, and which trajectory of it each one was part of.

    The step is the median step of the trajectory, and one step for all of them if theirs agree
    within 1 %. Time stamps that are uniform already are only set straight, and so are those that
    jitter about a regular clock over which positions are smoother. A gap longer than
    0.25 s or 20 steps splits a trajectory; pieces shorter than 1 s are dropped. What was done is
    said in the warnings of the result.

    Raises:
        LogError: time does not increase, a trajectory has one sample only, or nothing is left.
    """
    warnings: list[str] = []
    pieces: list[Log] = []
    steps: list[float] = []
    runs: list[int] = []
    for run, (trajectory, t) in enumerate(zip(log.trajectories(), stamps_of(log), strict=True)):
        own = [_on_clock(x, warnings) for x in _split_at_gaps(trajectory, t, warnings)]
        runs += [run] * len(own)
        # What was one trajectory has one step, however uneven its parts are.
        typical = [typical_step(x) for piece in own for x in stamps_of(piece)]
        pieces += own
        steps += [float(np.median(typical))] * len(own) if own else []
    if not pieces:
        raise LogError(
            f"log '{log.source}' has no piece of {SHORTEST_PIECE_S:g} s without a gap.",
            got="; ".join(warnings),
        )
    if max(steps) <= (1.0 + SAME_STEP) * min(steps):
        steps = [float(np.median(steps))] * len(steps)
    result = [_onto_grid(piece, step, warnings) for piece, step in zip(pieces, steps, strict=True)]
    everything = tuple(dict.fromkeys([*log.warnings, *warnings]))
    if not warnings:  # stamps alone were set straight: signals are the log's own, and no copies
        even = log.replace(t=torch.cat([x.t for x in result]), warnings=everything)
    else:
        even = Log.concatenate(result).replace(source=log.source, warnings=everything)
    return even, tuple(runs)


def at_rate(log: Log, rate: float) -> Log:
    """Trajectories on uniform grids, those sampled faster at a lower rate: low-passed without phase
    so that nothing folds, and interpolated. Those that are within 1 % of it are interpolated only
    where one rate must come of several. What was done is said in the warnings.

    Args:
        log: on a uniform grid, as `Log.even` is.
        rate: [Hz]; trajectories that are all within 1 % of it and have one rate stay as they are.

    >>> import torch
    >>> t = torch.arange(5000, dtype=torch.float64) / 1000
    >>> log = Log(t, torch.sin(6 * t)[:, None])
    >>> slow = at_rate(log, 250.0)
    >>> len(slow.t), bool((slow.q[:, 0] - torch.sin(6 * slow.t)).abs().max() < 1e-3)
    (1250, True)
    """
    pieces: list[Log] = []
    warnings: list[str] = []
    near, one = (1.0 + SAME_STEP) * rate, (1.0 + ROUNDING) * min(log.rates)
    if max(log.rates) <= min(near, one):
        return log
    for piece, own in zip(log.trajectories(), log.rates, strict=True):
        signals: dict[str, Any] = {}
        if own > near:
            # 0.4: what stays of a faster log, as a share of the new rate
            low = ZeroPhaseFilter(own, 0.4 * rate)
            signals = {k: low.apply(x.T).T for k, x in piece.signals.items()}
        name = piece.names[0]
        warnings.append(f"{name}: sampled at {own:.4g} Hz, and resampled to {rate:.4g} Hz.")
        pieces.append(_onto_grid(piece.replace(**signals), 1.0 / rate, []))
    everything = tuple(dict.fromkeys([*log.warnings, *warnings]))
    return Log.concatenate(pieces).replace(source=log.source, warnings=everything)


def _split_at_gaps(log: Log, t: np.ndarray, warnings: list[str]) -> list[Log]:
    """The pieces of a log of one trajectory between its long gaps."""
    steps = Steps.of(t)
    # Slowly sampled logs have long steps that are no gaps.
    longest = max(SMALL_GAP * steps.median, min(LONG_GAP_S, LONG_GAP_STEPS * steps.median))
    breaks = np.flatnonzero(np.diff(t) > longest) + 1
    if len(breaks) == 0:
        return [log]
    name = log.names[0]
    starts, ends = [0, *breaks.tolist()], [*breaks.tolist(), len(t)]
    pieces: list[Log] = []
    dropped = 0.0
    for a, b in zip(starts, ends, strict=True):
        duration = float(t[b - 1] - t[a])
        if b - a < 2 or duration < SHORTEST_PIECE_S:
            dropped += duration
            continue
        piece = log.select(slice(a, b))
        pieces.append(piece.replace(names=(f"{name}[part {len(pieces) + 1}]",)))
    gaps = "a gap" if len(breaks) == 1 else f"{len(breaks)} gaps"
    text = (
        f"{name}: {gaps} of up to {1e3 * steps.longest:.3g} ms, the first at "
        f"{t[breaks[0] - 1]:.3f} s; split there into {len(starts)} pieces"
    )
    if len(pieces) < len(starts):
        text += (
            f", of which {len(starts) - len(pieces)} shorter than {SHORTEST_PIECE_S:g} s "
            f"were dropped ({dropped:.3g} s)"
        )
    warnings.append(text + ".")
    return pieces


def _on_clock(log: Log, warnings: list[str]) -> Log:
    """A log of one trajectory with the stamps of a regular clock, where they jitter about one."""
    t = log.t.detach().cpu().numpy()
    clock = regular_clock(t, log.q.detach().cpu().numpy())
    if clock is None:
        return log
    warnings.append(
        f"{log.names[0]}: stamps jitter by {1e3 * float(np.std(t - clock)):.2g} ms about a regular "
        "clock, over which positions are smoother: it is taken."
    )
    return log.replace(t=torch.from_numpy(clock).to(log.t.device))


def _onto_grid(log: Log, step: float, warnings: list[str]) -> Log:
    """A log of one trajectory on the grid t[0], t[0] + step, ..."""
    t = log.t.detach().cpu().numpy()
    if off_grid(t, step) <= UNIFORM:
        grid = t[0] + step * np.arange(len(t))
        return log.replace(t=torch.from_numpy(grid).to(log.t.device))
    # The last grid point may lie on the last sample, but for rounding.
    count = int((t[-1] - t[0]) / step + 1e-6) + 1
    grid = np.minimum(t[0] + step * np.arange(count), t[-1])
    device = log.t.device
    signals: dict[str, Any] = {
        name: torch.from_numpy(
            _interpolate(t, values.detach().cpu().numpy(), grid, name in _SMOOTH)
        ).to(device)
        for name, values in log.signals.items()
    }
    warnings.append(f"{log.names[0]}: time {Steps.of(t)}; resampled to {1e3 * step:.4g} ms.")
    return log.replace(
        t=torch.from_numpy(t[0] + step * np.arange(count)).to(device),
        **signals,
        trajectory=torch.zeros(count, dtype=torch.int64, device=device),
    )


def _interpolate(t: np.ndarray, values: np.ndarray, grid: np.ndarray, smooth: bool) -> np.ndarray:
    if smooth and np.isfinite(values).all():
        from scipy.interpolate import CubicSpline

        return np.ascontiguousarray(CubicSpline(t, values)(grid))
    return np.stack([np.interp(grid, t, column) for column in values.T], 1)
