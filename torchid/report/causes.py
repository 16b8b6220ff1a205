"""Tables of every diagnosis, whatever the log measures: its causes in numbers, what they mean, and
what the log could not show."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from torchid.gap.record import FoundEffect, GapRecord, UnnamedEffect
from torchid.position.record import PositionFinding, PositionRecord
from torchid.report.cautions import number_ranges
from torchid.report.panels import Picture
from torchid.report.table import Table
from torchid.results.agreement import by_cause
from torchid.results.answer import Answer, Cause, NotTestable, named_size
from torchid.results.replication import repeat_words
from torchid.results.words import (
    effect_words,
    joints_words,
    measure,
    number_list,
    percent,
    sure,
    unit_behind,
    unit_words,
)
from torchid.robot.model import Robot
from torchid.statistics.proportion import HALF_95

MOST_SIZES = 12
"""Numbers of a cause that are listed."""
MOST_RUNS = 12
"""Runs that are listed of a cause."""
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")


Parts = Sequence[Picture | Table | None]


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What a diagnosis of one kind of log rests on, beside what all have; empty parts are left out.

    Attributes:
        where: where the error lies.
        friction: of each joint.
        numbers: errors, and what was known.
        unseen: beside what the log could not show.
        remarks: what to know about the tables, one sentence each.
    """

    where: Parts
    friction: Parts = ()
    numbers: Parts
    unseen: Parts = ()
    remarks: Sequence[str]


def cause_table(record: GapRecord | PositionRecord) -> Table:
    """Every cause with its numbers, and effects that are sure and remove less than was asked for.

    Args:
        record: with an answer.
    """
    assert isinstance(record.answer, Answer)
    small = record.small if isinstance(record, GapRecord) else ()
    findings = {(f.effect, _joints(f)): f for f in (*record.which, *small)}
    rows = []
    for cause in (*record.answer.causes, *record.answer.small):
        finding = findings.get((cause.effect, cause.joints))
        removes = "-" if math.isnan(cause.closes) else percent(cause.closes)
        removes += "" if math.isnan(cause.alone) else f", alone {percent(cause.alone)}"
        if isinstance(finding, UnnamedEffect):
            removes = f"small: {finding.closes_rms:.2g} RMS"
        others = "\n".join(map(effect_words, cause.ambiguous_with)) or "-"
        joints = number_list(cause.joints, "all")
        again = repeat_words(None if finding is None else finding.replication)
        values = _values(cause, finding)
        rows.append((cause.name, joints, values, others, removes, sure(cause.how_sure), again))
    columns = ("effect", "joints", "value", "could also be", "removes", "sure", "found in")
    note = (
        "or: could also be; removes: share of the error that this cause takes away, the mean over "
        "all orders in which the causes may join (shares add up), and by itself; found in: motions "
        "with the same size, of those that can show it"
    )
    return Table("which: causes of the error (value ± std)", columns, rows, "lllp", note)


def _joints(finding: FoundEffect | UnnamedEffect | PositionFinding) -> tuple[int, ...]:
    return finding.located if isinstance(finding, FoundEffect) else finding.joints


def _values(cause: Cause, finding: FoundEffect | UnnamedEffect | PositionFinding | None) -> str:
    """Numbers of a cause, a line each, and its shapes in brackets."""
    values = []
    for size in sorted(cause.sizes, key=lambda s: not s.determined)[:MOST_SIZES]:
        unsure = size.std is not None and abs(size.value) < HALF_95 * size.std
        words = named_size(size) if size.determined else size.name
        values.append(words + (", not determined" if unsure else ""))
    if not values:
        values = ["see the corrected model" if cause.effect == "link_inertia" else "-"]
    values += ["..."] if len(cause.sizes) > MOST_SIZES else []
    if isinstance(finding, FoundEffect) and finding.shape:
        sizes = ((finding.parameters[name], name) for name in finding.shape)
        numbers = [
            f"{name} = {x:.4g} {unit_behind(finding.unit[name])}".rstrip()
            for x, name in sizes
            if isinstance(x, int | float)
        ]
        values.append(f"({', '.join(numbers)})")
    return "\n".join(values)


def _corrects(finding: FoundEffect | PositionFinding, robot: Robot | None) -> bool:
    """Whether the model has this effect at this place already, so that values are changes of it."""
    if robot is None or not isinstance(finding, FoundEffect) or finding.effect == "link_inertia":
        return False
    joints = [j + 1 for j in finding.located]
    return any(
        r.get("effect") == finding.effect and (not joints or r.get("joint") in joints)
        for r in robot.effects
    )


def agreement_table(record: GapRecord | PositionRecord) -> Table:
    """What each run alone wants of each cause: of many runs those that differ."""
    rows = []
    for runs in by_cause(record.agreement):
        one = runs[0]
        first = sorted(runs, key=lambda r: r.verdict != "differs")
        listed_runs = runs if len(runs) <= MOST_RUNS else first[:MOST_RUNS]
        each = [
            f"{r.run}: {r.words if r.wanted is not None else '-'}{' *' * (r.verdict == 'differs')}"
            for r in listed_runs
        ]
        each += [f"and {len(runs) - MOST_RUNS} more"] if len(runs) > MOST_RUNS else []
        merged = measure(one.merged, one.merged_std, unit_behind(one.unit))
        name = f"{one.cause}, {one.parameter}"
        rows.append((name, "\n".join(each), merged, f"{one.spread:.2g}"))
    note = "* contradicts most of the runs; -: this run cannot tell; spread: beyond their own std"
    columns = ("cause", "value by run, from it alone (± std)", "of all runs", "spread")
    return Table("agreement of the runs", columns, rows, "pprr", note)


def meaning_table(record: GapRecord | PositionRecord) -> Table:
    """What each effect means and what to do; an effect on several joints once."""
    rows = []
    for name in dict.fromkeys(f.effect for f in record.which):
        same = [f for f in record.which if f.effect == name]
        remedy, notes = same[0].remedy, [same[0].meaning]
        for f in same:
            notes += [f"{joints_words(_joints(f))}: {x}" for x in getattr(f, "notes", ())]
        if any(_corrects(f, getattr(record, "model", None)) for f in same):
            remedy += " Where the model has it, the value is a change of the model's."
        words = "inertial parameters" if name == "link_inertia" else effect_words(name)
        rows.append((words, "\n".join(notes), remedy))
    columns = ("effect", "what it means", "what to do")
    return Table("what it means, and what to do", columns, rows, "lpp")


def not_testable_table(record: GapRecord | PositionRecord) -> Table:
    """Effects these data could not show, joints of one reason on one line."""
    groups: dict[tuple[str, str], list[NotTestable]] = {}
    for x in record.not_testable:
        groups.setdefault((x.effect, _NUMBER.sub("#", x.reason)), []).append(x)
    rows = []
    for (effect, _), members in groups.items():
        # Joints on which no size would do stand together, behind the others.
        sizes, never = [], []
        for x in members:
            place = " and ".join(str(j + 1) for j in x.joints) or "the arm"
            if x.smallest_detectable is None:
                never.append(place)
            else:
                sizes.append(f"{place}: {x.smallest_detectable:.3g} {unit_words(x.unit)}".rstrip())
        sizes += [f"{', '.join(never)}: at no size"] if never else []
        why = number_ranges([x.reason for x in members], _NUMBER)
        rows.append((effect_words(effect), "; ".join(sizes), why))
    columns = ("effect", "joint: smallest size that this log would show", "why")
    return Table("not testable with these data", columns, rows, "lpp")
