"""A payload as tables for people."""

import math

from rich.table import Table

from torchid.identification.payload import Body, Estimate, Payload
from torchid.report.identification import compact

_ENTRIES = ("xx", "xy", "xz", "yy", "yz", "zz")


def tables(payload: Payload) -> list[Table]:
    """The body in both frames, and what else changed, if anything did."""
    out = [body_table(payload)]
    if payload.friction_changes:
        out.append(effect_table(payload))
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
    half = payload.quantile * float(mass.std)
    place = ", ".join("?" if math.isnan(c) else f"{1e3 * c:.1f}" for c in com.value.tolist())
    return (
        f"{payload.robot} carries {float(mass.value):.4g} ± {half:.2g} kg (95 %), centre of mass "
        f"at ({place}) mm of the tool frame; {_verdict(payload)}."
    )


def body_table(payload: Payload) -> Table:
    """Mass, centre of mass and inertia about it, in the tool's and in the last link's frame."""
    table = compact(f"payload of {payload.robot} (value ± std, 95 % interval)")
    table.add_column("quantity", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for frame in ("tool frame", "last link's frame"):
        table.add_column(frame, justify="right", no_wrap=True)
        table.add_column("95 %", justify="right", no_wrap=True)
    rows = zip(_rows(payload.tool), _rows(payload.link), strict=True)
    for (name, unit, *tool), (_, _, *link) in rows:
        table.add_row(name, unit, *tool, *link)
    return table


def effect_table(payload: Payload) -> Table:
    """Coefficients of effects that changed with the load."""
    table = compact("effects that changed with the load, not part of the payload")
    for heading in ("coefficient", "unit", "change", "std"):
        table.add_column(heading, justify="right" if heading in ("change", "std") else "left")
    for c in payload.friction_changes:
        table.add_row(c.name, c.unit, f"{c.change:.3g}", f"{c.std:.2g}")
    return table


def _rows(body: Body) -> list[tuple[str, ...]]:
    """Name, unit, value ± std and interval of each quantity."""
    quantities = (
        (("mass",), "kg", body.mass),
        (tuple(f"com {axis}" for axis in "xyz"), "m", body.com),
        (tuple(f"inertia {e}" for e in _ENTRIES), "kg m^2", body.inertia_about_com),
    )
    return [
        (name, unit, *_cells(estimate, k))
        for names, unit, estimate in quantities
        for k, name in enumerate(names)
    ]


def _cells(estimate: Estimate, k: int) -> tuple[str, str]:
    value, std, low, high = (
        float(x[k]) for x in (estimate.value, estimate.std, estimate.low, estimate.high)
    )
    if math.isnan(value):
        return "not known", "-"
    return f"{value:.4g} ± {std:.1g}", f"{low:.4g} .. {high:.4g}"


def _verdict(payload: Payload) -> str:
    if payload.consistent:
        return "physically consistent"
    if payload.consistent_within:
        return "physically consistent within its interval"
    return "not physically consistent"
