"""Figures of a diagnosis. matplotlib is imported when a figure is drawn."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from torchid.gap.diagnosis import Diagnosis, Regime, RegimeGap, Trace
from torchid.report.figures import BLUE, GREY, INK, new_figure, styled
from torchid.report.gap_joint_figures import AFTER, BEFORE, joint_figure
from torchid.report.gap_words import CLEAR, regime_words, torque_unit
from torchid.report.text import percent
from torchid.robot.model import JointType

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORST = 3
"""Joints that get a figure of their own."""

_SMALL = 8
_MOST_POINTS = 4000
_SHORTEST = 12.0
"""Seconds of a trajectory shown in the torque overlay, at most."""


def figures(diagnosis: Diagnosis) -> dict[str, "Figure"]:
    """All figures by the names of their files."""
    out = {"where": map_figure(diagnosis), "how_far": bar_figure(diagnosis)}
    if not diagnosis.traces:
        return out
    for j in worst_joints(diagnosis):
        out[f"gap_joint_{j + 1}"] = joint_figure(diagnosis, j)
    out["torque"] = torque_figure(diagnosis)
    return out


def worst_joints(diagnosis: Diagnosis, most: int = WORST) -> list[int]:
    """Joints with the largest shares of the gap, at least one, those without a share left out."""
    order = sorted(diagnosis.joints, key=lambda gap: -gap.share)
    return [gap.joint for gap in order[:most] if gap.share > 0.02] or [order[0].joint]


def map_figure(diagnosis: Diagnosis) -> "Figure":
    """Joints x regimes: excess as colour and number where clear, faint elsewhere; the joint's
    share of the gap beside it."""
    regimes = get_args(Regime)
    joints = [gap.joint for gap in diagnosis.joints]
    found = {(r.joint, r.regime): r for r in diagnosis.regimes}
    figure = new_figure(9.6, 2.0 + 0.42 * len(joints))
    axes, bars = figure.subplots(1, 2, width_ratios=(4.4, 1), sharey=True)
    clear = np.zeros((len(joints), len(regimes)))
    for y, j in enumerate(joints):
        for x, name in enumerate(regimes):
            r = found.get((j, name))
            clear[y, x] = max(0.0, r.excess) if r and r.p < CLEAR else 0.0
            if r:
                _cell(axes, x, y, r)
    image = axes.imshow(clear, cmap=_shades(), vmin=0, vmax=1, aspect="auto")
    axes.set_xticks(range(len(regimes)), [regime_words(r).replace(" ", "\n") for r in regimes])
    axes.set_yticks(range(len(joints)), [f"joint {j + 1}" for j in joints])
    _grid(axes, len(joints), len(regimes))
    bar = figure.colorbar(image, ax=axes, pad=0.015, aspect=18)
    bar.outline.set_visible(False)
    bar.set_label("share of the joint's gap beyond\nthe regime's share of time", fontsize=_SMALL)
    bar.ax.yaxis.set_major_formatter(lambda v, _: f"{100 * v:.0f} %")
    bar.ax.tick_params(labelsize=_SMALL, length=0)
    styled(bars)
    bars.barh(range(len(joints)), [gap.share for gap in diagnosis.joints], color=BEFORE, height=0.6)
    for y, gap in enumerate(diagnosis.joints):
        bars.text(gap.share + 0.03, y, percent(gap.share), va="center", fontsize=_SMALL, color=INK)
    bars.set_xlim(0, 1.3)
    bars.set_xticks([])
    bars.tick_params(which="both", length=0, labelleft=False)
    bars.grid(False)
    bars.spines["bottom"].set_visible(False)
    bars.set_title("share of the gap", fontsize=_SMALL, color=INK, loc="left")
    axes.set_title(
        f"numbers: excess where p < {CLEAR:g}, corrected over all cells; "
        "dots: nothing beyond chance",
        fontsize=_SMALL, color=INK, loc="left",
    )  # fmt: skip
    return _titled(figure, f"{diagnosis.robot.name}: where the gap lies")


def _shades() -> Any:
    """Blue over whatever ground the figure has, so light that ink on it can be read."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("shades", [(BLUE, 0.0), (BLUE, 0.6)])


def _cell(axes: Any, x: int, y: int, r: RegimeGap) -> None:
    """Number, or a dot where there is nothing to see."""
    shown = r.p < CLEAR and r.excess > 0
    text = percent(r.excess).replace(" ", "\u2009") if shown else "·"
    axes.text(
        x, y, text, ha="center", va="center", fontsize=_SMALL if shown else 12,
        color=INK if shown else GREY,
        fontweight="bold" if shown else "normal",
    )  # fmt: skip


