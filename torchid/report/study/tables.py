"""A study's numbers as tables: coefficients, search, classification, torque; and all of them."""

from torchid.report.study.facts import (
    active,
    contradictions,
    count,
    endings,
    joint_names,
    kept,
    listed,
    number,
    phi_min,
    reason_counts,
    torque_errors,
    torque_unit,
    with_conditions,
)
from torchid.report.study.sheets import Sheet
from torchid.report.study.wrench_tables import class_sheet, payload_sheet, set_wrench_sheet
from torchid.study.result import ScenarioResult, Study

_FREQUENT = 6


def identification_sheet(study: Study) -> Sheet:
    """Tables A.1 to A.4: coefficient, estimated, real, error."""
    found = study.identification
    rows = zip(found.base.names, found.base.units, found.values, study.truth, strict=True)
    return Sheet(
        f"identified coefficients of {study.robot.name} (tables A.1 to A.4)",
        ("coefficient", "unit", "estimated", "real", "error"),
        tuple(
            (name, unit, f"{float(value):.6g}", f"{float(true):.6g}", number(float(value - true)))
            for name, unit, value, true in rows
        ),
        frozenset({"coefficient", "unit"}),
    )


def scenario_sheet(study: Study) -> Sheet:
    """Tables 5.2 to 5.5 and A.7 to A.10: the best set of each scenario."""
    return Sheet(
        "best set of each scenario (tables 5.2 to 5.5)",
        ("set", "bounds", "loss", "phi", "phi_min", "gamma", "feasible", "why not", "degree",
         "torque"),
        tuple(_scenario_row(study, s) for s in study.scenarios),
        frozenset({"set", "bounds", "loss", "feasible", "why not"}),
        "phi: loss; phi_min: proven least loss of any feasible set within the bounds; gamma: "
        "penalty; degree: negative outside, 0 on the boundary; torque: root mean square error on a "
        f"new motion over that of the torque, largest joint.{_alone(study)}",
    )  # fmt: skip


def _scenario_row(study: Study, s: ScenarioResult) -> tuple[str, ...]:
    return (
        s.scenario.id, s.scenario.bounds, s.scenario.penalty, number(s.phi, 4),
        number(phi_min(study, s), 4), number(s.gamma), "yes" if s.feasible else "no",
        ", ".join(s.reasons) or "-", number(s.degree, 2), number(s.torque_relative, 2),
    )  # fmt: skip


def _alone(study: Study) -> str:
    """For which bounds phi_min does not count the conditions."""
    alone = [b for b in study.certificates if not with_conditions(study, b)]
    return f" For the bounds {listed(alone)}, phi_min is that of the bounds and physics alone." * (
        bool(alone)
    )


def search_sheet(study: Study) -> Sheet:
    """How the runs of each scenario ended, before and after the polish."""
    rows = []
    for s in study.scenarios:
        e = s.extraction
        runs = len(e.sets)
        rows.append(
            (
                s.scenario.id,
                str(runs),
                *(number(float(x)) for x in (e.searched_phi.min(), e.searched_phi.median())),
                *(number(float(x)) for x in (e.phi.min(), e.phi.median(), e.phi.max())),
                f"{kept(e.searched_gamma)} / {kept(e.gamma)}",
                str(int(s.feasibility.feasible.sum())),
                str(len(endings(s).unique())),
                f"{e.seconds:.1f}",
            )
        )
    return Sheet(
        "runs of each scenario: loss phi before and after the polish",
        ("set", "runs", "best before", "median before", "best", "median", "worst", "gamma = 0",
         "feasible", "different", "time [s]"),
        tuple(rows),
        frozenset({"set"}),
        "gamma = 0: runs without any penalty, before / after the polish; different: runs that "
        "ended in the same set count once.",
    )  # fmt: skip


def certificate_sheet(study: Study) -> Sheet | None:
    """phi_min of each group of bounds, and what stands in the way; None without certificates."""
    if not study.certificates:
        return None
    rows = []
    for bounds, c in study.certificates.items():
        rows.append(
            (
                bounds,
                number(c.phi_min, 4),
                number(c.phi_strict, 4),
                "all" if with_conditions(study, bounds) else "bounds and physics only",
                ", ".join(c.forcing) or "-",
                ", ".join(f"{k} ({number(v, 4)})" for k, v in active(c).items()) or "-",
                ", ".join(contradictions(study, bounds) or c.conflict) or "-",
                ", ".join(c.relaxed_active) or "-",
                f"{c.seconds:.1f}",
            )
        )
    return Sheet(
        "what no search can beat: least loss of any feasible set",
        ("bounds", "phi_min", "reached", "conditions", "forced by", "phi_min without",
         "no room for", "relaxed", "time [s]"),
        tuple(rows),
        frozenset({"bounds", "conditions", "forced by", "phi_min without",
                   "no room for", "relaxed"}),
        "reached: loss of a strictly feasible set that was found; forced by: conditions without "
        "which phi_min is nearly zero; phi_min without: one condition released, where that saves "
        "5 % or more; no room for: conditions that the bounds meet on a face of theirs at most; "
        "relaxed: bounds that count in phi_min by a relaxation only.",
    )  # fmt: skip


def reason_sheet(study: Study) -> Sheet:
    """Reasons of the best set beside how often they occur: what is chance of the search."""
    rows = []
    for s in study.scenarios:
        runs = len(s.extraction.sets)
        found = reason_counts(s)
        shown = [f"{name} {k}" for name, k in list(found.items())[:_FREQUENT]]
        more = len(found) - len(shown)
        feasible = int(s.feasibility.feasible.sum())
        often = ", ".join(shown) + (f", {count(more, 'other')}" if more else "")
        why = ", ".join(s.reasons) or "-"
        rows.append((s.scenario.id, why, f"{feasible} of {runs}", often or "-"))
    return Sheet(
        "reasons of the best set, and in how many runs each reason occurs",
        ("set", "best set: why not", "runs feasible", "reasons over all runs"),
        tuple(rows),
        frozenset({"set", "best set: why not", "reasons over all runs"}),
        "The best set is the run of least loss: where many runs have losses that differ by "
        "rounding only, which of them is best, and hence its reasons, is chance of the search.",
    )


def torque_sheet(study: Study) -> Sheet:
    """Torque errors of the best sets per joint."""
    error, real = torque_errors(study.sets_motion)
    unit = torque_unit(study)
    rows = [
        (name, *(number(v) for v in row.tolist()), number(float((row / real).max())))
        for name, row in zip(study.sets_motion.labels[1:], error, strict=True)
    ]
    rows.insert(0, ("real torque", *(number(v) for v in real.tolist()), "-"))
    return Sheet(
        f"torque of the best sets on a new motion: root mean square error per joint [{unit}]",
        ("set", *joint_names(study), "largest share"),
        tuple(rows),
        frozenset({"set"}),
    )


def all_sheets(study: Study) -> list[Sheet]:
    """Every table, in the page's order."""
    found = (
        identification_sheet(study), certificate_sheet(study), scenario_sheet(study),
        search_sheet(study), reason_sheet(study), torque_sheet(study), set_wrench_sheet(study),
        class_sheet(study), payload_sheet(study),
    )  # fmt: skip
    return [sheet for sheet in found if sheet is not None]
