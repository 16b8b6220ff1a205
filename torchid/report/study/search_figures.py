"""How a study's searches went: convergence, losses against what is possible, degrees."""

import math
from typing import Any

import numpy as np
import torch

from torchid.report.colours import BLUE, BREAKS, GREY, INK, KEEPS
from torchid.report.panels import Figure, Picture, drawing, finish, panel, spread
from torchid.report.study import facts
from torchid.report.study.facts import ids, kept, number
from torchid.report.table import count, listed
from torchid.study.result import ScenarioResult, Study
from torchid.typing import Tensor

_LEAST_PHI = 1e-32
"""Losses below it are drawn on it: the square of rounding."""
_NEAR = 1e-4
"""Degree below which a feasible set is called close to the boundary."""
_REACHED = 1.01
"""Times phi_min up to which a loss counts as having reached it."""


def search_drawings(study: Study) -> list[Picture]:
    """Convergence, losses and degrees of all runs."""
    return [
        drawing("extraction", "search_convergence", _convergence_caption(study),
                lambda: _convergence(study)),
        drawing("extraction", "search_losses", _losses_caption(study), lambda: _losses(study)),
        drawing("classification", "degrees", _degrees_caption(study), lambda: _degrees(study)),
    ]  # fmt: skip


def _convergence_caption(study: Study) -> str:
    search = study.settings.search
    sentences = []
    for s in study.scenarios:
        e = s.extraction
        first, last = (float(e.history_phi[:, k].median()) for k in (0, -1))
        sentences.append(
            f"{s.scenario.id}: median phi {number(first)} after the first stage and {number(last)} "
            f"after the last, {kept(e.searched_gamma)} of {len(e.sets)} runs without penalty"
        )
    return (
        "Loss phi (above) and penalty gamma (below) of the best point so far after each of "
        f"{search.stages} stages, before the polish; thin: all runs, thick: the run that is best "
        "in the end, red: phi_min of the scenario's bounds where it is not zero. Under the "
        "full loss xi grows from stage to stage, so phi may rise while gamma falls. "
        f"{'; '.join(sentences)}."
    )


def _convergence(study: Study) -> Figure:
    k = len(study.scenarios)
    width = max(6.0, 1.0 + 2.1 * k)
    figure, grid = panel(width, 5.6, 2, k, sharex=True, sharey="row", squeeze=False)
    gammas = torch.cat([s.extraction.history_gamma.flatten() for s in study.scenarios])
    positive = gammas[(gammas > 0) & torch.isfinite(gammas)]
    zero = 10.0 ** (math.floor(math.log10(float(positive.min()))) - 1) if len(positive) else 1e-1
    for c, s in enumerate(study.scenarios):
        e = s.extraction
        for axes, history, floor in zip(
            grid[:, c], (e.history_phi, e.history_gamma), (_LEAST_PHI, zero), strict=True
        ):
            values = _floored(history, floor)
            axes.set(yscale="log", xlabel="stage" if axes is grid[1, c] else "")
            stages = np.arange(1, values.shape[1] + 1)
            axes.plot(stages, values.T, color=GREY, linewidth=0.5, alpha=0.7)
            axes.plot(stages, values[e.best], color=BLUE, linewidth=2.0)
        least = facts.phi_min(study, s)
        if _LEAST_PHI < least < math.inf:
            grid[0, c].axhline(least, color=BREAKS, linewidth=1.2)
        heading = f"{s.scenario.id}: {s.scenario.bounds}, {s.scenario.penalty}"
        grid[0, c].set_title(heading, fontsize=9, color=KEEPS if s.feasible else BREAKS)
        grid[1, c].axhline(zero, color=INK, linewidth=0.8)
        grid[1, c].text(0.98, zero / 1.3, "gamma = 0", transform=grid[1, c].get_yaxis_transform(),
                        fontsize=7, color=INK, ha="right", va="top")  # fmt: skip
    grid[0, 0].set_ylabel("phi")
    grid[1, 0].set(ylim=(zero / 10, None), ylabel="gamma")
    keys = {
        "runs": {"color": GREY, "linewidth": 0.8},
        "best run": {"color": BLUE, "linewidth": 2.0},
        "phi_min": {"color": BREAKS, "linewidth": 1.2},
    }
    if not any(_LEAST_PHI < facts.phi_min(study, s) < math.inf for s in study.scenarios):
        del keys["phi_min"]
    return finish(figure, f"{study.robot.name}: the search, stage by stage", keys=keys)


def _losses_caption(study: Study) -> str:
    sentences = []
    for s in study.scenarios:
        e, least = s.extraction, facts.phi_min(study, s)
        if math.isnan(least):
            said = "no phi_min is known"
        elif least == 0:
            said = "phi_min is 0"
        else:
            near = int((e.phi <= _REACHED * least).sum())
            under = e.phi < least
            said = (
                f"phi_min is {number(least)}, {near} runs end within 1 % of it or below, "
                f"{int(under.sum())} below ({int((under & s.feasibility.feasible).sum())} of these "
                "feasible)"
            )
        ended = count(len(facts.endings(s).unique()), "different set")
        sentences.append(
            f"{s.scenario.id}: best {number(s.phi)}, {ended} in {count(len(e.sets), 'run')}; {said}"
        )
    return (
        "Loss of every run before (grey) and after the polish (green: feasible, red: infeasible), "
        "the best set ringed, and phi_min as a bar: the proven least loss of any feasible set, so "
        "nothing green can be below it. Losses below "
        f"{_LEAST_PHI:g} are drawn there. {'. '.join(sentences)}."
    )


