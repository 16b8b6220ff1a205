"""A fleet for people: the verdict, tables and sentences."""

import math
from collections import Counter
from collections.abc import Sequence

from torchid.fleet.identify import USED
from torchid.fleet.record import FleetRecord, LogRow
from torchid.report.table import Cell, Table, count, listed, short

MOST = 20
"""Rows of logs and units that the terminal shows; the JSON has all of them."""

LONGEST = 22
"""Characters of a parameter's name."""


def _number(value: float, digits: str = ".4g") -> str:
    return f"{value:{digits}}" if math.isfinite(value) else "-"


def _between(ends: tuple[float, float]) -> str:
    return f"{_number(ends[0], '.2g')} .. {_number(ends[1], '.2g')}"


def verdict(found: FleetRecord) -> str:
    """How many units there are, and which are odd."""
    used = [log for log in found.logs if log.verdict in USED]
    hours = sum(log.seconds for log in used) / 3600
    odd = [u.unit for u in found.units if u.odd]
    said = (
        f"{found.robot}: {count(len(found.units), 'unit')}, "
        f"{count(len(found.sessions), 'session')}, {count(len(used), 'log')}, {hours:.3g} h of "
        "motion. "
    )
    if not odd:
        return said + "No unit is odd."
    return said + f"Odd: {listed(odd, most=MOST)}."


def log_table(logs: Sequence[LogRow]) -> Table:
    """Logs that are not simply good."""
    rows: list[list[Cell]] = [
        [log.unit, log.session, log.verdict, log.evidence[-1 if log.verdict not in USED else 0]]
        for log in logs
        if log.verdict != "good"
    ]
    verdicts = Counter(log.verdict for log in logs)
    title = "logs: " + ", ".join(f"{k} {v}" for v, k in sorted(verdicts.items()))
    note = f"and {len(rows) - MOST} more, in the JSON" if len(rows) > MOST else ""
    columns = ("unit", "session", "verdict", "why")
    return Table(title, columns, rows[:MOST], ("unit", "verdict"), ("session", "why"), note)


def parameter_table(found: FleetRecord) -> Table:
    """Means and spreads of the base parameters."""
    rows: list[list[Cell]] = [
        [
            short(p.name, LONGEST), f"{_number(p.mean)} ± {_number(p.std, '.2g')}", p.unit,
            _number(p.between, ".2g"), _between(p.between_ci95), _number(p.daily, ".2g"),
            _number(p.noise, ".2g"), "-" if p.sessions_needed is None else str(p.sessions_needed),
        ]
        for p in found.parameters
    ]  # fmt: skip
    columns = (
        "base parameter", "mean", "unit", "unit to unit", "95 %", "day to day", "a session",
        "sessions needed",
    )  # fmt: skip
    note = (
        "Standard deviations: between units, between days of one unit, and of a session's "
        "estimate. Sessions of one unit until its own value is known to half the spread of units."
    )
    return Table(
        f"{found.robot}: the type and its spread", columns, rows, ("base parameter", "unit"),
        note=note,
    )  # fmt: skip


def odd_table(found: FleetRecord) -> Table:
    """What is odd about which unit."""
    rows: list[list[Cell]] = [
        [
            o.unit, short(o.parameter, LONGEST), f"{_number(o.value)} ± {_number(o.std, '.2g')}",
            _number(o.others), _number(o.spread, ".2g"), f"{o.deviation:+.1f}", f"{o.p:.1e}",
        ]
        for o in found.odd
    ]  # fmt: skip
    share = f"{100 * found.settings.level:g} %"
    note = f"Of units called odd {share} are expected to be false (Benjamini and Hochberg)."
    if len(rows) > MOST:
        note += f" And {len(rows) - MOST} more rows, in the JSON."
    columns = ("unit", "base parameter", "its value", "others", "spread", "deviation", "p")
    return Table("odd units", columns, rows[:MOST], ("unit", "base parameter"), note=note)


def tables(found: FleetRecord) -> list[Table]:
    """All of them that have something to say."""
    out = [parameter_table(found)]
    if found.odd:
        out.append(odd_table(found))
    if any(log.verdict != "good" for log in found.logs):
        out.append(log_table(found.logs))
    return out
