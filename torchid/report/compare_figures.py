"""Figures of a comparison: a forest of intervals, and torque per joint."""

import math
from collections.abc import Sequence

from torchid.compare.diagnoses import GapComparison
from torchid.compare.identifications import Compared, Comparison
from torchid.compare.record import Range, TorqueSpread
from torchid.compare.sets import SetComparison
from torchid.report.colours import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, TEAL
from torchid.report.compare import ORDER, WORDS
from torchid.report.panels import Figure, finish, panel, rows_of
from torchid.report.table import short

COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE, TEAL, GREY, INK)
SHADES = {"drift": RED, "differ": ORANGE, "never_determined": GREY}
CLIP = 10.0
"""Claimed standard deviations beyond which a value is drawn at the edge."""


def figures(result: Comparison | GapComparison | SetComparison) -> dict[str, Figure]:
    """Those that the comparison has, by name of the file."""
    out = {}
    if isinstance(result, Comparison):
        if result.having(*ORDER[:4]):
            out["parameters"] = forest_figure(result)
    elif isinstance(result, SetComparison):
        out["parameters"] = range_figure(result.physical, result.labels, result.robot)
        out["base_parameters"] = range_figure(result.base, result.labels, result.robot)
    if result.torque is not None:
        out["torque"] = torque_figure(result.torque, result.labels, result.robot)
    return out


def forest_figure(result: Comparison) -> Figure:
    """95 % intervals of every result about the consensus, in the geometric mean of the claimed
    standard deviations; the consensus' own interval is the grey bar."""
    shown = [p for kind in ORDER[:4] for p in result.having(kind)]
    m = len(result.labels)
    figure, axes = panel(10, 1.6 + (0.2 + 0.05 * m) * len(shown))
    for row, p in enumerate(shown):
        assert p.scatter is not None
        known = p.std[~p.std.isnan()]
        unit = max(float(known.clamp(min=1e-300).log().mean().exp()), 1e-300)
        half = p.scatter.quantile * p.scatter.std / unit
        axes.barh(row, 2 * half, left=-half, height=0.8, color=GREY, alpha=0.22, linewidth=0)
        for k, (value, std) in enumerate(zip(p.values.tolist(), p.std.tolist(), strict=True)):
            if math.isnan(std):
                continue
            x = (value - p.scatter.consensus) / unit
            y = row + 0.6 * ((k + 0.5) / m - 0.5)
            wide = result.quantiles[k] * std / unit
            axes.plot([x - wide, x + wide], [y, y], color=_colour(k), linewidth=1.1)
            marker = "o" if abs(x) <= CLIP else ("<" if x < 0 else ">")
            axes.plot(max(-CLIP, min(CLIP, x)), y, marker, color=_colour(k), markersize=3.2)
    axes.axvline(0, color=GREY, linewidth=0.8)
    axes.set_xlim(-CLIP - 0.5, CLIP + 0.5)
    rows_of(axes, [short(p.name, 44) for p in shown])
    axes.set_xlabel(
        "value - consensus, in the geometric mean of the claimed standard deviations (bars: 95 %)\n"
        "red: drifts, orange: differs, black: agrees, grey: never determined; "
        "triangles lie beyond the edge"
    )
    return _compared(figure, f"{result.robot}: do {m} identifications agree?", shown, result.labels)


def range_figure(ranges: Sequence[Range], labels: Sequence[str], robot: str) -> Figure:
    """Ranges of the sets of every file, each parameter scaled to the widest of all."""
    shown = [r for kind in ORDER for r in ranges if r.verdict == kind]
    m = len(labels)
    figure, axes = panel(9, 1.4 + (0.14 + 0.04 * m) * len(shown))
    names = []
    for row, r in enumerate(shown):
        low, high = float(r.low.min()), float(r.high.max())
        size = max(high - low, 1e-9 * max(abs(low), abs(high)), 1e-300)
        for k in range(m):
            y = row + 0.6 * ((k + 0.5) / m - 0.5)
            a, b = ((float(x[k]) - (low + high) / 2) / size for x in (r.low, r.high))
            axes.plot([a, b], [y, y], "|-", color=_colour(k), markersize=4)
        names.append(f"{short(r.name, 44)}  {low:.3g} .. {high:.3g}")
    axes.set(xlim=(-0.55, 0.55), xticks=[])
    rows_of(axes, names, 6)
    axes.set_xlabel(
        "range of each file's sets, scaled to the whole range of the parameter (given beside its "
        f"name)\nred: {WORDS['drift']}, orange: {WORDS['differ']}, grey: open in every file"
    )
    return _compared(figure, f"{robot}: sets compared", shown, labels)


def torque_figure(t: TorqueSpread, labels: Sequence[str], robot: str) -> Figure:
    """Per joint: differences between models against what their covariances claim, and, with a log,
    every model's error."""
    n, m = len(t.size), len(labels)
    rows = 1 if t.errors is None else 2
    figure, grid = panel(9, 0.8 + 2.8 * rows, rows, 1, squeeze=False)
    claimed = [] if t.claimed is None else [("std that their covariances claim", t.claimed, GREY)]
    spreads = [("std between models", t.spread, BLUE), *claimed]
    parts = [(f"differences on {t.source} (in % of the joint's RMS torque)", spreads)]
    if t.errors is not None:
        errors = zip(labels, t.errors, map(_colour, range(m)), strict=True)
        parts.append(("measured torque - model", list(errors)))
    for axes, (title, bars) in zip(grid[:, 0], parts, strict=True):
        width = 0.8 / len(bars)
        for k, (name, values, colour) in enumerate(bars):
            x = [j + (k - (len(bars) - 1) / 2) * width for j in range(n)]
            axes.bar(x, values.tolist(), width * 0.94, color=colour, label=name)
        axes.set_xticks(range(n), [f"joint {j + 1}" for j in range(n)], fontsize=8)
        axes.set_ylabel("RMS [N m; N]")
        axes.set_title(title, fontsize=8, color=INK)
        axes.legend(fontsize=8, frameon=False)
    for j in range(n):
        share = 100 * float(t.spread[j] / t.size[j].clamp(min=1e-12))
        top = max(float(v[j]) for _, v, _ in spreads)
        grid[0, 0].annotate(
            f"{share:.2g} %", (j, top), xytext=(0, 2), textcoords="offset points",
            ha="center", fontsize=7, color=INK,
        )  # fmt: skip
    grid[0, 0].margins(y=0.15)
    return finish(figure, f"{robot}: torque of {m} models")


def _colour(k: int) -> str:
    return COLOURS[k % len(COLOURS)]


def _compared(
    figure: Figure, title: str, shown: Sequence[Compared | Range], labels: Sequence[str]
) -> Figure:
    """Names of the rows in the colours of their verdicts, and a legend of the results."""
    for name, row in zip(figure.axes[0].get_yticklabels(), shown, strict=True):
        name.set_color(SHADES.get(row.verdict, INK))
    styles = ({"color": _colour(k), "marker": "o", "markersize": 4} for k in range(len(labels)))
    return finish(figure, title, keys=dict(zip(labels, styles, strict=True)))
