"""What the doctor says about one thing."""

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from torchid.doctor.record import VERDICTS, CheckRecord, Choosable, Verdict
from torchid.doctor.repair import Repair
from torchid.robot.model import joint_list
from torchid.yaml_data import parsed_yaml


class Choice(Choosable, frozen=True):
    """One of several explanations, and its fix as changes of the log: `repairs`; none where the
    robot is what must change."""

    repairs: tuple[Repair, ...] = ()

    @classmethod
    def by(cls, name: str, *repairs: Repair) -> "Choice":
        """A choice that the repairs themselves describe."""
        return cls(name, "; ".join(map(str, repairs)), repairs)


class Check(CheckRecord, frozen=True):
    """A verdict with its evidence.

    Attributes:
        repairs: the fix as changes of the log, where the log can be mended.
        choices: explanations that are equally good, with their repairs.
    """

    choices: tuple[Choice, ...] = ()
    repairs: tuple[Repair, ...] = ()

    def mended_by(self, *repairs: Repair) -> "Check":
        """With repairs, which say what to do, before whatever else there is to be done."""
        said = [*map(str, repairs), *([self.fix] if self.fix else [])]
        return replace(self, fix="; ".join(said) or None, repairs=repairs)


def judged(
    name: str, verdict: Verdict, evidence: str, joints: tuple[int, ...] = (), **more: Any
) -> Check:
    """A check with its evidence, on joints from 0; `more` as of a Check."""
    return Check(name, verdict, joints, evidence=evidence, **more)


_TEXTS = Path(__file__).with_name("checks.yaml")
TEXTS: dict[str, dict[str, Any]] = parsed_yaml(_TEXTS.read_text(encoding="utf-8"))
"""What there is to say, by check."""


def worded_check(
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


def with_choices(
    check: Check, choices: Sequence[Choice], fixes: Collection[str], *, sure: bool = True
) -> Check:
    """A check with one fix, applied only by its name in `fixes` where it is not sure, or with
    several of which `fixes` may choose."""
    if len(choices) < 2 and sure:
        return replace(check, fix=choices[0].fix, repairs=choices[0].repairs)
    chosen = next((c for c in choices if c.name in fixes), None)
    taken = chosen or choices[0]
    if len(choices) > 1:
        every = "; or ".join(f"{c.name}: {c.fix}" for c in choices)
        ask = f"choose, the log cannot tell: {every}"
    else:
        ask = f'{taken.fix}, if you know it to be so: choose "{taken.name}"'
    return replace(
        check,
        fix=taken.fix if chosen else ask,
        repairs=taken.repairs if chosen or len(choices) > 1 else (),
        choices=tuple(choices),
        chosen=chosen.name if chosen else None,
    )
