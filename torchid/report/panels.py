"""What every figure is built of. matplotlib is imported when a figure is drawn, never before."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from torchid.files import atomic_write
from torchid.report.colours import GREY, GRID, INK
from torchid.report.text import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def new_figure(width: float, height: float) -> "Figure":
    """An empty figure in the house style, with a canvas that needs no display."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context():
        figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def styled(axes: Any) -> Any:
    """Quiet axes: no box, light grid, small labels."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(GREY)
    axes.grid(True, color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, colors=INK)
    return axes


def panel(width: float, height: float) -> "tuple[Figure, Any]":
    """A figure of one panel."""
    figure = new_figure(width, height)
    return figure, styled(figure.subplots())


def label(axes: Any, x: str = "", y: str = "", title: str = "", size: float = 8) -> Any:
    """What a panel's axes show, in ink."""
    if x:
        axes.set_xlabel(x, fontsize=size, color=INK)
    if y:
        axes.set_ylabel(y, fontsize=size, color=INK)
    if title:
        axes.set_title(title, fontsize=size, color=INK)
    return axes


def rows_of(axes: Any, names: Sequence[str], size: float = 7) -> None:
    """One name a row, the first on top."""
    axes.set_yticks(range(len(names)), names, fontsize=size)
    axes.set_ylim(len(names) - 0.4, -0.6)


def finish(figure: "Figure", title: str, *axes: Any, columns: int = 4) -> "Figure":
    """Title at the left; below all panels one legend of what the given ones hold, each name
    once."""
    once: dict[str, Any] = {}
    for part in axes:
        handles, names = part.get_legend_handles_labels()
        once |= dict(zip(names, handles, strict=True))
    if once:
        legend_below(figure, once, columns)
    figure.suptitle(title, fontsize=11, color=INK, x=0.01, ha="left")
    return figure


def legend_below(figure: "Figure", handles: Mapping[str, Any], columns: int) -> None:
    """A legend below all panels."""
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center", ncols=columns,
        frameon=False, fontsize=8,
    )  # fmt: skip


def ruled(axes: Any, rows: int, columns: int, width: float) -> None:
    """White lines between the cells of a map, and neither box nor ticks."""
    axes.set_xticks(np.arange(columns + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(rows + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=width)
    axes.tick_params(which="both", length=0)
    axes.tick_params(which="major", labelsize=8, labelcolor=INK)
    for side in axes.spines.values():
        side.set_visible(False)


def literal(figure: "Figure") -> None:
    """Names of robots and files are no formulas, whatever dollars they hold; labels of logarithmic
    axes are."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        words = text.get_text()
        if words and r"\mathdefault" not in words:
            text.set(text=printable(words), parse_math=False)


def save(figure: "Figure", path: Path) -> Path:
    """Write a PNG atomically."""
    literal(figure)
    with atomic_write(path, "wb") as stream:
        figure.savefig(stream, format="png", dpi=130)
    return path