def _grid(axes: Any, rows: int, columns: int) -> None:
    """White lines between cells."""
    axes.set_xticks(np.arange(columns + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(rows + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=2)
    axes.tick_params(which="minor", length=0)
    axes.tick_params(which="major", length=0, labelsize=_SMALL, labelcolor=INK)
    for side in axes.spines.values():
        side.set_visible(False)


def bar_figure(diagnosis: Diagnosis) -> "Figure":
    """RMS of the gap before and after, joint by joint, over the noise bracket."""
    far, floor, n = diagnosis.how_far, diagnosis.floor, diagnosis.robot.n
    figure = new_figure(2.4 + 0.85 * n, 4.3)
    axes = styled(figure.subplots())
    before, after = far.rms_before.numpy(), far.rms_after.numpy()
    place = np.arange(n)
    axes.bar(place - 0.2, before, 0.38, color=BEFORE, label="model as given")
    axes.bar(place + 0.2, after, 0.38, color=AFTER, label="with the effects found")
    low, high = floor.low.numpy(), floor.high.numpy()
    axes.bar(
        place, np.maximum(high - low, 1e-12), 0.86, bottom=low, color=INK, alpha=0.22,
        linewidth=0, label="noise, from lowest to highest estimate",
    )  # fmt: skip
    top = float(max(before.max(), after.max(), high.max()))
    for x, b, a in zip(place, before, after, strict=True):
        if b > 0 and top > 0:
            change = 100 * (a - b) / b
            text = f"{change:+.0f}\u2009%" if abs(change) >= 0.5 else "no change"
            text = text.replace("-", "\u2212")
            axes.text(x, max(a, b) + 0.02 * top, text, ha="center", fontsize=_SMALL, color=INK)
    axes.set_xticks(place, [f"joint {j + 1}" for j in range(n)])
    axes.set_xlim(-0.6, n - 0.4)
    axes.set_ylim(0, 1.12 * top if top > 0 else 1.0)
    axes.grid(axis="x", visible=False)
    unit = torque_unit(diagnosis.robot)
    axes.set_ylabel(f"measured - model, RMS [{unit}]", fontsize=_SMALL, color=INK)
    columns = 3 if n > 5 else 1
    figure.legend(loc="outside lower center", ncols=columns, frameon=False, fontsize=_SMALL)
    return _titled(figure, f"{diagnosis.robot.name}: how far the gap shrinks on data not fitted")


def budget_figure(diagnosis: Diagnosis) -> "Figure":
    """One bar: what refitted parameters close, what effects close, what stays unexplained."""
    b = diagnosis.budget
    parts = (
        ("base parameters", b.parametric, GREY),
        ("effects", b.structural, AFTER),
        ("unexplained", b.unexplained, BEFORE),
    )
    figure = new_figure(9.6, 1.5)
    axes = styled(figure.subplots())
    left = 0.0
    for name, share, colour in parts:
        width = max(0.0, share)
        axes.barh(0, width, left=left, color=colour, height=0.6, label=f"{name} {percent(share)}")
        left += width
    axes.set_xlim(0, max(1.0, left))
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.grid(axis="y", visible=False)
    axes.xaxis.set_major_formatter(lambda v, _: f"{100 * v:.0f}\u2009%")
    axes.set_xlabel("share of the gap beyond noise", fontsize=_SMALL, color=INK)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=_SMALL)
    return _titled(figure, f"{diagnosis.robot.name}: what closes the gap")


def torque_figure(diagnosis: Diagnosis, joint: int | None = None) -> "Figure":
    """Measured torque and both models on a joint (from 0; the worst, if None), in the stretch with
    the largest gap, and what is left over."""
    joint = worst_joints(diagnosis)[0] if joint is None else joint
    trace, rows = _largest_stretch(diagnosis.traces, joint)
    step = max(1, (rows.stop - rows.start) // _MOST_POINTS)
    pick = slice(rows.start, rows.stop, step)
    t = np.arange(rows.start, rows.stop, step) / trace.rate
    valid = trace.valid[pick].numpy()
    signals = [
        np.where(valid, x[pick, joint].numpy(), np.nan)
        for x in (trace.measured, trace.before, trace.after)
    ]
    measured, before, after = signals
    figure = new_figure(10, 5.4)
    upper, lower = (styled(a) for a in figure.subplots(2, 1, sharex=True, height_ratios=(3, 2)))
    upper.plot(t, measured, color=INK, linewidth=2.2, label="measured")
    upper.plot(t, before, color=BEFORE, linewidth=1.3, label="model as given")
    upper.plot(
        t, after, color=AFTER, linewidth=1.3, linestyle=(0, (5, 1.5)),
        label="with the effects found",
    )  # fmt: skip
    high = float(diagnosis.floor.high[joint])
    lower.axhspan(-high, high, color=INK, alpha=0.12, linewidth=0, label="noise, ±1 RMS")
    lower.plot(t, measured - before, color=BEFORE, linewidth=1.2)
    lower.plot(t, measured - after, color=AFTER, linewidth=1.2)
    unit = "N" if diagnosis.robot.joint_types[joint] is JointType.PRISMATIC else "N m"
    upper.set_ylabel(f"torque [{unit}]", fontsize=_SMALL, color=INK)
    lower.set_ylabel(f"measured - model [{unit}]", fontsize=_SMALL, color=INK)
    lower.set_xlabel(f"time in {trace.name} [s]", fontsize=_SMALL, color=INK)
    lower.set_xlim(t[0], t[-1])
    handles, labels = upper.get_legend_handles_labels()
    more, more_labels = lower.get_legend_handles_labels()
    figure.legend(
        handles + more, labels + more_labels, loc="outside lower center", ncols=4,
        frameon=False, fontsize=_SMALL,
    )  # fmt: skip
    return _titled(
        figure, f"{diagnosis.robot.name}: torque of joint {joint + 1} on data not fitted"
    )


def _largest_stretch(traces: Sequence[Trace], joint: int) -> tuple[Trace, slice]:
    """The trajectory, and its instants, in which the gap of a joint is largest."""
    best, where, most = traces[0], slice(0, len(traces[0].valid)), -1.0
    for trace in traces:
        length = min(len(trace.valid), max(2, round(_SHORTEST * trace.rate)))
        squared = (trace.measured - trace.before)[:, joint].square() * trace.valid
        sums = np.concatenate([[0.0], squared.cumsum(0).numpy()])
        windows = sums[length:] - sums[:-length]
        start = int(windows.argmax())
        if windows[start] / length > most:
            best, where, most = trace, slice(start, start + length), windows[start] / length
    return best, where


def _titled(figure: "Figure", text: str) -> "Figure":
    figure.suptitle(text, fontsize=11, color=INK, x=0.01, ha="left")
    return figure
