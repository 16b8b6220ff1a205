"""What every figure is built of. matplotlib is imported when a figure is drawn, never before."""

import io
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from torchid.files import atomic_write
from torchid.report.colours import BLUE, GREY, GRID, INK
from torchid.typing import Tensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure
else:
    Figure = Any  # matplotlib is slow to import, and most commands draw nothing

Figures = Mapping[str, Callable[..., Figure | None]]
"""What draws each figure, by its name; None where there is nothing to show."""

MOST_POINTS = 1000
"""Of a curve."""
SMALL = 8
"""Size of words beside marks and bars."""
_LETTER, _WIDEST = 0.082, 12.0  # of a title [inches], and of a figure that is widened for it


@dataclass(frozen=True)
class Picture:
    """A figure that is drawn when it is needed.

    Attributes:
        name: unique on its page, of letters, digits and underscores.
        caption: what is shown, and what to see in it.
        alt: what those who do not see it must know.
        draw: the figure.
        narrow: the same figure for a phone; None where the wide one scrolls sideways there.
    """

    name: str
    caption: str
    alt: str
    draw: Callable[[], Figure]
    narrow: Callable[[], Figure] | None = None


def new_figure(width: float, height: float) -> Figure:
    """An empty figure that needs no display; a notebook shows it, with no backend chosen."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    figure._repr_png_ = partial(_png, figure)  # type: ignore[attr-defined]
    return figure


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=90)
    return stream.getvalue()


def styled(axes: Any) -> Any:
    """Quiet axes: no box, light grid, small labels."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)
    for axis in (axes.xaxis, axes.yaxis):
        axis.label.set(fontsize=8, color=INK)
    axes.grid(True, color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, colors=INK)
    return axes


def panel(width: float, height: float, *shape: int, **subplots: Any) -> tuple[Figure, Any]:
    """A figure of one panel, or of rows and columns of them as `subplots` gives them."""
    figure = new_figure(width, height)
    axes = figure.subplots(*shape, **subplots)
    for one in np.ravel(axes):
        styled(one)
    return figure, axes


def joint_rows(
    n: int,
    headings: Sequence[str],
    size: tuple[float, float],
    units: Sequence[str] = (),
    x: str = "time [s]",
    **grid: Any,
) -> tuple[Figure, Any]:
    """A figure of one row a joint, and its panels (n, columns).

    Args:
        n: joints.
        headings: of the columns.
        size: width and height [inch].
        units: of the joints' ordinates.
        x: of the abscissa.
        grid: of `subplots`.
    """
    figure, panels = panel(*size, n, len(headings), sharex=True, squeeze=False, **grid)
    for j, axes in enumerate(panels[:, 0]):
        axes.set_ylabel(f"joint {j + 1}" + (f" [{units[j]}]" if units else ""))
    for axes, heading in zip(panels[0], headings, strict=True):
        axes.set_title(heading, fontsize=9, color=INK)
    for axes in panels[-1]:
        axes.set_xlabel(x)
    return figure, panels


