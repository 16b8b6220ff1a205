"""What a study's figures share: a figure with its caption, panels a joint, colours, files."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch

from torchid.files import atomic_write
from torchid.report.colours import BLUE, GREEN, INK, ORANGE, RED
from torchid.report.panels import label, new_figure, styled
from torchid.typing import Tensor
from torchid.wrenches.classes import FEASIBLE, MIXED

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Section = Literal[
    "identification", "extraction", "classification", "validation", "wrenches", "payload"
]
Array = np.ndarray

REAL, KEEPS, BREAKS = INK, GREEN, RED
"""Colours of the real arm, of feasible and of infeasible sets."""
CLASS_COLOURS = {
    FEASIBLE: GREEN, "inertia only": BLUE, "CoM only": ORANGE, MIXED: RED,
}  # fmt: skip
"""Colours of the classes of reasons; the others are grey."""
STYLES: tuple[Any, ...] = ("-", "--", ":", "-.", (0, (8, 2)), (0, (4, 1, 1, 1, 1, 1)))
"""Line styles that tell apart sets of one colour."""
MOST_POINTS = 1000
_DPI = 100
_COLOURS = 256


@dataclass(frozen=True)
class Drawing:
    """A figure that is drawn when it is needed.

    Attributes:
        section: of the page.
        name: of its file, without .png.
        caption: what is seen, and what it means.
        draw: the figure.
    """

    section: Section
    name: str
    caption: str
    draw: Callable[[], "Figure"]

    @property
    def file(self) -> str:
        """Name of its file."""
        return f"{self.name}.png"

    @property
    def words(self) -> str:
        """The name as people read it."""
        return self.name.replace("_", " ")

    @property
    def plain_caption(self) -> str:
        """The caption where stars would be markup."""
        return self.caption.replace("*", "")


def save(figure: "Figure", path: Path) -> Path:
    """Write a PNG of few colours atomically: a third of the size, and nothing is lost to see."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    figure.set_dpi(_DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    size = canvas.get_width_height()
    picture = Image.frombuffer("RGBA", size, canvas.buffer_rgba()).convert("RGB")
    few = picture.quantize(_COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    with atomic_write(path, "wb") as file:
        few.save(file, format="PNG", compress_level=9)
    return path


def thin(signal: Tensor) -> Array:
    """At most `MOST_POINTS` evenly spaced instants (first axis) as an array."""
    return signal[:: max(1, -(-len(signal) // MOST_POINTS))].detach().cpu().numpy()


def joint_panels(n: int, what: str) -> "tuple[Figure, list[Any]]":
    """A figure of one panel a joint: in a row up to three joints, else in two columns."""
    columns = n if n <= 3 else 2
    rows = -(-n // columns)
    figure = new_figure(11.0, 1.1 + 2.0 * rows)
    grid = figure.subplots(rows, columns, sharex=True, squeeze=False).flatten()
    for axes in grid[n:]:
        axes.set_axis_off()
    for j, axes in enumerate(grid[:n]):
        styled(axes)
        axes.set_title(f"joint {j + 1}", fontsize=9, color=INK, loc="left")
        if j % columns == 0:
            label(axes, y=what)
        if j + columns >= n:
            # sharex hides the labels of a panel that has an empty one below it.
            label(axes, "time [s]").tick_params(labelbottom=True)
    return figure, list(grid[:n])


def note(axes: Any, text: str) -> None:
    """A few words in the upper right corner of a panel."""
    axes.text(
        0.99, 0.97, text, transform=axes.transAxes, ha="right", va="top", fontsize=8, color=INK,
        bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1.0},
    )  # fmt: skip


def headroom(axes: Any, share: float = 0.25) -> None:
    """Room above the curves for a note."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + share * (high - low))


def decades(axis: Any) -> None:
    """A logarithmic axis of whole decades, with a label at each and none between."""
    from matplotlib.ticker import NullFormatter

    low, high = axis.get_data_interval()
    if 0 < low <= high < math.inf:
        first = math.floor(math.log10(low))
        last = max(first + 1, math.ceil(math.log10(high)))
        axis.axes.set(**{f"{axis.axis_name}lim": (10.0**first, 10.0**last)})
    axis.set_minor_formatter(NullFormatter())


def spread(k: int, seed: int, width: float = 0.3) -> Array:
    """k offsets that keep the marks of one column apart."""
    return np.random.default_rng(seed).uniform(-width, width, k)


def floored(values: Tensor, floor: float) -> Array:
    """Values for a logarithmic axis: what is smaller than the floor is drawn on it."""
    return torch.nan_to_num(values, nan=torch.inf).clamp(min=floor).cpu().numpy()
