"""Torque columns by themselves: are they there, clipped, or coarse?"""

from collections.abc import Sequence

import numpy as np

from torchid.doctor.case import Case
from torchid.doctor.check import Check, worded_check
from torchid.log.channels import odd_channels
from torchid.log.checks import NO_TORQUE
from torchid.statistics.spectrum import density
from torchid.typing import Float, Tensor

RUN = 4
"""Samples in a row at the largest torque, over those at any other, that make it a level."""


def check_torque(case: Case) -> Check:
    """Columns of torque that are missing, zero or constant."""
    signal, n = case.torque, case.log.n
    if signal is None:
        return worded_check("torque columns", "wrong" if case.log.u is None else "cannot tell")
    dead = (_span(signal) < NO_TORQUE).nonzero().flatten().tolist()
    if dead:
        verdict = "wrong dead" if len(dead) == n else "doubtful dead"
        values = ", ".join(f"{x:.4g}" for x in signal[0, dead].tolist())
        return worded_check("torque columns", verdict, joints=dead, values=values)
    kind = "torque" if case.log.tau is not None else "current"
    return worded_check("torque columns", "fine", kind=kind, n=n)


def check_silent_runs(case: Case) -> Sequence[Check]:
    """A run in which a joint moves and its torque never changes, as it does in others."""
    signal, log = case.torque, case.log
    if signal is None:
        return ()
    varies, way = _span(signal) >= NO_TORQUE, log.least_way
    for name, rows in zip(log.names, log.slices(), strict=True):
        moves = _span(log.q[rows]) > way
        silent = (varies & moves & (_span(signal[rows]) < NO_TORQUE)).nonzero().flatten().tolist()
        if silent:
            values = ", ".join(f"{x:.4g}" for x in signal[rows][0, silent].tolist())
            return [worded_check("runs", "wrong silent", joints=silent, run=name, values=values)]
    return ()


def check_channels(case: Case) -> Sequence[Check]:
    """Torque and current that look wrong by themselves."""
    odd = odd_channels(case.log, case.robot.limits.effort)
    joints = sorted({k for o in odd for k in o.joints})
    text = "; ".join(map(str, odd))
    return [worded_check("channels", "doubtful", joints=joints, text=text)] if odd else ()


def _span(x: Float[Tensor, "T n"]) -> Float[Tensor, " n"]:
    """Largest minus smallest value (n,)."""
    return x.amax(0) - x.amin(0)


def check_saturation(case: Case) -> Sequence[Check]:
    """Torque clipped at a level: many samples, in runs, exactly at the largest value."""
    if case.torque is None:
        return ()
    joints, levels, evidence = [], [], []
    for k, x in enumerate(case.torque.T.numpy()):
        for sign, word in ((1.0, "largest"), (-1.0, "smallest")):
            share, level = _pile(sign * x)
            # 0.004: share of the samples that may lie exactly at the largest torque
            if share > 0.004:
                joints.append(k)
                levels.append(float(sign * level))
                evidence.append(
                    f"tau{k + 1}: {100 * share:.2g} % of the samples are at the {word}, "
                    f"{sign * level:.4g}"
                )
    if not joints:
        return [worded_check("saturation", "fine")]
    text = "; ".join(evidence[:4])
    return [worded_check("saturation", "wrong", joints=joints, estimate=tuple(levels), text=text)]


def _pile(x: np.ndarray) -> tuple[float, float]:
    """Share of samples at the largest value if they come in runs and the values just below it do
    not pile up likewise (as those of a coarse signal do); and that value."""
    level = float(x.max())
    spread = float(x.std())
    if spread == 0.0:
        return 0.0, level
    at = x >= level - 1e-9 * max(abs(level), spread)
    changes = np.flatnonzero(np.diff(np.r_[0, at.astype(np.int8), 0]))
    starts, ends = changes[::2], changes[1::2]
    others = x[~at]
    # 0.9: share of the values that occur once, where a signal has no steps or held values
    if len(starts) >= RUN and len(np.unique(others)) > 0.9 * len(others):
        return float(at.mean()), level  # only its largest value ever comes back
    # Torque that comes at a lower rate holds every value for as long, its largest too.
    longest = int((ends - starts).max())
    if longest < RUN * len(x) / (1 + int((np.diff(x) != 0).sum())):
        return 0.0, level
    # The band just below the level, as wide as the signal's own resolution or a fiftieth of it.
    width = max(_resolution(x), 0.02 * spread)
    below = ((x < level) & ~at & (x >= level - 1.5 * width)).sum()
    # A value that is held at rest is not clipped: it is met at a slope.
    steep = _arrives_steeply(x, starts, ends)
    if at.sum() < 3 * max(1, below) or not steep:
        return 0.0, level
    return float(at.mean()), level


