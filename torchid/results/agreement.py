"""Which runs agree on which causes, in words; `torchid.results.replication` asks them. It needs no
torch."""

from collections.abc import Iterable
from typing import Annotated, Literal

from torchid.results.record import Col, Joint, Part, Real
from torchid.results.words import count, effect_words, joints_words, listed, measure, unit_behind

MOST = 3
"""Disagreements that are said."""


Verdict = Literal["agrees", "differs", "cannot tell"]
"""On a run, beside most of the others."""


class MotionScale(Part, frozen=True):
    """By which factor a part of the data wants an effect, 1 being as it was fitted to all.

    Attributes:
        trajectory, from_s, to_s: which part.
        scale, std: the factor.
    """

    trajectory: str
    from_s: float
    to_s: float
    scale: Real
    std: float


class Replication(Part, frozen=True, kw_only=True):
    """Whether an effect is the same in every motion.

    Attributes:
        motions: part by part.
        mean: of the parts that can tell.
        spread: standard deviation between these parts, beyond that of each.
        next_std: of the factor in the next part.
        repeats, asked: in how many of the trajectories that can tell it has the same sign and size;
            of the parts of a log of one trajectory.
    """

    motions: tuple[MotionScale, ...]
    mean: Real
    spread: Real
    next_std: Real
    repeats: int
    asked: int


def repeat_words(replication: Replication | None) -> str:
    """`5 of 6`: motions that want the effect with the same sign and size, of those that can show
    it; of a log of one motion its stretches."""
    if replication is None:
        return "-"
    one = len({m.trajectory for m in replication.motions}) == 1
    return f"{replication.repeats} of {replication.asked}{' stretches' if one else ''}"


class RunValue(Part, frozen=True, kw_only=True):
    """A cause's number as one run alone wants it, all else being as all runs together want it.

    Attributes:
        effect, joints: the cause.
        parameter, unit: its best known number.
        run: name of the trajectory.
        value, std: of this run alone; null where it cannot tell.
        wanted: whether this run shows the cause by itself; null where it cannot tell.
        verdict: whether it agrees with most of the runs.
        merged, merged_std: mean of all runs (DerSimonian and Laird 1986).
        spread: standard deviation between runs, beyond that of each.
    """

    effect: str
    joints: tuple[Joint, ...]
    parameter: Annotated[str, Col("number")]
    unit: str
    run: Annotated[str, Col()]
    value: Annotated[Real, Col("from it alone", spread="std", unit_of="unit")]
    std: Real
    wanted: bool | None
    verdict: Annotated[Verdict, Col()]
    merged: Annotated[Real, Col("of all runs", spread="merged_std", unit_of="unit")]
    merged_std: Real
    spread: Annotated[Real, Col(digits=".2g")]

    @property
    def words(self) -> str:
        """`0.61 ± 0.02 N m`."""
        return measure(self.value, self.std, unit_behind(self.unit))

    @property
    def cause(self) -> Annotated[str, Col()]:
        """`Coulomb friction on joint 2`."""
        place = f" on {joints_words(self.joints)}" if self.joints else ""
        return effect_words(self.effect) + place


def by_cause(rows: Iterable[RunValue]) -> list[list[RunValue]]:
    """Runs of each cause."""
    groups: dict[tuple[str, tuple[int, ...]], list[RunValue]] = {}
    for row in rows:
        groups.setdefault((row.effect, row.joints), []).append(row)
    return list(groups.values())


def disagreement(rows: Iterable[RunValue], most: int = MOST) -> str:
    """Which runs contradict the others, and on what: `run3 wants Coulomb friction on joint 2 of
    0.90 ± 0.02 N m, the others of 0.61 ± 0.01 N m`; empty where none does."""
    rows = list(rows)
    apart = [c for c in by_cause(rows) if any(r.verdict == "differs" for r in c)]
    if not apart:
        return ""
    odd = dict.fromkeys(r.run for c in apart for r in c if r.verdict == "differs")
    rest = [name for name in dict.fromkeys(r.run for r in rows) if name not in odd]
    agree = f", while {listed(rest, most=MOST)} agree on everything" if len(rest) > 1 else ""
    said = [_apart(runs) for runs in apart[:most]]
    said += [f"and {count(len(apart) - most, 'cause')} more"] if len(apart) > most else []
    return (
        f"{'; '.join(said)}{agree}. The corrected model is a mean of all: diagnose "
        f"{listed(odd, most=MOST)} apart."
    )


def agreement(rows: Iterable[RunValue]) -> str:
    """Which runs agree, one sentence; empty of one run."""
    rows = list(rows)
    every = dict.fromkeys(r.run for r in rows if r.verdict != "cannot tell")
    causes = count(len(by_cause(rows)), "cause")
    agrees = f"{listed(every, most=2 * MOST)} agree on {causes} that more than one can tell."
    return (disagreement(rows) or agrees) if rows else ""


def _apart(runs: list[RunValue]) -> str:
    """Which runs want which value of one cause, in words."""
    odd = [r for r in runs if r.verdict == "differs"]
    others = [r for r in runs if r.verdict == "agrees"]
    name = runs[0].cause
    if not others:
        ends = sorted(odd, key=lambda r: r.value)
        low, high = (f"{r.words} in {r.run}" for r in (ends[0], ends[-1]))
        return f"the runs do not agree on {name}, from {low} to {high}"
    weights = [r.std**-2 for r in others]
    mean = sum(w * r.value for w, r in zip(weights, others, strict=True)) / sum(weights)
    rest = measure(mean, sum(weights) ** -0.5, unit_behind(runs[0].unit))
    rest = f"of {rest}" if any(r.wanted for r in others) else "none"
    them = f"the {'others' if len(others) > 1 else 'other'} {rest}"
    wants = [f"{r.run} wants {f'{name} of {r.words}' if r.wanted else f'no {name}'}" for r in odd]
    more = [f"{count(len(odd) - MOST, 'run')} more differ"] if len(odd) > MOST else []
    return f"{', '.join([*wants[:MOST], *more])}, {them}"
