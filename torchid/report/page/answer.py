"""The answer of a diagnosis as a page shows it: causes at their joints, what to do first."""

from collections.abc import Sequence

from msgspec import UNSET

from torchid.results.answer import Answer
from torchid.results.cause import LINK, Cause, common_name, cut_line, remedy_of
from torchid.results.words import effect_words, listed, percent, sure

CLEAR = 0.99
"""Probability of a cause above which nothing is said of it."""
MOST_ADVICE = 3
"""Things to do first."""
LEAST_STEP = 0.02
"""Share of the error below which a cause is nothing to do next, however sure it is [1]."""


def cause_line(cause: Cause) -> tuple[str, str, str, str]:
    """One cause: its name, what makes most of its torque, how sure it is, and what else it is."""
    others = listed((effect_words(x) for x in cause.ambiguous_with), "or", most=2)
    # A word that stands at every cause says nothing.
    how_sure = "" if cause.how_sure is None or cause.how_sure > CLEAR else sure(cause.how_sure)
    name = cause.name
    size = cause.in_words(cause.known[0]) if cause.known else ""
    size = size if cause.law is UNSET else cause.values()
    size += "" if cause.window is UNSET else f", {cause.window.words}"
    rivals = f"could also be {others}" if cause.ambiguous_with else ""
    return name[:1].upper() + name[1:], size, how_sure, rivals


def first_steps(answer: Answer) -> list[str]:
    """What to do first: remedies of the causes that remove most, where data that were not fitted
    confirm them; else the doubt, what would settle suspects, or the motion that would decide;
    nothing while the search goes on."""
    if answer.status == "searching":
        return []
    if not answer.confirmed:
        return _to_decide(answer)
    same: dict[str, list[Cause]] = {}
    for cause in answer.entries:
        same.setdefault(cause.remedy, []).append(cause)
    steps: list[str] = []
    add = not answer.of_positions

    def worth(causes: Sequence[Cause]) -> float:
        if add:
            return sum(c.share for c in causes if c.share == c.share)
        # Shares of a joint's own error, as positions have them, have no sum.
        return max(map(answer.takes, causes)) / answer.before.value

    for causes in sorted(same.values(), key=lambda causes: -worth(causes)):
        if not worth(causes) > (LEAST_STEP if steps else 0.0):
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


def _to_decide(answer: Answer) -> list[str]:
    """What to do while nothing is confirmed."""
    if answer.doubt:
        return ["settle what speaks against the log: `torchid log doctor` shows what mends it."]
    if answer.fails:
        return [
            f"fit motions like those {answer.after.words}, too: there the answer does not hold."
        ]
    if answer.causes:
        # What happened once no other motion confirms.
        events = [c for c in answer.causes if c.window is not UNSET]
        names = listed(dict.fromkeys(c.name for c in events))
        return [f"cut out what happened once ({names}), {cut_line(events)}."] * bool(events) + [
            "record other motions and hold one out (--held-out): these logs confirm no cause. "
            "`torchid excite --for gap.json` plans motions that tell."
        ]
    return [
        f"to settle {c.name} {c.place}".rstrip() + f": {remedy_of([c]).rstrip('.')}."
        for c in answer.suspects[:MOST_ADVICE]
    ]
