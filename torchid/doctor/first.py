"""What every command that answers from logs asks of them first: faults that effects, parameters or
a payload would explain away."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from torchid.doctor.check import TEXTS, Check
from torchid.doctor.examine import FILE, LEAST_SAMPLES, Examination, examine
from torchid.doctor.faults import moments_of
from torchid.doctor.kind import holds_no_gravity
from torchid.errors import LogError
from torchid.log.model import Log
from torchid.robot.model import Robot, joint_list
from torchid.statistics.criteria import UNEXPLAINED

DECISIVE = tuple(name for name, texts in TEXTS.items() if texts.get("decisive"))
"""Checks of faults for which no effect stands."""
_EXPLAINABLE = ("velocity", "gravity")


class WrongLogError(LogError):
    """A log that must be mended before anything is told from it.

    Attributes:
        examination: that says so.
        wrong: its checks that do.
    """

    def __init__(self, examination: Examination, wrong: Sequence[Check], line: str | None = None):
        self.examination, self.wrong = examination, tuple(wrong)
        mends = any(c.repairs for c in wrong)
        line = line or ("`torchid.examine(robot, log).mended()` is mended" if mends else None)
        super().__init__(
            f"log '{examination.log.source}' is not used, it looks wrong: {_names(wrong)}.",
            got="; ".join(c.evidence for c in wrong),
            expected="; ".join(c.fix or "another log" for c in wrong),
            hint="; ".join(filter(None, (line, "`force=True` goes on all the same"))),
        )


@dataclass(frozen=True)
class Doubts:
    """What speaks against a log that is used all the same.

    Attributes:
        short: for the headline; empty where nothing does.
        warnings: with the evidence, and what is odd about the robot's file.
        wrong: whether a fault is sure, which no answer settles.
        foreign: that the torque follows no model of this robot; empty where it follows one.
        sizes: measured torque over the model's, by joint from 0, where that can be told [1].
    """

    short: str = ""
    warnings: tuple[str, ...] = ()
    wrong: bool = False
    foreign: str = ""
    sizes: Mapping[int, float] = field(default_factory=dict)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Doubts and warnings, where there is no headline to hold the first."""
        return (self.short, *self.warnings) if self.short else ()


def ask_first(robot: Robot, log: Log, *, force: bool = False, loaded: bool = False) -> Doubts:
    """Make the decisive checks of a log that something is to be told from.

    Args:
        robot: that it is of.
        log: of one arm with one load; one that cannot be examined raises no doubt.
        force: whether a wrong log is a doubt, and no error.
        loaded: whether the arm carries what the model does not have: then torque of another size
            than the model's is no doubt.

    Raises:
        WrongLogError: a decisive check says that the log is wrong.
    """
    longest = max(rows.stop - rows.start for rows in log.slices())
    gains = log.tau is not None or log.current is None or robot.drive_gain is not None
    if robot.floating or log.n != robot.n or longest < LEAST_SAMPLES or not gains:
        return Doubts()  # without gains the diagnosis asks for them
    try:
        examination = examine(robot, log, first=True)
    except LogError:  # which the diagnosis says, if it matters there
        return Doubts()
    odd = [c for c in examination.by_verdict() if c.name in DECISIVE or holds_no_gravity(c)]
    # A dq that only lags, or is coarse, is left out of what follows; a tilt is an effect.
    odd = [c for c in odd if c.verdict in ("wrong", "doubtful")]
    odd = [c for c in odd if c.verdict == "wrong" or c.name not in _EXPLAINABLE]
    # A load makes torque of any size; of a thousandth or a hundredth of its unit it is still told.
    odd = [c for c in odd if c.repairs or not (loaded and c.name == "torque unit")]
    # A model is wrong by any factor, a unit by its own.
    wrong = [c for c in odd if c.verdict == "wrong" and (c.repairs or c.name != "torque unit")]
    if wrong and not force:
        raise WrongLogError(examination, wrong)
    odd.sort(key=lambda c: c not in wrong)
    # The model's own mistakes are what a diagnosis is for: no doubt of the log.
    every = (*odd, *(c for c in examination.checks if c.name == FILE))
    notes = tuple(f"Caution: {c.evidence}{f'; {c.fix}' if c.fix else ''}." for c in every)
    foreign = _foreign(examination)
    sizes = {
        j: x
        for c in examination.checks
        if c.name == "torque unit" and log.tau is not None and isinstance(c.estimate, tuple)
        for j, x in zip(c.joints, c.estimate, strict=True)
        if x is not None and x > 0
    }
    if not odd:
        return Doubts(warnings=notes, foreign=foreign, sizes=sizes)
    text = f"Wrong log: {_names(wrong)}." if wrong else f"Doubt: {_in_short(odd[0])}."
    return Doubts(text, notes, bool(wrong), foreign, sizes)


def _foreign(examination: Examination) -> str:
    """A sentence that the torque follows no model of this robot, where the examination has decided
    so; else empty."""
    if examination.search is None or examination.judge is None or examination.search.explained:
        return ""
    odd = [j for j, x in enumerate(examination.search.left) if x > UNEXPLAINED]
    live = examination.judge.live(examination.search.final.hypothesis)
    known = moments_of(examination.judge, examination.search, [j for j in odd if j in live])
    more = "".join(f": it is {moment}" for joints, moment in known if joints == odd)
    return f"The torque of {joint_list(odd)} follows no model of this robot{more}."


def _in_short(check: Check) -> str:
    """A doubt and its remedy: `torque is -28.8 ms late; tau(t) = tau(t - 0.0288 s)`."""
    evidence = re.split(r": | \(|; ", check.evidence)[0]
    return "; ".join(filter(None, (evidence, check.fix)))


def _names(checks: Sequence[Check]) -> str:
    """Faults in few words: `torque sign of joint 2; run two contradicts the others`."""
    words = [
        c.evidence.partition(":")[0]
        if c.name == "runs"
        else f"{c.name} of {joint_list(c.joints)}"
        if c.joints
        else c.name
        for c in checks
    ]
    return "; ".join(words)
