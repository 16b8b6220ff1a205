"""The answer of a diagnosis as a page shows it: causes at their joints, what to do first."""

from collections.abc import Sequence

from torchid.results.answer import Answer, Cause, LawCause, common_name
from torchid.results.words import effect_words, listed, percent, sure

CLEAR = 0.99
"""Probability of a cause above which nothing is said of it."""
MOST_ADVICE = 3
"""Things to do first."""
LEAST_STEP = 0.02
"""Share of the error below which a cause is nothing to do next, however sure it is [1]."""


def cause_line(cause: Cause) -> tuple[str, str, str, str]:
    """One cause: its name, what makes most of its torque, how sure it is, and what else it is."""
    known = [s for s in cause.sizes if s.determined][:1]
    others = listed((effect_words(x) for x in cause.ambiguous_with), "or", most=2)
    # A word that stands at every cause says nothing.
    how_sure = "" if cause.how_sure is None or cause.how_sure > CLEAR else sure(cause.how_sure)
    name = ("changed " if cause.changed else "") + cause.name
    size = cause.values() if isinstance(cause, LawCause) else ""
    size = cause.in_words(known[0]) if known else size
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
        shares = [c.closes for c in causes if c.closes == c.closes]
        return sum(shares) if add else max(shares, default=0.0)

    for remedy, causes in sorted(same.items(), key=lambda pair: -worth(pair[1])):
        if steps and worth(causes) != 0 and worth(causes) < LEAST_STEP:  # 0 where none is known
            continue
        what = listed(dict.fromkeys(common_name(c, causes) for c in causes))
        if causes[0].effect != "link_inertia":  # whose name has its place
            what += f", {answer.where(causes)}"
        removes = f" ({percent(worth(causes))} of the error)" if add else ""
        steps.append(f"{what}{removes}: {remedy[:1].lower()}{remedy[1:]}")
    return steps[:MOST_ADVICE]
