"""An examination in a sentence or two, and as its JSON has it: the schema torchid.doctor/1."""

import itertools
from typing import TYPE_CHECKING, Generic, TypeVar

from msgspec import UNSET, UnsetType

from torchid.doctor.check import VERDICTS, Check, Verdict
from torchid.json_data import plain
from torchid.results.record import Joint, Part, Record, Rows
from torchid.robot.model import joint_list

if TYPE_CHECKING:
    from torchid.doctor.examine import Examination

_MINOR = ("torque side", "unseen joint sign")
"""No fault is hidden where these cannot be told: a mirrored arm has the same torques."""


def conclusion(examination: "Examination") -> str:
    """What is wrong, or that nothing is, and what this log cannot show."""
    said = [
        f"{word}: {', '.join(names)}"
        for word, verdict in (("wrong", "wrong"), ("to look at", "doubtful"))
        if (
            names := list(dict.fromkeys(c.name for c in examination.checks if c.verdict == verdict))
        )
    ]
    hidden = _hidden(examination)
    if not said and not hidden:
        return "Nothing speaks against this log."
    found = "; ".join(said) or "no fault found in what could be checked"
    text = f"{found[0].upper()}{found[1:]}."
    if not hidden:
        return text
    reasons = {c.evidence for c in hidden}
    reason = f" ({reasons.pop()})" if len(reasons) == 1 < len(hidden) else ""
    return f"{text} This log cannot tell: {', '.join(untold(examination))}{reason}."


def untold(examination: "Examination") -> tuple[str, ...]:
    """What may hide a fault since this log cannot tell."""
    kinds = [(c.name.removeprefix("unseen "), c) for c in _hidden(examination)]
    return tuple(
        kind if kind == c.name else f"{kind} of {joint_list(c.joints)}" for kind, c in kinds
    )


def _hidden(examination: "Examination") -> list[Check]:
    return [c for c in examination.checks if c.verdict == "cannot tell" and c.name not in _MINOR]


class Choosable(Part, frozen=True):
    """One of several explanations, and what to do with it."""

    name: str
    fix: str


class CheckRecord(Part, frozen=True, kw_only=True):
    """A verdict with its evidence; see torchid.doctor.check.Check.

    `applicable`: whether its repairs wait for no choice.
    """

    name: str
    verdict: Verdict
    joints: tuple[Joint, ...]
    estimate: float | tuple[float | None, ...] | None
    interval: tuple[float | tuple[float | None, ...] | None, ...] | None
    unit: str
    evidence: str
    fix: str | None
    applicable: bool
    choices: tuple[Choosable, ...]
    chosen: str | None

    @property
    def undecided(self) -> bool:
        """Whether somebody has to choose."""
        return bool(self.choices) and self.chosen is None


_C = TypeVar("_C", Check, CheckRecord)


class Examined(Generic[_C]):
    """Checks of a log, made just now or read back."""

    __slots__ = ()

    if TYPE_CHECKING:

        @property
        def checks(self) -> tuple[_C, ...]:
            """In the order in which they were made."""

    @property
    def applied(self) -> tuple[_C, ...]:
        """Checks whose repairs are applied: those before the first that leaves a choice, since
        what comes after rests on it."""
        return tuple(itertools.takewhile(lambda c: not c.undecided, self.checks))

    @property
    def undecided(self) -> tuple[_C, ...]:
        """Checks that leave a choice between explanations that are equally good."""
        return tuple(c for c in self.checks if c.undecided)

    def by_verdict(self) -> list[_C]:
        """The checks, wrong ones first."""
        return sorted(self.checks, key=lambda c: VERDICTS.index(c.verdict))


class DoctorRecord(
    Examined[CheckRecord], Record, frozen=True, kw_only=True, tag="torchid.doctor/1"
):
    """An examination as its JSON has it.

    Attributes:
        robot, log: what was examined.
        conclusion: in a sentence or two.
        silent: whether nothing is wrong or doubtful.
        untold: what may hide a fault since this log cannot tell.
        checks: in the order in which they were made.
        repairs: what would mend the log.
        columns: what `--columns` must be to read it mended, where that can be said.
        seed: from a command.
    """

    robot: str
    log: str
    conclusion: str
    silent: bool
    untold: tuple[str, ...]
    checks: tuple[CheckRecord, ...]
    repairs: tuple[str, ...]
    columns: str | None = None
    seed: int | UnsetType = UNSET

    def __repr__(self) -> str:
        return f"DoctorRecord('{self.robot}': {self.conclusion})"

    @property
    def table(self) -> Rows[CheckRecord]:
        """The checks."""
        return Rows(self.checks)


def record(examination: "Examination", columns: str | None = None) -> DoctorRecord:
    """The examination as the JSON has it.

    Args:
        examination: of a log.
        columns: what `--columns` must be to read it mended, where that can be said.
    """
    return DoctorRecord(
        robot=examination.robot.name,
        log=examination.log.source,
        conclusion=conclusion(examination),
        silent=examination.silent,
        untold=untold(examination),
        checks=tuple(
            CheckRecord.of(
                check,
                estimate=plain(check.estimate) if check.estimate is not None else None,
                interval=plain(check.interval) if check.interval is not None else None,
                applicable=check in examination.applied and bool(check.repairs),
            )
            for check in examination.checks
        ),
        repairs=tuple(str(repair) for repair in examination.repairs),
        columns=columns,
    )
