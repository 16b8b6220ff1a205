"""The answer of a diagnosis as a page shows it: causes at their joints, what to do first."""

from collections.abc import Sequence

from msgspec import UNSET

from torchid.results.answer import Answer
from torchid.results.cause import LINK, Cause, common_name, remedy_of
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
    rivals = f"could also be {others}" if cause.ambiguous_with else ""
    return name[:1].upper() + name[1:], size, how_sure, rivals


def first_steps(answer: Answer) -> list[str]:
    """What to do first: remedies of the causes that remove most, or what would settle suspects."""
    if not answer.causes:
        return [
            f"To settle {c.name} {c.place}".rstrip() + f": {c.remedy.rstrip('.')}."
            for c in answer.suspects[:MOST_ADVICE]
        ]
    same: dict[str, list[Cause]] = {}
    for cause in answer.entries:
        same.setdefault(cause.remedy, []).append(cause)
    steps: list[str] = []
    # Shares of a joint's own error, as positions have them, have no sum.
    add = not answer.of_positions

    def worth(causes: Sequence[Cause]) -> float:
        shares = [c.share for c in causes if c.share == c.share]
        return sum(shares) if add else max(shares, default=0.0)

    for causes in sorted(same.values(), key=lambda causes: -worth(causes)):
        if steps and worth(causes) != 0 and worth(causes) < LEAST_STEP:  # 0 where none is known
            continue
        what = listed(dict.fromkeys(common_name(c, causes) for c in causes))
        if causes[0].effect != LINK:  # whose name has its place
            what += f", {answer.where(causes)}"
        removes = f" ({percent(worth(causes))} of the error)" if add else ""
        remedy = remedy_of(causes)
        steps.append(f"{what}{removes}: {remedy[:1].lower()}{remedy[1:]}")
    return steps[:MOST_ADVICE]
