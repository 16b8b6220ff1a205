"""Figures of a comparison: a forest of intervals, and torque per joint."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from torchid.compare.diagnoses import GapComparison
from torchid.compare.identifications import Compared, Comparison
from torchid.compare.sets import Range, SetComparison
from torchid.compare.torque import TorqueSpread
from torchid.report.compare import ORDER, WORDS, short
from torchid.report.figures import BLUE, GREEN, GREY, INK, ORANGE, RED, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = (BLUE, ORANGE, GREEN, RED, "#8250df", "#1b7c83", GREY, INK)
SHADES = {"drift": RED, "differ": ORANGE}
CLIP = 10.0
"""Claimed standard deviations beyond which a value is drawn at the edge."""


def figures(result: Comparison | GapComparison | SetComparison) -> "dict[str, Figure]":
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


def forest_figure(result: Comparison) -> "Figure":
    """95 % intervals of every result about the consensus, in the geometric mean of the claimed
    standard deviations; the consensus' own interval is the grey bar."""
    shown = [p for kind in ORDER[:4] for p in result.having(kind)]
    m = len(result.labels)
    step = 0.2 + 0.05 * m
    figure = new_figure(10, 1.6 + step * len(shown))
    axes = styled(figure.subplots())
    for row, p in enumerate(shown):
        _forest_row(axes, row, p, result)
    axes.axvline(0, color=GREY, linewidth=0.8)
    axes.set_xlim(-CLIP - 0.5, CLIP + 0.5)
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.set_yticks(range(len(shown)), [short(p.name, 44) for p in shown], fontsize=7)
    for label, p in zip(axes.get_yticklabels(), shown, strict=True):
        label.set_color(SHADES.get(p.verdict, GREY if p.verdict == "never_determined" else INK))
    axes.set_xlabel(
        "value - consensus, in the geometric mean of the claimed standard deviations (bars: 95 %)\n"
        "red: drifts, orange: differs, black: agrees, grey: never determined; "
        "triangles lie beyond the edge",
        fontsize=8,
        color=INK,
    )
    _legend(figure, result.labels)
    figure.suptitle(
        f"{result.robot}: do {m} identifications agree?", fontsize=11, color=INK, x=0.01, ha="left"
    )
    return figure


def _forest_row(axes: Any, row: int, p: Compared, result: Comparison) -> None:
    assert p.scatter is not None
    known = p.std[~p.std.isnan()]
    unit = max(float(known.clamp(min=1e-300).log().mean().exp()), 1e-300)
    half = p.scatter.quantile * p.scatter.std / unit
    axes.barh(row, 2 * half, left=-half, height=0.8, color=GREY, alpha=0.22, linewidth=0)
    m = len(result.labels)
    for k, (value, std) in enumerate(zip(p.values.tolist(), p.std.tolist(), strict=True)):
        if math.isnan(std):
            continue
        x = (value - p.scatter.consensus) / unit
        y = row + 0.6 * ((k + 0.5) / m - 0.5)
        wide = result.quantiles[k] * std / unit
        colour = COLOURS[k % len(COLOURS)]
        axes.plot([x - wide, x + wide], [y, y], color=colour, linewidth=1.1)
        marker = "o" if abs(x) <= CLIP else ("<" if x < 0 else ">")
        axes.plot(max(-CLIP, min(CLIP, x)), y, marker, color=colour, markersize=3.2)


