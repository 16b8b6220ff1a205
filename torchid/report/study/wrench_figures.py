"""Internal wrenches of a study's sets: every combination, overviews, errors by degree and class;
and its payload: what was estimated against the truth, and what it does inside the arm."""

import math
from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import torch

from torchid.report.colours import BLUE, BREAKS, GREEN, GREY, INK, KEEPS, ORANGE, REAL, RED
from torchid.report.equal_torque import class_colour
from torchid.report.panels import (
    Figure,
    Picture,
    drawing,
    finish,
    joint_lines,
    panel,
    rows_of,
    spread,
    thin,
)
from torchid.report.study import facts
from torchid.report.study.facts import at_joint, ids, number, rms
from torchid.results.words import count, listed
from torchid.study.result import SetsOnMotion, Study
from torchid.typing import Float, Tensor
from torchid.wrenches.classes import FEASIBLE, ordered_classes

_STYLES: tuple[Any, ...] = ("-", "--", ":", "-.", (0, (8, 2)), (0, (4, 1, 1, 1, 1, 1)))
"""Lines that tell apart sets of one colour."""
_Line = tuple[str, str, str, Any]
"""What the legend says, id of the set or `real`, colour, dashes."""
_REAL: _Line = ("real", "real", REAL, "-")
_FAR = 8.0
"""Times the real arm's largest value from which a logarithmic axis is easier to read."""
_DECADES = 1e-3
"""Share of the real arm's largest value down to which a logarithmic axis goes."""


def wrench_drawings(study: Study) -> list[Picture]:
    """Overviews, combinations, and errors of all runs."""
    wrench, name = study.wrench_motion, study.robot.name
    chosen = [_REAL]
    for feasible, colour in ((True, KEEPS), (False, BREAKS)):
        for k, own in enumerate(ids(facts.by_feasibility(study, feasible))):
            said = f"{own} ({'feasible' if feasible else 'infeasible'})"
            chosen.append((said, own, colour, _STYLES[k % len(_STYLES)]))
    out = []
    for what, unit, values in (("force", "N", wrench.force), ("moment", "N m", wrench.moment)):
        title = f"{name}: internal {what}s of all best sets"
        draw = partial(_norms, wrench, values, chosen, title, f"{what} norm [{unit}]")
        caption = _overview_caption(study, what, unit, values)
        out.append(drawing("wrenches", f"overview_{what}", caption, draw))
    # Pairs of a feasible and an infeasible best set; one of them is empty where there is none.
    good = ids(facts.by_feasibility(study, True)) or [""]
    bad = ids(facts.by_feasibility(study, False)) or [""]
    for a, b in product(good, bad):
        parts = [x for x in (("F", a, KEEPS), ("UN", b, BREAKS)) if x[1]]
        shown = [_REAL, *((f"{kind} = {own}", own, colour, "-") for kind, own, colour in parts)]
        file = "wrenches_" + "_".join(f"{kind}-{own}" for kind, own, _ in parts)
        title = f"{name}: internal forces, {', '.join(x[0] for x in shown[1:])}, real"
        draw = partial(_norms, wrench, wrench.force, shown, title, "force norm [N]")
        out.append(drawing("wrenches", file, _combination_caption(study, a, b), draw))
    return [*out, _errors(study)]


def _combination_caption(study: Study, good: str, bad: str) -> str:
    wrench = study.wrench_motion
    error = rms(wrench.force - wrench.force[0])
    real = rms(wrench.force[0])
    said = []
    for name in filter(None, (good, bad)):
        row = error[facts.row_of(wrench, name)]
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
    if good and bad:
        a, b = (error[facts.row_of(wrench, name)] for name in (good, bad))
        nearer = [str(j + 1) for j in range(study.robot.n) if b[j] < a[j]]
        where = f"{'joint' if len(nearer) == 1 else 'joints'} {listed(nearer)}"
        if len(nearer) == study.robot.n:
            where = "every joint"
        caption += (
            f" The infeasible {bad} is nearer to the real arm than the feasible {good} at {where}."
            if nearer
            else f" The feasible {good} is nearer to the real arm than {bad} at every joint."
        )
    elif not good:
        caption += " There is no feasible set to compare with."
    return caption


