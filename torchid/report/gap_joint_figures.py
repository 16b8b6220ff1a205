"""The gap of one joint before and after, against everything it may depend on."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from torchid.gap.diagnosis import Diagnosis, Trace
from torchid.report.colours import AFTER, BEFORE, GREY, INK
from torchid.report.panels import finish, label, new_figure, styled
from torchid.report.text import joint_unit
from torchid.statistics.jackknife import student_quantile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BINS = 24
BLOCK = 1.0
"""Seconds of a block for the bins' intervals."""

_SCATTER = 1500
_FEWEST = 3  # blocks in a bin that is drawn


@dataclass(frozen=True)
class Samples:
    """Valid instants of one joint, all trajectories.

    Attributes:
        t, q, dq, ddq, load: (N,).
        before, after: (N,) measured - model.
        block: (N,) number of the block.
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    load: np.ndarray
    before: np.ndarray
    after: np.ndarray
    block: np.ndarray


def joint_figure(diagnosis: Diagnosis, joint: int) -> "Figure":
    """Binned means of the gap against velocity, position, acceleration, load and time, over a light
    scatter, and its spectrum over the noise."""
    unit = joint_unit(diagnosis.robot, joint)
    length = "m" if unit == "N" else "rad"
    s = samples(diagnosis.traces, joint)
    figure = new_figure(11, 6.4)
    grid = figure.subplots(2, 3)
    panels = (
        (s.dq, f"velocity [{length}/s]"),
        (s.q, f"position [{length}]"),
        (s.ddq, f"acceleration [{length}/s²]"),
        (s.load, f"torque of the model [{unit}]"),
    )
    # Half the height of the panels is the scatter but for its outermost points.
    both = np.abs(np.concatenate([s.before, s.after]))
    limit = 1.25 * max(float(np.quantile(both, 0.99)), 1e-9) if len(both) else 1.0
    high = float(diagnosis.floor.high[joint])
    for axes, (x, name) in zip(grid.flat[:4], panels, strict=True):
        styled(axes)
        axes.axhspan(-high, high, color=INK, alpha=0.10, linewidth=0, label="noise, ±1 RMS")
        axes.axhline(0, color=GREY, linewidth=0.8)
        some = slice(None, None, max(1, len(x) // _SCATTER))
        faint = {"s": 4, "alpha": 0.16, "linewidths": 0, "rasterized": True}
        for y, colour in ((s.before, BEFORE), (s.after, AFTER)):
            axes.scatter(x[some], y[some], color=colour, **faint)
        for y, colour, whose in (
            (s.before, BEFORE, "model as given"),
            (s.after, AFTER, "with the effects found"),
        ):
            centre, mean, half = binned(x, y, s.block)
            text = f"{whose}: mean, 95 % interval"
            _banded(axes, centre, mean, mean - half, mean + half, colour, text)
        axes.set_ylim(-limit, limit)
        label(axes, name)
    for axes in grid[:, 0]:
        label(axes, y=f"measured - model [{unit}]")
    # RMS over a few seconds: a mean over time would show the motion, not the gap's size. A block
    # that two bins share counts in both, so that no bin of a short log has too few.
    axes = styled(grid[1, 1])
    axes.axhspan(0, high, color=INK, alpha=0.10, linewidth=0)
    bins = int(np.clip(len(np.unique(s.block)) // _FEWEST, 1, BINS))
    for y, colour in ((s.before, BEFORE), (s.after, AFTER)):
        centre, mean, half = binned(s.t, np.square(y), s.block, bins)
        ends = (np.sqrt(np.maximum(mean - half, 0)), np.sqrt(mean + half))
        _banded(axes, centre, np.sqrt(mean), *ends, colour)
    axes.set_ylim(bottom=0)
    several = len(diagnosis.traces) > 1
    time = "time, one trajectory after another [s]" if several else "time [s]"
    label(axes, time, f"RMS [{unit}]")
    _spectrum(styled(grid[1, 2]), diagnosis, joint, unit)
    title = f"{diagnosis.robot.name}, joint {joint + 1}: what the model lacks, on data not fitted"
    return finish(figure, title, grid[0, 0], columns=5)


def samples(traces: tuple[Trace, ...], joint: int) -> Samples:
    """The valid instants of one joint."""
    parts: dict[str, list[np.ndarray]] = {}
    clock, blocks = 0.0, 0
    for trace in traces:
        v = trace.valid
        t = torch.arange(len(v), dtype=torch.float64) / trace.rate
        block = (t / BLOCK).long() + blocks
        motion = trace.motion
        signals = {
            "t": t + clock,
            "q": motion.q[:, joint],
            "dq": motion.dq[:, joint],
            "ddq": motion.ddq[:, joint],
            "load": trace.before[:, joint],
            "before": (trace.measured - trace.before)[:, joint],
            "after": (trace.measured - trace.after)[:, joint],
            "block": block,
        }
        for name, x in signals.items():
            parts.setdefault(name, []).append(x[v].cpu().numpy())
        clock += len(v) / trace.rate
        blocks = int(block[-1]) + 1
    return Samples(**{name: np.concatenate(x) for name, x in parts.items()})


def _banded(
    axes: Any,
    x: np.ndarray,
    y: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    colour: str,
    text: str | None = None,
) -> None:
    """A line with marks over the band of its interval."""
    axes.fill_between(x, low, high, color=colour, alpha=0.25, linewidth=0)
    axes.plot(
        x, y, color=colour, linewidth=1.4, marker="o" if colour == BEFORE else "s",
        markersize=3.4, markeredgecolor="white", markeredgewidth=0.4, label=text,
    )  # fmt: skip


def binned(
    x: np.ndarray, y: np.ndarray, block: np.ndarray, bins: int = BINS
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres, means and half-widths of 95 % intervals of y in equal bins of x between its 0.2 %
    and 99.8 % quantiles, those of fewer than three blocks left out. The intervals take blocks, not
    samples, as independent: neighbouring samples are alike."""
    if not len(x):
        return x, y, y
    low, high = np.quantile(x, [0.002, 0.998])
    edges = np.linspace(low, high if high > low else low + 1.0, bins + 1)
    where = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, bins - 1)
    centre, mean, half, spare = [], [], [], []
    for b in range(bins):
        inside = where == b
        names, owner = np.unique(block[inside], return_inverse=True)
        if len(names) < _FEWEST:
            continue
        count = np.bincount(owner)
        total = np.bincount(owner, weights=y[inside])
        value = total.sum() / count.sum()
        left = total - value * count
        k = len(names)
        error = np.sqrt(k / (k - 1) * np.square(left).sum()) / count.sum()
        centre.append(0.5 * (edges[b] + edges[b + 1]))
        mean.append(value)
        half.append(error)
        spare.append(k - 1.0)
    wide = student_quantile(0.95, torch.tensor(spare)).numpy()
    return np.array(centre), np.array(mean), wide * np.array(half)


