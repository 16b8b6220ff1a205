"""The check of the diagnosis on one's own arm."""

from collections.abc import Sequence

from torchid.report.table import Shown, Table
from torchid.withheld.own import OwnCheck


def own_shown(found: OwnCheck) -> Shown:
    """All that there is to see of the check."""
    half = "untouched data: the second half of every trajectory (--held-out for others)"
    said: list[Table | str] = [own_table(found), *([] if found.whole else [half])]
    return Shown(verdict=own_headline(found), parts=said)


def own_headline(found: OwnCheck) -> str:
    """What was found again of what is there, in one sentence."""
    if not found.withheld:
        return "No effect was accepted on the first part of the logs, so none could be withheld."
    again = sum(w.in_set for w in found.withheld)
    judged = [w.as_much for w in found.withheld if w.as_much is not None]
    text = f"{again} of {len(found.withheld)} accepted effects were found again once withheld"
    if not judged:
        return f"{text}; without any of them these data show no gap."
    return (
        f"{text}; of {len(judged)} that leave a gap here, {sum(judged)} closed as much of it as "
        "they are known to."
    )


def own_table(found: OwnCheck) -> Table:
    """What was withheld, and what the diagnosis named instead."""
    withheld = []
    for w in found.withheld:
        others = (
            f"{f.effect} {_joints(f.joints)}" if f.joints else f.effect
            for f in w.found
            if (f.effect, f.joints) != (w.effect, w.joints)
        )
        again = "yes" if w.named else "in a set" if w.in_set else "no"
        shares = ("no gap" if x is None else f"{100 * x:.0f} %" for x in (w.closed, w.known))
        withheld.append((w.effect, _joints(w.joints), again, ", ".join(others), *shares))
    heads = ("effect", "joint", "found again", "named instead", "closed", "known to close")
    return Table("Accepted effects, withheld", heads, withheld, "pppppp")


def _joints(joints: Sequence[int]) -> str:
    return " ".join(str(j + 1) for j in joints) or "arm"
