"""An export as tables and as plain data (schema torchid.export/1)."""

import math
from typing import Any

from torchid.export.export import Export
from torchid.feasibility.plausibility import DENSITIES
from torchid.report.table import Table

SCHEMA = "torchid.export/1"


def export_record(done: Export) -> dict[str, Any]:
    """JSON-ready data; every number is finite or null."""
    checks = []
    for one in done.comparisons:
        value = one.difference
        checks.append(
            {
                "reader": one.reader,
                "compared": one.compared,
                "states": one.states,
                "largest_relative_difference": None
                if value is None or math.isinf(value)
                else value,
                "limit": one.limit,
                "ok": None if value is None else one.ok,
                "note": one.note,
            }
        )
    return {
        "schema": SCHEMA,
        "robot": done.dynamics.robot.name,
        "what": done.dynamics.kind,
        "result": done.dynamics.title,
        "format": done.format,
        "files": [str(path) for path in done.files],
        "original": None if done.original is None else str(done.original),
        "feasible": None if done.check is None else bool(done.check.feasibility.feasible[0]),
        "reasons": [] if done.check is None else list(done.check.feasibility.reasons(0)),
        "checks": checks,
        "effects": {
            "in_file": list(done.in_file),
            "beside": list(done.beside),
            "left_out": list(done.left_out),
        },
        "warnings": list(warnings(done)),
    }


def warnings(done: Export) -> tuple[str, ...]:
    """What must not be overlooked."""
    said = list(done.dynamics.warnings) + list(done.notes)
    if done.check is not None and not bool(done.check.feasibility.feasible[0]):
        reasons = ", ".join(done.check.feasibility.reasons(0))
        said.append(f"infeasible, and written all the same: {reasons}")
    # Links that are bodies, but of no material: one sentence for all of them.
    findings = () if done.check is None else done.check.findings[0]
    dense = [f for f in findings if f.what == "density" and f.value > f.threshold == DENSITIES[1]]
    if dense:
        links = ", ".join(str(f.link) for f in dense)
        said.append(
            f"not plausible, though not forbidden: the inertia of link {links} is that of a body "
            f"denser than lead (up to {max(f.value for f in dense):.2g} kg/m^3); `torchid check` "
            "says more"
        )
    said += [f"LEFT OUT of the {done.format} file: {words}" for words in done.left_out]
    return tuple(said)


def comparison_table(done: Export) -> Table:
    """Who reloaded the file, and by how much its torque differs from the result's."""
    rows = []
    for one in done.comparisons:
        cells, said = ("", "", ""), "not compared"
        if one.difference is not None:
            cells = (str(one.states), f"{one.difference:.1e}", f"{one.limit:g}")
            said = "agrees"
        said += f": {one.note}" if one.note else ""
        rows.append((one.reader, one.compared, *cells, said))
    return Table(
        "reloaded and compared with the result's own model",
        ("reader", "compared", "states", "largest difference", "limit", ""),
        rows,
        words=("reader", "compared", ""),
    )


def effect_lines(done: Export) -> list[str]:
    """Where each effect went, one sentence a place."""
    sidecar = done.files[-1].name if len(done.files) > 1 else "the sidecar"
    places = ((f"in the {done.format} file", done.in_file), (f"in {sidecar}", done.beside))
    return [
        f"{len(words)} effect{'s' if len(words) > 1 else ''} {place}"
        for place, words in places
        if words
    ]


def headline(done: Export) -> str:
    """What lies where, in one sentence."""
    first, *others = (str(path) for path in done.files)
    beside = f" (and {', '.join(others)})" if others else ""
    return f"{done.dynamics.title} of '{done.dynamics.robot.name}': {first}{beside}"
