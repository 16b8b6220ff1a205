"""Figures of a diagnosis: where the gap lies, how far it shrinks, and the gap of one joint against
everything it may depend on."""

from collections.abc import Callable
from functools import partial
from typing import Any, get_args

import numpy as np
import torch

from torchid.gap.diagnosis import TorqueDiagnosis, Trace
from torchid.gap.record import GapRecord, Regime
from torchid.report.colours import AFTER, BEFORE, GREY, INK
from torchid.report.gap_words import CLEAR, clear_regimes
from torchid.report.panels import (
    SMALL,
    Figure,
    Figures,
    finish,
    new_figure,
    panel,
    shaded_map,
    side_bars,
    styled,
    worst_stretch,
)
from torchid.report.repeats import repeats_figures
from torchid.report.table import joint_unit
from torchid.results.words import percent, regime_words
from torchid.statistics.jackknife import student_quantile
from torchid.statistics.proportion import HALF_95

WORST = 3
"""Joints that get a figure of their own."""

NARROW = 4.2
"""Width of a figure on a phone [inch]."""

_MOST_POINTS = 4000
_SHORTEST = 12.0
"""Seconds of a trajectory shown in the torque overlay, at most."""


def figures(result: TorqueDiagnosis | GapRecord) -> Figures:
    """What draws each figure, by the names of their files; of a record those that need no torque
    over time."""
    record = result.record
    assert isinstance(record, GapRecord)
    out: dict[str, Callable[[], Figure]] = {
        "where": partial(map_figure, record),
        "how_far": partial(bar_figure, record),
    }
    if isinstance(result, TorqueDiagnosis) and result.traces:
        out |= {
            f"gap_joint_{j + 1}": partial(joint_figure, result, j) for j in worst_joints(record)
        }
        out["torque"] = partial(torque_figure, result)
    out |= repeats_figures(record)
    if record.knowledge is not None and record.knowledge.coefficients:
        out["known"] = partial(known_figure, record)
    return out


def worst_joints(record: GapRecord, most: int = WORST) -> list[int]:
    """Joints with the largest shares of the gap, at least one, those without a share left out."""
    order = sorted(record.where.joints, key=lambda gap: -gap.share)
    return [gap.joint for gap in order[:most] if gap.share > 0.02] or [order[0].joint]


def map_figure(record: GapRecord) -> Figure:
    """Joints x regimes: excess as colour and number where clear, faint elsewhere; the joint's
    share of the gap beside it."""
    regimes = get_args(Regime)
    joints = [gap.joint for gap in record.where.joints]
    found = {(r.joint, r.regime): r for r in record.where.regimes}
    figure = new_figure(9.6, 2.0 + 0.42 * len(joints))
    axes, bars = figure.subplots(1, 2, width_ratios=(4.4, 1), sharey=True)
    clear = np.zeros((len(joints), len(regimes)))
    for y, j in enumerate(joints):
        for x, name in enumerate(regimes):
            r = found.get((j, name))
            if r is None:
                continue
            # A number where the excess is clear, else a dot.
            if r in clear_regimes(record, j):
                clear[y, x] = r.excess
                text = percent(r.excess).replace(" ", "\u2009")
                style = {"fontsize": SMALL, "color": INK, "fontweight": "bold"}
            else:
                text, style = "·", {"fontsize": 12, "color": GREY}
            axes.text(x, y, text, ha="center", va="center", **style)
    label = "share of the joint's gap beyond\nthe regime's share of time"
    names = [f"joint {j + 1}" for j in joints]
    bar = shaded_map(axes, clear, [regime_words(r) for r in regimes], names, label, 1.0)
    bar.ax.yaxis.set_major_formatter(lambda v, _: f"{100 * v:.0f} %")
    shares = [gap.share for gap in record.where.joints]
    words = [f" {percent(share)}" for share in shares]
    side_bars(bars, shares, words, BEFORE, "share of the gap", 1.3)
    axes.set_title(
        f"numbers: excess where p < {CLEAR:g}, corrected over all cells; "
        "dots: nothing beyond chance",
        fontsize=SMALL, color=INK, loc="left",
    )  # fmt: skip
    return finish(figure, f"{record.robot}: where the gap lies")


