"""A fleet for people: the verdict, tables and sentences."""

from collections import Counter
from collections.abc import Sequence
from functools import partial

from torchid.fleet.gap import FleetGap
from torchid.fleet.record import USED, FleetRecord, LogRow
from torchid.report.cautions import caution_section
from torchid.report.colours import BLUE, GREY, RED
from torchid.report.page.document import Origin, Page
from torchid.report.panels import Figure, Picture, panel
from torchid.report.table import Report, Section, Table, table_of
from torchid.results.words import count, listed

MOST = 20
"""Rows of logs and units that the terminal shows; the JSON has all of them."""


def report_of_fleet(fleet: FleetRecord) -> Report:
    """All that there is to see of a fleet's parameters."""
    return Report(
        verdict=verdict(fleet),
        parts=[parameter_table(fleet), odd_table(fleet), log_table(fleet.logs)],
        warnings=fleet.notes,
    )


def report_of_fleet_gap(gaps: FleetGap) -> Report:
    """All that there is to see of a fleet's gaps."""
    return Report(
        verdict=gap_verdict(gaps),
        parts=[effect_table(gaps), diagnosed_table(gaps)],
        warnings=gaps.notes,
        figures={"map": partial(gap_map, gaps)},
        page=partial(fleet_gap_page, gaps),
    )


def verdict(fleet: FleetRecord) -> str:
    """How many units there are, and which are odd."""
    used = [log for log in fleet.logs if log.verdict in USED]
    hours = sum(log.seconds for log in used) / 3600
    odd = fleet.odd
    size = (
        f"{fleet.robot}: {count(len(fleet.units), 'unit')}, "
        f"{count(len(fleet.sessions), 'session')}, {count(len(used), 'log')}, {hours:.3g} h of "
        "motion. "
    )
    if not odd:
        return size + "No unit is odd."
    return size + f"Odd: {listed(odd, most=MOST)}."


def log_table(logs: Sequence[LogRow]) -> Table:
    """Logs that are not simply good."""
    verdicts = Counter(log.verdict for log in logs)
    title = "logs: " + ", ".join(f"{k} {verdict}" for verdict, k in sorted(verdicts.items()))
    return table_of(title, [log for log in logs if log.verdict != "good"], most=MOST)


def parameter_table(fleet: FleetRecord) -> Table:
    """Means and spreads of the base parameters."""
    note = (
        "Standard deviations between units, between days of one unit, and of a session's "
        "estimate; sessions needed until a unit's own value is known to half the spread of units."
    )
    return table_of(f"{fleet.robot}: the type and its spread", fleet.parameters, note=note)


def odd_table(fleet: FleetRecord) -> Table:
    """What is odd about which unit."""
    share = f"{100 * fleet.settings.level:g} %"
    note = f"Of units called odd {share} are expected to be false (Benjamini and Hochberg)."
    return table_of("odd units", fleet.oddities, note=note, most=MOST)


def gap_verdict(gaps: FleetGap) -> str:
    """Which effects the type has, and which are a unit's own."""
    of_type = [e.label for e in gaps.effects if e.scope == "type"]
    of_units = [f"{e.label} ({', '.join(e.units[:3])})" for e in gaps.effects if e.scope == "unit"]
    text = f"{gaps.robot}, {count(len(gaps.units), 'unit')}: "
    text += f"the type has {listed(of_type)}" if of_type else "no effect is surely the type's"
    return (
        f"{text}; units of their own have {listed(of_units, most=MOST)}."
        if of_units
        else f"{text}."
    )


def effect_table(gaps: FleetGap) -> Table:
    """Effects over the fleet."""
    count_of = [f"{len(e.units)} of {len(gaps.units)}" for e in gaps.effects]
    columns = "label scope ci95 units ambiguous_with"
    return table_of("effects over the fleet", gaps.effects, columns, beside={"units": count_of})


def diagnosed_table(gaps: FleetGap) -> Table:
    """Logs, their gaps over the noise, and what is named."""
    return table_of("logs", gaps.logs, most=MOST)


def gap_map(gaps: FleetGap) -> Figure:
    """Units by effects and places; what is named is filled, and the type's effects are blue."""
    effects, units = gaps.effects, gaps.units
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


def fleet_gap_page(gaps: FleetGap, origin: Origin) -> Page:
    """The page of a fleet's gaps, sortable."""
    caption = (
        "Which unit has which effect, and where. Blue: surely more than half of the units have it; "
        "red: surely fewer; grey: neither is sure."
    )
    named = sum(len(e.units) for e in gaps.effects)
    alt = f"{len(gaps.units)} units by {len(gaps.effects)} effects and places, {named} named."
    used = sum(log.closed is not None or bool(log.gap) for log in gaps.logs)
    facts = [("units", str(len(gaps.units))), ("logs diagnosed", f"{used} of {len(gaps.logs)}")]
    return Page(
        title=f"Sim-to-real gaps of a fleet of {gaps.robot}",
        verdict=gap_verdict(gaps),
        facts=facts,
        origin=origin,
        sections=[
            Section(
                "Which unit has which effect",
                [
                    Picture("map", caption, alt, partial(gap_map, gaps)),
                    effect_table(gaps),
                ],
                folded=False,
            ),
            Section("Every log", [diagnosed_table(gaps)]),
            caution_section(gaps.notes),
        ],
        sortable=True,
    )
