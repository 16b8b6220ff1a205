"""Figures of a diagnosis of commands and positions: where they part, what closes it, how far."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import torch

from torchid.errors import TorchidError
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.model import Replay
from torchid.position.record import PositionRecord
from torchid.report.colours import AFTER, BEFORE, BLUE, GREY, INK
from torchid.report.gap_words import effect_words, regime_words
from torchid.report.panels import (
    Figure,
    Figures,
    finish,
    joint_lines,
    new_figure,
    panel,
    ruled,
    styled,
    thin,
)

WORST = 3
"""Joints that get a figure of their own."""
MOST_FINDINGS = 16
"""That are drawn, those that close most."""
SHOWN_S = 8.0
"""Of a motion in a joint's figure [s]."""
_SMALL = 8


def figures(result: PositionDiagnosis) -> Figures:
    """What draws each figure, by the names of their files."""
    out: dict[str, Callable[[], Figure | None]] = {
        "where": partial(where_figure, result),
        "how_far": partial(error_figure, result.record),
    }
    if result.findings:
        out["which"] = partial(which_figure, result)
    return out | {
        f"gap_joint_{j + 1}": partial(joint_figure, result, j) for j in worst_joints(result)
    }


def worst_joints(result: PositionDiagnosis, most: int = WORST) -> list[int]:
    """Joints on which a plain servo is worst, those that never move left out."""
    order = result.plain_servo.whole.nan_to_num().argsort(descending=True).tolist()
    return [j for j in order if not result.still[j]][:most]


def labels(result: PositionDiagnosis) -> list[str]:
    """Joints by number and name."""
    return [f"{j + 1} {name}" for j, name in enumerate(result.data.robot.joint_names)]


def where_figure(result: PositionDiagnosis) -> Figure:
    """Joints x what the command does: the plain servo's error as colour, and what the answer leaves
    of it; beside it the joints' errors of the command alone."""
    from matplotlib.colors import LinearSegmentedColormap

    names, n = list(result.regimes), result.servos.n
    before, after = (
        torch.stack([result.regimes[name][k] for name in names], 1).numpy() for k in (0, 1)
    )
    figure = new_figure(9.0, 2.0 + 0.42 * n)
    axes, bars = figure.subplots(1, 2, width_ratios=(3, 1), sharey=True)
    shades = LinearSegmentedColormap.from_list("shades", [(BLUE, 0.0), (BLUE, 0.6)])
    image = axes.imshow(np.nan_to_num(before), cmap=shades, vmin=0, aspect="auto")
    for y in range(n):
        for x in range(len(names)):
            text = f"{before[y, x]:.1f} \u2192 {after[y, x]:.1f}"
            text = "-" if np.isnan(before[y, x]) else text
            axes.text(x, y, text, ha="center", va="center", fontsize=_SMALL, color=INK)
    axes.set_xticks(range(len(names)), [regime_words(name).replace(" ", "\n") for name in names])
    axes.set_yticks(range(n), labels(result))
    ruled(axes, n, len(names), 2)
    bar = figure.colorbar(image, ax=axes, pad=0.015, aspect=18)
    bar.outline.set_visible(False)
    bar.set_label("plain servo [mrad]", fontsize=_SMALL)
    bar.ax.tick_params(labelsize=_SMALL, length=0)
    styled(bars)
    said = result.commanded.whole.nan_to_num().numpy()
    bars.barh(range(n), said, color=GREY, height=0.6)
    for y, value in enumerate(said):
        words = " never moves" if result.still[y] else f" {value:.1f}"
        bars.text(value, y, words, va="center", fontsize=_SMALL, color=INK)
    bars.set(xlim=(0, 1.35 * max(float(said.max()), 1e-9)), xticks=[])
    bars.tick_params(which="both", length=0, labelleft=False)
    bars.grid(False)
    bars.spines["bottom"].set_visible(False)
    bars.set_title("command less position [mrad]", fontsize=_SMALL, color=INK, loc="left")
    axes.set_title(
        "error of whole motions left out [mrad]: a plain servo \u2192 with what was found",
        fontsize=_SMALL, color=INK, loc="left",
    )  # fmt: skip
    return finish(figure, f"{result.data.robot.name}: where command and position part")


def which_figure(result: PositionDiagnosis) -> Figure:
    """Effects: the error when each is left out and all others are fitted again, and with it."""
    shown = result.findings[:MOST_FINDINGS]
    figure, axes = panel(8.0, 1.6 + 0.3 * len(shown))
    names = result.data.robot.joint_names
    for y, f in enumerate(shown):
        axes.plot([f.error_with, f.error_without], [y, y], color=GREY, linewidth=2, zorder=1)
        axes.scatter([f.error_without], [y], color=BEFORE, s=28, label="without it", zorder=2)
        axes.scatter([f.error_with], [y], color=AFTER, s=28, label="with it", zorder=2)
        place = "arm" if f.joint is None else names[f.joint - 1]
        axes.text(
            f.error_without, y, f"  {f.error_without - f.error_with:.1f} mrad",
            va="center", fontsize=_SMALL, color=INK,
        )  # fmt: skip
        axes.text(
            -0.01, y, f"{effect_words(f.effect)}, {place}", ha="right", va="center",
            fontsize=_SMALL, color=INK, transform=axes.get_yaxis_transform(),
        )  # fmt: skip
    axes.set(yticks=[], ylim=(len(shown) - 0.4, -0.6), xlabel="error in windows of 2 s [mrad]")
    axes.set_xlim(0, 1.25 * max(f.error_without for f in shown))
    many = len(result.findings)
    most = f" (the {len(shown)} largest of {many})" if many > len(shown) else ""
    return finish(figure, f"what closes it: each effect left out in turn{most}", axes)