def _arrives_steeply(x: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> bool:
    """Whether the signal meets its level at a slope, as a clipped one does, and does not settle
    there: the steps into and out of the runs are as large as its usual ones."""
    step = np.abs(np.diff(x))
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
    long = ends - starts >= RUN
    edges = [step[a - 1] for a in starts[long] if a > 0]
    edges += [step[b - 1] for b in ends[long] if b - 1 < len(step)]
    return bool(edges) and float(np.median(edges)) >= 0.2 * usual


def _resolution(x: np.ndarray) -> float:
    """Median distance of neighbouring values that occur."""
    values = np.unique(x)
    return float(np.median(np.diff(values))) if len(values) > 1 else 0.0


def check_resolution(case: Case) -> Sequence[Check]:
    """Torque in steps that are coarse against its variation."""
    if case.torque is None:
        return ()
    shares = [_coarseness(x) for x in case.torque.T.numpy()]
    # 0.1: largest step between torque values, as a share of their standard deviation
    coarse = tuple(k for k, share in enumerate(shares) if share > 0.1)
    if not coarse:
        return [worded_check("resolution", "fine", most=100 * max(shares))]
    steps = ", ".join(f"{100 * shares[k]:.0f} % of its spread (joint {k + 1})" for k in coarse)
    own = tuple(shares[k] for k in coarse)
    return [worded_check("resolution", "doubtful", joints=coarse, estimate=own, steps=steps)]


def _coarseness(x: np.ndarray) -> float:
    """Steps over the spread of a column that has few values: a third of its samples has as many,
    if all have."""
    few = all(len(np.unique(part)) < 0.2 * len(x) for part in (x[: len(x) // 3], x))
    return _resolution(x) / float(x.std()) if few and x.std() > 0 else 0.0


def check_content(case: Case) -> Sequence[Check]:
    """Torque that was filtered or resampled: without noise at high frequency, or on straight lines
    between every few samples."""
    if case.torque is None:
        return ()
    parts = zip(case.log.slices(), case.log.steps, strict=True)
    rows, clock = max(parts, key=lambda p: p[0].stop - p[0].start)
    rate, x = 1 / clock.median, case.torque[rows].numpy()
    x = x[:, np.ptp(x, 0) > 0]
    # Samples of which a spectrum is taken at least
    fewest = 256
    if len(x) < fewest or not x.shape[1]:
        return [worded_check("content", "cannot tell", fewest=fewest)]
    bends, steps = np.abs(np.diff(x, 2, axis=0)), np.abs(np.diff(x, axis=0))[1:]
    straight, share = bends < 1e-6 * steps, 0.0
    if straight.any():
        # Steps of a coarse signal are alike by chance.
        coarse = np.array([_resolution(column) for column in x.T])
        straight = straight[steps > 20 * coarse]
        share = float(straight.mean()) if len(straight) else 0.0
    # 0.4: share of moving samples on the straight line between their neighbours: every second one,
    # where twice as many were made of a log
    if share >= 0.4:
        return [worded_check("content", "doubtful straight", estimate=share, percent=100 * share)]
    # Density of the steps, whose own gain, none at rest, is taken out: where it is that of the
    # sensor's noise.
    frequency, power = (x[1:] for x in density(np.diff(x, axis=0), rate, fewest // 2))
    power = power / (2 * np.sin(np.pi * frequency / rate))[:, None] ** 2
    top = np.median(power[frequency > 0.8 * frequency[-1]], 0)
    noise = np.sqrt(top * rate / 2) / x.std(0).clip(1e-300)
    # Noise as a share of the torque's spread below which no sensor is: 1e-3 to 0.7 in the logs of
    # nine arms
    sensed = 1e-5
    if float(noise.max()) > sensed:
        return [worded_check("content", "fine", least=100 * float(noise.min()))]
    held = (power.cumsum(0) / power.sum(0).clip(1e-300)).min(1)
    ends = float(frequency[:-1][held[:-1] < 1 - sensed**2].max(initial=0.0))
    return [worded_check("content", "doubtful", estimate=ends, ends=ends, nyquist=rate / 2)]