def tiles(
    titles: Sequence[str],
    columns: int,
    width: float,
    heights: tuple[float, float],
    x: str = "",
    y: str = "",
    loc: str = "center",
    **share: Any,
) -> tuple[Figure, list[Any]]:
    """A figure of one panel a title, labelled at its left and below the lowest of each column.

    Args:
        titles: of the panels.
        columns: panels in a row.
        width: of the figure [inch].
        heights: of a row of panels, and of all that is above and below them [inch].
        x, y: of the abscissa and the ordinate.
        loc: of the titles.
        share: `sharex` and `sharey` of `subplots`.
    """
    n, rows = len(titles), -(-len(titles) // columns)
    figure = new_figure(width, heights[0] * rows + heights[1])
    grid = figure.subplots(rows, columns, squeeze=False, **share).flatten()
    for axes in grid[n:]:
        axes.set_visible(False)
    for k, (axes, title) in enumerate(zip(grid, titles, strict=False)):
        styled(axes).set_title(title, fontsize=9, color=INK, loc=loc)
        if k % columns == 0:
            axes.set_ylabel(y)
        if x and k + columns >= n:
            axes.set_xlabel(x)
            # sharex hides the labels of a panel that has an empty one below it.
            axes.tick_params(labelbottom=True)
    return figure, list(grid[:n])


def joint_lines(
    title: str,
    y: str,
    t: np.ndarray,
    curves: Mapping[str, tuple[np.ndarray, Mapping[str, Any]]],
    x: str = "time [s]",
) -> tuple[Figure, list[Any]]:
    """Curves over time, a panel a joint: in a row up to three joints, else in two columns.

    Args:
        title: of the figure.
        y, x: of the ordinate and the abscissa.
        t: (T,) the abscissa.
        curves: (T, n) values and the line's style by name.
    """
    n = next(iter(curves.values()))[0].shape[-1]
    joints = [f"joint {j + 1}" for j in range(n)]
    figure, panels = tiles(joints, n if n <= 3 else 2, 11.0, (2.0, 1.1), x, y, "left", sharex=True)
    for j, axes in enumerate(panels):
        for name, (values, style) in curves.items():
            axes.plot(t, values[:, j], label=name, **style)
    return finish(figure, title, panels[0], columns=len(curves)), panels


def rows_of(axes: Any, names: Sequence[str], size: float = 7) -> None:
    """One name a row, the first on top."""
    axes.set_yticks(range(len(names)), names, fontsize=size)
    axes.set_ylim(len(names) - 0.4, -0.6)


def finish(
    figure: Figure,
    title: str,
    *axes: Any,
    columns: int = 4,
    keys: Mapping[str, Mapping[str, Any]] | None = None,
) -> Figure:
    """Title at the left, for which the figure is made wide enough; below all panels one legend of
    what the given ones hold, each name once, and of `keys`, names of lines with their styles."""
    from matplotlib.lines import Line2D

    handles: dict[str, Any] = {}
    for part in axes:
        handles |= dict(zip(*reversed(part.get_legend_handles_labels()), strict=True))
    handles |= {name: Line2D([], [], **style) for name, style in (keys or {}).items()}
    if handles:
        figure.legend(
            list(handles.values()), list(handles), loc="outside lower center", ncols=columns,
            frameon=False, fontsize=8,
        )  # fmt: skip
    figure.suptitle(title, fontsize=11, color=INK, x=0.01, ha="left")
    figure.set_figwidth(max(figure.get_figwidth(), min(_LETTER * len(title), _WIDEST)))
    return figure


def shaded_map(
    axes: Any,
    shades: np.ndarray,
    columns: Sequence[str],
    rows: Sequence[str],
    label: str,
    most: float | None = None,
) -> Any:
    """A map of rows and columns; blue over whatever ground the figure has, so light that ink on it
    can be read.

    Args:
        axes: of the map.
        shades: (rows, columns) from 0 on.
        columns, rows: their names.
        label: of the bar of colours, which is returned.
        most: with the deepest blue; the largest if None.
    """
    from matplotlib.colors import LinearSegmentedColormap, to_rgba

    blue = LinearSegmentedColormap.from_list("shades", [to_rgba(BLUE, 0.0), to_rgba(BLUE, 0.6)])
    image = axes.imshow(shades, cmap=blue, vmin=0, vmax=most, aspect="auto")
    axes.set_xticks(range(len(columns)), [name.replace(" ", "\n") for name in columns])
    axes.set_yticks(range(len(rows)), rows)
    # White lines between the cells, and neither box nor ticks.
    axes.set_xticks(np.arange(len(columns) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(rows) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=2)
    axes.tick_params(which="both", length=0)
    axes.tick_params(which="major", labelsize=8, labelcolor=INK)
    axes.spines[:].set_visible(False)
    bar = axes.figure.colorbar(image, ax=axes, pad=0.015, aspect=18)
    bar.outline.set_visible(False)
    bar.set_label(label, fontsize=SMALL)
    bar.ax.tick_params(labelsize=SMALL, length=0)
    return bar


def map_with_words(
    title: str,
    heading: str,
    rows: Sequence[str],
    columns: Sequence[str],
    shades: np.ndarray,
    cells: Mapping[tuple[int, int], tuple[str, dict[str, Any]]],
    label: str,
    most: float | None = None,
) -> tuple[Figure, Any]:
    """A map with words in its cells; the figure, and the bar of colours.

    Args:
        title, heading: of the figure, and above the map.
        rows, columns: their names.
        shades: (rows, columns) from 0 on.
        cells: text and style by row and column.
        label: of the bar of colours.
        most: with the deepest blue; the largest if None.
    """
    figure = new_figure(9.0, 2.0 + 0.42 * len(rows))
    axes = figure.subplots()
    scale = shaded_map(axes, shades, columns, rows, label, most)
    for (y, x), (text, style) in cells.items():
        look: Mapping[str, Any] = {"fontsize": SMALL, "color": INK} | style
        axes.text(x, y, text, ha="center", va="center", **look)
    axes.set_title(heading, fontsize=SMALL, color=INK, loc="left")
    return finish(figure, title), scale


def note(axes: Any, text: str) -> None:
    """A few words in the upper right corner of a panel."""
    axes.text(
        0.99, 0.97, text, transform=axes.transAxes, ha="right", va="top", fontsize=8, color=INK,
        bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1.0},
    )  # fmt: skip


def worst_stretch(squares: Tensor, size: int) -> tuple[slice, float]:
    """The `size` neighbouring values, or all of fewer, with the largest mean, and that mean."""
    size = min(size, len(squares))
    sums = squares.cumsum(0)
    sums = sums[size - 1 :] - torch.cat([sums.new_zeros(1), sums[: len(sums) - size]])
    start = int(sums.argmax())
    return slice(start, start + size), float(sums[start]) / size


def thin(signal: Tensor) -> np.ndarray:
    """At most `MOST_POINTS` evenly spaced instants (first axis) as an array."""
    return signal[:: max(1, -(-len(signal) // MOST_POINTS))].detach().cpu().numpy()


def printable(text: str) -> str:
    """A text without what XML and UTF-8 cannot hold: control characters, and bytes of a file's
    name that are no text."""
    return "".join(
        c if c in "\n\t" or unicodedata.category(c) not in ("Cc", "Cs", "Cn") else "\ufffd"
        for c in text
    )


def plain_texts(figure: Figure) -> None:
    """Names of robots and files are no formulas, whatever dollars they hold; labels of logarithmic
    axes are."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        words = text.get_text()
        if words and r"\mathdefault" not in words:
            text.set(text=printable(words), parse_math=False)


def _picture(figure: Figure, dpi: float) -> Any:
    """A figure as a picture of red, green and blue, drawn once: `savefig` draws twice where a
    layout is to be found."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG atomically."""
    plain_texts(figure)
    picture = _picture(figure, 130)
    with atomic_write(path, "wb") as file:
        picture.save(file, format="PNG", dpi=(130, 130))
    return path
