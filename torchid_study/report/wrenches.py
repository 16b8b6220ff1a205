"""Internal forces of many sets: tables, sentences that follow their intervals, and one picture."""

import math
from collections.abc import Iterable
from functools import partial

import numpy as np

from torchid.report.panels import Figure, Figures, finish, panel
from torchid.report.table import Report, Table, cells, table_of
from torchid_study.equal_torque.given_sets import GivenSets
from torchid_study.equal_torque.study import EqualTorqueRecord, EqualTorqueStudy, GivenSetsRecord
from torchid_study.wrenches.classes import class_of
from torchid_study.wrenches.compare import Comparison
from torchid_study.wrenches.resampling import Estimate


def report_of_equal_torque(study: EqualTorqueRecord) -> Report:
    """All that there is to see of a study of families: errors by kind, their differences, and what
    any set can do."""
    nominal = study.reference.origin == "nominal"
    title = f"errors against the {'nominal parameters' if nominal else 'nearest feasible set'}"
    own = f"The reference's own forces: {' '.join(cells(study.reference.force_rms))} N."
    return Report(
        parts=[
            table_of(f"{study.robot}: {title}, median", study.kinds, note=own),
            effect_table(study.comparison),
            table_of("greatest force error of any set with this torque [N]", study.reach),
        ],
        warnings=study.warnings,
        last="\n".join(f"- {sentence}" for sentence in findings(study)),
        figures=figures(study),
    )


def report_of_given_sets(given: GivenSetsRecord) -> Report:
    """All that there is to see of given sets: one by one, then by class and by reason."""
    reference, ordered = given.reference, sorted(given.sets, key=lambda one: -one.worst)
    name = reference.id
    against = f"the nominal parameters of {name}" if name == given.robot else name
    near, far = ordered[-1], ordered[0]
    extremes = f"{near.worst:.3g} N ({near.id})"
    if len(ordered) > 1:
        extremes = f"between {extremes} and {far.worst:.3g} N ({far.id})"
    own = f"The reference's own forces: {' '.join(cells(reference.force_rms))} N."
    # 40: sets that are printed, those of the largest errors
    return Report(
        parts=[
            table_of(f"errors against {against}, by joint", ordered, note=own, most=40),
            *(class_tables(given.comparison) if len(ordered) > 1 else ()),
        ],
        warnings=given.warnings,
        last=f"Against {against}, on {given.instants} instants: the largest force error over the "
        f"joints is {extremes} RMS; torques differ by at most "
        f"{100 * given.torque_relative_max:.2g} % of a joint's own.",
        figures=figures(given),
    )


def unequal_torque(given: GivenSetsRecord) -> list[str]:
    """Says when the sets do not have the reference's torque: then the forces differ for that."""
    worst = [float(one.torque_relative.max()) for one in given.sets]
    # 0.01: relative difference of a joint's torque above which sets do not count as having equal
    # torque
    count = sum(size > 0.01 for size in worst)
    if count == 0:
        return []
    return [
        f"{count} of {len(worst)} sets do not have the torque of the reference "
        f"'{given.reference.id}' (up to {100 * max(worst):.2g} % off at one joint): "
        "these differences are not what equal torque leaves open. --reference ID compares with "
        "one of them"
    ]


def class_tables(comparison: Comparison) -> list[Table]:
    """Errors by class, then of all sets that have a reason, alone or among others; differences of
    the classes."""
    rho = comparison.correlation.rho
    note = f"Spearman's rank correlation of degree and error: {rho}."
    every = (*comparison.classes, *comparison.per_reason)
    return [
        table_of("force error by class and reason, largest joint", every, note=note),
        effect_table(comparison),
    ]


def effect_table(comparison: Comparison) -> Table:
    """Differences of the classes, with 95 % intervals."""
    title = "differences of the classes (95 % intervals from whole clusters)"
    return table_of(title, comparison.effects, "first second ratio delta")


def figures(result: EqualTorqueStudy | EqualTorqueRecord | GivenSets | GivenSetsRecord) -> Figures:
    """What draws the figure, by the name of its file."""
    record = result.record
    shown = [
        (one.kind if isinstance(one.kind, str) else class_of(one.reasons), one.degree, one.worst)
        for one in record.sets
    ]
    return {"force_by_degree": partial(force_by_degree, record.robot, shown)}


def force_by_degree(robot: str, sets: Iterable[tuple[str, float, float]]) -> Figure:
    """Force errors of sets against their degrees, a colour a group, with running medians where a
    group has enough sets.

    Args:
        robot: its name.
        sets: group, degree, and largest force error over the joints [N].
    """
    figure, axes = panel(10.5, 5.4)
    groups: dict[str, list[list[float]]] = {}
    for name, *point in sets:
        groups.setdefault(name, []).append(point)
    for k, (name, points) in enumerate(groups.items()):
        degree, error = np.maximum(np.array(points), (-np.inf, 1e-12)).T
        axes.scatter(degree, error, s=14, alpha=0.55, color=f"C{k}", label=name)
        # Running median of six groups of neighbours, of five sets at least.
        parts = [own for own in np.array_split(np.argsort(degree), 6) if len(own) >= 5]
        axes.plot(*([np.median(x[own]) for own in parts] for x in (degree, error)), color=f"C{k}")
    # 1e-3: degrees smaller than this are drawn on a linear scale
    axes.set_xscale("symlog", linthresh=1e-3, linscale=0.6)
    axes.axvline(0, color="black", linewidth=0.9)
    axes.set(yscale="log", ylabel="force error, largest joint [N], RMS over the motion")
    axes.set_xlabel("degree: below 0 infeasible, 0 the boundary, above feasible")
    return finish(figure, f"{robot}: degree and error of the internal forces", axes)


_COMPARED = (
    ("inertia only", "feasible"), ("CoM only", "feasible"), ("CoM only", "inertia only"),
)  # fmt: skip
"""Classes whose difference is told."""
_WORDS = {
    "inertia": "inertia", "com": "centres of mass",
    "inertia only": "inertia", "CoM only": "centres of mass",
}  # fmt: skip
"""Of kinds and of classes."""


def findings(study: EqualTorqueRecord) -> list[str]:
    """What the numbers say, a sentence each; `cannot tell` where an interval says so."""
    reaches = [
        f"The torque is equal: the largest difference of any set at any joint is "
        f"{study.torque_relative_max:.0e} of that joint's torque.",
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
