"""A check of feasibility as tables for people."""

import math
from collections import Counter
from collections.abc import Sequence

from torchid.extraction.convex.nearest import NearestSets
from torchid.feasibility.margins import LINK_CONDITIONS
from torchid.feasibility.plausibility import excess_percent
from torchid.feasibility.record import Check
from torchid.report.table import Report, Table, joint_table, table_of
from torchid.results.words import listed
from torchid.robot.model import JointType

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
    sets = check.record.sets
    if len(sets) > MOST_TABLES:
        title = f"{len(sets)} sets of {check.robot.name}"
        # 50: rows that are printed
        columns = "id feasible degree total_mass plausibility reasons"
        return [table_of(title, sets, columns, most=50)]
    boxes = "com_margins " * bool(check.conditions.com_box.isfinite().any())
    shapes = "shape_margin " * check.round_shapes
    columns = (
        f"link name mass inertias triangle_excess_percent centre {boxes}{shapes}degree violated"
    )
    links = [table_of(f"links of {one.id}", one.links, columns) for one in sets]
    effects = [_coefficient_table(check, k) for k in range(len(sets))]
    return [table for both in zip(links, effects, strict=True) for table in both]


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


def _coefficient_table(check: Check, k: int) -> Table:
    """Coefficients of effects, joints as columns."""
    rows: dict[str, list[float]] = {}
    named = [(c, effect.joint) for effect in check.sets.effects for c in effect.coefficients]
    for (c, joint), value in zip(named, check.sets.coefficients[k].tolist(), strict=True):
        slides = check.robot.joint_types[joint] is JointType.PRISMATIC
        row = rows.setdefault(f"{c.name} [{c.unit_for(slides)}]", [math.nan] * check.robot.n)
        row[joint] = value
    return joint_table("coefficients of the effects, by joint", rows.items(), ".4g")


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
    names = (
        f"{one}, {status}" for one, status in zip(nearest.sets.ids, nearest.status, strict=True)
    )
    rows = zip(names, 100 * nearest.torque_change_relative, strict=True)
    title = "nearest feasible sets: change of the joints' torques, % of their own rms"
    return joint_table(title, rows)