def range_figure(ranges: Sequence[Range], labels: Sequence[str], robot: str) -> "Figure":
    """Ranges of the sets of every file, each parameter scaled to the widest of all."""
    shown = [r for kind in ORDER for r in ranges if r.verdict == kind]
    m = len(labels)
    figure = new_figure(9, 1.4 + (0.14 + 0.04 * m) * len(shown))
    axes = styled(figure.subplots())
    for row, r in enumerate(shown):
        low, high = float(r.low.min()), float(r.high.max())
        size = max(high - low, 1e-9 * max(abs(low), abs(high)), 1e-300)
        for k in range(m):
            y = row + 0.6 * ((k + 0.5) / m - 0.5)
            a, b = ((float(x[k]) - (low + high) / 2) / size for x in (r.low, r.high))
            axes.plot([a, b], [y, y], "|-", color=COLOURS[k % len(COLOURS)], markersize=4)
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.set_xlim(-0.55, 0.55)
    names = [
        f"{short(r.name, 44)}  {float(r.low.min()):.3g} .. {float(r.high.max()):.3g}" for r in shown
    ]
    axes.set_yticks(range(len(shown)), names, fontsize=6)
    for label, r in zip(axes.get_yticklabels(), shown, strict=True):
        label.set_color(SHADES.get(r.verdict, GREY if r.verdict == "never_determined" else INK))
    axes.set_xticks([])
    axes.set_xlabel(
        "range of each file's sets, scaled to the whole range of the parameter (given beside its "
        f"name)\nred: {WORDS['drift']}, orange: {WORDS['differ']}, grey: open in every file",
        fontsize=8,
        color=INK,
    )
    _legend(figure, labels)
    figure.suptitle(f"{robot}: sets compared", fontsize=11, color=INK, x=0.01, ha="left")
    return figure


def torque_figure(t: TorqueSpread, labels: Sequence[str], robot: str) -> "Figure":
    """Per joint: differences between models against what their covariances claim, and, with a log,
    every model's error."""
    n, m = len(t.size), len(labels)
    figure = new_figure(9, 3.6 if t.errors is None else 6.4)
    grid = figure.subplots(1 if t.errors is None else 2, 1, squeeze=False)[:, 0]
    axes = styled(grid[0])
    bars = [("std between models", t.spread, BLUE)]
    if t.claimed is not None:
        bars.append(("std that their covariances claim", t.claimed, GREY))
    width = 0.8 / len(bars)
    for k, (label, values, colour) in enumerate(bars):
        x = [j + (k - (len(bars) - 1) / 2) * width for j in range(n)]
        axes.bar(x, values.tolist(), width * 0.94, color=colour, label=label)
    for j in range(n):
        share = 100 * float(t.spread[j] / t.size[j].clamp(min=1e-12))
        top = max(float(v[j]) for _, v, _ in bars)
        axes.annotate(
            f"{share:.2g} %", (j, top), xytext=(0, 2), textcoords="offset points",
            ha="center", fontsize=7, color=INK,
        )  # fmt: skip
    axes.margins(y=0.15)
    axes.set_ylabel("RMS [N m; N]", fontsize=8, color=INK)
    axes.set_title(
        f"differences on {t.source} (in % of the joint's RMS torque)", fontsize=8, color=INK
    )
    axes.legend(fontsize=8, frameon=False)
    if t.errors is not None:
        below = styled(grid[1])
        for k, label in enumerate(labels):
            x = [j + ((k + 0.5) / m - 0.5) * 0.8 for j in range(n)]
            below.bar(
                x, t.errors[k].tolist(), 0.75 / m, color=COLOURS[k % len(COLOURS)], label=label
            )
        below.set_ylabel("RMS [N m; N]", fontsize=8, color=INK)
        below.set_title("measured torque - model", fontsize=8, color=INK)
        below.legend(fontsize=8, frameon=False)
    for part in grid:
        part.set_xticks(range(n), [f"joint {j + 1}" for j in range(n)], fontsize=8)
    figure.suptitle(f"{robot}: torque of {m} models", fontsize=11, color=INK, x=0.01, ha="left")
    return figure


def _legend(figure: "Figure", labels: Sequence[str]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=COLOURS[k % len(COLOURS)], marker="o", markersize=4, label=label)
        for k, label in enumerate(labels)
    ]
    figure.legend(
        handles=handles, loc="outside upper right", ncols=min(4, len(labels)), frameon=False,
        fontsize=8,
    )  # fmt: skip
