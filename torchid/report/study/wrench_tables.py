"""Internal wrenches and payload of a study as tables."""

import math

import torch

from torchid.report.study.facts import (
    best_rows,
    class_errors,
    count,
    different,
    joint_names,
    listed,
    number,
)
from torchid.report.study.sheets import Sheet
from torchid.robot.inertia import InertialParameters
from torchid.study.result import Study
from torchid.wrenches.compare import ClassSummary
from torchid.wrenches.resampling import Estimate

PAYLOAD_QUANTITIES = (
    ("mass", "kg"),
    *((f"com {axis}", "m") for axis in "xyz"),
    *((f"inertia {entry}", "kg m^2") for entry in ("xx", "xy", "xz", "yy", "yz", "zz")),
)
"""Names and units of what is estimated of a payload; the inertia is about its centre of mass."""


def set_wrench_sheet(study: Study) -> Sheet:
    """Errors of the internal forces of the best sets per joint, moments beside the largest."""
    e, rows = study.errors, best_rows(study)
    cells = [
        (
            s.scenario.id,
            "yes" if s.feasible else "no",
            *(number(v) for v in e.force_rms[row].tolist()),
            number(float(e.moment_rms[row].max())),
        )
        for s, row in zip(study.scenarios, rows, strict=True)
    ]
    real = [number(v) for v in e.reference_force_rms.tolist()]
    cells.insert(0, ("real wrench", "-", *real, number(float(e.reference_moment_rms.max()))))
    return Sheet(
        "internal wrenches of the best sets: root mean square of the force error per joint [N], "
        "largest moment error [N m]",
        ("set", "feasible", *joint_names(study), "moment"),
        tuple(cells),
        frozenset({"set", "feasible"}),
        "The error is the norm of the difference of the vectors, which is never smaller than the "
        "difference of the norms that the figures show.",
    )


def class_sheet(study: Study) -> Sheet:
    """Force errors of all runs by reason class, against feasible ones."""
    effects = {e.first: e for e in study.comparison.effects}
    rows = []
    for c in study.comparison.classes:
        effect = effects.get(c.name)
        rows.append(
            (
                c.name,
                str(c.sets),
                str(different(class_errors(study, c.name))),
                *(_or_dash(v) for v in (c.median, c.lower_quartile, c.upper_quartile)),
                "-" if effect is None else _interval(effect.ratio),
                "-" if effect is None else _interval(effect.delta),
            )
        )
    first = study.comparison.classes[0].name
    return Sheet(
        "force error of all runs by the kind of their reasons: largest joint [N]",
        ("class", "sets", "different", "median", "lower quartile", "upper quartile",
         f"ratio to {first}", "Cliff's delta"),
        tuple(rows),
        frozenset({"class"}),
        f"{_correlations(study)} A ratio of 1 and a delta of 0 are no difference; in brackets 95 % "
        "bootstrap intervals that take every run for its own unit: they are too narrow where many "
        "runs have the same error (`different` counts errors that differ by 0.1 % or more).",
    )  # fmt: skip


def reason_error_sheet(study: Study) -> Sheet:
    """Force errors of all runs that have a reason, alone or among others."""
    found = study.comparison.per_reason
    return Sheet(
        "force error of all runs that have a reason, alone or among others: largest joint [N]",
        ("reason", "sets", "median", "lower quartile", "upper quartile"),
        tuple(_summary(c) for c in found),
        frozenset({"reason"}),
    )


def payload_sheet(study: Study) -> Sheet:
    """True and estimated payload in the tool frame, with intervals."""
    truth, value, low, high = payload_numbers(study)
    rows = [
        (
            name,
            unit,
            number(t, 4),
            number(v, 4) if math.isfinite(v) else "not known",
            f"{number(a, 4)} .. {number(b, 4)}" if math.isfinite(a) else "-",
            "-" if not math.isfinite(a) else "yes" if a <= t <= b else "no",
        )
        for (name, unit), t, v, a, b in zip(
            PAYLOAD_QUANTITIES, truth, value, low, high, strict=True
        )
    ]
    return Sheet(
        "payload in the tool frame, inertia about its centre of mass",
        ("quantity", "unit", "true", "estimated", "95 % interval", "true inside"),
        tuple(rows),
        frozenset({"quantity", "unit", "true inside"}),
    )


def payload_numbers(study: Study) -> tuple[list[float], list[float], list[float], list[float]]:
    """True value, estimate, lower and upper end of the 95 % interval of the ten quantities."""
    body = InertialParameters(study.payload.true)
    true = torch.cat([body.mass.reshape(1), body.com, body.inertia_about_com])
    tool = study.payload.estimate.tool
    parts = (tool.mass, tool.com, tool.inertia_about_com)
    value, low, high = (
        torch.cat([getattr(part, name) for part in parts]).tolist()
        for name in ("value", "low", "high")
    )
    return true.tolist(), value, low, high


def _summary(c: ClassSummary) -> tuple[str, ...]:
    values = (c.median, c.lower_quartile, c.upper_quartile)
    return (c.name, str(c.sets), *(_or_dash(v) for v in values))


def _or_dash(value: float | None) -> str:
    return "-" if value is None else number(value)


def _interval(e: Estimate) -> str:
    if math.isnan(e.value):
        return "-"
    if math.isnan(e.low):
        return number(e.value)
    return f"{number(e.value)} [{number(e.low)}, {number(e.high)}]"


def _correlations(study: Study) -> str:
    c = study.comparison
    parts = [
        f"{_interval(found.rho)} over {what}"
        for what, found in (
            (count(c.correlation.sets, "set"), c.correlation),
            (f"the {c.correlation_infeasible.sets} infeasible ones", c.correlation_infeasible),
        )
        if not math.isnan(found.rho.value)
    ]
    if not parts:
        return "No rank correlation of degree and error: too few sets."
    return f"Rank correlation of degree and error: {listed(parts)}."