def error_figure(record: PositionRecord) -> Figure:
    """RMS errors of motions left out, joint by joint: command alone, plain servo, answer."""
    joints = record.where.joints
    figure, axes = panel(2.4 + 1.0 * len(joints), 4.0)
    place = np.arange(len(joints))
    ways = (
        ("the command alone", GREY, [j.commanded_mrad for j in joints]),
        ("a plain servo", BEFORE, [j.plain_mrad for j in joints]),
        ("with what was found", AFTER, [j.answered_mrad for j in joints]),
    )
    for k, (name, colour, errors) in enumerate(ways):
        axes.bar(place + 0.27 * (k - 1), errors, 0.25, color=colour, label=name)
        for x, error in zip(place, errors, strict=True):
            if math.isnan(error):
                continue
            axes.text(
                x + 0.27 * (k - 1), error, f"{error:.1f}", ha="center", va="bottom", fontsize=7,
                color=INK,
            )  # fmt: skip
    axes.set_xticks(place, [f"joint {j.joint + 1}" for j in joints])
    axes.set_ylabel("RMS error of whole motions left out [mrad]")
    axes.grid(False, axis="x")
    return finish(figure, "how far: motions that the model has not seen", axes)


def replay_figure(result: Replay, log: int = 0) -> Figure:
    """Command, measured and simulated position of every joint over one log's time.

    Raises:
        TorchidError: no such log.
    """
    if not 0 <= log < len(result.measured):
        raise TorchidError("there is no such log.", got=log, expected=f"0..{len(result.files) - 1}")
    real, far = result.measured[log], result.simulated[log]
    assert real.u is not None
    curves = {
        "commanded": (thin(real.u), {"color": GREY, "linewidth": 1.0}),
        "measured": (thin(real.q), {"color": INK, "linewidth": 2.0}),
        "simulated": (thin(far.q), {"color": AFTER, "linewidth": 1.0}),
    }
    title = f"{result.files[log] or result.robot}: {float(result.error[log].mean()):.1f} mrad RMS"
    # Motions one after the other, each from its own beginning.
    samples = thin(torch.arange(real.samples))
    alone = real.trajectory_count == 1
    t, x = (thin(real.t - real.t[0]), "time [s]") if alone else (samples, "sample")
    return joint_lines(title, "position [rad or m]", t, curves, x)[0]


def worst_place(result: PositionDiagnosis, joint: int) -> slice:
    """Rows of `SHOWN_S` of the motion left out in which the plain servo errs most on a joint."""
    data = result.data
    length = max(2, round(SHOWN_S / data.tracks.dt))
    best, chosen = -1.0, slice(0, 0)
    for a, b in zip(data.tracks.first.tolist(), data.tracks.last.tolist(), strict=True):
        square = result.errors[0][a : b + 1, joint].square()
        size = min(length, len(square))
        sums = square.cumsum(0)
        sums = sums[size - 1 :] - torch.cat([sums.new_zeros(1), sums[: len(sums) - size]])
        k = int(sums.argmax())
        if float(sums[k]) / size > best:
            best, chosen = float(sums[k]) / size, slice(a + k, a + k + size)
    return chosen


def joint_figure(result: PositionDiagnosis, joint: int) -> Figure:
    """One joint where a plain servo errs most: command, measured and simulated positions, and both
    models' errors below."""
    rows = worst_place(result, joint)
    log, (plain, answered) = result.data.log, result.errors
    t = log.t[rows].numpy()
    q = log.q[rows, joint]
    figure, (above, below) = panel(9.0, 4.8, 2, 1, sharex=True, height_ratios=(2, 1))
    if log.u is not None:
        above.plot(t, log.u[rows, joint].numpy(), color=GREY, linewidth=1, label="command")
    above.plot(t, q.numpy(), color=INK, linewidth=1.4, label="measured")
    for error, colour, name in (
        (plain[rows, joint], BEFORE, "a plain servo"),
        (answered[rows, joint], AFTER, "with what was found"),
    ):
        above.plot(t, (q + error).numpy(), color=colour, linewidth=1, label=name)
        below.plot(t, 1e3 * error.numpy(), color=colour, linewidth=1)
    below.axhline(0, color=INK, linewidth=0.6)
    above.set_ylabel("position [rad or m]")
    below.set(ylabel="simulated less\nmeasured [mrad]", xlabel="time [s]")
    motion = log.names[int(log.trajectory[rows.start])]
    return finish(figure, f"joint {labels(result)[joint]} in {motion}, which was left out", above)
