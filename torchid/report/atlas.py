"""The null-space atlas for people: which parameters the torque determines, and how far."""

from typing import TYPE_CHECKING

import torch
from rich.table import Table

from torchid.extraction.convex.atlas import Atlas
from torchid.extraction.problem import Problem
from torchid.report.figures import GREEN, GREY, INK, ORANGE, RED, new_figure, styled
from torchid.report.identification import compact
from torchid.robot.inertia import InertialParameters

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_KNOWN, _NARROWED = 0.01, 0.5
"""Shares of the bounds' range below which a parameter counts as known, and as narrowed."""
_OUTSIDE = 1e-6
"""Share of an interval between bounds by which a set at an end may miss it: rounding."""


def headline(atlas: Atlas, problem: Problem) -> str:
    """How many parameters the torque determines, narrows and leaves open."""
    share = atlas.narrowed
    known = int((share < _KNOWN).sum())
    some = int(((share >= _KNOWN) & (share < _NARROWED)).sum())
    meaning = {
        "exact": "reproduce the base parameters exactly",
        "least loss": "have nearly the least loss that is possible",
        "confidence": "lie in the confidence region of the base parameters",
    }
    text = (
        f"Of {len(atlas.names)} physical parameters of {problem.robot.name}, over feasible sets "
        f"that {meaning.get(atlas.kind, atlas.kind)}: {known} are known to 1 % of their bounds, "
        f"{some} are narrowed to less than half, {len(atlas.names) - known - some} hardly or not "
        "at all."
    )
    if atlas.widened:
        text += " No feasible set lies in the confidence region; it was widened until one does."
    outside = _ends_outside(atlas, problem)
    if outside:
        text += (
            f" The bounds of the barycentric inertias count by a relaxation: the sets at {outside} "
            f"of {atlas.low.numel() * 2} ends are outside them, so ranges may be narrower than "
            "shown."
        )
    return text


def _ends_outside(atlas: Atlas, problem: Problem) -> int:
    """How many sets at the ends do not meet the bounds of the barycentric inertias."""
    sets = InertialParameters.from_paper_order(atlas.extremes[..., : 10 * problem.n])
    inertia = sets.inertia_about_com
    low, high = problem.bounds.inertia.to(inertia).unbind(-1)
    slack = _OUTSIDE * (high - low)
    out = (inertia < low - slack) | (inertia > high + slack)
    return int(out.flatten(2).any(-1).sum())


def atlas_table(atlas: Atlas) -> Table:
    """One row a parameter: range, range of the bounds, share."""
    table = compact("ranges over feasible sets of equal torque")
    for heading in ("parameter", "low", "high", "unit", "within the bounds alone", "share %"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    for k, name in enumerate(atlas.names):
        share = float(atlas.narrowed[k])
        colour = "green" if share < _KNOWN else "yellow" if share < _NARROWED else "red"
        table.add_row(
            name,
            f"{float(atlas.low[k]):.4g}",
            f"{float(atlas.high[k]):.4g}",
            atlas.units[k],
            f"{float(atlas.bounds_low[k]):.3g} .. {float(atlas.bounds_high[k]):.3g}",
            f"[{colour}]{100 * share:.2g}[/]",
        )
    return table


def atlas_figure(atlas: Atlas, problem: Problem) -> "Figure":
    """Each parameter's range inside the range that the bounds alone allow."""
    names = list(atlas.names)
    columns = [
        ("masses", [k for k, n in enumerate(names) if n.startswith("m")]),
        ("centres of mass", [k for k, n in enumerate(names) if n.startswith("c")]),
        ("inertias about the link frame", [k for k, n in enumerate(names) if n.startswith("J")]),
    ]
    rest = [k for k, n in enumerate(names) if n[0] not in "mcJ"]
    if rest:
        columns.append(("coefficients", rest))
    tallest = max(len(rows) for _, rows in columns)
    figure = new_figure(11, 1.6 + 0.17 * tallest)
    grid = figure.subplots(1, len(columns), squeeze=False)[0]
    low, high = (
        (end - atlas.bounds_low) / (atlas.bounds_high - atlas.bounds_low)
        for end in (atlas.low, atlas.high)
    )
    for axes, (title, rows) in zip(grid, columns, strict=True):
        styled(axes)
        for y, k in enumerate(rows):
            share = float(atlas.narrowed[k])
            colour = GREEN if share < _KNOWN else ORANGE if share < _NARROWED else RED
            colour = GREY if not bool(torch.isfinite(low[k] + high[k])) else colour
            start, end = float(low[k].nan_to_num(0.0)), float(high[k].nan_to_num(1.0))
            axes.plot([0, 1], [y, y], color="#eaeef2", linewidth=4, solid_capstyle="butt")
            axes.plot([start, end], [y, y], color=colour, linewidth=4, solid_capstyle="butt")
            axes.plot([(start + end) / 2], [y], "|", color=colour, markersize=7)
        axes.set_yticks(range(len(rows)), [names[k] for k in rows], fontsize=7)
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set_xlim(-0.02, 1.02)
        axes.set_title(title, fontsize=9, color=INK)
        axes.grid(False, axis="y")
    grid[1].set_xlabel(
        "0 and 1: least and largest value that feasible sets of any torque have within the bounds",
        fontsize=8, color=INK,
    )  # fmt: skip
    handles = [figure.axes[0].plot([], [], color=c, linewidth=4)[0] for c in (GREEN, ORANGE, RED)]
    figure.legend(
        handles,
        ["known to 1 % of its bounds", "narrowed to less than half", "hardly or not narrowed"],
        loc="outside lower center", ncols=3, frameon=False, fontsize=8,
    )  # fmt: skip
    figure.suptitle(
        f"{problem.robot.name}: what the torque determines",
        fontsize=11,
        color=INK,
        x=0.01,
        ha="left",
    )
    return figure
