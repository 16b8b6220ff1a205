"""Figures of a diagnosis: where the gap lies, how far it shrinks, and the gap of one joint against
everything it may depend on."""

from typing import get_args

import numpy as np
import torch

from torchid.gap.diagnosis import TorqueDiagnosis, Trace
from torchid.gap.record import GapRecord, Regime, RegimeGap
from torchid.report.colours import AFTER, BEFORE, GREY
from torchid.report.over_time import NARROW, draw_noise
from torchid.report.panels import (
    SMALL,
    Figure,
    finish,
    map_with_words,
    panel,
    rows_of,
)
from torchid.results.words import interval, percent, regime_words
from torchid.robot.model import joint_unit
from torchid.statistics.jackknife import student_quantile
from torchid.statistics.proportion import HALF_95

WORST = 3
"""Joints that get a figure of their own."""
CLEAR = 0.05
"""p below which a regime is said to hold more than its share."""


def excess_words(one: RegimeGap) -> str:
    """`low speed 40 % [35, 45]`."""
    return f"{regime_words(one.regime)} {percent(one.excess)} {interval(one.ci95)}"


def clear_regimes(record: GapRecord, joint: int) -> list[RegimeGap]:
    """What holds more than its share of a joint's gap beyond chance, the most first; nothing on a
    joint whose gap is below all noise."""
    gap = next(g for g in record.where.joints if g.joint == joint)
    if gap.gap_rms <= gap.noise_floor_rms[0]:
        return []
    # Against chance, and in other samples of the log's blocks as well.
    regimes = record.where.regimes
    clear = [r for r in regimes if r.joint == joint and r.p < CLEAR and r.ci95[0] > 0]
    return sorted(clear, key=lambda r: -r.excess)


def stands_out(record: GapRecord) -> bool:
    """Whether a kind of motion holds more than its share of some joint's gap."""
    return any(clear_regimes(record, gap.joint) for gap in record.where.joints)


def worst_joints(record: GapRecord, most: int = WORST) -> list[int]:
    """Joints with the largest shares of the gap, at least one, those without a share left out."""
    order = sorted(record.where.joints, key=lambda gap: -gap.share)
    return [gap.joint for gap in order[:most] if gap.share > 0.02] or [order[0].joint]


def map_figure(record: GapRecord) -> Figure:
    """Joints x regimes: excess as colour and number where clear, faint elsewhere."""
    regimes = get_args(Regime)
    joints = [gap.joint for gap in record.where.joints]
    clear, cells = np.zeros((len(joints), len(regimes))), {}
    for r in record.where.regimes:
        y, x = joints.index(r.joint), regimes.index(r.regime)
        cells[y, x] = ("·", {"fontsize": 12, "color": GREY})
        # A number where the excess is clear, else a dot.
        if r in clear_regimes(record, r.joint):
            clear[y, x] = r.excess
            cells[y, x] = (percent(r.excess).replace(" ", "\u2009"), {"fontweight": "bold"})
    figure, bar = map_with_words(
        f"{record.robot}: where the gap lies",
        f"numbers: excess where p < {CLEAR:g}, corrected over all cells; "
        "dots: nothing beyond chance",
        [f"joint {gap.joint + 1}, {percent(gap.share)}" for gap in record.where.joints],
        [regime_words(r) for r in regimes],
        clear,
        cells,
        "share of the joint's gap beyond\nthe regime's share of time",
        most=1.0,
    )
    bar.ax.yaxis.set_major_formatter(lambda v, _: f"{100 * v:.0f} %")
    return figure


def known_figure(record: GapRecord) -> Figure:
    """What the log makes of each known coefficient: its value with 95 % intervals before and after,
    as a share of the value before; what has changed is marked."""
    known = record.knowledge
    assert known is not None
    coefficients = [c for c in known.coefficients if c.before and c.before_std is not None]
    figure, axes = panel(9.6, 1.4 + 0.24 * max(len(coefficients), 4))
    for k, c in enumerate(coefficients):
        for value, std, colour, up in (
            (c.before, c.before_std, BEFORE, 0.14),
            (c.after, c.after_std, AFTER, -0.14),
        ):
            half = 0.0 if std is None else HALF_95 * std / abs(c.before)
            axes.errorbar(
                value / c.before, k - up, xerr=half, fmt="D" if c.changed else "o", color=colour,
                markersize=4, linewidth=1.2,
                label="known before" if colour == BEFORE else "with this log",
            )  # fmt: skip
    names = [c.name.replace("_", " ") + (" (changed)" if c.changed else "") for c in coefficients]
    rows_of(axes, names, SMALL)
    axes.set_xlabel("of the value before")
    low, high = axes.get_xlim()
    axes.set_xlim(max(low, -1.0), min(high, 3.0))  # what is hardly known leaves the picture
    return finish(figure, f"{record.robot}: what this log makes of what was known", axes)


BINS = 24
BLOCK = 1.0
"""Seconds of a block for the bins' intervals."""