def _losses(study: Study) -> Figure:
    figure, axes = _columns(study)
    axes.set(yscale="log", ylabel="loss phi")
    for c, s in enumerate(study.scenarios):
        e = s.extraction
        before, after = (_floored(x, _LEAST_PHI) for x in (e.searched_phi, e.phi))
        axes.scatter(c - 0.2 + spread(len(before), 1, 0.1), before, s=10, color=GREY, linewidth=0)
        place = c + 0.15 + spread(len(after), 2, 0.12)
        _marks(axes, s, place, after)
        least = facts.phi_min(study, s)
        if not math.isnan(least) and least < math.inf:
            axes.hlines(max(least, _LEAST_PHI), c - 0.42, c + 0.42, color=INK, linewidth=1.6)
    axes.scatter([], [], s=10, color=GREY, label="before the polish")
    _names(axes)
    axes.plot([], [], color=INK, linewidth=1.6, label="phi_min")
    title = f"{study.robot.name}: losses of all runs against what is possible"
    return finish(figure, title, axes, columns=5)


def _floored(values: Tensor, floor: float) -> np.ndarray:
    """Values for a logarithmic axis: what is smaller than the floor is drawn on it."""
    return torch.nan_to_num(values, nan=torch.inf).clamp(min=floor).cpu().numpy()


def _marks(axes: Any, s: ScenarioResult, place: np.ndarray, values: np.ndarray) -> None:
    feasible = s.feasibility.feasible.cpu().numpy()
    for chosen, colour, marker in ((~feasible, BREAKS, "x"), (feasible, KEEPS, "o")):
        axes.scatter(place[chosen], values[chosen], s=16, color=colour, marker=marker, linewidth=1)
    best = s.extraction.best
    axes.scatter(place[best], values[best], s=90, facecolors="none", edgecolors=INK, linewidth=1.2)


def _names(axes: Any) -> None:
    axes.scatter([], [], s=16, color=KEEPS, marker="o", label="feasible")
    axes.scatter([], [], s=16, color=BREAKS, marker="x", label="infeasible")
    axes.scatter([], [], s=90, facecolors="none", edgecolors=INK, label="best set")


def _columns(study: Study) -> tuple[Figure, Any]:
    """A panel with one column a scenario."""
    names = [f"{s.scenario.id}\n{s.scenario.bounds}, {s.scenario.penalty}" for s in study.scenarios]
    figure, axes = panel(max(6.0, 1.5 + 1.5 * len(names)), 4.6)
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_xlim(-0.6, len(names) - 0.4)
    return figure, axes


def _degrees_caption(study: Study) -> str:
    sentences = []
    for s in study.scenarios:
        degree = s.feasibility.degree
        sentences.append(
            f"{s.scenario.id}: {int(s.feasibility.feasible.sum())} of {len(degree)} runs feasible, "
            f"degrees from {number(float(degree.min()), 2)} to {number(float(degree.max()), 2)}"
        )
    good = facts.by_feasibility(study, True)
    firm = max(good, key=lambda s: s.degree) if good else None
    if firm is None:
        last = "No best set is feasible."
    elif len(good) == 1:
        last = f"The only feasible best set, {firm.scenario.id}, has {number(firm.degree, 2)}."
    else:
        last = (
            f"Of the feasible best sets ({listed(ids(good))}) {firm.scenario.id} is the firmest, "
            f"with {number(firm.degree, 2)}."
        )
    degrees, feasible = facts.all_degrees(study), int((facts.all_degrees(study) > 0).sum())
    near = int(((degrees > 0) & (degrees < _NEAR)).sum())
    close = (
        f" {near} of {count(feasible, 'feasible run')} are within {_NEAR:g} of the boundary: "
        "feasible, but only just."
        if near
        else ""
    )
    return (
        "Degree of every run: the smallest margin of its conditions over their scales, negative "
        "outside, 0 on the boundary (the axis is linear within 0.001 and logarithmic beyond). "
        f"{'; '.join(sentences)}. {last}{close}"
    )


def _degrees(study: Study) -> Figure:
    figure, axes = _columns(study)
    axes.set_yscale("symlog", linthresh=1e-3, linscale=0.6)
    for c, s in enumerate(study.scenarios):
        degree = s.feasibility.degree.cpu().numpy()
        _marks(axes, s, c + spread(len(degree), 3, 0.25), degree)
    low, high = axes.get_ylim()
    high = max(high, 1e-1)
    axes.axhspan(0, high, color=KEEPS, alpha=0.08, linewidth=0)
    axes.axhline(0, color=INK, linewidth=0.9)
    axes.set(ylim=(low, high), ylabel="degree [-]")
    _names(axes)
    return finish(figure, f"{study.robot.name}: degree of feasibility of all runs", axes, columns=3)