def bar_figure(record: GapRecord) -> Figure:
    """RMS of the gap before and after, joint by joint, over the noise bracket."""
    far, floor = record.how_far.per_joint, record.noise_floor
    n = len(far)
    figure, axes = panel(2.4 + 0.85 * n, 4.3)
    before, after = np.array([j.before for j in far]), np.array([j.after for j in far])
    place = np.arange(n)
    axes.bar(place - 0.2, before, 0.38, color=BEFORE, label="as given")
    axes.bar(place + 0.2, after, 0.38, color=AFTER, label="corrected")
    low, high = floor.low.numpy(), floor.high.numpy()
    axes.bar(
        place, np.maximum(high - low, 1e-12), 0.86, bottom=low, color=INK, alpha=0.22,
        linewidth=0, label="noise, from lowest to highest estimate",
    )  # fmt: skip
    top = float(max(before.max(), after.max(), high.max()))
    for bars, heights in ((place - 0.2, before), (place + 0.2, after)):
        for x, height in zip(bars, heights, strict=True):
            text = f"{height:.3g}"
            axes.text(x, height + 0.02 * top, text, ha="center", fontsize=SMALL, color=INK)
    axes.set_xticks(place, [f"joint {j + 1}" for j in range(n)])
    axes.set(xlim=(-0.6, n - 0.4), ylim=(0, 1.12 * top if top > 0 else 1.0))
    axes.grid(axis="x", visible=False)
    unit = "" if record.answer is None else f" [{record.answer.unit}]"
    axes.set_ylabel(f"measured - model, RMS{unit}")
    title = f"{record.robot}: how far the gap shrinks on data not fitted"
    return finish(figure, title, axes, columns=3 if n > 5 else 1)


def budget_figure(record: GapRecord) -> Figure:
    """One bar: what refitted parameters close, what effects close, what stays unexplained."""
    b = record.budget
    parts = (
        ("base parameters", b.parametric, GREY),
        ("effects", b.structural, AFTER),
        ("unexplained", b.unexplained, BEFORE),
    )
    figure, axes = panel(9.6, 1.5)
    left = 0.0
    for name, share, colour in parts:
        width = max(0.0, share)
        axes.barh(0, width, left=left, color=colour, height=0.6, label=f"{name} {percent(share)}")
        left += width
    axes.set(xlim=(0, max(1.0, left)), yticks=[], xlabel="share of the gap beyond noise")
    axes.spines["left"].set_visible(False)
    axes.grid(axis="y", visible=False)
    axes.xaxis.set_major_formatter(lambda v, _: f"{100 * v:.0f}\u2009%")
    return finish(figure, f"{record.robot}: what closes the gap", axes, columns=3)


def known_figure(record: GapRecord) -> Figure:
    """Of each known coefficient what the log makes of it: its value with 95 % intervals before and
    after, as a share of the value before; what has changed is marked."""
    known = record.knowledge
    assert known is not None
    shown = [c for c in known.coefficients if c.before and c.before_std is not None]
    figure = new_figure(9.6, 1.0 + 0.24 * max(len(shown), 4))
    axes = figure.subplots()
    styled(axes)
    for k, c in enumerate(shown):
        for value, std, colour, up in (
            (c.before, c.before_std, BEFORE, 0.14),
            (c.after, c.after_std, AFTER, -0.14),
        ):
            half = 0.0 if std is None else HALF_95 * std / abs(c.before)
            axes.errorbar(
                value / c.before, k - up, xerr=half, fmt="D" if c.changed else "o", color=colour,
                markersize=4, linewidth=1.2,
                label={BEFORE: "known before", AFTER: "with this log"}[colour] if not k else None,
            )  # fmt: skip
    axes.set_yticks(
        range(len(shown)),
        [c.name.replace("_", " ") + (" (changed)" if c.changed else "") for c in shown],
        fontsize=SMALL,
    )
    axes.set(ylim=(len(shown) - 0.4, -0.6), xlabel="of the value before")
    low, high = axes.get_xlim()
    axes.set_xlim(max(low, -1.0), min(high, 3.0))  # what is hardly known leaves the picture
    axes.legend(fontsize=SMALL, frameon=False)
    return finish(figure, f"{record.robot}: what this log makes of what was known")