def _spectrum(axes: Any, diagnosis: Diagnosis, joint: int, unit: str) -> None:
    """Amplitude spectral density of both gaps over that of white noise of the floor's RMS."""
    band = diagnosis.band
    lowest = np.inf
    for name, colour in (("before", BEFORE), ("after", AFTER)):
        f, density = spectrum(diagnosis.traces, joint, name)
        shown = (f > 0) & (f <= 1.2 * band)
        if not shown.any():
            continue
        axes.plot(f[shown], np.sqrt(density[shown]), color=colour, linewidth=1.2)
        inside = shown & (f <= band)
        lowest = min(lowest, float(np.sqrt(density[inside]).min()))
    ends = [float(x[joint]) / np.sqrt(band) for x in (diagnosis.floor.low, diagnosis.floor.high)]
    axes.axhspan(max(ends[0], 1e-12), max(ends[1], 1e-12), color=INK, alpha=0.22, linewidth=0)
    axes.set_yscale("log")
    if np.isfinite(lowest):
        axes.set_ylim(bottom=0.5 * max(min(lowest, ends[0] or lowest), 1e-9))
    axes.set_xlim(0, 1.2 * band)
    axes.axvline(diagnosis.cutoff, color=GREY, linewidth=1.0, linestyle=(0, (4, 2)))
    axes.annotate(
        " cut-off of the fit", (diagnosis.cutoff, 0.98), xycoords=("data", "axes fraction"),
        fontsize=7, color=GREY, va="top",
    )  # fmt: skip
    label(axes, "frequency [Hz] (grey: noise)", f"gap, spectral density [{unit}/√Hz]")


def spectrum(traces: tuple[Trace, ...], joint: int, model: str) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and power spectral density [(N m)^2/Hz], by Welch's method: 4 s windows of
    the longest valid stretch of each trajectory; trajectories of the highest rate's grid."""
    from scipy.signal import welch

    frequencies, total, weight = np.zeros(0), np.zeros(0), 0.0
    rate = max(t.rate for t in traces)
    for trace in traces:
        if trace.rate != rate:
            continue
        # The longest run of valid instants.
        edges = np.flatnonzero(np.diff(np.concatenate([[0], trace.valid.cpu().numpy(), [0]])))
        starts, ends = edges[::2], edges[1::2]
        k = int((ends - starts).argmax()) if len(starts) else 0
        stretch = slice(int(starts[k]), int(ends[k])) if len(starts) else slice(0, 0)
        x = (trace.measured - getattr(trace, model))[stretch, joint].cpu().numpy()
        size = round(4.0 * rate)
        if len(x) < size:
            continue
        frequencies, density = welch(x, rate, nperseg=size)
        total = density * len(x) + (total if len(total) else 0.0)
        weight += len(x)
    return frequencies, total / max(weight, 1.0)
