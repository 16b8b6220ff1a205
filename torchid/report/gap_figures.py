"""Figures of a diagnosis. matplotlib is imported when a figure is drawn."""

from typing import TYPE_CHECKING, get_args

import numpy as np

from torchid.gap.diagnosis import Diagnosis, Regime
from torchid.report.colours import AFTER, BEFORE, BLUE, GREY, INK
from torchid.report.gap_joint_figures import joint_figure
from torchid.report.gap_words import CLEAR, regime_words
from torchid.report.panels import finish, label, new_figure, panel, ruled, styled
from torchid.report.text import joint_unit, percent, torque_unit

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
    from matplotlib.colors import LinearSegmentedColormap

    regimes = get_args(Regime)
    joints = [gap.joint for gap in diagnosis.joints]
    found = {(r.joint, r.regime): r for r in diagnosis.regimes}
    figure = new_figure(9.6, 2.0 + 0.42 * len(joints))
    axes, bars = figure.subplots(1, 2, width_ratios=(4.4, 1), sharey=True)
    clear = np.zeros((len(joints), len(regimes)))
    for y, j in enumerate(joints):
        for x, name in enumerate(regimes):
            r = found.get((j, name))
            if r is None:
                continue
            # A number where the excess is clear, else a dot.
            if r.p < CLEAR and r.excess > 0:
                clear[y, x] = r.excess
                text, style = percent(r.excess).replace(" ", "\u2009"), (_SMALL, INK, "bold")
            else:
                text, style = "·", (12, GREY, "normal")
            size, colour, weight = style
            axes.text(
                x, y, text, ha="center", va="center", fontsize=size, color=colour,
                fontweight=weight,
            )  # fmt: skip
    # Blue over whatever ground the figure has, so light that ink on it can be read.
    shades = LinearSegmentedColormap.from_list("shades", [(BLUE, 0.0), (BLUE, 0.6)])
    image = axes.imshow(clear, cmap=shades, vmin=0, vmax=1, aspect="auto")
    axes.set_xticks(range(len(regimes)), [regime_words(r).replace(" ", "\n") for r in regimes])
    axes.set_yticks(range(len(joints)), [f"joint {j + 1}" for j in joints])
    ruled(axes, len(joints), len(regimes), 2)
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
    return finish(figure, f"{diagnosis.robot.name}: where the gap lies")


def bar_figure(diagnosis: Diagnosis) -> "Figure":
    """RMS of the gap before and after, joint by joint, over the noise bracket."""
    far, floor, n = diagnosis.how_far, diagnosis.floor, diagnosis.robot.n
    figure, axes = panel(2.4 + 0.85 * n, 4.3)
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
    label(axes, y=f"measured - model, RMS [{torque_unit(diagnosis.robot)}]")
    title = f"{diagnosis.robot.name}: how far the gap shrinks on data not fitted"
    return finish(figure, title, axes, columns=3 if n > 5 else 1)


def budget_figure(diagnosis: Diagnosis) -> "Figure":
    """One bar: what refitted parameters close, what effects close, what stays unexplained."""
    b = diagnosis.budget
    parts = (
        ("base parameters", b.parametric, GREY),
        ("effects", b.structural, AFTER),
        ("unexplained", b.unexplained, BEFORE),
    )
    figure, axes = panel(9.6, 1.5)
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
    label(axes, "share of the gap beyond noise")
    return finish(figure, f"{diagnosis.robot.name}: what closes the gap", axes, columns=3)


def torque_figure(diagnosis: Diagnosis, joint: int | None = None) -> "Figure":
    """Measured torque and both models on a joint (from 0; the worst, if None), in the stretch with
    the largest gap, and what is left over."""
    joint = worst_joints(diagnosis)[0] if joint is None else joint
    trace, rows, most = diagnosis.traces[0], slice(0, len(diagnosis.traces[0].valid)), -1.0
    for own in diagnosis.traces:
        length = min(len(own.valid), max(2, round(_SHORTEST * own.rate)))
        squared = (own.measured - own.before)[:, joint].square() * own.valid
        sums = np.concatenate([[0.0], squared.cumsum(0).numpy()])
        windows = sums[length:] - sums[:-length]
        start = int(windows.argmax())
        if windows[start] / length > most:
            trace, rows, most = own, slice(start, start + length), windows[start] / length
    step = max(1, (rows.stop - rows.start) // _MOST_POINTS)
    pick = slice(rows.start, rows.stop, step)
    t = np.arange(rows.start, rows.stop, step) / trace.rate
    valid = trace.valid[pick].numpy()
    measured, before, after = (
        np.where(valid, x[pick, joint].numpy(), np.nan)
        for x in (trace.measured, trace.before, trace.after)
    )
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
    unit = joint_unit(diagnosis.robot, joint)
    label(upper, y=f"torque [{unit}]")
    label(lower, f"time in {trace.name} [s]", f"measured - model [{unit}]")
    lower.set_xlim(t[0], t[-1])
    title = f"{diagnosis.robot.name}: torque of joint {joint + 1} on data not fitted"
    return finish(figure, title, upper, lower)
