"""What the doctor says about one thing."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from torchid.doctor.repair import Repair

Verdict = Literal["fine", "wrong", "doubtful", "cannot tell"]
VERDICTS: tuple[Verdict, ...] = ("wrong", "doubtful", "cannot tell", "fine")
"""In the order in which they are shown."""


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


def joint_list(joints: Sequence[int]) -> str:
    """`joint 3`, `joints 1, 4`."""
    names = ", ".join(str(k + 1) for k in joints)
    return f"joint{'s' if len(joints) > 1 else ''} {names}"


def fix_text(repairs: Sequence[Repair]) -> str:
    """Repairs as one sentence."""
    return "; ".join(str(r) for r in repairs)
