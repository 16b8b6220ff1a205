"""The check on one's own arm, as sentences and tables."""

from collections.abc import Sequence

from rich.table import Table

from torchid.withheld.own import OwnCheck, Withheld
from torchid.withheld.planting import LEVELS, Planted


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
    """What was withheld, and the smallest sizes planted that were found."""
    withheld = [_withheld(found.withheld)] if found.withheld else []
    return [*withheld, *([_planted(found.planted)] if found.planted else [])]


def _withheld(rows: Sequence[Withheld]) -> Table:
    table = Table(title="Accepted effects, withheld", title_justify="left")
    for head in ("effect", "joint", "found again", "named instead", "closed", "known to close"):
        table.add_column(head)
    for w in rows:
        others = [
            f"{name}{_at(js)}" for name, js in w.findings if (name, js) != (w.effect, w.joints)
        ]
        again = "yes" if w.named else "in a set" if w.in_set else "no"
        table.add_row(
            w.effect, _joints(w.joints), again, ", ".join(others), _share(w.closed), _share(w.known)
        )
    return table


def _planted(rows: Sequence[Planted]) -> Table:
    """Smallest size, in units of the noise, at which an effect was named, or in a set (in
    brackets)."""
    effects = list(dict.fromkeys(p.effect for p in rows))
    joints = sorted({p.joint for p in rows})
    table = Table(title="Smallest size found, over noise", title_justify="left")
    table.add_column("effect")
    for j in joints:
        table.add_column(f"joint {j + 1}", justify="right")
    for effect in effects:
        table.add_row(effect, *(smallest(rows, effect, j) for j in joints))
    return table


def smallest(rows: Sequence[Planted], effect: str, joint: int) -> str:
    """`2`, `(2)` if only in a set, or `> 10`."""
    own = [p for p in rows if (p.effect, p.joint) == (effect, joint)]
    found = min((p for p in own if p.in_set), key=lambda p: p.level, default=None)
    if found is None:
        return f"> {max((p.level for p in own), default=LEVELS[-1]):g}"
    return f"{found.level:g}" if found.named else f"({found.level:g})"


def _joints(joints: Sequence[int]) -> str:
    return " ".join(str(j + 1) for j in joints) or "arm"


def _at(joints: Sequence[int]) -> str:
    return f" {_joints(joints)}" if joints else ""


def _share(value: float | None) -> str:
    return "no gap" if value is None else f"{100 * value:.0f} %"
