"""The answer of a diagnosis as a page shows it: bars, causes at their joints, what to do first."""

from collections.abc import Sequence
from dataclasses import dataclass

from torchid.results.answer import Answer, Cause, size_words
from torchid.results.words import effect_words, joints_words, listed, percent, sure

MOST_CAUSES = 5
"""That are shown at a joint."""
CLEAR = 0.99
"""Probability of a cause above which nothing is said of it."""
MOST_ADVICE = 3
"""Things to do first."""


@dataclass(frozen=True)
class CauseLine:
    """One cause: its name, its largest number, how sure it is, and what it could also be."""

    name: str
    size: str
    sure: str
    others: str


@dataclass(frozen=True)
class JointBar:
    """One joint.

    Attributes:
        joint: number and name.
        before, after, noise: errors in words; empty of a joint that never moves.
        solid, light, mark: what remains, what is removed, and the highest noise, in percent of the
            longest bar.
        causes: the largest first.
        more: how many causes are not shown.
    """

    joint: str
    before: str
    after: str
    noise: str
    solid: float
    light: float
    mark: float
    causes: Sequence[CauseLine]
    more: int


@dataclass(frozen=True)
class AnswerBars:
    """The answer's table.

    Attributes:
        title: what the bars are, with the unit.
        joints: the largest remaining error first.
        arm: causes of the whole arm.
        all_sure: whether most causes need no word on how sure they are.
    """

    title: str
    joints: Sequence[JointBar]
    arm: Sequence[CauseLine]
    all_sure: bool


def answer_bars(answer: Answer, band: float | None = None) -> AnswerBars:
    """The answer's table; errors are below `band` [Hz]."""
    rows = answer.joint_rows()
    moving = [r.error for r in rows if not r.never_moves]
    longest = max((x for e in moving for x in (e.before, e.after)), default=0.0) or 1.0
    arm = [c for c in answer.causes if not c.joints]
    bars = []
    for row in rows:
        error, moves = row.error, not row.never_moves
        lines = [_line(c) for c in answer.causes if error.joint in c.joints]
        whole, left = (100 * x / longest if moves else 0.0 for x in (error.before, error.after))
        high = min(100.0, 100 * error.noise[1] / longest) if moves else 0.0
        bars.append(
            JointBar(
                row.label,
                f"{error.before:.3g}" if moves else "",
                f"{error.after:.3g}" if moves else "",
                " to ".join(dict.fromkeys(f"{x:.2g}" for x in error.noise)) if moves else "",
                left, max(0.0, whole - left), high, lines[:MOST_CAUSES],
                max(0, len(lines) - MOST_CAUSES),
            )
        )  # fmt: skip
    title = f"RMS error of each joint [{answer.unit}]" + (f", below {band:g} Hz" if band else "")
    clear = any(c.how_sure is not None and c.how_sure > CLEAR for c in answer.causes)
    return AnswerBars(title, bars, [_line(c) for c in arm], clear)


def _line(cause: Cause) -> CauseLine:
    known = [s for s in cause.sizes if s.determined][:1]
    others = listed((effect_words(x) for x in cause.ambiguous_with), "or", most=2)
    # A word that stands at every cause says nothing.
    how_sure = "" if cause.how_sure is None or cause.how_sure > CLEAR else sure(cause.how_sure)
    name = ("changed " if cause.changed else "") + cause.name
    return CauseLine(
        name[:1].upper() + name[1:], size_words(known[0]) if known else "", how_sure,
        f"could also be {others}" if cause.ambiguous_with else "",
    )  # fmt: skip


def first_steps(answer: Answer) -> list[str]:
    """What to do first: remedies of the causes that remove most, or what would settle suspects."""
    if not answer.causes:
        return [
            f"To settle {c.name} {c.place}".rstrip() + f": {c.remedy.rstrip('.')}."
            for c in answer.suspects[:MOST_ADVICE]
        ]
    same: dict[str, list[Cause]] = {}
    for cause in answer.causes:
        same.setdefault(cause.remedy, []).append(cause)
    steps = []
    # Shares of a joint's own error, as positions have them, have no sum.
    add = answer.unit != "mrad"

    def worth(causes: Sequence[Cause]) -> float:
        shares = [c.closes for c in causes if c.closes == c.closes]
        return sum(shares) if add else max(shares, default=0.0)

    for remedy, causes in sorted(same.items(), key=lambda pair: -worth(pair[1])):
        joints = sorted({j for c in causes for j in c.joints})
        if causes[0].effect == "link_inertia":
            what = listed(dict.fromkeys(c.name for c in causes))
        else:
            every = len(joints) == len(answer.joints) > 1
            place = "all joints" if every else joints_words(joints)
            what = f"{listed(dict.fromkeys(c.name for c in causes))}, {place}"
        removes = f" ({percent(worth(causes))} of the error)" if add else ""
        steps.append(f"{what}{removes}: {remedy[:1].lower()}{remedy[1:]}")
    return steps[:MOST_ADVICE]