def torque_figure(
    diagnosis: TorqueDiagnosis, joint: int | None = None, width: float = 10.0
) -> Figure:
    """Measured torque and both models on a joint (from 0; the worst, if None), in the stretch with
    the largest gap, and what stays of it; `width` [inch]."""
    joint = worst_joints(diagnosis.record)[0] if joint is None else joint
    trace, rows, most = diagnosis.traces[0], slice(0, len(diagnosis.traces[0].valid)), -1.0
    for own in diagnosis.traces:
        squares = (own.measured - own.before)[:, joint].square() * own.counting[:, joint]
        stretch, mean = worst_stretch(squares, max(2, round(_SHORTEST * own.rate)))
        if mean > most:
            trace, rows, most = own, stretch, mean
    step = max(1, (rows.stop - rows.start) // _MOST_POINTS)
    pick = slice(rows.start, rows.stop, step)
    t = np.arange(rows.start, rows.stop, step) / trace.rate
    valid = trace.valid[pick].numpy()
    measured, before, after = (
        np.where(valid, x[pick, joint].numpy(), np.nan)
        for x in (trace.measured, trace.before, trace.after)
    )
    figure, (upper, lower) = panel(width, 5.4, 2, 1, sharex=True, height_ratios=(3, 2))
    upper.plot(t, measured, color=INK, linewidth=2.2, label="measured")
    upper.plot(t, before, color=BEFORE, linewidth=1.3, label="as given")
    upper.plot(
        t, after, color=AFTER, linewidth=1.3, linestyle=(0, (5, 1.5)),
        label="corrected",
    )  # fmt: skip
    # What does not count for how far the gap shrinks: a joint at rest, or where it may stick.
    aside = valid & ~trace.counting[pick, joint].numpy()
    for axes, text in ((upper, "not counted: at rest, at a reversal"), (lower, None)):
        if aside.any():
            axes.fill_between(
                t, 0, 1, where=aside, transform=axes.get_xaxis_transform(), color=GREY, alpha=0.22,
                linewidth=0, label=text,
            )  # fmt: skip
    high = float(diagnosis.floor.high[joint])
    lower.axhspan(-high, high, color=INK, alpha=0.12, linewidth=0, label="noise, ±1 RMS")
    lower.plot(t, measured - before, color=BEFORE, linewidth=1.2)
    lower.plot(t, measured - after, color=AFTER, linewidth=1.2)
    unit = joint_unit(diagnosis.robot, joint)
    upper.set_ylabel(f"torque [{unit}]")
    lower.set(xlabel=f"time in {trace.name} [s]", ylabel=f"measured - model [{unit}]")
    lower.set_xlim(t[0], t[-1])
    where = " on data not fitted" if width > NARROW else ""
    title = f"{diagnosis.robot.name}: torque of joint {joint + 1}{where}"
    return finish(figure, title, upper, lower, columns=4 if width > NARROW else 1)


BINS = 24
BLOCK = 1.0
"""Seconds of a block for the bins' intervals."""

_SCATTER = 1500
_FEWEST = 3  # blocks in a bin that is drawn


def joint_figure(diagnosis: TorqueDiagnosis, joint: int | None = None) -> Figure:
    """Binned means of the gap of a joint (from 0; the worst, if None) against velocity, position,
    acceleration, load and time, over a light scatter, and its spectrum over the noise."""
    joint = worst_joints(diagnosis.record)[0] if joint is None else joint
    unit = joint_unit(diagnosis.robot, joint)
    length = "m" if unit == "N" else "rad"
    s = samples(diagnosis.traces, joint)
    figure, grid = panel(11, 6.4, 2, 3)
    panels = (
        (s["dq"], f"velocity [{length}/s]"),
        (s["q"], f"position [{length}]"),
        (s["ddq"], f"acceleration [{length}/s²]"),
        (s["load"], f"torque of the model [{unit}]"),
    )
    models = (
        (s["before"], BEFORE, "as given"), (s["after"], AFTER, "corrected"),
    )  # fmt: skip
    # Half the height of the panels is the scatter but for its outermost points.
    both = np.abs(np.concatenate([s["before"], s["after"]]))
    limit = 1.25 * max(float(np.quantile(both, 0.99)), 1e-9) if len(both) else 1.0
    high = float(diagnosis.floor.high[joint])
    for axes, (x, name) in zip(grid.flat[:4], panels, strict=True):
        axes.axhspan(-high, high, color=INK, alpha=0.10, linewidth=0, label="noise, ±1 RMS")
        axes.axhline(0, color=GREY, linewidth=0.8)
        some = slice(None, None, max(1, len(x) // _SCATTER))
        faint = {"s": 4, "alpha": 0.16, "linewidths": 0, "rasterized": True}
        for y, colour, _ in models:
            axes.scatter(x[some], y[some], color=colour, **faint)
        for y, colour, whose in models:
            centre, mean, half = binned(x, y, s["block"])
            ends = (mean - half, mean + half)
            _banded(axes, centre, mean, ends, colour, f"{whose}: mean, 95 % interval")
        axes.set(ylim=(-limit, limit), xlabel=name)
    for axes in grid[:, 0]:
        axes.set_ylabel(f"measured - model [{unit}]")
    # RMS over a few seconds: a mean over time would show the motion, not the gap's size. A block
    # that two bins share counts in both, so that no bin of a short log has too few.
    axes = grid[1, 1]
    axes.axhspan(0, high, color=INK, alpha=0.10, linewidth=0)
    bins = int(np.clip(len(np.unique(s["block"])) // _FEWEST, 1, BINS))
    for y, colour, _ in models:
        centre, mean, half = binned(s["t"], np.square(y), s["block"], bins)
        ends = (np.sqrt(np.maximum(mean - half, 0)), np.sqrt(mean + half))
        _banded(axes, centre, np.sqrt(mean), ends, colour)
    axes.set_ylim(bottom=0)
    several = len(diagnosis.traces) > 1
    time = "time, one trajectory after another [s]" if several else "time [s]"
    axes.set(xlabel=time, ylabel=f"RMS [{unit}]")
    _spectrum(grid[1, 2], diagnosis, joint, unit)
    title = f"{diagnosis.robot.name}, joint {joint + 1}: what the model lacks, on data not fitted"
    return finish(figure, title, grid[0, 0], columns=5)


def samples(traces: tuple[Trace, ...], joint: int) -> dict[str, np.ndarray]:
    """The instants of one joint that count, all trajectories, (N,) each: `t`, `q`, `dq`, `ddq`,
    `load`, what is `before` and `after` measured - model, and the number of the `block`."""
    parts: dict[str, list[np.ndarray]] = {}
    clock, blocks = 0.0, 0
    for trace in traces:
        v = trace.counting[:, joint]
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
    return {name: np.concatenate(x) for name, x in parts.items()}


def _banded(
    axes: Any,
    x: np.ndarray,
    y: np.ndarray,
    ends: tuple[np.ndarray, np.ndarray],
    colour: str,
    text: str | None = None,
) -> None:
    """A line with marks over the band of its interval."""
    axes.fill_between(x, *ends, color=colour, alpha=0.25, linewidth=0)
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


def _spectrum(axes: Any, diagnosis: TorqueDiagnosis, joint: int, unit: str) -> None:
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
    axes.set_xlabel("frequency [Hz], all instants (grey: noise)")
    axes.set_ylabel(f"gap, spectral density [{unit}/√Hz]")


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
