"""A fleet for people: the verdict, tables and sentences."""

from collections import Counter
from collections.abc import Sequence
from functools import partial

from torchid.fleet.gap import FleetGap
from torchid.fleet.identify import USED
from torchid.fleet.record import FleetRecord, LogRow
from torchid.fleet.watch import Watch
from torchid.report.cautions import caution_section
from torchid.report.colours import BLUE, GREY, RED
from torchid.report.page.document import Origin, Page
from torchid.report.panels import Figure, Picture, panel
from torchid.report.table import Cell, Section, Shown, Table, cell, cells, more_rows
from torchid.results.words import count, listed, short

MOST = 20
"""Rows of logs and units that the terminal shows; the JSON has all of them."""

LONGEST = 22
"""Characters of a parameter's name."""


def shown(found: FleetRecord) -> Shown:
    """All that there is to see of a fleet's parameters."""
    return Shown(verdict=verdict(found), parts=tables(found), warnings=found.notes)


def gap_shown(found: FleetGap) -> Shown:
    """All that there is to see of a fleet's gaps."""
    return Shown(
        verdict=gap_verdict(found),
        parts=[effect_table(found), diagnosed_table(found, MOST)],
        warnings=found.notes,
        figures={"map": partial(gap_map, found)},
        page=partial(fleet_gap_page, found),
    )


def watch_shown(found: Watch) -> Shown:
    """All that there is to see of what drifts."""
    return Shown(verdict=watch_verdict(found), parts=[alarm_table(found)], warnings=found.notes)


def verdict(found: FleetRecord) -> str:
    """How many units there are, and which are odd."""
    used = [log for log in found.logs if log.verdict in USED]
    hours = sum(log.seconds for log in used) / 3600
    odd = found.odd
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
    columns = ("unit", "session", "verdict", "why")
    return Table(title, columns, rows[:MOST], "lplp", more_rows(len(rows), MOST))


def parameter_table(found: FleetRecord) -> Table:
    """Means and spreads of the base parameters."""
    rows: list[list[Cell]] = [
        [
            short(p.name, LONGEST), f"{cell(p.mean, '.4g')} ± {cell(p.std, '.2g')} {p.unit}",
            cell(p.between, ".2g"), " .. ".join(cells(p.between_ci95, ".2g")), cell(p.daily, ".2g"),
            cell(p.noise, ".2g"), cell(p.sessions_needed, "d"),
        ]
        for p in found.parameters
    ]  # fmt: skip
    columns = ("base parameter", "mean", "units", "95 %", "days", "noise", "needed")
    note = (
        "Standard deviations between units, between days of one unit, and of a session's "
        "estimate; sessions needed until a unit's own value is known to half the spread of units."
    )
    return Table(f"{found.robot}: the type and its spread", columns, rows, "pp", note)


def odd_table(found: FleetRecord) -> Table:
    """What is odd about which unit."""
    rows: list[list[Cell]] = [
        [
            o.unit, short(o.parameter, LONGEST), f"{cell(o.value, '.4g')} ± {cell(o.std, '.2g')}",
            cell(o.others, ".4g"), cell(o.spread, ".2g"), f"{o.deviation:+.1f}", f"{o.p:.1e}",
        ]
        for o in found.oddities
    ]  # fmt: skip
    share = f"{100 * found.settings.level:g} %"
    note = f"Of units called odd {share} are expected to be false (Benjamini and Hochberg)."
    if len(rows) > MOST:
        note += f" And {len(rows) - MOST} more rows, in the JSON."
    columns = ("unit", "base parameter", "its value", "others", "spread", "deviation", "p")
    return Table("odd units", columns, rows[:MOST], "ll", note)


def tables(found: FleetRecord) -> list[Table]:
    """All of them that have something to say."""
    return [parameter_table(found), odd_table(found), log_table(found.logs)]


SCOPES = {"type": "the type's", "some": "some units'", "unit": "a unit's own"}


def gap_verdict(found: FleetGap) -> str:
    """Which effects the type has, and which are a unit's own."""
    of_type = [e.label for e in found.effects if e.scope == "type"]
    own = [f"{e.label} ({', '.join(e.units[:3])})" for e in found.effects if e.scope == "unit"]
    said = f"{found.robot}, {count(len(found.units), 'unit')}: "
    said += f"the type has {listed(of_type)}" if of_type else "no effect is surely the type's"
    return said + (f"; units of their own have {listed(own, most=MOST)}." if own else ".")


