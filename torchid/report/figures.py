"""Figures. matplotlib is imported when a figure is drawn, never before."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from torchid.files import atomic_write
from torchid.identification.identify import Identification
from torchid.identification.validation import Prediction
from torchid.report.text import printable
from torchid.typing import Tensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, BLUE, ORANGE, GREEN, RED, GREY, GRID = (
    "#22272e", "#1f6feb", "#d9730d", "#2da44e", "#cf222e", "#8c959f", "#eaeef2",
)  # fmt: skip
_MOST_POINTS = 4000


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


def torque_figure(prediction: Prediction, units: Sequence[str], title: str) -> "Figure":
    """Measured and predicted torque per joint, the residual beside it on its own scale."""
    n = prediction.measured.shape[1]
    figure = new_figure(11, 1.2 + 1.35 * n)
    grid = figure.subplots(n, 2, sharex=True, squeeze=False, width_ratios=(3, 2))
    step = max(1, len(prediction.t) // _MOST_POINTS)
    t = (prediction.t - prediction.t[0])[::step].numpy()
    measured, predicted = (x[::step].numpy() for x in (prediction.measured, prediction.predicted))
    moving = prediction.moving[::step].numpy()
    for j in range(n):
        left, right = styled(grid[j, 0]), styled(grid[j, 1])
        left.plot(t, measured[:, j], color=INK, linewidth=1.6, label="measured")
        left.plot(t, predicted[:, j], color=BLUE, linewidth=1.0, label="model")
        left.set_ylabel(f"joint {j + 1} [{units[j]}]", fontsize=8, color=INK)
        error = measured[:, j] - predicted[:, j]
        right.plot(t, error, color=ORANGE, linewidth=0.9, label="measured - model")
        low, high = right.get_ylim()
        right.fill_between(
            t, low, high, where=~moving[:, j], color=GREY, alpha=0.25, linewidth=0,
            label="joint at rest",
        )  # fmt: skip
        right.set_ylim(low, high)
        share = (
            100 * float(np.linalg.norm(error)) / max(float(np.linalg.norm(measured[:, j])), 1e-300)
        )
        right.text(
            0.995, 0.97, f"{share:.1f} %", transform=right.transAxes, ha="right", va="top",
            fontsize=8, color=INK,
        )  # fmt: skip
    for axes in grid[-1]:
        axes.set_xlabel("time [s]", fontsize=8, color=INK)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    more, more_labels = grid[0, 1].get_legend_handles_labels()
    figure.legend(
        handles + more, labels + more_labels, loc="outside lower center", ncols=4,
        frameon=False, fontsize=8,
    )  # fmt: skip
    figure.suptitle(title, fontsize=11, color=INK, x=0.01, ha="left")
    return figure


def parameter_figure(result: Identification) -> "Figure":
    """Each estimated parameter's 95 % interval relative to its value: what the log determines."""
    relative = result.uncertainty.quantile() * result.relative_std_percent
    shown = [k for k in range(len(result.base)) if bool(result.free[k])]
    order = sorted(shown, key=lambda k: float(relative[k]))
    figure = new_figure(9, 1.4 + 0.19 * len(order))
    axes = styled(figure.subplots())
    values = [max(1e-3, min(float(relative[k]), 1e3)) for k in order]
    colours = [GREEN if v < 30 else ORANGE if v < 100 else RED for v in values]
    axes.barh(range(len(order)), values, left=1e-3, color=colours, height=0.7)
    axes.set_xscale("log")
    axes.set_xlim(max(1e-3, min(values) / 2), 1.1e3)
    axes.set_yticks(range(len(order)), [_short(result.base.names[k]) for k in order], fontsize=7)
    axes.set_ylim(len(order) - 0.4, -0.6)
    axes.axvline(100, color=INK, linewidth=0.8)
    axes.set_xlabel(
        "half-width of the 95 % interval, % of the value (100 %: cannot be told from zero)",
        fontsize=8,
        color=INK,
    )
    figure.suptitle(
        f"{result.robot.name}: how well each parameter is known", fontsize=11, color=INK,
        x=0.01, ha="left",
    )  # fmt: skip
    return figure


def truth_figure(result: Identification, truth: Tensor) -> "Figure":
    """Errors against known true values, in units of each parameter's 95 % interval."""
    half = result.uncertainty.quantile() * result.std
    shown = [k for k in range(len(result.base)) if bool(result.free[k])]
    error = ((result.values - truth) / half)[shown].numpy()
    figure = new_figure(9, 1.4 + 0.19 * len(shown))
    axes = styled(figure.subplots())
    axes.axvspan(-1, 1, color=GREEN, alpha=0.12, linewidth=0)
    axes.axvline(0, color=GREY, linewidth=0.8)
    colours = [BLUE if abs(e) <= 1 else RED for e in error]
    axes.scatter(error, range(len(shown)), color=colours, s=18)
    axes.set_yticks(range(len(shown)), [_short(result.base.names[k]) for k in shown], fontsize=7)
    axes.set_ylim(len(shown) - 0.4, -0.6)
    limit = max(2.0, 1.1 * float(np.abs(error).max()))
    axes.set_xlim(-limit, limit)
    axes.set_xlabel("(identified - true) / half-width of the 95 % interval", fontsize=8, color=INK)
    figure.suptitle(
        f"{result.robot.name}: identified against true values", fontsize=11, color=INK,
        x=0.01, ha="left",
    )  # fmt: skip
    return figure


def _short(name: str, length: int = 44) -> str:
    return name if len(name) <= length else name[: length - 1] + "…"
