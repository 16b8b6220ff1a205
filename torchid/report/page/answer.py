"""The answer of a diagnosis as a page shows it: causes at their joints, what to do first."""

import math
import shlex
from collections.abc import Sequence

from msgspec import UNSET

from torchid.results.answer import UNCHANGED, Answer, JointRow
from torchid.results.cause import LINK, Cause, common_name, cut_line, remedy_of
from torchid.results.words import effect_words, listed, percent, sure

NAMED = 2
"""Causes of a joint that are named where there is no room for more."""
MOST_ADVICE = 3
"""Things to do first."""


def cause_line(cause: Cause) -> tuple[str, str, str, str]:
    """One cause: its name, what makes most of its torque, how sure it is, and what else it is."""
    others = listed((effect_words(x) for x in cause.ambiguous_with), "or", most=2)
    # A word that stands at every cause says nothing.
    # 0.99: probability of a cause above which nothing is said of it
    how_sure = "" if cause.how_sure is None or cause.how_sure > 0.99 else sure(cause.how_sure)
    name = cause.name
    size = cause.in_words(cause.known[0]) if cause.known else ""
    size = size if cause.law is UNSET else cause.values()
    size += "" if cause.window is UNSET else f", {cause.window.words}"
    rivals = f"could also be {others}" if cause.rivals else ""
    return name[:1].upper() + name[1:], size, how_sure, rivals


def no_own_cause(row: JointRow, answer: Answer) -> str:
    """What a joint's error is without a cause of its own: what joints share, noise, or unknown."""
    joint, error = row.error.joint, row.error
    names = dict.fromkeys(same[0].name for same in answer.shared() if _acts(same, joint))
    if names and error.after < UNCHANGED * error.before:
        return f"{listed(names, most=NAMED)} (below)"
    if answer.status == "searching":
        return "not explained so far"
    if error.after <= max(error.noise):
        return "noise"
    return "no cause found" + ("; may be noise" if math.isnan(error.noise[1]) else "")


def _acts(same: Sequence[Cause], joint: int) -> bool:
    """Whether causes of one name lower the error of a joint."""
    if same[0].removes:
        return sum(c.removes[joint] for c in same) > 0
    return any(joint in c.at or not c.at for c in same)


def first_steps(answer: Answer, robot: str = "ROBOT") -> list[str]:
    """What to do first: remedies of the causes that remove most, where data that were not fitted
    confirm them, behind what would settle a suspect that removes more than all of them; else the
    doubt, what would settle suspects, or the motion that would decide; nothing while the search
    goes on. `robot` is what a command line calls it, where a JSON holds none."""
    if answer.status == "searching":
        return []
    if not answer.confirmed:
        return _to_decide(answer, robot)
    same: dict[tuple[str, bool], list[Cause]] = {}
    for cause in answer.entries:
        same.setdefault((cause.remedy, cause.no_field), []).append(cause)
    main, add = answer.main_suspect, not answer.of_positions
    steps = [] if main is None else [_to_settle(main)]

    def worth(causes: Sequence[Cause]) -> float:
        if add:
            return sum(c.share for c in causes if c.share == c.share)
        # Shares of a joint's own error, as positions have them, have no sum.
        return max(map(answer.takes, causes)) / answer.before.value

    for causes in sorted(same.values(), key=lambda causes: -worth(causes)):
        # 0.02: share of the error below which a cause is nothing to do next, however sure it is
        if not worth(causes) > (0.02 if steps else 0.0):
            continue
        what = listed(dict.fromkeys(common_name(c, causes) for c in causes))
        if causes[0].effect != LINK:  # whose name has its place
            what += f", {answer.where(causes)}"
        removes = f" ({percent(worth(causes))} of the error)" if add else ""
        remedy = remedy_of(causes)
        cut = cut_line(causes)
        end = f" Cut {cut}." if cut else ""
        steps.append(f"{what}{removes}: {remedy[:1].lower()}{remedy[1:]}{end}")
    return steps[:MOST_ADVICE]


def _to_decide(answer: Answer, robot: str) -> list[str]:
    """What to do while nothing is confirmed."""
    if answer.doubt:
        return [
            "settle what speaks against the log: `torchid log doctor` has the evidence, and the "
            "fix where there is one."
        ]
    if answer.fails:
        return [
            f"fit motions like those {answer.after.words}, too: there the answer does not hold."
        ]
    if answer.causes:
        # What happened once no other motion confirms.
        events = [c for c in answer.causes if c.window is not UNSET]
        names = listed(dict.fromkeys(c.name for c in events))
        robot = f"{shlex.quote(robot)} " * answer.of_positions  # whose JSON holds none
        return [f"cut out what happened once ({names}), {cut_line(events)}."] * bool(events) + [
            "record other motions and hold one out (--held-out): these logs confirm no cause. "
            f"`torchid excite {robot}--for gap.json --max-acceleration 5 --out next` plans one."
        ]
    return [_to_settle(c) for c in answer.suspects[:MOST_ADVICE]]


def _to_settle(suspect: Cause) -> str:
    """What would tell whether it is one."""
    remedy = remedy_of([suspect]).rstrip(".")
    name = f"{suspect.name} {suspect.place}".rstrip()
    return f"to settle {name}: {remedy[:1].lower()}{remedy[1:]}."
