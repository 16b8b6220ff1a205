"""Sets with equal torque and their internal forces, as tables, in sentences that follow their
intervals, and as figures."""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial

import numpy as np

from torchid.report.colours import BLUE, BROWN, GREEN, GREY, INK, ORANGE, PURPLE, RED
from torchid.report.panels import Figure, Figures, finish, panel, tiles
from torchid.report.table import Report, Table, cells, joint_numbers, table_of
from torchid_study.equal_torque.study import EqualTorqueStudy
from torchid_study.wrenches.classes import KINDS as CLASS_NAMES
from torchid_study.wrenches.classes import MIXED, ordered_classes
from torchid_study.wrenches.compare import ClassSummary, Comparison, EffectSize
from torchid_study.wrenches.resampling import Estimate


def report_of_equal_torque(study: EqualTorqueStudy) -> Report:
    """All that there is to see of a study."""
    words = "\n".join(f"- {sentence}" for sentence in findings(study))
    return Report(parts=tables(study), warnings=study.warnings, last=words, figures=figures(study))


def tables(study: EqualTorqueStudy) -> list[Table]:
    """Errors by kind and joint, their differences, and what any set can do."""
    makers = (kind_table, joint_table, effect_table, reach_table)
    return [make(study) for make in makers]


def kind_table(study: EqualTorqueStudy) -> Table:
    """Quartiles of the largest force error over the joints by kind, and the moments' median."""
    rows: list[tuple[str, ...]] = []
    moment = study.errors.moment_rms.amax(-1)
    for kind in study.kinds:
        own = study.rows(kind)
        low, middle, high = (float(study.worst[own].quantile(p)) for p in (0.25, 0.5, 0.75))
        degree = study.degree[own]
        rows.append(
            (
                kind_words(kind), str(len(own)), str(len(set(study.family.cluster[own].tolist()))),
                f"{float(degree.min()):.2g} .. {float(degree.max()):.2g}",
                f"{middle:.3g} ({low:.3g} - {high:.3g})",
                f"{float(moment[own].quantile(0.5)):.3g}",
            )
        )  # fmt: skip
    largest = (study.errors.reference_force_rms.max(), study.errors.reference_moment_rms.max())
    rows.append(("the wrench itself", "", "", "", *cells(map(float, largest))))
    nominal = study.setting.origin == "nominal"
    title = (
        f"{study.setting.robot.name}: errors of the internal wrenches against the "
        f"{'nominal parameters' if nominal else 'nearest feasible set'}, RMS over the motion, "
        "largest joint"
    )
    force = "force [N]: median (quartiles)"
    return Table(title, ("kind", "sets", "chains", "degree", force, "moment [N m]"), rows, "l")


def joint_table(study: EqualTorqueStudy) -> Table:
    """Medians of the force error per joint."""
    errors = study.errors
    rows = {kind_words(k): errors.force_rms[study.rows(k)].median(0).values for k in study.kinds}
    rows["the force itself"] = errors.reference_force_rms
    columns = ("kind", *joint_numbers(study.setting.robot.n))
    texts = [(name, *cells(row)) for name, row in rows.items()]
    return Table("median force error per joint [N]", columns, texts, "l")


def effect_table(study: EqualTorqueStudy) -> Table:
    """Differences of the classes, with 95 % intervals."""
    title = "differences of the classes (95 % intervals from whole chains)"
    return table_of(title, study.comparison.effects, "first second ratio delta")


def class_table(comparison: Comparison, title: str, note: str = "") -> Table:
    """Errors by class, against those of the first, then of all sets that have a reason, alone or
    among others."""
    effects = {e.first: e for e in comparison.effects}

    def row(c: ClassSummary, effect: EffectSize | None) -> list[str]:
        sizes = cells((c.median, c.lower_quartile, c.upper_quartile))
        against = ["-"] * 2 if effect is None else [str(effect.ratio), str(effect.delta)]
        return [c.name, str(c.sets), *sizes, *against]

    rows = [row(c, effects.get(c.name)) for c in comparison.classes]
    rows += [[], *(row(c, None) for c in comparison.per_reason)]
    columns = (
        "sets that violate", "sets", "median", "lower quartile", "upper quartile",
        f"ratio to {comparison.classes[0].name}", "Cliff's delta",
    )  # fmt: skip
    return Table(title, columns, rows, "l", note)


