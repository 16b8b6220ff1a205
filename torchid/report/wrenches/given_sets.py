"""Internal wrenches of given sets: tables and figures."""

from typing import TYPE_CHECKING

import numpy as np
from rich.markup import escape
from rich.table import Table

from torchid.report.figures import GREY, INK, new_figure, styled
from torchid.report.identification import compact
from torchid.report.wrenches.figures import COLOURS
from torchid.report.wrenches.tables import interval
from torchid.study.equal_torque.given_sets import GivenSets
from torchid.wrenches.classes import KINDS, class_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_ROWS = 40
_MOST_MARKS = 60


def tables(found: GivenSets) -> list[Table]:
    """Set by set, then by class and by reason where there are enough of them."""
    made = [set_table(found)]
    if len(found.sets) > 1:
        made.append(class_table(found))
    return made


UNEQUAL = 0.01
"""Relative difference of a joint's torque above which sets do not count as having equal torque."""


def unequal(found: GivenSets) -> list[str]:
    """Says when the sets do not have the reference's torque: then the forces differ for that."""
    worst = found.torque_relative.amax(-1)
    count = int((worst > UNEQUAL).sum())
    if count == 0:
        return []
    return [
        f"{count} of {len(found.sets)} sets do not have the torque of the reference "
        f"'{found.reference.ids[0]}' (up to {100 * float(worst.max()):.2g} % off at one joint): "
        "these differences are not what equal torque leaves open. --reference ID compares with "
        "one of them"
    ]


def headline(found: GivenSets) -> str:
    """One sentence: how far the torques and the forces are apart."""
    worst = found.errors.force_rms.amax(-1)
    near, far = int(worst.argmin()), int(worst.argmax())
    ids = found.sets.ids
    extremes = f"{float(worst[near]):.3g} N ({ids[near]})"
    if len(ids) > 1:
        extremes = f"between {extremes} and {float(worst[far]):.3g} N ({ids[far]})"
    return (
        f"Against {_reference(found)}, on {found.motion.q.shape[0]} instants: the largest "
        f"force error over the joints is {extremes} RMS; torques differ by at most "
        f"{100 * float(found.torque_relative.max()):.2g} % of a joint's own."
    )


def set_table(found: GivenSets) -> Table:
    """Reasons, degree and force error per joint; the sets with the largest errors if many."""
    worst = found.errors.force_rms.amax(-1)
    rows = list(range(len(found.sets)))
    title = f"force error against {escape(_reference(found))} [N], RMS over the motion"
    if len(rows) > _MOST_ROWS:
        rows = sorted(worst.argsort(descending=True)[:_MOST_ROWS].tolist())
        title += f" (the {_MOST_ROWS} of {len(worst)} sets with the largest)"
    table = compact(title)
    for heading in ("set", "degree", "torque [%]", "moment [N m]"):
        table.add_column(heading, justify="left" if heading == "set" else "right", no_wrap=True)
    for joint in range(found.robot.n):
        table.add_column(f"j{joint + 1}", justify="right", no_wrap=True)
    table.add_column("reasons", overflow="fold")
    for k in rows:
        table.add_row(
            escape(found.sets.ids[k]), f"{float(found.checked.degree[k]):.2g}",
            f"{100 * float(found.torque_relative[k].max()):.2g}",
            f"{float(found.errors.moment_rms[k].max()):.3g}",
            *(f"{v:.3g}" for v in found.errors.force_rms[k].tolist()),
            " ".join(found.checked.reasons(k)) or "feasible",
        )  # fmt: skip
    own = found.errors
    table.add_row(
        "itself", "", "", f"{float(own.reference_moment_rms.max()):.3g}",
        *(f"{v:.3g}" for v in own.reference_force_rms.tolist()), "",
    )  # fmt: skip
    return table