def _overview_caption(study: Study, what: str, unit: str, values: Float[Tensor, "S T n"]) -> str:
    error = rms(values - values[0]) / rms(values[0])
    sentences = []
    for feasible, word in ((True, "feasible"), (False, "infeasible")):
        chosen = facts.by_feasibility(study, feasible)
        if not chosen:
            sentences.append(f"no best set is {word}")
            continue
        worst = {s.scenario.id: float(error[facts.row_of(study.wrench_motion, s.scenario.id)].max())
                 for s in chosen}  # fmt: skip
        near, far = min(worst, key=worst.__getitem__), max(worst, key=worst.__getitem__)
        text = f"of the {word} sets {near} comes nearest to the real arm"
        text += f" ({number(100 * worst[near])} %"
        if far != near:
            text += f") and {far} is farthest ({number(100 * worst[far])} %"
        sentences.append(text + ")")
    return (
        f"Norms of the internal {what}s [{unit}] of all best sets on the reference motion: real "
        "black, feasible sets green, infeasible ones red. By the largest root mean square "
        f"difference of a joint's norm, in percent of the real one, {'; '.join(sentences)}."
    )


def _norms(
    sets: SetsOnMotion, values: Float[Tensor, "S T n"], chosen: Sequence[_Line], title: str, y: str
) -> Figure:
    """Norms of some sets, one panel a joint."""
    shown = values[[facts.row_of(sets, own) for _, own, _, _ in chosen]]
    real = values[0].amax(0)
    far = bool((shown.amax((0, 1)) > _FAR * real.clamp(min=1e-9)).any())
    curves = {}
    for (text, own, colour, dashes), norms in zip(chosen, shown, strict=True):
        width, order = (2.4, 2) if own == "real" else (1.3, 3)
        style = {"linewidth": width, "zorder": order, "alpha": 0.85}
        curves[text] = (thin(norms), {"color": colour, "linestyle": dashes, **style})
    title += " (logarithmic)" if far else ""
    figure, panels = joint_lines(title, y, thin(sets.motion.t - sets.motion.t[0]), curves)
    for j, axes in enumerate(panels if far else ()):
        least = max(_DECADES * float(real[j]), float(shown[..., j].min()) / 2)
        axes.set(yscale="log", ylim=(least, None))
    return figure


def _errors(study: Study) -> Picture:
    rho = study.comparison.correlation_infeasible.rho
    if np.isnan(rho.value):
        said = "Too few infeasible sets differ for a rank correlation of degree and error."
    else:
        interval = (
            "" if np.isnan(rho.low) else f" (95 % interval {number(rho.low)} to {number(rho.high)})"
        )
        sure = not np.isnan(rho.low) and (rho.low > 0) == (rho.high > 0)
        meaning = f"the deeper outside, the {'larger' if rho.value < 0 else 'smaller'} the error."
        said = (
            "Over the infeasible sets the rank correlation of degree and error is "
            f"{number(rho.value)}{interval}: "
            f"{meaning if sure else 'that is no different from no relation.'}"
        )
    caption = (
        "Force error of every run (root mean square of the vector difference from the real arm, "
        "largest joint) against its degree, by the kind of its reasons: feasible sets by how "
        "firmly they are inside, infeasible ones by how far they are outside (both logarithmic), "
        f"and the classes side by side with medians and quartiles. {said} Crosses mark the best "
        "sets."
    )
    return drawing("wrenches", "force_error_by_degree", caption, lambda: _error_figure(study))


def _error_figure(study: Study) -> Figure:
    error = study.errors.force_rms.amax(-1)
    degree, classes = facts.all_degrees(study), facts.run_classes(study)
    names = ordered_classes(classes)
    figure, (inside, outside, beside) = panel(12, 4.8, 1, 3, sharey=True, width_ratios=(2, 3, 2))
    for axes in (inside, outside):
        axes.set(xscale="log", yscale="log")
    best = torch.zeros_like(degree, dtype=torch.bool)
    best[facts.best_rows(study)] = True
    for c, name in enumerate(names):
        own = torch.tensor([x == name for x in classes])
        axes = inside if name == FEASIBLE else outside
        colour = class_colour(name)
        depth = degree[own].abs().clamp(min=1e-12)
        axes.scatter(depth, error[own], s=16, color=colour, alpha=0.7, linewidth=0)
        axes.scatter(depth[best[own]], error[own & best], s=60, color=INK, marker="x", linewidth=1)
        place = c + spread(int(own.sum()), c)
        beside.scatter(place, error[own], s=12, color=colour, alpha=0.6, linewidth=0)
        low, median, high = np.nanpercentile(error[own].numpy(), [25, 50, 75])
        beside.vlines(c, low, high, color=INK, linewidth=5, alpha=0.35)
        beside.hlines(median, c - 0.35, c + 0.35, color=INK, linewidth=1.6)
        outside.scatter([], [], s=16, color=colour, label=name)
    for axes in (inside, outside):
        _decades(axes.xaxis)
    _decades(inside.yaxis)
    if FEASIBLE not in names:
        inside.text(0.5, 0.5, "no run is feasible", transform=inside.transAxes, ha="center",
                    fontsize=9, color=GREY)  # fmt: skip
    outside.scatter([], [], s=60, color=INK, marker="x", label="best sets")
    inside.set(xlabel="degree (feasible)", ylabel="force error, largest joint [N]")
    outside.set_xlabel("-degree (infeasible)")
    beside.set_xticks(range(len(names)), [x.replace(" ", "\n") for x in names], fontsize=8)
    beside.set_xlim(-0.6, len(names) - 0.4)
    title = f"{study.robot.name}: force error by degree and by reason, all runs"
    return finish(figure, title, outside, columns=7)


