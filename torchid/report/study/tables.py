"""A study's numbers as tables: coefficients, search, classification, torque, wrenches, payload."""

import math
from collections import Counter

from torchid.report.study import facts
from torchid.report.study.facts import kept, number
from torchid.report.table import Table, count, listed, torque_unit
from torchid.study.result import Study
from torchid.wrenches.compare import ClassSummary
from torchid.wrenches.resampling import Estimate

_FREQUENT = 6
_ACTIVE = 5e-2
"""Share of phi_min that releasing a condition saves, for the condition to be named."""


def identification_table(study: Study) -> Table:
    """Tables A.1 to A.4: coefficient, estimated, real, error."""
    found = study.identification
    values = zip(found.base.names, found.base.units, found.values, study.truth, strict=True)
    return Table(
        f"identified coefficients of {study.robot.name} (tables A.1 to A.4)",
        ("coefficient", "unit", "estimated", "real", "error"),
        [
            (name, unit, f"{float(value):.6g}", f"{float(true):.6g}", number(float(value - true)))
            for name, unit, value, true in values
        ],
        words=("coefficient", "unit"),
    )


def scenario_table(study: Study) -> Table:
    """Tables 5.2 to 5.5 and A.7 to A.10: the best set of each scenario."""
    rows = [
        (
            s.scenario.id, s.scenario.bounds, s.scenario.penalty, number(s.phi, 4),
            number(facts.phi_min(study, s), 4), number(s.gamma), "yes" if s.feasible else "no",
            ", ".join(s.reasons) or "-", number(s.degree, 2), number(s.torque_relative, 2),
        )
        for s in study.scenarios
    ]  # fmt: skip
    # For some bounds phi_min does not count the conditions.
    alone = [b for b, c in study.certificates.items() if not c.with_conditions]
    note = f" For the bounds {listed(alone)}, phi_min is that of the bounds and physics alone."
    return Table(
        "best set of each scenario (tables 5.2 to 5.5)",
        ("set", "bounds", "loss", "phi", "phi_min", "gamma", "feasible", "why not", "degree",
         "torque"),
        rows,
        words=("set", "bounds", "loss", "feasible", "why not"),
        note="phi: loss; phi_min: proven least loss of any feasible set within the bounds; gamma: "
        "penalty; degree: negative outside, 0 on the boundary; torque: root mean square error on a "
        f"new motion over that of the torque, largest joint.{note if alone else ''}",
    )  # fmt: skip


def search_table(study: Study) -> Table:
    """How the runs of each scenario ended, before and after the polish."""
    rows = []
    for s in study.scenarios:
        e = s.extraction
        before = (e.searched_phi.min(), e.searched_phi.median())
        losses = (*before, e.phi.min(), e.phi.median(), e.phi.max())
        rows.append(
            (
                s.scenario.id, str(len(e.sets)), *(number(float(x)) for x in losses),
                f"{kept(e.searched_gamma)} / {kept(e.gamma)}",
                str(int(s.feasibility.feasible.sum())), str(len(facts.endings(s).unique())),
                f"{e.seconds:.1f}",
            )
        )  # fmt: skip
    return Table(
        "runs of each scenario: loss phi before and after the polish",
        ("set", "runs", "best before", "median before", "best", "median", "worst", "gamma = 0",
         "feasible", "different", "time [s]"),
        rows,
        words=("set",),
        note="gamma = 0: runs without any penalty, before / after the polish; different: runs that "
        "ended in the same set count once.",
    )  # fmt: skip


def certificate_table(study: Study) -> Table | None:
    """phi_min of each group of bounds, and what stands in the way; None without certificates."""
    rows = []
    for bounds, c in study.certificates.items():
        # phi_min without each condition that raises it by more than a little, largest effect first.
        released = sorted(c.released.items(), key=lambda item: item[1])
        active = [
            f"{name} ({number(v, 4)})" for name, v in released if v < (1 - _ACTIVE) * c.phi_min
        ]
        conditions = "all" if c.with_conditions else "bounds and physics only"
        no_room = facts.contradictions(study, bounds) or c.conflict
        stands = (", ".join(x) or "-" for x in (c.forcing, active, no_room, c.relaxed_active))
        losses = (number(c.phi_min, 4), number(c.phi_strict, 4))
        rows.append((bounds, *losses, conditions, *stands, f"{c.seconds:.1f}"))
    words = ("bounds", "conditions", "forced by", "phi_min without", "no room for", "relaxed")
    table = Table(
        "what no search can beat: least loss of any feasible set",
        (words[0], "phi_min", "reached", *words[1:], "time [s]"),
        rows,
        words=words,
        note="reached: loss of a strictly feasible set that was found; forced by: conditions "
        "without which phi_min is nearly zero; phi_min without: one condition released, where that "
        "saves 5 % or more; no room for: conditions that the bounds meet on a face of theirs at "
        "most; relaxed: bounds that count in phi_min by a relaxation only.",
    )
    return table if rows else None


def reason_table(study: Study) -> Table:
    """Reasons of the best set beside how often they occur: what is chance of the search."""
    rows = []
    for s in study.scenarios:
        runs = len(s.extraction.sets)
        every = Counter(reason for k in range(runs) for reason in s.feasibility.reasons(k))
        found = sorted(every.items(), key=lambda item: (-item[1], item[0]))
        often = ", ".join(f"{name} {k}" for name, k in found[:_FREQUENT])
        if len(found) > _FREQUENT:
            often += f", {count(len(found) - _FREQUENT, 'other')}"
        feasible = f"{int(s.feasibility.feasible.sum())} of {runs}"
        rows.append((s.scenario.id, ", ".join(s.reasons) or "-", feasible, often or "-"))
    columns = ("set", "best set: why not", "runs feasible", "reasons over all runs")
    return Table(
        "reasons of the best set, and in how many runs each reason occurs",
        columns,
        rows,
        words=(*columns[:2], columns[3]),
        note="The best set is the run of least loss: where many runs have losses that differ by "
        "rounding only, which of them is best, and hence its reasons, is chance of the search.",
    )


