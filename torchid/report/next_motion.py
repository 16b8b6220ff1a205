"""What a designed motion would add, for people and as data."""

import math
from collections.abc import Iterable
from typing import Any

from rich.table import Table

from torchid.excitation.ambiguity import DETECTABLE
from torchid.excitation.informed import InformedDesign
from torchid.excitation.separation import Rival, Separation
from torchid.report.compare import short
from torchid.report.identification import compact

MOST_ROWS = 20

DECISIVE = 9.0
"""Expected difference of the squared residuals, in noise units, from which a motion decides."""


def informed_verdict(d: InformedDesign) -> str:
    """What the motion does for the least known parameters."""
    count, every = int(d.targets.sum()), len(d.prior.base)
    which = f"the {count} least known of {every} parameters" if count < every else "all parameters"
    said = (
        f"After this motion and the log together, {which} are known to {d.shrinks(d.after):.2g} of "
        "their present standard deviation on average; after a plain exciting motion of the same "
        f"length to {d.shrinks(d.with_plain):.2g}."
    )
    unknown = int((~d.prior.known).sum())
    if unknown:
        said += f" {unknown} that the log did not determine at all are among them."
    return said


def informed_table(d: InformedDesign) -> Table:
    """Standard deviations before, after a plain motion, after this one; the worst known first."""
    table = compact("predicted standard deviations")
    for heading in ("parameter", "value", "now", "after a plain motion", "after this motion"):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    relative = d.before / d.prior.values.abs().clamp(min=1e-300)
    order = [k for k in relative.argsort(descending=True).tolist() if bool(d.targets[k])]
    for k in order[:MOST_ROWS]:
        known = math.isfinite(float(d.before[k]))
        table.add_row(
            f"{short(d.prior.base.names[k], 40)} \\[{d.prior.base.units[k]}]",
            f"{float(d.prior.values[k]):.3g}" if known else "-",
            f"{float(d.before[k]):.2g}" if known else "unknown",
            f"{float(d.with_plain[k]):.2g}",
            f"{float(d.after[k]):.2g}",
        )
    if len(order) > MOST_ROWS:
        table.caption = f"and {len(order) - MOST_ROWS} more, in the JSON"
    return table


def informed_record(d: InformedDesign) -> dict[str, Any]:
    """JSON-ready."""
    columns = zip(
        d.prior.base.names, d.prior.base.units, d.targets.tolist(), _numbers(d.before.tolist()),
        d.with_plain.tolist(), d.after.tolist(), strict=True,
    )  # fmt: skip
    return {
        "criterion": d.goal,
        "shrinks_to": {"plain": d.shrinks(d.with_plain), "designed": d.shrinks(d.after)},
        "parameters": [
            {"name": name, "unit": unit, "target": target, "std": std,
             "predicted_std": {"plain": plain, "designed": designed}}
            for name, unit, target, std, plain, designed in columns
        ],
    }  # fmt: skip


def separation_verdict(s: Separation, kind: str) -> str:
    """What the motion separates, or shows."""
    worst, plain = min(s.after), min(s.with_plain)
    if kind == "not_testable":
        seen = sum(v >= DETECTABLE for v in s.after)
        before = sum(v >= DETECTABLE for v in s.with_plain)
        out = (
            f"Of {len(s.rivals)} effects that the log could not have shown, this motion shows "
            f"{seen} at the size that the log would have needed, a plain exciting motion of the "
            f"same length {before}."
        )
    else:
        names = " and ".join(dict.fromkeys(n for r in s.rivals for n in _pair(r)))
        out = (
            f"This motion separates {names} by {worst:.3g} in squared residuals over noise, a "
            f"plain exciting motion of the same length by {plain:.3g}"
            + ("." if worst >= DECISIVE else "; neither is likely to decide it once."
               if plain < DECISIVE else ".")
        )  # fmt: skip
    if s.hopeless:
        lost = ", ".join(dict.fromkeys(" and ".join(_pair(r)) for r in s.hopeless))
        out += f" No motion tried shows a difference for {lost}."
    return out


def separation_table(s: Separation, kind: str) -> Table:
    """Every pair, both ways."""
    table = compact("expected difference of the squared residuals, in noise units")
    testing = kind == "not_testable"
    headings = ("effect", "size") if testing else ("if it is", "and not")
    for heading in (*headings, "plain motion", "this motion"):
        table.add_column(heading, justify="right" if "motion" in heading else "left")
    for r, plain, after in zip(s.rivals, s.with_plain, s.after, strict=True):
        second = f"{r.truth[1][0]:.3g}" if testing else r.name
        table.add_row(_place(r), second, f"{plain:.3g}", f"{after:.3g}")
    return table


def separation_record(s: Separation, kind: str) -> dict[str, Any]:
    """JSON-ready."""
    return {
        "criterion": "separation",
        "for": kind,
        "pairs": [
            {
                "if": r.truth[0].record(r.truth[1]),
                "not": r.name or None,
                "separation": {"plain": plain, "designed": after},
            }
            for r, plain, after in zip(s.rivals, s.with_plain, s.after, strict=True)
        ],
        "hopeless": [list(_pair(r)) for r in s.hopeless],
    }


def _pair(r: Rival) -> tuple[str, ...]:
    return (r.truth[0].name, r.name) if r.name else (_place(r),)


def _place(r: Rival) -> str:
    effect = r.truth[0]
    joints = ", ".join(str(j + 1) for j in effect.joints)
    return f"{effect.name}, joint {joints}" if joints else effect.name


def _numbers(values: Iterable[float]) -> list[float | None]:
    return [v if math.isfinite(v) else None for v in values]
