"""What a designed motion would add, for people and as data."""

import math
from collections.abc import Iterable
from typing import Any

from rich.table import Table

from torchid.excitation.informed import InformedDesign
from torchid.next_motion.separating_motion import Separation
from torchid.next_motion.separation import DECISIVE, Rival, Told, beyond, named
from torchid.report.compare import short
from torchid.report.identification import compact

MOST_ROWS = 20


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
    of_all = len(s.rivals)
    after, plain = (sum(t.reached >= 1 for t in x) for x in (s.after, s.with_plain))
    if kind == "not_testable":
        out = (
            f"Of {of_all} effects and places that the log could not have shown and a motion can, "
            f"this motion shows {after} where they are a tenth of the joint's torque, a plain "
            f"exciting motion of the same length {plain}."
        )
    else:
        names = " and ".join(dict.fromkeys(r.truth.effect.name for r in s.rivals))
        out = (
            f"For {names}, this motion is expected to decide {after} of {of_all} questions, a "
            f"plain exciting motion of the same length {plain}. The hardest is "
            f"{_hardest(s)}."
        )
    both = {(r.name, r.truth.effect.name) for r in s.rivals}
    nested = [r for r in s.hopeless if (r.truth.effect.name, r.name) in both]
    for one, other in dict.fromkeys((r.truth.effect.name, r.name) for r in nested):
        out += (
            f" {one} is a special case of {other}: the simpler one stands where nothing of the "
            "rest is seen."
        )
    lost = [r for r in s.hopeless if r not in nested]
    if lost:
        out += (
            f" No motion tried settles {named(lost)}. What would: "
            f"{beyond(r.truth.effect.name for r in lost)}."
        )
    return out


def _hardest(s: Separation) -> str:
    k = min(range(len(s.after)), key=lambda k: s.after[k].reached)
    rival, told = s.rivals[k], s.after[k]
    other = f" against {rival.name}" if rival.name else ""
    said = f"{_place(rival)}{other}: {told.difference:.3g} in squared residuals over noise"
    if told.reached >= 1:
        return said
    if told.difference >= DECISIVE:
        return f"{said}, but only a small share of what the effect explains"
    times = math.ceil(DECISIVE / max(told.difference, 1e-9))
    return f"{said}, {DECISIVE:g} decide" + (f": drive it {times} times" if times < 20 else "")


def separation_table(s: Separation, kind: str) -> Table:
    """Every pair, both ways, the hardest first; * where it decides."""
    table = compact("expected difference of the squared residuals, in noise units; * decides")
    testing = kind == "not_testable"
    headings = ("effect", "size") if testing else ("if it is", "and not")
    for heading in (*headings, "plain motion", "this motion"):
        table.add_column(heading, justify="right" if "motion" in heading else "left")
    rows = sorted(zip(s.rivals, s.with_plain, s.after, strict=True), key=lambda r: r[2].reached)
    for r, plain, after in rows[:MOST_ROWS]:
        second = f"{max(r.truth.values, key=abs):.3g}" if testing else r.name
        table.add_row(_place(r), second, _shown(plain), _shown(after))
    if len(rows) > MOST_ROWS:
        table.caption = f"and {len(rows) - MOST_ROWS} more, in the JSON"
    return table


def separation_record(s: Separation, kind: str) -> dict[str, Any]:
    """JSON-ready."""
    return {
        "criterion": "separation",
        "for": kind,
        "pairs": [
            {
                "if": r.truth.effect.record(r.truth.values),
                "common": len(r.truth.effects) > 1,
                "not": r.name or None,
                "separation": {"plain": plain.difference, "designed": after.difference},
                "decides": {"plain": plain.reached >= 1, "designed": after.reached >= 1},
            }
            for r, plain, after in zip(s.rivals, s.with_plain, s.after, strict=True)
        ],
        "hopeless": [
            {"effect": r.truth.effect.name, "joints": [j + 1 for j in r.truth.effect.joints],
             "not": r.name or None, "instead": beyond([r.truth.effect.name])}
            for r in s.hopeless
        ],
    }  # fmt: skip


def _shown(told: Told) -> str:
    return f"{told.difference:.3g} " + ("*" if told.reached >= 1 else " ")


def _place(r: Rival) -> str:
    effect = r.truth.effect
    if len(r.truth.effects) > 1:
        return f"{effect.name}, every joint"
    joints = ", ".join(str(j + 1) for j in effect.joints)
    return f"{effect.name}, joint {joints}" if joints else effect.name


def _numbers(values: Iterable[float]) -> list[float | None]:
    return [v if math.isfinite(v) else None for v in values]
