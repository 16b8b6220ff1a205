"""Tables of every diagnosis, whatever the log measures: its causes in numbers, what they mean, and
what the log could not show."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from torchid.gap.record import GapRecord
from torchid.position.record import PositionRecord
from torchid.report.cautions import number_ranges
from torchid.report.panels import Picture
from torchid.report.table import Table, table_of
from torchid.results.answer import Answer, NotTestable
from torchid.results.cause import LINK, remedy_of
from torchid.results.words import effect_words, joints_words, unit_behind

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
    small = record.answer.small
    note = (
        "share: of the error that this cause takes away, the mean over all orders in which the "
        "causes may join (shares add up), and by itself; same size in: of the motions that can "
        "show it"
    )
    columns = f"name at {'role ' * bool(small)}numbers ambiguous_with share alone how_sure"
    causes = (*record.answer.causes, *small)
    return table_of("causes of the error", causes, f"{columns} replication", note)


def agreement_table(record: GapRecord | PositionRecord) -> Table:
    """What each run alone wants of each cause."""
    note = "spread: between runs, beyond their own std"
    columns = "cause parameter run value verdict merged spread"
    # 60: rows that are printed
    return table_of("agreement of the runs", record.agreement, columns, note, most=60)


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