def _decades(axis: Any) -> None:
    """A logarithmic axis of whole decades, with a label at each and none between."""
    from matplotlib.ticker import NullFormatter

    low, high = axis.get_data_interval()
    if 0 < low <= high < math.inf:
        first = math.floor(math.log10(low))
        last = max(first + 1, math.ceil(math.log10(high)))
        axis.axes.set(**{f"{axis.axis_name}lim": (10.0**first, 10.0**last)})
    axis.set_minor_formatter(NullFormatter())


def payload_drawings(study: Study) -> list[Picture]:
    """Estimate against truth, and internal forces without and with the payload."""
    return [
        drawing("payload", "payload_estimate", _estimate_caption(study), lambda: _estimate(study)),
        drawing("payload", "payload_force", _force_caption(study), lambda: _force(study)),
    ]


def _estimate_caption(study: Study) -> str:
    quantities = facts.payload_quantities(study)
    known = [q for q in quantities if math.isfinite(q.low) and math.isfinite(q.high)]
    missed = [q.name for q in known if not q.held]
    unknown = [q.name for q in quantities if not math.isfinite(q.value)]
    text = (
        "The payload estimated from two runs of the exciting motion with the noise of real "
        "sensors (encoder steps, noisy torque), without and with it: error of each quantity in "
        "half-widths of its 95 % interval, so that the true value is inside the green band where "
        f"the interval holds it. It does for {len(known) - len(missed)} of "
        f"{count(len(known), 'quantity', 'quantities')}"
    )
    text += f" (not {listed(missed)})." if missed else "."
    if unknown:
        text += f" Not determined: {listed(unknown)}."
    return text


def _estimate(study: Study) -> Figure:
    figure, axes = panel(9, 4.2)
    axes.axvspan(-1, 1, color=GREEN, alpha=0.12, linewidth=0)
    axes.axvline(0, color=GREY, linewidth=0.8)
    labels, largest = [], 2.0
    for k, q in enumerate(facts.payload_quantities(study)):
        half = (q.high - q.low) / 2
        error, shown = (q.value - q.true) / half if half > 0 else math.nan, "not known"
        if math.isfinite(error):
            axes.errorbar(error, k, xerr=1, fmt="o", markersize=4, capsize=3, linewidth=1,
                          color=BLUE if abs(error) <= 1 else RED)  # fmt: skip
            largest = max(largest, 1.15 * abs(error) + 1)
            shown = f"{number(q.value, 4)} ± {number(half, 2)}"
        labels.append(f"{q.name} [{q.unit}]\n{shown}, true {number(q.true, 4)}")
    rows_of(axes, labels, 6.5)
    axes.set_xlim(-largest, largest)
    axes.set_xlabel("(estimated - true) / half-width of the 95 % interval")
    return finish(figure, f"{study.robot.name}: payload, estimated against true")


def _force_caption(study: Study) -> str:
    force = study.payload.force
    before, after = rms(force[0]), rms(force[1])
    rise = ((after - before) / before).tolist()
    joint = max(range(len(rise)), key=lambda j: abs(rise[j]))
    wrong = rms(force[2] - force[1])
    return (
        "Norms of the internal forces on the reference motion without the payload, with the true "
        f"one of {number(study.settings.payload.mass)} kg, and with the estimated one. The payload "
        f"changes the force most at joint {joint + 1}, from a root mean square of "
        f"{number(float(before[joint]))} to {number(float(after[joint]))} N; with the estimated "
        f"one the force is wrong by at most {at_joint(wrong.tolist(), 'N')}."
    )


def _force(study: Study) -> Figure:
    t = study.wrench_motion.motion.t
    styles = {
        "without payload": {"color": GREY, "linewidth": 1.2},
        "with the true payload": {"color": INK, "linewidth": 2.4},
        "with the estimated payload": {"color": ORANGE, "linewidth": 1.3, "linestyle": "--"},
    }
    lines = zip(styles, study.payload.force, styles.values(), strict=True)
    curves = {name: (thin(force), style) for name, force, style in lines}
    title = f"{study.robot.name}: internal forces with a payload"
    return joint_lines(title, "force norm [N]", thin(t - t[0]), curves)[0]