def torque_table(study: Study) -> Table:
    """Torque errors of the best sets per joint."""
    error, real = facts.torque_errors(study.sets_motion)
    rows = [("real torque", *(number(v) for v in real.tolist()), "-")]
    for name, row in zip(study.sets_motion.labels[1:], error, strict=True):
        largest = number(float((row / real).max()))
        rows.append((name, *(number(v) for v in row.tolist()), largest))
    unit = torque_unit(study.robot, "N m; N")
    return Table(
        f"torque of the best sets on a new motion: root mean square error per joint [{unit}]",
        ("set", *facts.joint_names(study), "largest share"),
        rows,
        words=("set",),
    )


def set_wrench_table(study: Study) -> Table:
    """Errors of the internal forces of the best sets per joint, moments beside the largest."""
    e = study.errors
    sets = [("real wrench", "-", e.reference_force_rms, e.reference_moment_rms)]
    for s, row in zip(study.scenarios, facts.best_rows(study), strict=True):
        said = "yes" if s.feasible else "no"
        sets.append((s.scenario.id, said, e.force_rms[row], e.moment_rms[row]))
    return Table(
        "internal wrenches of the best sets: root mean square of the force error per joint [N], "
        "largest moment error [N m]",
        ("set", "feasible", *facts.joint_names(study), "moment"),
        [
            (name, said, *(number(v) for v in force.tolist()), number(float(moment.max())))
            for name, said, force, moment in sets
        ],
        words=("set", "feasible"),
        note="The error is the norm of the difference of the vectors, which is never smaller than "
        "the difference of the norms that the figures show.",
    )


def class_table(study: Study) -> Table:
    """Force errors of all runs by reason class, against feasible ones."""
    effects = {e.first: e for e in study.comparison.effects}
    rows = []
    for c in study.comparison.classes:
        name, sets, *quartiles = _summary(c)
        effect, distinct = effects.get(name), str(facts.distinct_errors(study, name))
        against = ("-", "-")
        if effect is not None:
            against = (_interval(effect.ratio), _interval(effect.delta))
        rows.append((name, sets, distinct, *quartiles, *against))
    found = study.comparison
    rho = [
        f"{_interval(correlation.rho)} over {what}"
        for what, correlation in (
            (count(found.correlation.sets, "set"), found.correlation),
            (
                f"the {found.correlation_infeasible.sets} infeasible ones",
                found.correlation_infeasible,
            ),
        )
        if not math.isnan(correlation.rho.value)
    ]
    said = "No rank correlation of degree and error: too few sets."
    if rho:
        said = f"Rank correlation of degree and error: {listed(rho)}."
    return Table(
        "force error of all runs by the kind of their reasons: largest joint [N]",
        ("class", "sets", "different", "median", "lower quartile", "upper quartile",
         f"ratio to {found.classes[0].name}", "Cliff's delta"),
        rows,
        words=("class",),
        note=f"{said} A ratio of 1 and a delta of 0 are no difference; in brackets 95 % "
        "bootstrap intervals that take every run for its own unit: they are too narrow where many "
        "runs have the same error (`different` counts errors that differ by 0.1 % or more).",
    )  # fmt: skip


def reason_error_table(study: Study) -> Table:
    """Force errors of all runs that have a reason, alone or among others."""
    return Table(
        "force error of all runs that have a reason, alone or among others: largest joint [N]",
        ("reason", "sets", "median", "lower quartile", "upper quartile"),
        [_summary(c) for c in study.comparison.per_reason],
        words=("reason",),
    )


def payload_table(study: Study) -> Table:
    """True and estimated payload in the tool frame, with intervals."""
    rows = []
    for q in facts.payload_quantities(study):
        value = number(q.value, 4) if math.isfinite(q.value) else "not known"
        ends = ("-", "-")
        if math.isfinite(q.low):
            ends = (f"{number(q.low, 4)} .. {number(q.high, 4)}", "yes" if q.held else "no")
        rows.append((q.name, q.unit, number(q.true, 4), value, *ends))
    return Table(
        "payload in the tool frame, inertia about its centre of mass",
        ("quantity", "unit", "true", "estimated", "95 % interval", "true inside"),
        rows,
        words=("quantity", "unit", "true inside"),
    )


def all_tables(study: Study) -> list[Table]:
    """Every table, in the page's order."""
    found = (
        identification_table(study), certificate_table(study), scenario_table(study),
        search_table(study), reason_table(study), torque_table(study), set_wrench_table(study),
        class_table(study), payload_table(study),
    )  # fmt: skip
    return [table for table in found if table is not None]


def _summary(c: ClassSummary) -> tuple[str, ...]:
    values = (c.median, c.lower_quartile, c.upper_quartile)
    return (c.name, str(c.sets), *("-" if v is None else number(v) for v in values))


def _interval(e: Estimate) -> str:
    if math.isnan(e.value) or math.isnan(e.low):
        return number(e.value)
    return f"{number(e.value)} [{number(e.low)}, {number(e.high)}]"
