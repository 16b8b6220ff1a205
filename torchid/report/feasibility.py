"""A check of feasibility as tables for people."""

import math
from collections import Counter

from rich.markup import escape
from rich.table import Table

from torchid.extraction.convex.nearest import NearestSets
from torchid.feasibility.margins import LINK_CONDITIONS
from torchid.feasibility.record import Check, excess_percent
from torchid.report.identification import compact

NEAR = 0.05
"""Degree below which a condition is shown as near its boundary."""
MOST_TABLES = 3
"""Sets that have a table each; more are one row a set."""
MOST_ROWS = 50
"""Rows of the table of sets."""
DEGREE = (
    "degree: the smallest margin of all conditions, each over a scale of its own (a link's mean "
    "second moment, half a box's side, the mean mass): negative outside, 0 on the boundary"
)


def tables(check: Check) -> list[Table]:
    """A table of links a set, or one row a set where there are many."""
    if len(check.sets) > MOST_TABLES:
        return [_set_table(check)]
    out = []
    for k in range(len(check.sets)):
        out.append(_link_table(check, k))
        if check.sets.effects:
            out.append(_coefficient_table(check, k))
    return out


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
    found, name = check.feasibility, check.sets.ids[k]
    if bool(found.feasible[k]):
        degree = float(found.degree[k])
        return f"{name} is feasible, with degree {degree:.3g} (nearest: {_nearest(check, k)})."
    return f"{name} is infeasible: {', '.join(_violations(check, k))}."


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
    found, n = check.feasibility, check.robot.n
    broken: dict[str, list[str]] = {"mass": [], "eigenvalue": []}
    phrases = []
    for i in range(n):
        if bool(found.violated[k, i, 0]):
            broken["mass"].append(f"mass_{i + 1}")
        if found.inertia_violation(k, i) == "eigenvalue":
            broken["eigenvalue"].append(f"inertia_{i + 1}")
    if broken["mass"]:
        phrases.append(f"{_and(broken['mass'])} not positive")
    if broken["eigenvalue"]:
        phrases.append(f"{_and(broken['eigenvalue'])} not positive definite")
    for i in range(n):
        if found.inertia_violation(k, i) == "triangle":
            excess = excess_percent(check.eigenvalues[k, i].tolist())
            by = "" if excess is None else f" (by {excess:.3g} %)"
            phrases.append(f"inertia_{i + 1} breaks the triangle inequality{by}")
    for i in range(n):
        for column, name in enumerate(LINK_CONDITIONS):
            if column > 2 and bool(found.violated[k, i, column]):
                phrases.append(_outside(name, i + 1, float(found.margins[k, i, column])))
    if bool(found.violated_total[k]):
        phrases.append(f"total_mass is {float(check.sets.parameters.mass[k].sum()):.4g} kg")
    bad = found.violated_coefficients[k].tolist()
    negative = [r for r, b in zip(found.coefficient_reasons, bad, strict=True) if b]
    if negative:
        phrases.append(f"{_and(negative)} negative")
    return phrases


def _outside(condition: str, link: int, margin: float) -> str:
    if condition == "shape":
        return f"shape_{link} is missed by {-1e3 * margin:.3g} mm"
    return f"com_{link}{condition[-1]} is {-1e3 * margin:.3g} mm outside its box"


def _and(names: list[str]) -> str:
    """a is; a and b are; a, b and c are."""
    if len(names) == 1:
        return f"{names[0]} is"
    return f"{', '.join(names[:-1])} and {names[-1]} are"


def _nearest(check: Check, k: int) -> str:
    """Name of the condition with the smallest degree."""
    found = check.feasibility
    named = {
        f"{name} of link {i + 1}": float(found.degrees[k, i, c])
        for i in range(check.robot.n)
        for c, name in enumerate(LINK_CONDITIONS)
    }
    named["the total mass"] = float(found.total_mass_degree[k])
    degrees = found.coefficient_degrees[k].tolist()
    named |= dict(zip(found.coefficient_names, degrees, strict=True))
    return min(named, key=named.__getitem__)


def _colour(text: str, degree: float, violated: bool) -> str:
    if violated or math.isnan(degree):
        return f"[red]{text}[/]"
    return f"[yellow]{text}[/]" if degree < NEAR else text


