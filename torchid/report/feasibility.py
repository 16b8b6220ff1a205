"""A check of feasibility as tables for people."""

import math
from collections import Counter
from collections.abc import Sequence

from rich.text import Text

from torchid.extraction.convex.nearest import NearestSets
from torchid.feasibility.margins import LINK_CONDITIONS
from torchid.feasibility.plausibility import excess_percent
from torchid.feasibility.record import Check
from torchid.report.table import Cell, Report, Table, cells, joint_numbers
from torchid.results.words import listed
from torchid.robot.model import JointType

NEAR = 0.05
"""Degree below which a condition is shown as near its boundary."""
MOST_TABLES = 3
"""Sets that have a table each; more are one row a set."""
DEGREE = (
    "degree: the smallest margin of all conditions, each over a scale of its own (a link's mean "
    "second moment, half a box's side, the mean mass): negative outside, 0 on the boundary"
)


def report_of_check(check: Check, repaired: NearestSets | None, warnings: Sequence[str]) -> Report:
    """All that there is to see of a check, and of the feasible sets nearest to it, if asked for."""
    nearest = [] if repaired is None else [nearest_table(repaired)]
    return Report(
        verdict=headline(check),
        parts=[conditions_line(check), *tables(check), *nearest, DEGREE],
        warnings=warnings,
    )


def tables(check: Check) -> list[Table]:
    """A table of links a set, or one row a set where there are many."""
    if len(check.sets) > MOST_TABLES:
        return [_set_table(check)]
    makers = (_link_table, _coefficient_table)
    return [make(check, k) for k in range(len(check.sets)) for make in makers]


def headline(check: Check) -> str:
    """What is feasible and what is not, and why, in one sentence a set; counts for many."""
    count = len(check.sets)
    if count <= MOST_TABLES:
        return "\n".join(verdict(check, k) for k in range(count))
    reasons = Counter(r for k in range(count) for r in check.feasibility.reasons(k))
    feasible = int(check.feasibility.feasible.sum())
    often = ", ".join(f"{reason} ({times})" for reason, times in reasons.most_common(5))
    said = f"{feasible} of {count} sets are feasible"
    return f"{said}; most often violated: {often}." if often else f"{said}."


def verdict(check: Check, k: int) -> str:
    """One set in one sentence: feasible with which degree, or what is violated, and by how much."""
    judged, name = check.feasibility, check.sets.ids[k]
    if not bool(judged.feasible[k]):
        return f"{name} is infeasible: {', '.join(_violations(check, k))}."
    # The condition with the smallest degree is the nearest.
    named = {
        f"{condition} of link {i + 1}": float(judged.degrees[k, i, c])
        for i in range(check.robot.n_links)
        for c, condition in enumerate(LINK_CONDITIONS)
    }
    named["the total mass"] = float(judged.total_mass_degree[k])
    degrees = judged.coefficient_degrees[k].tolist()
    named |= dict(zip(judged.coefficient_names, degrees, strict=True))
    nearest = min(named, key=named.__getitem__)
    return f"{name} is feasible, with degree {float(judged.degree[k]):.3g} (nearest: {nearest})."


def conditions_line(check: Check) -> str:
    """What the sets were checked against."""
    low, high = check.conditions.total_mass.tolist()
    parts = [
        "positive masses, inertias that a body can have",
        "signs of the effects' coefficients" if check.sets.effects else "",
        f"centres of mass in boxes: {check.geometry}",
        "cylinders and spheres of the links" if check.round_shapes else "",
        f"total mass in {low:g} .. {high:g} kg" if low > -math.inf or high < math.inf else "",
    ]
    return f"checked: {'; '.join(part for part in parts if part)}"


def _violations(check: Check, k: int) -> list[str]:
    """Phrases, those of the same kind together."""
    feasibility, links = check.feasibility, range(check.robot.n_links)
    broken = [feasibility.inertia_violation(k, i) for i in links]
    bad = feasibility.violated_coefficients[k].tolist()
    kinds = (
        ("not positive", [f"mass_{i + 1}" for i in links if bool(feasibility.violated[k, i, 0])]),
        ("not positive definite", [f"inertia_{i + 1}" for i in links if broken[i] == "eigenvalue"]),
        ("negative", [r for r, b in zip(feasibility.coefficient_reasons, bad, strict=True) if b]),
    )
    masses, inertias, negative = (
        [f"{listed(names)} {'is' if len(names) == 1 else 'are'} {what}"] if names else []
        for what, names in kinds
    )
    phrases = [*masses, *inertias]
    for i in links:
        if broken[i] == "triangle":
            excess = excess_percent(check.eigenvalues[k, i].tolist())
            by = "" if excess is None else f" (by {excess:.3g} %)"
            phrases.append(f"inertia_{i + 1} breaks the triangle inequality{by}")
    for i in links:
        for column, name in enumerate(LINK_CONDITIONS):
            if column > 2 and bool(feasibility.violated[k, i, column]):
                missed = f"{-1e3 * float(feasibility.margins[k, i, column]):.3g} mm"
                phrases.append(
                    f"shape_{i + 1} is missed by {missed}"
                    if name == "shape"
                    else f"com_{i + 1}{name[-1]} is {missed} outside its box"
                )
    if bool(feasibility.violated_total[k]):
        phrases.append(f"total_mass is {float(check.sets.parameters.mass[k].sum()):.4g} kg")
    return [*phrases, *negative]


