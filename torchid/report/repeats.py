"""Figures of every diagnosis: errors of the joints, and whether each cause repeats."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from torchid.gap.record import GapRecord
from torchid.position.record import EffectRecord, PositionRecord
from torchid.report.colours import AFTER, BEFORE, GREY, INK
from torchid.report.panels import SMALL, Figure, Picture, finish, panel, rows_of
from torchid.results.answer import Answer
from torchid.results.replication import Replication, times
from torchid.results.words import effect_words, number_list
from torchid.statistics.proportion import HALF_95

_ROW = 0.34  # height of a cause [inch]
_ENDS = (-1.0, 3.0)  # factors that are drawn; what is beyond stands at the edge


def repeats_picture(record: GapRecord | PositionRecord) -> Picture | None:
    """Whether causes repeat, where they can be asked."""
    if not any(found.replication for found in record.which):
        return None
    return Picture(
        "repeats",
        "By which factor each motion, or part of one, wants a cause: 1 is as it was fitted to "
        "all, 0 not at all; lines are 95 % intervals, and the grey bar is where the next "
        "motion's factor would lie. At the right: found in how many of the motions that can "
        "show it. A true cause repeats; what one motion alone wants is misfit.",
        "Factor of each cause, motion by motion.",
        partial(repeats_figure, record),
    )


def _replicated(record: GapRecord | PositionRecord) -> Iterator[tuple[str, Replication]]:
    """Causes with joints, and what motions say of them."""
    for found in record.which:
        if found.replication is not None:
            joints = found.joints if isinstance(found, EffectRecord) else found.located
            yield f"{effect_words(found.effect)} {number_list(joints)}".rstrip(), found.replication


def repeats_figure(record: GapRecord | PositionRecord) -> Figure:
    """A row a cause: by which factor each part of the data wants it, 1 as it was fitted."""
    shown = list(_replicated(record))
    figure, axes = panel(9.6, 1.5 + _ROW * len(shown))
    for y, (_, found) in enumerate(shown):
        half = HALF_95 * found.next_std
        axes.barh(y, 2 * half, left=found.mean - half, height=0.62, color=GREY, alpha=0.35)
        # Parts stand beneath each other, the first on top.
        apart = np.linspace(-0.26, 0.26, len(found.motions)) if len(found.motions) > 1 else [0.0]
        for off, m in zip(apart, found.motions, strict=True):
            ends = np.clip([m.scale - HALF_95 * m.std, m.scale + HALF_95 * m.std], *_ENDS)
            axes.plot(ends, [y + off] * 2, color=AFTER, linewidth=1, alpha=0.55)
            axes.plot(np.clip(m.scale, *_ENDS), y + off, "o", color=AFTER, markersize=3)
        axes.text(
            _ENDS[1], y, f" {times(found)}", va="center", fontsize=SMALL, color=INK, clip_on=False
        )
    for x, style in ((0.0, "-"), (1.0, (0, (4, 2)))):
        axes.axvline(x, color=INK, linewidth=0.7, linestyle=style, zorder=0)
    rows_of(axes, [name for name, _ in shown], SMALL)
    axes.set(xlim=_ENDS, xlabel="factor of the cause, motion by motion (1: as fitted to all)")
    return finish(figure, f"{record.robot}: found in how many motions")


def error_figure(answer: Answer, robot: str) -> Figure:
    """RMS error of each joint before and after, beside the noise."""
    joints = answer.joints
    figure, axes = panel(2.4 + 0.85 * len(joints), 4.3)
    place = np.arange(len(joints))
    before, after, low, high = (
        np.nan_to_num(np.array(values, dtype=float))
        for values in zip(*((j.before, j.after, *j.noise) for j in joints), strict=True)
    )
    top = max(float(np.max([before, after, high])), 1e-12)
    for off, heights, colour, name in (
        (-0.2, before, BEFORE, "before"), (0.2, after, AFTER, "after"),
    ):  # fmt: skip
        axes.bar(place + off, heights, 0.38, color=colour, label=name)
        for x, height in zip(place + off, heights, strict=True):
            text = f"{height:.3g}" if height else ""
            axes.text(x, height + 0.02 * top, text, ha="center", fontsize=SMALL, color=INK)
    axes.bar(
        place, np.maximum(high - low, 1e-12), 0.86, bottom=low, color=INK, alpha=0.22,
        linewidth=0, label="noise, from lowest to highest estimate",
    )  # fmt: skip
    axes.set_xticks(place, [f"joint {j.joint + 1}" for j in joints])
    axes.set(xlim=(-0.6, len(joints) - 0.4), ylim=(0, 1.12 * top))
    axes.grid(axis="x", visible=False)
    axes.set_ylabel(f"RMS error [{answer.unit}]")
    title = f"{robot}: error of each joint, before and after, on data not fitted"
    return finish(figure, title, axes, columns=3 if len(joints) > 5 else 1)