def reach_table(study: EqualTorqueStudy) -> Table:
    """The greatest force error of any set, per joint."""
    rows = []
    for r in study.reach:
        ends = zip(r.reached.tolist(), r.bound.tolist(), strict=True)
        texts = (
            f"{a:.3g}" if math.isclose(a, b, rel_tol=0.01, abs_tol=0.05) else f"{a:.3g} - {b:.3g}"
            for a, b in ends
        )
        rows.append(("nothing (feasible)" if r.kind == "feasible" else kind_words(r.kind), *texts))
    title = "greatest force error of any set with this torque [N] (reached - bound)"
    return Table(title, ("what may be violated", *joint_numbers(study.setting.robot.n)), rows, "l")


def kind_words(kind: str) -> str:
    """A kind as people read it."""
    names = {"com": "CoM", "inertia+com": "inertia + CoM", "total_mass": "total mass"}
    return names.get(kind, kind)


_COMPARED = (
    ("inertia only", "feasible"), ("CoM only", "feasible"), ("CoM only", "inertia only"),
)  # fmt: skip
"""Classes whose difference is told."""
_WORDS = {
    "inertia": "inertia", "com": "centres of mass",
    "inertia only": "inertia", "CoM only": "centres of mass",
}  # fmt: skip
"""Of kinds and of classes."""


def findings(study: EqualTorqueStudy) -> list[str]:
    """What the numbers say, a sentence each; `cannot tell` where an interval says so."""
    reaches = [
        f"The torque is equal: the largest difference of any set at any joint is "
        f"{float(study.torque_relative.max()):.0e} of that joint's torque.",
        weight_sentence(study.static_share),
    ]
    few = "too few independent chains to tell"
    for e in study.comparison.effects:
        if (e.first, e.second) in _COMPARED:
            who = f"Drawn sets that violate {_WORDS[e.first]} only"
            against = f"those that violate {_WORDS.get(e.second)} only"
            against = "drawn feasible sets" if e.second == "feasible" else against
            reaches.append(
                _judged(
                    e.ratio, 1, f"{who}, against {against}: {few}.",
                    f"{who} are not distinguishable from {against}: HOW.",
                    f"{who} have HOW of {against}.", "{:.2f} times the force error",
                )
            )  # fmt: skip
    for c in study.correlations:
        if c.kind in ("feasible", *_WORDS):
            among = f"sets that violate {_WORDS.get(c.kind)} only"
            among, which = (
                ("feasible sets", "firmer") if c.kind == "feasible" else (among, "less violating")
            )
            side = "smaller" if c.degree.value < 0 else "larger"
            reaches.append(
                _judged(
                    c.degree, 0, f"Among {among}: {few} whether the degree matters.",
                    f"Among {among} no effect of the degree is visible: HOW.",
                    f"Among {among} {which} ones have {side} errors: HOW.", "rho = {:.2f}",
                )
            )  # fmt: skip
    # What any set can do, feasible ones first.
    reach = {r.kind: r for r in study.reach}
    if "feasible" in reach:
        greatest = float(reach["feasible"].reached.max())
        reaches.append(f"Even feasible sets can be off by {greatest:.3g} N.")
        for kind in (kind for kind in ("inertia", "com") if kind in reach):
            times = (reach[kind].reached / reach["feasible"].bound).clamp(min=1.0).tolist()
            reaches.append(
                f"With {_WORDS[kind]} violated alone, the greatest error of any set is at least "
                f"{', '.join(f'{t:.2f}' for t in times)} times that of feasible ones (joint by "
                "joint)."
            )
    return reaches


