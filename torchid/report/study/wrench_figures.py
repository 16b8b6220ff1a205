"""Internal wrenches of a study's sets: every combination, overviews, errors by degree and class."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from torchid.report.figures import GREY, INK, new_figure, styled
from torchid.report.study.drawing import (
    BREAKS,
    KEEPS,
    REAL,
    STYLES,
    Drawing,
    colour_of,
    decades,
    finish,
    joint_panels,
    panel_size,
    spread,
    thin,
)
from torchid.report.study.facts import (
    all_degrees,
    at_joint,
    best_rows,
    by_feasibility,
    ids,
    listed,
    number,
    rms,
    row_of,
    run_classes,
)
from torchid.study.result import SetsOnMotion, Study
from torchid.typing import Float, Tensor
from torchid.wrenches.classes import FEASIBLE, ordered_classes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FAR = 8.0
"""Times the real arm's largest value from which a logarithmic axis is easier to read."""
_DECADES = 1e-3
"""Share of the real arm's largest value down to which a logarithmic axis goes."""


def wrench_drawings(study: Study) -> list[Drawing]:
    """Overviews, combinations, and errors of all runs."""
    return [*_overviews(study), *_combinations(study), _errors(study)]


def combination_names(study: Study) -> list[tuple[str | None, str | None]]:
    """Pairs of a feasible and an infeasible best set; one of them is None where there is none."""
    good: list[str | None] = [*ids(by_feasibility(study, True))] or [None]
    bad: list[str | None] = [*ids(by_feasibility(study, False))] or [None]
    return [(a, b) for a in good for b in bad]


def _combinations(study: Study) -> list[Drawing]:
    return [_combination(study, good, bad) for good, bad in combination_names(study)]


def _combination(study: Study, good: str | None, bad: str | None) -> Drawing:
    parts = (("F", good, KEEPS), ("UN", bad, BREAKS))
    present = [(f"{kind} = {name}", name, colour) for kind, name, colour in parts if name]
    file = "wrenches_" + "_".join(f"{kind}-{name}" for kind, name, _ in parts if name)
    chosen = [("real", "real", REAL), *present]
    title = f"{study.robot.name}: internal forces, {', '.join(x[0] for x in present)}, real"
    return Drawing(
        "wrenches", file, _combination_caption(study, good, bad),
        lambda: _norms(study.wrench_motion, study.wrench_motion.force, chosen, title,
                       "force norm [N]"),
    )  # fmt: skip


def _combination_caption(study: Study, good: str | None, bad: str | None) -> str:
    wrench = study.wrench_motion
    error = rms(wrench.force - wrench.force[0])
    real = rms(wrench.force[0])
    said = []
    for name in (good, bad):
        if name is None:
            continue
        row = error[row_of(wrench, name)]
        s = next(s for s in study.scenarios if s.scenario.id == name)
        why = "feasible" if s.feasible else f"infeasible by {listed(s.reasons)}"
        worst = int((row / real).argmax())
        said.append(
            f"{name} ({why}) is off by {at_joint(row.tolist(), 'N')}, and relative to the real "
            f"force by {number(100 * float((row / real)[worst]))} % at joint {worst + 1}"
        )
    caption = (
        "Norms of the internal forces on the reference motion, per joint. Root mean square "
        f"differences of the norms from the real ones: {'; '.join(said)}."
    )
    if good is not None and bad is not None:
        a, b = (error[row_of(wrench, name)] for name in (good, bad))
        nearer = [str(j + 1) for j in range(study.robot.n) if b[j] < a[j]]
        where = f"{'joint' if len(nearer) == 1 else 'joints'} {listed(nearer)}"
        if len(nearer) == study.robot.n:
            where = "every joint"
        caption += (
            f" The infeasible {bad} is nearer to the real arm than the feasible {good} at {where}."
            if nearer
            else f" The feasible {good} is nearer to the real arm than {bad} at every joint."
        )
    elif good is None:
        caption += " There is no feasible set to compare with."
    return caption


def _overviews(study: Study) -> list[Drawing]:
    wrench = study.wrench_motion
    chosen: list[tuple[str, str, str, Any]] = []
    for feasible, colour in ((True, KEEPS), (False, BREAKS)):
        for k, name in enumerate(ids(by_feasibility(study, feasible))):
            label = f"{name} ({'feasible' if feasible else 'infeasible'})"
            chosen.append((label, name, colour, STYLES[k % len(STYLES)]))
    out = []
    for what, unit, values in (("force", "N", wrench.force), ("moment", "N m", wrench.moment)):
        out.append(
            Drawing(
                "wrenches", f"overview_{what}", _overview_caption(study, what, unit, values),
                lambda what=what, unit=unit, values=values: _norms(  # type: ignore[misc]
                    wrench, values, [("real", "real", REAL), *chosen],
                    f"{study.robot.name}: internal {what}s of all best sets",
                    f"{what} norm [{unit}]",
                ),
            )
        )  # fmt: skip
    return out


def _overview_caption(study: Study, what: str, unit: str, values: Float[Tensor, "S T n"]) -> str:
    error = rms(values - values[0]) / rms(values[0])
    sentences = []
    for feasible, word in ((True, "feasible"), (False, "infeasible")):
        chosen = by_feasibility(study, feasible)
        if not chosen:
            sentences.append(f"no best set is {word}")
            continue
        worst = {s.scenario.id: float(error[row_of(study.wrench_motion, s.scenario.id)].max())
                 for s in chosen}  # fmt: skip
        near, far = min(worst, key=worst.__getitem__), max(worst, key=worst.__getitem__)
        text = f"of the {word} sets {near} comes nearest to the real arm ({_percent(worst[near])}"
        if far != near:
            text += f") and {far} is farthest ({_percent(worst[far])}"
        sentences.append(text + ")")
    return (
        f"Norms of the internal {what}s [{unit}] of all best sets on the reference motion: real "
        "black, feasible sets green, infeasible ones red. By the largest root mean square "
        f"difference of a joint's norm, in percent of the real one, {'; '.join(sentences)}."
    )