def _coloured(text: str, degree: float, violated: bool) -> Text:
    if violated or math.isnan(degree):
        return Text(text, "red")
    return Text(text, "yellow" if degree < NEAR else "")


def _link_table(check: Check, k: int) -> Table:
    feasibility = check.feasibility
    boxes = bool(check.conditions.com_box.isfinite().any())
    columns = [
        "", "link", "mass\n[kg]", "principal inertias\n[kg m²]", "largest over sum\nof others [%]",
        "CoM\n[mm]",
    ]  # fmt: skip
    columns += ["CoM to box\n[mm]"] * boxes + ["to shape\n[mm]"] * check.round_shapes + ["degree"]
    rows = []
    for i, name in enumerate(check.robot.link_names):
        degrees, bad = feasibility.degrees[k, i].tolist(), feasibility.violated[k, i].tolist()
        margins = feasibility.margins[k, i].tolist()
        eigenvalues = check.eigenvalues[k, i].tolist()
        excess = excess_percent(eigenvalues)
        texts: list[Cell] = [
            _coloured(f"{float(check.sets.parameters.mass[k, i]):.4g}", degrees[0], bad[0]),
            _coloured(" ".join(f"{v:.3g}" for v in eigenvalues), degrees[1], bad[1]),
            _coloured("-" if excess is None else f"{100 + excess:.3g}", degrees[2], bad[2]),
            " ".join(f"{1e3 * c:.1f}" for c in check.sets.parameters.com[k, i].tolist()),
        ]
        if boxes:
            # Of the three sides of the box the nearest one is shown.
            c = min((3, 4, 5), key=lambda column: degrees[column])
            known = math.isfinite(margins[c])
            text = f"{1e3 * margins[c]:.1f} {LINK_CONDITIONS[c][-1]}" if known else "-"
            texts.append(_coloured(text, degrees[c], bad[c]))
        if check.round_shapes:
            texts.append(_coloured(f"{1e3 * margins[6]:.1f}", degrees[6], bad[6]))
        least = min(degrees)
        degree = f"{least:.2g}" if math.isfinite(least) else "no body"
        rows.append((str(i + 1), name, *texts, _coloured(degree, least, any(bad))))
    title = f"links of {check.sets.ids[k]} (red: violated, yellow: degree below {NEAR:g})"
    return Table(title, columns, rows, "ll")


def _coefficient_table(check: Check, k: int) -> Table:
    """Coefficients of effects, joints as columns."""
    feasibility, n = check.feasibility, check.robot.n
    rows: dict[str, list[Cell]] = {}
    named = [(c, effect.joint) for effect in check.sets.effects for c in effect.coefficients]
    for e, (c, joint) in enumerate(named):
        slides = check.robot.joint_types[joint] is JointType.PRISMATIC
        name = f"{c.name} [{c.unit_for(slides)}]"
        row = rows.setdefault(name, [name, *["-"] * n])
        degree = float(feasibility.coefficient_degrees[k, e])
        value = f"{float(check.sets.coefficients[k, e]):.4g}"
        row[joint + 1] = _coloured(value, degree, bool(feasibility.violated_coefficients[k, e]))
    columns = ("", *joint_numbers(n))
    return Table("coefficients of the effects, by joint", columns, list(rows.values()), "l")


def _set_table(check: Check) -> Table:
    """One row a set."""
    feasibility, count = check.feasibility, len(check.sets)
    feasible, degrees = feasibility.feasible.tolist(), feasibility.degree.tolist()
    masses = check.sets.parameters.mass.sum(-1).tolist()
    rows = []
    for k, name in enumerate(check.sets.ids):
        said = "yes" if feasible[k] else Text("no", "red")
        degree = _coloured(f"{degrees[k]:.2g}", degrees[k], not feasible[k])
        findings, why = str(len(check.findings[k]) or "-"), ", ".join(feasibility.reasons(k)) or "-"
        rows.append((name, said, degree, f"{masses[k]:.4g}", findings, why))
    columns = ("set", "feasible", "degree", "total mass [kg]", "findings", "violated")
    title = f"{count} sets of {check.robot.name}"
    # 50: rows of the table of sets
    return Table(title, columns, rows, "lrrrrp", most=50)


def findings_lines(check: Check) -> tuple[str, ...]:
    """What is not plausible, one sentence each; those of many sets are counted by kind."""
    if len(check.sets) <= MOST_TABLES:
        several = len(check.sets) > 1
        return tuple(
            f"{f'{name}: ' if several else ''}{finding.sentence}"
            for name, own in zip(check.sets.ids, check.findings, strict=True)
            for finding in own
        )
    kinds = Counter(kind for own in check.findings for kind in {f.what for f in own})
    return tuple(f"{kind}: in {count} sets" for kind, count in kinds.most_common())


def nearest_table(nearest: NearestSets) -> Table:
    """What the nearest feasible sets cost in torque."""
    changes = (100 * nearest.torque_change_relative).tolist()
    rows = []
    for name, status, feasible, row in zip(
        nearest.sets.ids, nearest.status, nearest.feasible.tolist(), changes, strict=True
    ):
        rows.append((name, status if feasible else Text(status, "red"), *cells(row)))
    joints = joint_numbers(nearest.torque_change.shape[1])
    title = "nearest feasible sets: change of the joints' torques, % of their own rms"
    return Table(title, ["set", "status", *joints], rows, "ll")