def weight_sentence(share: tuple[float, float, float]) -> str:
    """How much of the largest force error is the weight of the carried mass's error: the median
    over the sets and the ends of their 95 % range. Only where it is nearly all of it in nearly all
    sets, of whatever kind, do the masses alone count."""
    middle, low, high = share
    apart = max(abs(1 - low), abs(1 - high))
    # 0.1: share of the force error that may be missing where it is called the carried mass's weight
    if apart <= 0.1:
        return (
            f"The force error is the weight of the carried mass's error to {100 * apart:.2g} % "
            "(95 % of all sets): what counts is how far the masses are off, whatever the reason "
            "for which a set is infeasible."
        )
    return (
        f"The weight of the carried mass's error is {100 * middle:.3g} % of the force error (95 % "
        f"of all sets: {100 * low:.3g} to {100 * high:.3g} %): in this motion first moments and "
        "accelerations count as well."
    )


def _judged(
    estimate: Estimate, none: float, few: str, same: str, other: str, how: str = "{:.2f} times"
) -> str:
    """What an interval says: too little, that `none` is in it, or that something is; `HOW` in these
    sentences is the estimate with its interval."""
    if math.isnan(estimate.low):
        return few
    said = f"{how.format(estimate.value)} (95 %: {estimate.low:.2f} to {estimate.high:.2f})"
    return (same if estimate.low <= none <= estimate.high else other).replace("HOW", said)


COLOURS = {
    "feasible": GREEN,
    "inertia": BLUE,
    "com": ORANGE,
    "mass": RED,
    "total_mass": BROWN,
    "inertia+com": PURPLE,
}


def figures(study: EqualTorqueStudy) -> Figures:
    """What draws each figure, by the names of their files."""
    return {
        "force_by_degree": partial(degree_figure, study),
        "force_by_kind": partial(kind_figure, study),
    }


def degree_figure(study: EqualTorqueStudy) -> Figure:
    """Force error against the degree, coloured by kind; what any feasible set can reach."""
    rows = {kind: study.rows(kind) for kind in study.kinds}
    what = "the degree of a violation and the error of the internal forces"
    figure = error_by_degree(
        f"{study.setting.robot.name}: {what}",
        study.degree.numpy(),
        study.worst.numpy(),
        {f"{kind_words(k)} ({len(own)})": (own, _colour(k)) for k, own in rows.items()},
    )
    (axes,) = figure.axes
    for value in (float(r.reached.max()) for r in study.reach if r.kind == "feasible"):
        axes.axhline(value, color=GREEN, linewidth=1.0, linestyle=(0, (5, 3)))
        axes.annotate(
            f"greatest of any feasible set: {value:.3g} N", (0.995, value),
            xycoords=axes.get_yaxis_transform(), xytext=(0, 3), textcoords="offset points",
            fontsize=8, color=GREEN, va="bottom", ha="right",
        )  # fmt: skip
    return figure


def by_class(classes: Sequence[str]) -> dict[str, tuple[list[int], str]]:
    """Rows and colour of each class of reasons."""
    return {
        name: ([k for k, own in enumerate(classes) if own == name], class_colour(name))
        for name in ordered_classes(classes)
    }