def effect_table(found: FleetGap) -> Table:
    """Effects over the fleet."""
    rows: list[list[Cell]] = [
        [
            e.label, SCOPES[e.scope], f"{len(e.units)} of {len(found.units)}",
            f"{100 * e.ci95[0]:.0f} .. {100 * e.ci95[1]:.0f}",
            ", ".join(e.units[:4]) + (" ..." if len(e.units) > 4 else ""),
            ", ".join(e.ambiguous_with),
        ]
        for e in found.effects
    ]  # fmt: skip
    columns = ("effect", "is", "units", "95 % [%]", "which", "or")
    return Table("effects over the fleet", columns, rows, "llrrpp")


def diagnosed_table(found: FleetGap, most: int) -> Table:
    """Logs, their gaps over the noise, and what is named."""
    rows: list[list[Cell]] = [
        [
            log.unit, log.session, log.status.replace("_", " "),
            cell(max(log.gap, default=None), ".2g"),
            str(max(range(len(log.gap)), key=log.gap.__getitem__) + 1) if log.gap else "-",
            "-" if log.closed is None else f"{100 * log.closed:.0f}",
            "; ".join(log.effects) or log.evidence,
        ]
        for log in found.logs
    ]  # fmt: skip
    columns = ("unit", "session", "status", "gap / noise", "joint", "closed [%]", "named")
    title, note = "logs: the largest gap over the noise", more_rows(len(rows), most)
    return Table(title, columns, rows[:most], "lllrrrp", note)


def gap_map(found: FleetGap) -> Figure:
    """Units by effects and places; what is named is filled, and the type's effects are blue."""
    effects, units = found.effects, found.units
    height = min(40.0, 1.6 + 0.16 * len(units))
    figure, axes = panel(max(4.0, 2.5 + 0.3 * len(effects)), height)
    colours = {"type": BLUE, "some": GREY, "unit": RED}
    for k, effect in enumerate(effects):
        at = [units.index(unit) for unit in effect.units]
        axes.scatter([k] * len(at), at, marker="s", s=28, color=colours[effect.scope])
    axes.set_xticks(range(len(effects)), [e.label for e in effects], rotation=60, ha="right")
    axes.set_yticks(range(len(units)), units)
    axes.set_ylim(len(units) - 0.5, -0.5)
    axes.set_xlim(-0.5, max(1, len(effects)) - 0.5)
    return figure


def fleet_gap_page(found: FleetGap, origin: Origin) -> Page:
    """The page of a fleet's gaps, sortable."""
    caption = (
        "Which unit has which effect, and where. Blue: surely more than half of the units have it; "
        "red: surely fewer; grey: neither is sure."
    )
    named = sum(len(e.units) for e in found.effects)
    alt = f"{len(found.units)} units by {len(found.effects)} effects and places, {named} named."
    used = sum(log.closed is not None or bool(log.gap) for log in found.logs)
    facts = [("units", str(len(found.units))), ("logs diagnosed", f"{used} of {len(found.logs)}")]
    return Page(
        title=f"Sim-to-real gaps of a fleet of {found.robot}",
        verdict=gap_verdict(found),
        facts=facts,
        origin=origin,
        sections=[
            Section(
                "Which unit has which effect",
                [
                    Picture("map", caption, alt, partial(gap_map, found)),
                    effect_table(found),
                ],
                folded=False,
            ),
            Section("Every log", [diagnosed_table(found, len(found.logs))]),
            caution_section(found.notes),
        ],
        sortable=True,
    )


def watch_verdict(found: Watch) -> str:
    """The clearest change, and how many there are."""
    sessions = sum(len(u.sessions) for u in found.units)
    over = f"{count(len(found.units), 'unit')} over {count(sessions, 'session')}"
    if not found.alarms:
        return f"{found.robot}, {over}: nothing has changed."
    changed = len({a.unit for a in found.alarms})
    return f"{found.robot}, {over}: {count(changed, 'unit')} changed. {found.alarms[0].sentence}."


def alarm_table(found: Watch) -> Table:
    """What changed, the clearest first."""
    rows: list[list[Cell]] = [
        [
            a.unit, short(a.parameter, LONGEST), a.since, a.said_at, cell(a.before, ".4g"),
            cell(a.after, ".4g"), f"{a.percent:+.0f}",
            cell(a.by_temperature, "+.0f"),
        ]
        for a in found.alarms
    ]  # fmt: skip
    columns = ("unit", "base parameter", "since", "sure at", "before", "after", "by [%]",
               "temperature's [%]")  # fmt: skip
    note = (
        f"False alarms: one in {found.false_alarm_every:g} sessions of a unit at most, on average."
    )
    return Table("what changed", columns, rows[:MOST], "llll", note)
