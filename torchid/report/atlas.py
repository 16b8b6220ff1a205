"""The null-space atlas for people: which parameters the torque determines, and how far."""

from typing import TYPE_CHECKING

import torch
from rich.text import Text

from torchid.extraction.convex.atlas import Atlas
from torchid.extraction.problem import Problem
from torchid.report.colours import GREEN, GREY, INK, ORANGE, RED
from torchid.report.panels import finish, label, legend_below, new_figure, rows_of, styled
from torchid.report.table import Cell, Table
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
    # Sets at the ends need not meet the bounds of the barycentric inertias, which are relaxed.
    sets = InertialParameters.from_paper_order(atlas.extremes[..., : 10 * problem.n])
    inertia = sets.inertia_about_com
    low, high = problem.bounds.inertia.to(inertia).unbind(-1)
    slack = _OUTSIDE * (high - low)
    out = (inertia < low - slack) | (inertia > high + slack)
    outside = int(out.flatten(2).any(-1).sum())
    if outside:
        text += (
            f" The bounds of the barycentric inertias count by a relaxation: the sets at {outside} "
            f"of {atlas.low.numel() * 2} ends are outside them, so ranges may be narrower than "
            "shown."
        )
    return text


def atlas_table(atlas: Atlas) -> Table:
    """One row a parameter: range, range of the bounds, share."""
    rows: list[tuple[Cell, ...]] = []
    for k, name in enumerate(atlas.names):
        share = float(atlas.narrowed[k])
        colour = "green" if share < _KNOWN else "yellow" if share < _NARROWED else "red"
        ends = (f"{float(end[k]):.4g}" for end in (atlas.low, atlas.high))
        bounds = f"{float(atlas.bounds_low[k]):.3g} .. {float(atlas.bounds_high[k]):.3g}"
        rows.append((name, *ends, atlas.units[k], bounds, Text(f"{100 * share:.2g}", colour)))
    return Table(
        "ranges over feasible sets of equal torque",
        ("parameter", "low", "high", "unit", "within the bounds alone", "share %"),
        rows,
        names=("parameter", "unit"),
    )


def atlas_figure(atlas: Atlas, problem: Problem) -> "Figure":
    """Each parameter's range inside the range that the bounds alone allow."""
    kinds = {"m": "masses", "c": "centres of mass", "J": "inertias about the link frame"}
    columns: dict[str, list[int]] = {title: [] for title in kinds.values()}
    for k, name in enumerate(atlas.names):
        columns.setdefault(kinds.get(name[0], "coefficients"), []).append(k)
    figure = new_figure(11, 1.6 + 0.17 * max(len(rows) for rows in columns.values()))
    grid = figure.subplots(1, len(columns), squeeze=False)[0]
    low, high = (
        (end - atlas.bounds_low) / (atlas.bounds_high - atlas.bounds_low)
        for end in (atlas.low, atlas.high)
    )
    for axes, (title, rows) in zip(grid, columns.items(), strict=True):
        styled(axes)
        for y, k in enumerate(rows):
            share = float(atlas.narrowed[k])
            colour = GREEN if share < _KNOWN else ORANGE if share < _NARROWED else RED
            colour = GREY if not bool(torch.isfinite(low[k] + high[k])) else colour
            start, end = float(low[k].nan_to_num(0.0)), float(high[k].nan_to_num(1.0))
            axes.plot([0, 1], [y, y], color="#eaeef2", linewidth=4, solid_capstyle="butt")
            axes.plot([start, end], [y, y], color=colour, linewidth=4, solid_capstyle="butt")
            axes.plot([(start + end) / 2], [y], "|", color=colour, markersize=7)
        rows_of(axes, [atlas.names[k] for k in rows])
        axes.set_xlim(-0.02, 1.02)
        axes.set_title(title, fontsize=9, color=INK)
        axes.grid(False, axis="y")
    label(
        grid[1],
        "0 and 1: least and largest value that feasible sets of any torque have within the bounds",
    )
    meanings = {
        "known to 1 % of its bounds": GREEN,
        "narrowed to less than half": ORANGE,
        "hardly or not narrowed": RED,
    }
    lines = {words: grid[0].plot([], [], color=c, linewidth=4)[0] for words, c in meanings.items()}
    legend_below(figure, lines, 3)
    return finish(figure, f"{problem.robot.name}: what the torque determines")
