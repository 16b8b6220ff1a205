"""A payload as tables for people."""

import math

from torchid.identification.payload import Estimate, Payload
from torchid.report.table import Table

QUANTITIES = (
    ("mass", "kg"),
    *((f"com {axis}", "m") for axis in "xyz"),
    *((f"inertia {entry}", "kg m^2") for entry in ("xx", "xy", "xz", "yy", "yz", "zz")),
)
"""Names and units of what is estimated of a payload; the inertia is about its centre of mass."""


def tables(payload: Payload) -> list[Table]:
    """The body in the tool's and in the last link's frame, and what else changed, if anything."""
    tool, link = (
        [
            _cells(part, k)
            for part in (body.mass, body.com, body.inertia_about_com)
            for k in range(part.value.numel())
        ]
        for body in (payload.tool, payload.link)
    )
    named = zip(QUANTITIES, tool, link, strict=True)
    out = [
        Table(
            f"payload of {payload.robot} (value ± std, 95 % interval)",
            ("quantity", "unit", "tool frame", "95 %", "last link's frame", "95 %"),
            [(*name, *own, *other) for name, own, other in named],
            names=("quantity", "unit"),
        )
    ]
    if payload.friction_changes:
        columns = ("coefficient", "unit", "change", "std")
        rows = [
            (c.name, c.unit, f"{c.change:.3g}", f"{c.std:.2g}") for c in payload.friction_changes
        ]
        title = "effects that changed with the load, not part of the payload"
        out.append(Table(title, columns, rows, words=columns[:2]))
    return out


def headline(payload: Payload) -> str:
    """One sentence: mass and centre of mass in the tool frame, and whether a body can have them."""
    mass, com = payload.tool.mass, payload.tool.com
    if bool(mass.high < 0):
        return (
            f"The logs with the payload carry {-float(mass.value):.4g} kg less than those without: "
            "are they exchanged?"
        )
    if not payload.seen:
        return f"No payload can be seen on the last link of {payload.robot}."
    verdict = "not physically consistent"
    if payload.consistent or payload.consistent_within:
        within = "" if payload.consistent else " within its interval"
        verdict = f"physically consistent{within}"
    half = payload.quantile * float(mass.std)
    place = ", ".join("?" if math.isnan(c) else f"{1e3 * c:.1f}" for c in com.value.tolist())
    return (
        f"{payload.robot} carries {float(mass.value):.4g} ± {half:.2g} kg (95 %), centre of mass "
        f"at ({place}) mm of the tool frame; {verdict}."
    )


def _cells(estimate: Estimate, k: int) -> tuple[str, str]:
    value, std, low, high = (
        float(x[k]) for x in (estimate.value, estimate.std, estimate.low, estimate.high)
    )
    if math.isnan(value):
        return "not known", "-"
    return f"{value:.4g} ± {std:.1g}", f"{low:.4g} .. {high:.4g}"
