"""Tables of every diagnosis, whatever the log measures: its causes in numbers, what they mean, and
what the log could not show."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from torchid.gap.record import GapRecord
from torchid.position.record import PositionRecord
from torchid.report.cautions import number_ranges
from torchid.report.panels import Picture
from torchid.report.table import Table
from torchid.results.agreement import by_cause, repeat_words
from torchid.results.answer import Answer, NotTestable
from torchid.results.cause import LINK, Cause, remedy_of
from torchid.results.words import (
    effect_words,
    joints_words,
    measure,
    number_list,
    percent,
    sure,
    unit_behind,
)
from torchid.statistics.proportion import HALF_95

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
    rows = []
    for cause in (*record.answer.causes, *record.answer.small):
        removes = "-" if math.isnan(cause.share) else percent(cause.share)
        removes += "" if math.isnan(cause.alone) else f"; by itself {percent(cause.alone)}"
        if cause.role == "small":
            removes = f"small: {cause.closes_rms:.2g} RMS"
        others = "\n".join(map(effect_words, cause.ambiguous_with)) or "-"
        again = repeat_words(cause.replication)
        cells = (number_list(cause.at, "all"), _values(cause), others, removes)
        rows.append((cause.name, *cells, sure(cause.how_sure), again))
    columns = ("effect", "joints", "value", "could also be", "share", "sure", "same size in")
    note = (
        "share: of the error that this cause takes away, the mean over all orders in which the "
        "causes may join (shares add up), and by itself; same size in: of the motions that can "
        "show it"
    )
    return Table("causes of the error (value ± std)", columns, rows, "lllp", note)


def _values(cause: Cause) -> str:
    """Numbers of a cause, a line each, and its shapes in brackets."""
    values = []
    # Numbers of a cause that are listed
    most_sizes = 12
    for size in sorted(cause.sizes, key=lambda s: not s.determined)[:most_sizes]:
        change = abs(size.value - (size.was or 0.0))
        unsure = size.std is not None and change < HALF_95 * size.std
        words = size.named if size.determined else size.name
        values.append(words + (", not determined" if unsure else ""))
    if not values:
        values = ["see the corrected model" if cause.effect == LINK else "-"]
    values += ["..."] if len(cause.sizes) > most_sizes else []
    if cause.shape and cause.role != "small":
        sizes = ((cause.parameters[name], name) for name in cause.shape)
        numbers = [
            f"{name} = {x:.4g} {unit_behind(cause.unit[name])}".rstrip()
            for x, name in sizes
            if isinstance(x, int | float)
        ]
        values.append(f"({', '.join(numbers)})")
    return "\n".join(values)


def agreement_table(record: GapRecord | PositionRecord) -> Table:
    """What each run alone wants of each cause: of many runs those that differ."""
    rows = []
    # Runs that are listed of a cause
    most_runs = 12
    for runs in by_cause(record.agreement):
        one = runs[0]
        first = sorted(runs, key=lambda r: r.verdict != "differs")
        listed_runs = runs if len(runs) <= most_runs else first[:most_runs]
        each = [
            f"{r.run}: {r.words if r.wanted is not None else '-'}{' *' * (r.verdict == 'differs')}"
            for r in listed_runs
        ]
        each += [f"and {len(runs) - most_runs} more"] if len(runs) > most_runs else []
        merged = measure(one.merged, one.merged_std, unit_behind(one.unit))
        name = f"{one.cause}, {one.parameter}"
        rows.append((name, "\n".join(each), merged, f"{one.spread:.2g}"))
    note = "* contradicts most of the runs; -: this run cannot tell; spread: beyond their own std"
    columns = ("cause", "value by run, from it alone (± std)", "of all runs", "spread")
    return Table("agreement of the runs", columns, rows, "pprr", note)


def meaning_table(record: GapRecord | PositionRecord) -> Table:
    """What each effect means and what to do; an effect on several joints once."""
    assert isinstance(record.answer, Answer)
    rows = []
    for name in dict.fromkeys(c.effect for c in record.answer.causes if c.meaning):
        same = [c for c in record.answer.causes if c.effect == name]
        notes = [f"{joints_words(c.at)}: {x}" for c in same for x in c.notes]
        words = "inertial parameters" if name == LINK else effect_words(name)
        # Those with a field first; where both kinds are, each with its joints.
        kinds = [[c for c in same if c.no_field is kind] for kind in (False, True)]
        remedies = [(joints_words([j for c in k for j in c.at]), remedy_of(k)) for k in kinds if k]
        todo = [f"{joints}: {x}" if len(remedies) > 1 else x for joints, x in remedies]
        rows.append((words, "\n".join([same[0].meaning, *notes]), "\n".join(todo)))
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
                sizes.append(f"{place}: {x.smallest_detectable:.3g} {unit_behind(x.unit)}".rstrip())
        sizes += [f"{', '.join(never)}: at no size"] if never else []
        why = number_ranges([x.reason for x in members], _NUMBER)
        rows.append((effect_words(effect), "; ".join(sizes), why))
    columns = ("effect", "joint: smallest size that this log would show", "why")
    return Table("not testable with these data", columns, rows, "lpp")