def class_table(found: GivenSets) -> Table:
    """By class and reason, with the rank correlation of error and degree."""
    rho = found.comparison.correlation
    value = interval(rho.rho) if rho.sets else "-"
    table = compact(
        f"largest force error by class and by reason [N]; Spearman's rho with the degree {value}"
    )
    for heading in ("sets that violate", "sets", "median", "quartiles"):
        table.add_column(heading, justify="left" if heading[-1] == "e" else "right", no_wrap=True)
    for summary in (*found.comparison.classes, *found.comparison.per_reason):
        if summary.median is None:
            table.add_row(summary.name, str(summary.sets), "-", "too few")
            continue
        quartiles = f"{summary.lower_quartile:.3g} - {summary.upper_quartile:.3g}"
        table.add_row(summary.name, str(summary.sets), f"{summary.median:.3g}", quartiles)
    return table


def figures(found: GivenSets) -> dict[str, "Figure"]:
    """All figures by the names of their files."""
    return {"force_errors": error_figure(found), "force_by_degree": degree_figure(found)}


def error_figure(found: GivenSets) -> "Figure":
    """Force error per joint, a mark a set."""
    figure = new_figure(8.0, 4.6)
    axes = styled(figure.subplots())
    n, errors = found.robot.n, found.errors.force_rms.numpy()
    floor = max(1e-6 * float(errors.max()), 1e-12)
    names = [class_of(found.checked.reasons(k)) for k in range(len(found.sets))]
    spread = np.linspace(-0.28, 0.28, len(names)) if len(names) > 1 else np.zeros(1)
    for k, name in enumerate(names):
        axes.scatter(
            np.arange(1, n + 1) + spread[k], np.maximum(errors[k], floor), s=22, marker="o",
            color=_colour(name), alpha=0.8, linewidths=0,
            label=name if name not in names[:k] else None,
        )  # fmt: skip
    own = np.maximum(found.errors.reference_force_rms.numpy(), floor)
    axes.scatter(
        np.arange(1, n + 1), own, marker="_", s=900, color=GREY, label="the force itself", zorder=0
    )
    axes.set_yscale("log")
    axes.tick_params(axis="y", which="minor", labelsize=7, labelcolor=INK)
    axes.set_xticks(range(1, n + 1))
    axes.set_xlabel("joint", fontsize=9, color=INK)
    axes.set_ylabel("force error [N], RMS over the motion", fontsize=9, color=INK)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8, markerscale=0.7)
    title = f"{found.robot.name}: force error per joint against {_reference(found)}"
    figure.suptitle(title, fontsize=11, color=INK, x=0.01, ha="left")
    return figure


def degree_figure(found: GivenSets) -> "Figure":
    """Largest force error against the degree; ids beside the marks where there are few."""
    figure = new_figure(8.0, 4.6)
    axes = styled(figure.subplots())
    degree = found.checked.degree.numpy()
    worst = found.errors.force_rms.amax(-1).clamp(min=1e-12).numpy()
    names = [class_of(found.checked.reasons(k)) for k in range(len(found.sets))]
    for k, name in enumerate(names):
        axes.scatter(
            degree[k], worst[k], s=22, color=_colour(name), alpha=0.8, linewidths=0,
            label=name if name not in names[:k] else None,
        )  # fmt: skip
        if len(names) <= _MOST_MARKS // 4:
            axes.annotate(
                found.sets.ids[k], (degree[k], worst[k]), xytext=(4, 3),
                textcoords="offset points", fontsize=7, color=INK,
            )  # fmt: skip
    axes.axvline(0, color=INK, linewidth=0.9)
    axes.set_xscale("symlog", linthresh=1e-3, linscale=0.6)
    axes.margins(x=0.08)
    axes.set_yscale("log")
    axes.tick_params(axis="y", which="minor", labelsize=7, labelcolor=INK)
    axes.set_xlabel("degree (0 is the boundary, negative infeasible)", fontsize=9, color=INK)
    axes.set_ylabel("force error, largest joint [N], RMS", fontsize=9, color=INK)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    title = f"{found.robot.name}: degree and force error"
    figure.suptitle(title, fontsize=11, color=INK, x=0.01, ha="left")
    return figure


def _reference(found: GivenSets) -> str:
    name = found.reference.ids[0]
    return f"the nominal parameters of {name}" if name == found.robot.name else name


def _colour(name: str) -> str:
    kinds = {label: kind for kind, label in KINDS.items()}
    kind = "inertia+com" if name == "mixed" else kinds.get(name, name)
    return COLOURS.get(kind, GREY)
