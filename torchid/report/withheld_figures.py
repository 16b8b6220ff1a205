"""Figures of a score: what was named for what, and from which size on. matplotlib is imported when
a figure is drawn."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from torchid.report.colours import BLUE, GREY, INK, ORANGE
from torchid.report.panels import Figure, Figures, finish, new_figure, ruled, styled, tiles

_SMALL = 8
_COLUMNS = 3
_TICKS = (0.1, 0.3, 1, 3, 10, 30, 100)

Matrix = Mapping[str, Mapping[str, int]]


def figures(summary: Mapping[str, Any]) -> Figures:
    """What draws each figure that there are data for, by the names of their files."""
    scores, out = summary["scores"], {}
    inside, outside = scores["confusion"], scores["confusion_outside"]
    if inside or outside:
        out["confusion"] = partial(confusion_figure, inside, outside)
    if scores["detection"]:
        out["detection"] = partial(detection_figure, scores["detection"])
    if scores["how_sure"]["curve"]:
        out["reliability"] = partial(reliability_figure, scores["how_sure"]["curve"])
    return out


def reliability_figure(curve: Sequence[Mapping[str, Any]]) -> Figure:
    """Shares of right names over the probability that was given, with 95 % intervals."""
    figure = new_figure(4.2, 3.4)
    axes = styled(figure.add_subplot())
    axes.plot([0, 100], [0, 100], color=GREY, linewidth=1.0, label="as often as said")
    x, y = ([100 * point[name] for point in curve] for name in ("mean", "share"))
    ends = np.array([[100 * e for e in point["ci95"]] for point in curve]).T
    axes.errorbar(
        x, y, np.abs(ends - np.array(y)), color=BLUE, marker="o", markersize=4, linewidth=1.2,
        capsize=2, label="names (95 %)",
    )  # fmt: skip
    axes.set(xlim=(-2, 102), ylim=(-2, 102))
    axes.set_xlabel("how sure it was said to be [%]", fontsize=_SMALL, color=INK)
    axes.set_ylabel("right [%]", fontsize=_SMALL, color=INK)
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
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for y, row in enumerate(rows):
        for x, column in enumerate(columns):
            if table[y, x]:
                axes.text(
                    x, y, f"{table[y, x]:.0f}", ha="center", va="center", fontsize=_SMALL,
                    color="white" if shares[y, x] > 0.55 else INK,
                )  # fmt: skip
            if row == column:
                corner = (x - 0.5, y - 0.5)
                axes.add_patch(Rectangle(corner, 1, 1, fill=False, edgecolor=GREY, linewidth=1.0))
    names = [_words(c) for c in columns]
    axes.set_xticks(range(len(columns)), names, rotation=60, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(rows)), [_words(r) for r in rows])
    ruled(axes, len(rows), len(columns), 1.5)
    if inside and outside:
        axes.axhline(len(inside) - 0.5, color=INK, linewidth=1.0)
        axes.text(
            len(columns) - 0.4, len(inside) + 0.5 * len(outside) - 0.5, "outside\nthe library",
            fontsize=_SMALL, color=INK, va="center",
        )  # fmt: skip
    axes.set_xlabel("named first", fontsize=_SMALL, color=INK)
    axes.set_ylabel("planted", fontsize=_SMALL, color=INK)
    return finish(figure, "What was planted and what was named first (number of cases)")


def detection_figure(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    """Shares of cases detected and named over the planted size, one panel a family, with 95 %
    intervals."""
    columns = min(_COLUMNS, len(curves))
    names, width = [_words(name) for name in curves], max(4.4, 3.2 * columns)
    across: dict[str, Any] = {
        "x": "size / noise",
        "y": "cases [%]",
        "loc": "left",
        "sharex": True,
        "sharey": True,
    }
    figure, grid = tiles(names, columns, width, (2.2, 1.3), **across)
    levels = sorted({point["level"] for points in curves.values() for point in points})
    low, high = 0.8 * levels[0], 1.25 * levels[-1]
    ticks = [x for x in _TICKS if low <= x <= high]
    for axes, points in zip(grid, curves.values(), strict=True):
        x = [point["level"] for point in points]
        for which, colour, style in (("detected", ORANGE, (0, (4, 2))), ("named", BLUE, "-")):
            rates = [point[which] for point in points]
            axes.fill_between(
                x, [100 * r["ci95"][0] for r in rates], [100 * r["ci95"][1] for r in rates],
                color=colour, alpha=0.13, linewidth=0,
            )  # fmt: skip
            axes.plot(
                x, [100 * r["share"] for r in rates], color=colour, linestyle=style, marker="o",
                markersize=3, linewidth=1.5, label=f"{which} (band: 95 %)",
            )  # fmt: skip
        axes.set(xscale="log", xlim=(low, high), ylim=(-4, 104))
        axes.set_xticks(ticks, [f"{x:g}" for x in ticks])
        axes.minorticks_off()
    return finish(figure, "Detected and named, by the size of what was planted", grid[0], columns=2)


def _words(name: str) -> str:
    return name.replace("_", " ")