def joint_figure(
    diagnosis: TorqueDiagnosis, joint: int | None = None, narrow: bool = False
) -> Figure:
    """Binned means of the gap of a joint (from 0; the worst, if None) against velocity, position
    and load, over a light scatter and the noise; `narrow` is for a phone."""
    joint = worst_joints(diagnosis.record)[0] if joint is None else joint
    unit = joint_unit(diagnosis.robot, joint)
    length = "m" if unit == "N" else "rad"
    s = samples(diagnosis.traces, joint)
    figure, panels = (
        panel(NARROW, 7.8, 3, 1, sharey=True) if narrow else panel(11, 3.6, 1, 3, sharey=True)
    )
    against = (
        (s["dq"], f"velocity [{length}/s]"),
        (s["q"], f"position [{length}]"),
        (s["load"], f"torque of the model [{unit}]"),
    )
    models = (
        (s["before"], BEFORE, "as given"), (s["after"], AFTER, "corrected"),
    )  # fmt: skip
    # Half the height of the panels is the scatter but for its outermost points.
    both = np.abs(np.concatenate([s["before"], s["after"]]))
    limit = 1.25 * max(float(np.quantile(both, 0.99)), 1e-9) if len(both) else 1.0
    for axes, (x, name) in zip(panels, against, strict=True):
        draw_noise(axes, diagnosis.floor.ends[joint].tolist())
        axes.axhline(0, color=GREY, linewidth=0.8)
        # 1500: points at most
        some = slice(None, None, max(1, len(x) // 1500))
        faint = {"s": 4, "alpha": 0.16, "linewidths": 0, "rasterized": True}
        for y, colour, _ in models:
            axes.scatter(x[some], y[some], color=colour, **faint)
        for y, colour, whose in models:
            centre, mean, half = binned(x, y, s["block"])
            axes.fill_between(centre, mean - half, mean + half, color=colour, alpha=0.25, lw=0)
            axes.plot(
                centre, mean, color=colour, linewidth=1.4, marker="o" if colour == BEFORE else "s",
                markersize=3.4, markeredgecolor="white", markeredgewidth=0.4,
                label=f"{whose}: mean, 95 % interval",
            )  # fmt: skip
        axes.set(ylim=(-limit, limit), xlabel=name)
    for axes in panels if narrow else panels[:1]:
        axes.set_ylabel(f"measured - model [{unit}]")
    where = "" if narrow else ", on data not fitted"
    title = f"{diagnosis.robot.name}, joint {joint + 1}: what the model lacks{where}"
    return finish(figure, title, panels[0], columns=1 if narrow else 5)


def samples(traces: tuple[Trace, ...], joint: int) -> dict[str, np.ndarray]:
    """The instants of one joint that count, all trajectories, (N,) each: `q`, `dq`, `load`, what is
    `before` and `after` measured - model, and the number of the `block`."""
    parts: dict[str, list[np.ndarray]] = {}
    blocks = 0
    for trace in traces:
        counts = trace.counting[:, joint]
        block = (torch.arange(len(counts)) / (trace.rate * BLOCK)).long() + blocks
        signals = {
            "q": trace.motion.q[:, joint],
            "dq": trace.motion.dq[:, joint],
            "load": trace.before[:, joint],
            "before": (trace.measured - trace.before)[:, joint],
            "after": (trace.measured - trace.after)[:, joint],
            "block": block,
        }
        for name, x in signals.items():
            parts.setdefault(name, []).append(x[counts].cpu().numpy())
        blocks = int(block[-1]) + 1
    return {name: np.concatenate(x) for name, x in parts.items()}


def binned(
    x: np.ndarray, y: np.ndarray, block: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres, means and half-widths of 95 % intervals of y in `BINS` equal bins of x between its
    0.2 % and 99.8 % quantiles, those of fewer than three blocks left out. The intervals take
    blocks, not samples, as independent: neighbouring samples are alike."""
    if not len(x):
        return x, y, y
    low, high = np.quantile(x, [0.002, 0.998])
    edges = np.linspace(low, high if high > low else low + 1.0, BINS + 1)
    where = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BINS - 1)
    centre, mean, half, spare = [], [], [], []
    for b in range(BINS):
        inside = where == b
        names, owner = np.unique(block[inside], return_inverse=True)
        # 3: blocks in a bin that is drawn
        if len(names) < 3:
            continue
        count = np.bincount(owner)
        total = np.bincount(owner, weights=y[inside])
        value = total.sum() / count.sum()
        rest = total - value * count
        k = len(names)
        error = np.sqrt(k / (k - 1) * np.square(rest).sum()) / count.sum()
        centre.append(0.5 * (edges[b] + edges[b + 1]))
        mean.append(value)
        half.append(error)
        spare.append(k - 1.0)
    wide = student_quantile(0.95, torch.tensor(spare)).numpy()
    return np.array(centre), np.array(mean), wide * np.array(half)