def error_by_degree(
    title: str,
    degree: np.ndarray,
    error: np.ndarray,
    groups: Mapping[str, tuple[list[int], str]],
    named: Iterable[tuple[int, str]] = (),
) -> Figure:
    """Force errors of sets against their degrees, a colour a group, with running medians where a
    group has enough of them.

    Args:
        title: of the figure.
        degree, error: of the sets; errors [N], largest joint.
        groups: rows and colour by name.
        named: rows with names beside their marks.
    """
    figure, axes = panel(10.5, 5.4)
    shown = np.maximum(error, 1e-12)
    for name, (rows, colour) in groups.items():
        # 100: sets from which marks are small
        look = {"s": 11 if len(error) > 100 else 22, "alpha": 0.55, "linewidths": 0}
        axes.scatter(degree[rows], shown[rows], color=colour, label=name, **look)
        # Running median of six groups of neighbours.
        neighbours = np.array_split(np.argsort(degree[rows]), 6)
        parts = [g for g in neighbours if len(g) >= 5]
        x, y = ([float(np.median(v[rows][g])) for g in parts] for v in (degree, shown))
        axes.plot(x, y, color="white", linewidth=3.6)
        axes.plot(x, y, color=colour, linewidth=2.0)
    for k, name in named:
        place = (degree[k], shown[k])
        axes.annotate(name, place, (4, 3), textcoords="offset points", fontsize=7, color=INK)
    # 1e-3: degrees smaller than this are drawn on a linear scale
    axes.set_xscale("symlog", linthresh=1e-3, linscale=0.6)
    axes.margins(x=0.08)
    axes.set(yscale="log", ylabel=_ERROR)
    axes.tick_params(axis="y", which="minor", labelsize=7, labelcolor=INK)
    axes.set_xlabel("degree (smallest margin over its scale; 0 is the boundary)")
    axes.axvline(0, color=INK, linewidth=0.9)
    for text, side in ((" feasible", "left"), ("infeasible ", "right")):
        axes.text(
            0.0, 1.04, text, transform=axes.get_xaxis_transform(), ha=side, va="top",
            fontsize=8, color=INK,
        )  # fmt: skip
    return finish(figure, title, axes)


def kind_figure(study: EqualTorqueStudy) -> Figure:
    """Boxes of the force error per joint and kind, with the greatest of any set and the force."""
    n, kinds = study.setting.robot.n, study.kinds
    columns = min(n, 4)
    joints = [f"joint {j + 1}" for j in range(n)]
    figure, grid = tiles(
        joints, columns, 2.6 * columns + 1.0, (3.0, 0.9), y="force error [N], RMS", sharey=True
    )
    reach = {r.kind: r.reached.tolist() for r in study.reach}
    own = study.errors.reference_force_rms.tolist()
    floor = 1e-2 * float(study.worst.median())
    for j, axes in enumerate(grid):
        for place, kind in enumerate(kinds):
            values = study.errors.force_rms[study.rows(kind), j].clamp(min=floor).numpy()
            colour = _colour(kind)
            axes.boxplot(
                values, positions=[place], widths=0.62, whis=(5, 95), showfliers=False,
                patch_artist=True, manage_ticks=False,
                boxprops={"facecolor": colour, "alpha": 0.45, "edgecolor": colour},
                medianprops={"color": INK, "linewidth": 1.4},
                whiskerprops={"color": colour}, capprops={"color": colour},
            )  # fmt: skip
            if kind in reach:
                axes.plot(place, max(reach[kind][j], floor), marker="_", color=INK, markersize=13)
        axes.axhline(max(own[j], floor), color=GREY, linewidth=1.2, linestyle=(0, (4, 2)))
        axes.set_yscale("log")
        shown = [kind_words(k) for k in kinds]
        axes.set_xticks(range(len(kinds)), shown, rotation=40, ha="right", fontsize=7)
    keys = {
        "the force itself (RMS)": {"color": GREY, "linewidth": 1.2, "linestyle": (0, (4, 2))},
        "greatest of any set of the kind": {
            "color": INK, "linewidth": 0, "marker": "_", "markersize": 12,
        },
    }  # fmt: skip
    title = f"{study.setting.robot.name}: force error per joint and kind of violation"
    return finish(figure, title, columns=2, keys=keys)


_ERROR = "force error, largest joint [N], RMS over the motion"


def _colour(kind: str) -> str:
    return COLOURS.get(kind, GREY)


def class_colour(name: str) -> str:
    """Colour of a class of reasons: that of its kind."""
    kinds = {label: kind for kind, label in CLASS_NAMES.items()} | {MIXED: "inertia+com"}
    return _colour(kinds.get(name, name))