def _link_table(check: Check, k: int) -> Table:
    boxes = bool(check.conditions.com_box.isfinite().any())
    title = f"links of {check.sets.ids[k]} (red: violated, yellow: degree below {NEAR:g})"
    table = compact(escape(title))
    table.add_column("")
    table.add_column("link", no_wrap=True)
    headings = ["mass\n[kg]", "principal inertias\n[kg m²]", "largest over sum\nof others [%]"]
    headings += ["CoM\n[mm]"]
    headings += ["CoM to box\n[mm]"] if boxes else []
    headings += ["to shape\n[mm]"] if check.round_shapes else []
    for heading in (*headings, "degree"):
        table.add_column(escape(heading), justify="right", no_wrap=True)
    for i in range(check.robot.n):
        table.add_row(
            str(i + 1), escape(check.robot.link_names[i]), *_link_cells(check, k, i, boxes)
        )
    return table


def _link_cells(check: Check, k: int, i: int, boxes: bool) -> list[str]:
    found = check.feasibility
    degrees, bad = found.degrees[k, i].tolist(), found.violated[k, i].tolist()
    margins = found.margins[k, i].tolist()
    eigenvalues = check.eigenvalues[k, i].tolist()
    excess = excess_percent(eigenvalues)
    com = check.sets.parameters.com[k, i].tolist()
    cells = [
        _colour(f"{margins[0]:.4g}", degrees[0], bad[0]),
        _colour(" ".join(f"{v:.3g}" for v in eigenvalues), degrees[1], bad[1]),
        _colour("-" if excess is None else f"{100 + excess:.3g}", degrees[2], bad[2]),
        " ".join(f"{1e3 * c:.1f}" for c in com),
    ]
    if boxes:
        c = min((3, 4, 5), key=lambda column: degrees[column])
        known = math.isfinite(margins[c])
        text = f"{1e3 * margins[c]:.1f} {LINK_CONDITIONS[c][-1]}" if known else "-"
        cells.append(_colour(text, degrees[c], bad[c]))
    if check.round_shapes:
        cells.append(_colour(f"{1e3 * margins[6]:.1f}", degrees[6], bad[6]))
    least = min(degrees)
    return [*cells, _colour(f"{least:.2g}", least, any(bad))]


def _coefficient_table(check: Check, k: int) -> Table:
    """Coefficients of effects, joints as columns."""
    found = check.feasibility
    table = compact("coefficients of the effects, by joint")
    table.add_column("")
    for joint in range(check.robot.n):
        table.add_column(str(joint + 1), justify="right")
    rows: dict[str, list[str]] = {}
    named = [(c, effect.joint) for effect in check.sets.effects for c in effect.coefficients]
    for e, (c, joint) in enumerate(named):
        row = rows.setdefault(f"{c.name} \\[{c.unit}]", ["-"] * check.robot.n)
        degree = float(found.coefficient_degrees[k, e])
        value = f"{float(check.sets.coefficients[k, e]):.4g}"
        row[joint] = _colour(value, degree, bool(found.violated_coefficients[k, e]))
    for name, row in rows.items():
        table.add_row(name, *row)
    return table


def _set_table(check: Check) -> Table:
    """One row a set, for the first ones."""
    found, count = check.feasibility, len(check.sets)
    shown = f", the first {MOST_ROWS} (all with --json)" if count > MOST_ROWS else ""
    table = compact(escape(f"{count} sets of {check.robot.name}{shown}"))
    for heading in ("set", "feasible", "degree", "total mass \\[kg]", "findings"):
        table.add_column(heading, justify="left" if heading == "set" else "right", no_wrap=True)
    table.add_column("violated", overflow="fold", ratio=1)
    feasible, degrees = found.feasible.tolist(), found.degree.tolist()
    masses = check.sets.parameters.mass.sum(-1).tolist()
    for k, name in enumerate(check.sets.ids[:MOST_ROWS]):
        table.add_row(
            escape(name),
            "yes" if feasible[k] else "[red]no[/]",
            _colour(f"{degrees[k]:.2g}", degrees[k], not feasible[k]),
            f"{masses[k]:.4g}",
            str(len(check.findings[k]) or "-"),
            ", ".join(found.reasons(k)) or "-",
        )
    return table


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
    table = compact("nearest feasible sets: change of the joints' torques, % of their own rms")
    for heading in ("set", "status"):
        table.add_column(heading)
    for joint in range(nearest.torque_change.shape[1]):
        table.add_column(str(joint + 1), justify="right")
    changes = (100 * nearest.torque_change_relative).tolist()
    for name, status, feasible, row in zip(
        nearest.sets.ids, nearest.status, nearest.feasible.tolist(), changes, strict=True
    ):
        said = status if feasible else f"[red]{status}[/]"
        table.add_row(escape(name), said, *(f"{v:.3g}" if math.isfinite(v) else "-" for v in row))
    return table
