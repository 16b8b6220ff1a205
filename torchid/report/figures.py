"""Figures of an identification, and where others find what figures are built of."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from torchid.identification.identify import Identification
from torchid.identification.validation import Prediction
from torchid.report.colours import BLUE, GREEN, GREY, INK, ORANGE, RED
from torchid.report.panels import finish, label, new_figure, panel, rows_of, save, styled
from torchid.report.text import short
from torchid.typing import Tensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "BLUE", "GREEN", "GREY", "INK", "ORANGE", "RED", "new_figure", "parameter_figure", "save",
    "styled", "torque_figure", "truth_figure",
]  # fmt: skip

_MOST_POINTS = 4000


def torque_figure(prediction: Prediction, units: Sequence[str], title: str) -> "Figure":
    """Measured and predicted torque per joint, the residual beside it on its own scale."""
    n = prediction.measured.shape[1]
    figure = new_figure(11, 1.2 + 1.35 * n)
    grid = figure.subplots(n, 2, sharex=True, squeeze=False, width_ratios=(3, 2))
    step = slice(None, None, max(1, len(prediction.t) // _MOST_POINTS))
    t = (prediction.t - prediction.t[0])[step].numpy()
    measured, predicted = (x[step].numpy() for x in (prediction.measured, prediction.predicted))
    moving = prediction.moving[step].numpy()
    for j in range(n):
        left, right = styled(grid[j, 0]), styled(grid[j, 1])
        left.plot(t, measured[:, j], color=INK, linewidth=1.6, label="measured")
        left.plot(t, predicted[:, j], color=BLUE, linewidth=1.0, label="model")
        label(left, y=f"joint {j + 1} [{units[j]}]")
        error = measured[:, j] - predicted[:, j]
        right.plot(t, error, color=ORANGE, linewidth=0.9, label="measured - model")
        low, high = right.get_ylim()
        right.fill_between(
            t, low, high, where=~moving[:, j], color=GREY, alpha=0.25, linewidth=0,
            label="joint at rest",
        )  # fmt: skip
        right.set_ylim(low, high)
        size = max(float(np.linalg.norm(measured[:, j])), 1e-300)
        right.text(
            0.995, 0.97, f"{100 * float(np.linalg.norm(error)) / size:.1f} %",
            transform=right.transAxes, ha="right", va="top", fontsize=8, color=INK,
        )  # fmt: skip
    for axes in grid[-1]:
        label(axes, "time [s]")
    return finish(figure, title, *grid[0])


def parameter_figure(result: Identification) -> "Figure":
    """Each estimated parameter's 95 % interval relative to its value: what the log determines."""
    relative = result.uncertainty.quantile() * result.relative_std_percent
    shown = [k for k in range(len(result.base)) if bool(result.free[k])]
    order = sorted(shown, key=lambda k: float(relative[k]))
    figure, axes = panel(9, 1.4 + 0.19 * len(order))
    values = [max(1e-3, min(float(relative[k]), 1e3)) for k in order]
    colours = [GREEN if v < 30 else ORANGE if v < 100 else RED for v in values]
    axes.barh(range(len(order)), values, left=1e-3, color=colours, height=0.7)
    axes.set_xscale("log")
    axes.set_xlim(max(1e-3, min(values) / 2), 1.1e3)
    rows_of(axes, [short(result.base.names[k], 44) for k in order])
    axes.axvline(100, color=INK, linewidth=0.8)
    label(axes, "half-width of the 95 % interval, % of the value (100 %: cannot be told from zero)")
    return finish(figure, f"{result.robot.name}: how well each parameter is known")


def truth_figure(result: Identification, truth: Tensor) -> "Figure":
    """Errors against known true values, in units of each parameter's 95 % interval."""
    half = result.uncertainty.quantile() * result.std
    shown = [k for k in range(len(result.base)) if bool(result.free[k])]
    error = ((result.values - truth) / half)[shown].numpy()
    figure, axes = panel(9, 1.4 + 0.19 * len(shown))
    axes.axvspan(-1, 1, color=GREEN, alpha=0.12, linewidth=0)
    axes.axvline(0, color=GREY, linewidth=0.8)
    colours = [BLUE if abs(e) <= 1 else RED for e in error]
    axes.scatter(error, range(len(shown)), color=colours, s=18)
    rows_of(axes, [short(result.base.names[k], 44) for k in shown])
    limit = max(2.0, 1.1 * float(np.abs(error).max()))
    axes.set_xlim(-limit, limit)
    label(axes, "(identified - true) / half-width of the 95 % interval")
    return finish(figure, f"{result.robot.name}: identified against true values")