def _percent(share: float) -> str:
    return f"{number(100 * share)} %"


def _norms(
    sets: SetsOnMotion,
    values: Float[Tensor, "S T n"],
    chosen: Sequence[tuple[Any, ...]],
    title: str,
    label: str,
) -> "Figure":
    """Norms of some sets, one panel a joint. Chosen: (label, id, colour[, line style])."""
    n = values.shape[-1]
    rows = {name: row_of(sets, name) for _, name, *_ in chosen}
    shown = values[list(rows.values())]
    top, real = shown.amax((0, 1)), values[0].amax(0)
    far = bool((top > _FAR * real.clamp(min=1e-9)).any())
    figure = new_figure(*panel_size(n))
    panels = joint_panels(figure, n, label)
    t = thin(sets.motion.t - sets.motion.t[0])
    for j, axes in enumerate(panels):
        for text, name, colour, *style in chosen:
            axes.plot(
                t, thin(values[rows[name], :, j]), color=colour,
                linestyle=style[0] if style else "-", label=text,
                linewidth=2.4 if name == "real" else 1.3,
                zorder=2 if name == "real" else 3, alpha=0.85,
            )  # fmt: skip
        if far:
            axes.set_yscale("log")
            axes.set_ylim(bottom=max(_DECADES * float(real[j]), float(shown[..., j].min()) / 2))
    return finish(figure, title + (" (logarithmic)" if far else ""), panels[0], len(chosen))


def _errors(study: Study) -> Drawing:
    comparison = study.comparison
    rho = comparison.correlation_infeasible.rho
    sentences = [
        f"{c.name}: {c.sets} sets"
        + ("" if c.median is None else f", median {number(c.median)} N, quartiles "
           f"{number(c.lower_quartile or 0.0)} and {number(c.upper_quartile or 0.0)} N")
        for c in comparison.classes
    ]  # fmt: skip
    if np.isnan(rho.value):
        said = "Too few infeasible sets differ for a rank correlation of degree and error."
    else:
        interval = (
            "" if np.isnan(rho.low) else f" (95 % interval {number(rho.low)} to {number(rho.high)})"
        )
        sure = not np.isnan(rho.low) and (rho.low > 0) == (rho.high > 0)
        said = (
            "Over the infeasible sets the rank correlation of degree and error is "
            f"{number(rho.value)}{interval}: "
            + (
                ("the deeper outside, the larger the error."
                 if rho.value < 0 else "the deeper outside, the smaller the error.")
                if sure
                else "that is not told from no relation."
            )
        )  # fmt: skip
    caption = (
        "Force error of every run (root mean square of the vector difference from the real arm, "
        "largest joint) against its degree, by the kind of its reasons: feasible sets by how "
        "firmly they are inside, infeasible ones by how far they are outside (both logarithmic), "
        "and the classes side by side with medians and quartiles. "
        f"{'; '.join(sentences)}. {said} Crosses mark the best sets."
    )
    return Drawing("wrenches", "force_error_by_degree", caption, lambda: _error_figure(study))


def _error_figure(study: Study) -> "Figure":
    error = study.errors.force_rms.amax(-1)
    degree, classes = all_degrees(study), run_classes(study)
    names = ordered_classes(classes)
    figure = new_figure(12, 4.8)
    inside, outside, beside = (
        styled(x) for x in figure.subplots(1, 3, sharey=True, width_ratios=(2, 3, 2))
    )
    for axes in (inside, outside):
        axes.set_xscale("log")
        axes.set_yscale("log")
    best = torch.zeros_like(degree, dtype=torch.bool)
    best[best_rows(study)] = True
    for c, name in enumerate(names):
        own = torch.tensor([x == name for x in classes])
        axes = inside if name == FEASIBLE else outside
        depth = degree[own].abs().clamp(min=1e-12)
        axes.scatter(depth, error[own], s=16, color=colour_of(name), alpha=0.7, linewidth=0)
        axes.scatter(depth[best[own]], error[own & best], s=60, color=INK, marker="x", linewidth=1)
        place = c + spread(int(own.sum()), c)
        beside.scatter(place, error[own], s=12, color=colour_of(name), alpha=0.6, linewidth=0)
        low, median, high = np.nanpercentile(error[own].numpy(), [25, 50, 75])
        beside.vlines(c, low, high, color=INK, linewidth=5, alpha=0.35)
        beside.hlines(median, c - 0.35, c + 0.35, color=INK, linewidth=1.6)
        outside.scatter([], [], s=16, color=colour_of(name), label=name)
    for axes in (inside, outside):
        decades(axes.xaxis)
    decades(inside.yaxis)
    if FEASIBLE not in names:
        inside.text(0.5, 0.5, "no run is feasible", transform=inside.transAxes, ha="center",
                    fontsize=9, color=GREY)  # fmt: skip
    outside.scatter([], [], s=60, color=INK, marker="x", label="best sets")
    inside.set_xlabel("degree (feasible)", fontsize=8, color=INK)
    outside.set_xlabel("-degree (infeasible)", fontsize=8, color=INK)
    inside.set_ylabel("force error, largest joint [N]", fontsize=8, color=INK)
    beside.set_xticks(range(len(names)), [x.replace(" ", "\n") for x in names], fontsize=8)
    beside.set_xlim(-0.6, len(names) - 0.4)
    return finish(
        figure, f"{study.robot.name}: force error by degree and by reason, all runs", outside, 7
    )
