"""Figures of a score: what was named for what, and from which size on. matplotlib is imported when
a figure is drawn."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from torchid.report.figures import BLUE, GREY, INK, ORANGE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SMALL = 8
_COLUMNS = 3
_TICKS = (0.1, 0.3, 1, 3, 10, 30, 100)

Matrix = Mapping[str, Mapping[str, int]]


def figures(summary: Mapping[str, Any]) -> dict[str, "Figure"]:
    """All figures that there are data for, by the names of their files."""
    scores = summary["scores"]
    out = {}
    if scores["confusion"] or scores["confusion_outside"]:
        out["confusion"] = confusion_figure(scores["confusion"], scores["confusion_outside"])
    if scores["detection"]:
        out["detection"] = detection_figure(scores["detection"])
    return out


def confusion_figure(inside: Matrix, outside: Matrix) -> "Figure":
    """Planted causes (rows) and what was named first (columns): share of the row as colour, cases
    as number. Causes outside the library are below the line, and have no right name."""
    rows = [*sorted(inside), *sorted(outside)]
    columns = _columns(inside, outside)
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
                axes.add_patch(_frame(x, y))
    names = [_words(c) for c in columns]
    axes.set_xticks(range(len(columns)), names, rotation=60, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(rows)), [_words(r) for r in rows])
    _grid(axes, len(rows), len(columns))
    if inside and outside:
        axes.axhline(len(inside) - 0.5, color=INK, linewidth=1.0)
        axes.text(
            len(columns) - 0.4, len(inside) + 0.5 * len(outside) - 0.5, "outside\nthe library",
            fontsize=_SMALL, color=INK, va="center",
        )  # fmt: skip
    axes.set_xlabel("named first", fontsize=_SMALL, color=INK)
    axes.set_ylabel("planted", fontsize=_SMALL, color=INK)
    return _titled(figure, "What was planted and what was named first (number of cases)")


def detection_figure(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> "Figure":
    """Shares of cases detected and named over the planted size, one panel a family, with 95 %
    intervals."""
    lines = math.ceil(len(curves) / _COLUMNS)
    columns = min(_COLUMNS, len(curves))
    figure = new_figure(max(4.4, 3.2 * columns), 1.3 + 2.2 * lines)
    grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    levels = sorted({point["level"] for points in curves.values() for point in points})
    for axes, (name, points) in zip(grid.flat, curves.items(), strict=False):
        styled(axes)
        x = [point["level"] for point in points]
        for which, colour, style in (("detected", ORANGE, (0, (4, 2))), ("named", BLUE, "-")):
            rates = [point[which] for point in points]
            axes.fill_between(
                x, [100 * r["ci95"][0] for r in rates], [100 * r["ci95"][1] for r in rates],
                color=colour, alpha=0.13, linewidth=0,
            )  # fmt: skip
            axes.plot(
                x, [100 * r["share"] for r in rates], color=colour, linestyle=style, marker="o",
                markersize=3, linewidth=1.5, label=which,
            )  # fmt: skip
        axes.set_xscale("log")
        axes.set_xlim(0.8 * levels[0], 1.25 * levels[-1])
        ticks = [x for x in _TICKS if 0.8 * levels[0] <= x <= 1.25 * levels[-1]]
        axes.set_xticks(ticks, [f"{x:g}" for x in ticks])
        axes.minorticks_off()
        axes.set_ylim(-4, 104)
        axes.set_title(_words(name), fontsize=_SMALL + 1, color=INK, loc="left")
    for axes in list(grid.flat)[len(curves) :]:
        axes.set_visible(False)
    _label_edges(grid, len(curves))
    handles, labels = grid.flat[0].get_legend_handles_labels()
    figure.legend(
        handles, [f"{label} (band: 95 %)" for label in labels], loc="outside lower center",
        ncols=2, frameon=False, fontsize=_SMALL,
    )  # fmt: skip
    return _titled(figure, "Detected and named, by the size of what was planted")


def _label_edges(grid: Any, count: int) -> None:
    """Axis labels on the left, and on the lowest panel of every column."""
    for axes in grid[:, 0]:
        axes.set_ylabel("cases [%]", fontsize=_SMALL, color=INK)
    lines, columns = grid.shape
    for column in range(columns):
        lowest = max(k for k in range(lines) if k * columns + column < count)
        grid[lowest, column].set_xlabel("size / noise", fontsize=_SMALL, color=INK)
        grid[lowest, column].tick_params(labelbottom=True)


def _columns(inside: Matrix, outside: Matrix) -> list[str]:
    """Names said: those that were planted first, in the same order, then others, then none."""
    said = {name for matrix in (inside, outside) for row in matrix.values() for name in row}
    planted = [name for name in sorted(inside) if name in said]
    nothing = sorted(name for name in said if name.startswith("("))
    return [*planted, *sorted(said - set(planted) - set(nothing)), *nothing]


def _frame(x: int, y: int) -> Any:
    """Around the right answer."""
    from matplotlib.patches import Rectangle

    return Rectangle((x - 0.5, y - 0.5), 1, 1, fill=False, edgecolor=GREY, linewidth=1.0)


def _grid(axes: Any, rows: int, columns: int) -> None:
    """White lines between cells."""
    axes.set_xticks(np.arange(columns + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(rows + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=1.5)
    axes.tick_params(which="both", length=0)
    axes.tick_params(which="major", labelsize=_SMALL, labelcolor=INK)
    for side in axes.spines.values():
        side.set_visible(False)


def _words(name: str) -> str:
    return name.replace("_", " ")


def _titled(figure: "Figure", text: str) -> "Figure":
    figure.suptitle(text, fontsize=11, color=INK, x=0.01, ha="left")
    return figure
