"""What the doctor says about one thing."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from torchid.doctor.repair import Repair
from torchid.robot.model import joint_list
from torchid.yaml_data import parsed_yaml

Verdict = Literal["fine", "wrong", "doubtful", "cannot tell"]
VERDICTS: tuple[Verdict, ...] = ("wrong", "doubtful", "cannot tell", "fine")
"""In the order in which they are shown."""


@dataclass(frozen=True)
class Choice:
    """One of several explanations that this log cannot tell apart.

    Attributes:
        name: by which it is chosen.
        fix: what to do, for people.
        repairs: the same as changes of the log; none where the robot is what must change.
    """

    name: str
    fix: str
    repairs: tuple[Repair, ...] = ()

    @classmethod
    def of(cls, name: str, *repairs: Repair) -> "Choice":
        """A choice that the repairs themselves describe."""
        return cls(name, "; ".join(map(str, repairs)), repairs)


@dataclass(frozen=True)
class Check:
    """A verdict with its evidence.

    Attributes:
        name: of the check.
        verdict: fine, wrong (clearly), doubtful (look at it), cannot tell (this log cannot say).
        evidence: in words and numbers.
        joints: from 0; empty where it is about the whole log.
        estimate: what was measured, one number or one a joint of `joints`.
        interval: of the estimate (95 %), (low, high) or one pair a joint.
        unit: of the estimate.
        fix: what to do, for people; None where nothing.
        repairs: the same as changes of the log, where the log can be mended.
        choices: explanations that are equally good, where there are several; the checks that come
            after go on with the first, or with the chosen one.
        chosen: name of the one that was chosen, by somebody or because bodies explain the torque
            clearly better with it.
    """

    name: str
    verdict: Verdict
    evidence: str
    joints: tuple[int, ...] = ()
    estimate: float | tuple[float, ...] | None = None
    interval: tuple[float, float] | tuple[tuple[float, float], ...] | None = None
    unit: str = ""
    fix: str | None = None
    repairs: tuple[Repair, ...] = ()
    choices: tuple[Choice, ...] = ()
    chosen: str | None = None

    @property
    def undecided(self) -> bool:
        """Whether somebody has to choose."""
        return bool(self.choices) and self.chosen is None

    def mended_by(self, *repairs: Repair) -> "Check":
        """With repairs, which say what to do, before whatever else there is to be done."""
        said = [*map(str, repairs), *([self.fix] if self.fix else [])]
        return replace(self, fix="; ".join(said) or None, repairs=repairs)


_TEXTS = Path(__file__).with_name("checks.yaml")
TEXTS: dict[str, dict[str, Any]] = parsed_yaml(_TEXTS.read_text(encoding="utf-8"))
"""What there is to say, by check."""


def said(
    name: str,
    verdict: str,
    /,
    *words: object,
    joints: Sequence[int] = (),
    estimate: Any = None,
    interval: Any = None,
    **known: Any,
) -> Check:
    """A check as checks.yaml says it, with words and numbers in their places.

    Args:
        name: of the check.
        verdict: and which of several of this verdict, `doubtful idle`.
        words: of the texts, in order.
        joints, estimate, interval: as of a Check.
        known: words of the texts by name.
    """
    own = TEXTS[name]
    given = own.get(verdict, "{text}")
    parts = {"evidence": given} if isinstance(given, str) else given
    known |= {"joints": joint_list(joints)} if joints else {}
    texts = {key: text.format(*words, **known) for key, text in parts.items()}
    unit = own.get("unit", "") if estimate is not None else ""
    kind = next(v for v in VERDICTS if verdict.startswith(v))
    return Check(
        name,
        kind,
        **{"unit": unit} | texts,
        joints=tuple(joints),
        estimate=estimate,
        interval=interval,
    )


def with_choices(check: Check, choices: Sequence[Choice], fixes: Collection[str]) -> Check:
    """A check with one fix, or with several of which `fixes` may choose."""
    if len(choices) < 2:
        return replace(check, fix=choices[0].fix, repairs=choices[0].repairs)
    chosen = next((c for c in choices if c.name in fixes), None)
    taken = chosen or choices[0]
    every = "; or ".join(f"{c.name}: {c.fix}" for c in choices)
    return replace(
        check,
        fix=taken.fix if chosen else f"choose, the log cannot tell: {every}",
        repairs=taken.repairs,
        choices=tuple(choices),
        chosen=chosen.name if chosen else None,
    )
