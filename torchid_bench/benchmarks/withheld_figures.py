"""Figures of a score: what was planted and what was named for it, and how sure and how often right.
`withheld_score.py` draws them."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from torchid.report.colours import BLUE, GREY, INK
from torchid.report.panels import (
    SMALL,
    Figure,
    Figures,
    finish,
    new_figure,
    panel,
    shaded_map,
)

Matrix = Mapping[str, Mapping[str, int]]


def figures(summary: Mapping[str, Any]) -> Figures:
    """What draws each figure that there are data for, by the names of their files."""
    scores, out = summary["scores"], {}
    inside, outside = scores["confusion"], scores["confusion_outside"]
    if inside or outside:
        out["confusion"] = partial(confusion_figure, inside, outside)
    if scores["how_sure"]["curve"]:
        out["reliability"] = partial(reliability_figure, scores["how_sure"]["curve"])
    return out


def reliability_figure(curve: Sequence[Mapping[str, Any]]) -> Figure:
    """Shares of right names over the probability that was given, with 95 % intervals."""
    figure, axes = panel(4.2, 3.4)
    axes.plot([0, 100], [0, 100], color=GREY, linewidth=1.0, label="as often as stated")
    x, y = ([100 * point[name] for point in curve] for name in ("mean", "share"))
    ends = np.array([[100 * e for e in point["ci95"]] for point in curve]).T
    axes.errorbar(
        x, y, np.abs(ends - np.array(y)), color=BLUE, marker="o", markersize=4, linewidth=1.2,
        capsize=2, label="names (95 %)",
    )  # fmt: skip
    axes.set(xlim=(-2, 102), ylim=(-2, 102))
    axes.set_xlabel("stated probability [%]", fontsize=SMALL, color=INK)
    axes.set_ylabel("right [%]", fontsize=SMALL, color=INK)
    return finish(figure, "How sure, and how often right", axes)


def confusion_figure(inside: Matrix, outside: Matrix) -> Figure:
    """Planted causes (rows) and what was named first (columns): share of the row as colour, cases
    as number. Causes outside the library are below the line, and have no right name."""
    from matplotlib.patches import Rectangle

    rows = [*sorted(inside), *sorted(outside)]
    # Names said: those that were planted first, in the same order, then others, then none.
    said = {name for matrix in (inside, outside) for row in matrix.values() for name in row}
    planted = [name for name in sorted(inside) if name in said]
    nothing = sorted(name for name in said if name.startswith("("))
    columns = [*planted, *sorted(said - set(planted) - set(nothing)), *nothing]
    table = np.array(
        [[{**inside, **outside}[r].get(c, 0) for c in columns] for r in rows], dtype=float
    )
    shares = table / np.maximum(table.sum(1, keepdims=True), 1)
    figure = new_figure(3.6 + 0.3 * len(columns), 2.6 + 0.24 * len(rows))
    axes = figure.subplots()
    names = [_words(c) for c in columns]
    shaded_map(axes, shares, names, [_words(r) for r in rows], "share of the row's cases", 1.0)
    axes.set_xticks(range(len(columns)), names, rotation=60, ha="right", rotation_mode="anchor")
    for (y, x), cases in np.ndenumerate(table):
        text = f"{cases:.0f}" if cases else ""
        axes.text(x, y, text, ha="center", va="center", fontsize=SMALL, color=INK)
        if rows[y] == columns[x]:
            corner = (x - 0.5, y - 0.5)
            axes.add_patch(Rectangle(corner, 1, 1, fill=False, edgecolor=GREY, linewidth=1.0))
    if inside and outside:
        axes.axhline(len(inside) - 0.5, color=INK, linewidth=1.0)
        axes.text(
            len(columns) - 0.4, len(inside) + 0.5 * len(outside) - 0.5, "outside\nthe library",
            fontsize=SMALL, color=INK, va="center",
        )  # fmt: skip
    axes.set_xlabel("named first", fontsize=SMALL, color=INK)
    axes.set_ylabel("planted", fontsize=SMALL, color=INK)
    return finish(figure, "What was planted and what was named first (number of cases)")


def _words(name: str) -> str:
    return name.replace("_", " ")
