"""The check on one's own arm, as sentences and tables."""

from collections.abc import Sequence

from torchid.report.table import Table
from torchid.withheld.own import LEVELS, OwnCheck, Planted


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


def own_tables(found: OwnCheck) -> list[Table]:
    """What was withheld, and the smallest sizes planted that were found: in units of the noise,
    those at which an effect was named, or in a set (in brackets)."""
    withheld = []
    for w in found.withheld:
        others = (
            f"{name} {_joints(js)}" if js else name
            for name, js in w.findings
            if (name, js) != (w.effect, w.joints)
        )
        again = "yes" if w.named else "in a set" if w.in_set else "no"
        shares = ("no gap" if x is None else f"{100 * x:.0f} %" for x in (w.closed, w.known))
        withheld.append((w.effect, _joints(w.joints), again, ", ".join(others), *shares))
    heads = ("effect", "joint", "found again", "named instead", "closed", "known to close")
    joints = sorted({p.joint for p in found.planted})
    planted = [
        (effect, *(smallest(found.planted, effect, j) for j in joints))
        for effect in dict.fromkeys(p.effect for p in found.planted)
    ]
    columns = ("effect", *(f"joint {j + 1}" for j in joints))
    made = (
        Table("Accepted effects, withheld", heads, withheld, words=heads),
        Table("Smallest size found, over noise", columns, planted, words=("effect",)),
    )
    return [table for table in made if table.rows]


def smallest(rows: Sequence[Planted], effect: str, joint: int) -> str:
    """`2`, `(2)` if only in a set, or `> 10`."""
    own = [p for p in rows if (p.effect, p.joint) == (effect, joint)]
    found = min((p for p in own if p.in_set), key=lambda p: p.level, default=None)
    if found is None:
        return f"> {max((p.level for p in own), default=LEVELS[-1]):g}"
    return f"{found.level:g}" if found.named else f"({found.level:g})"


def _joints(joints: Sequence[int]) -> str:
    return " ".join(str(j + 1) for j in joints) or "arm"
