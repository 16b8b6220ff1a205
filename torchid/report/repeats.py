"""Whether causes are the same in every motion, for the page of any diagnosis."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from torchid.gap.record import GapRecord
from torchid.position.record import EffectRecord, PositionRecord
from torchid.report.colours import AFTER, GREY, INK
from torchid.report.panels import SMALL, Figure, Picture, finish, new_figure, styled
from torchid.results.replication import Replication, times
from torchid.results.words import effect_words
from torchid.statistics.proportion import HALF_95

ABREAST = 4
"""Panels in a line of findings' replications."""


def repeats_pictures(record: GapRecord | PositionRecord) -> list[Picture]:
    """One, where causes can be asked whether they repeat."""
    return [
        Picture(
            "repeats",
            "Is it the same in every motion? By which factor each motion, or part of one, wants a "
            "cause: 1 is as it was fitted to all, 0 not at all. The grey band is where the next "
            "motion's would lie. A law repeats; what one motion alone wants is misfit.",
            "Factor of each cause, motion by motion.",
            figure,
        )
        for figure in repeats_figures(record).values()
    ]


def repeats_figures(record: GapRecord | PositionRecord) -> dict[str, Callable[[], Figure]]:
    """The same figure by its name."""
    if not any(found.replication for found in record.which):
        return {}
    return {"repeats": partial(repeats_figure, record)}


def _replicated(record: GapRecord | PositionRecord) -> Iterator[tuple[str, Replication]]:
    """Causes with joints, and what motions say of them."""
    for found in record.which:
        if found.replication is not None:
            joints = found.joints if isinstance(found, EffectRecord) else found.located
            where = ", ".join(str(j + 1) for j in joints)
            name = effect_words(found.effect) + (f" {where}" if where else "")
            yield name, found.replication


def repeats_figure(record: GapRecord | PositionRecord) -> Figure:
    """A panel a finding: by which factor each part of the data wants it, 1 as it was fitted."""
    shown = list(_replicated(record))
    columns = min(ABREAST, len(shown))
    lines = -(-len(shown) // columns)
    figure = new_figure(9.6, 0.8 + 1.9 * lines)
    grid = figure.subplots(lines, columns, sharey=True, squeeze=False)
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    for (name, found), axes in zip(shown, grid.flat, strict=False):
        styled(axes)
        x = np.arange(1, len(found.motions) + 1)
        scale = np.array([m.scale for m in found.motions])
        std = np.array([m.std for m in found.motions])
        half = HALF_95 * found.next_std
        axes.axhspan(found.mean - half, found.mean + half, color=GREY, alpha=0.35, linewidth=0)
        axes.axhline(0, color=INK, linewidth=0.6)
        axes.axhline(found.mean, color=AFTER, linewidth=1)
        axes.errorbar(x, scale, HALF_95 * std, fmt="o", color=AFTER, markersize=4, linewidth=1)
        axes.set(xlim=(0.5, len(x) + 0.5), ylim=(-1, 3))
        axes.set_xticks(x if len(x) <= 12 else x[:: len(x) // 6])
        axes.set_title(f"{name}: {times(found)}", fontsize=SMALL, color=INK, loc="left")
    for axes in grid[:, 0]:
        axes.set_ylabel("factor")
    for axes in grid[-1]:
        axes.set_xlabel("motion, or part of one")
    return finish(figure, f"{record.robot}: is it the same in every motion?")
