"""An examination as its JSON has it: the schema torchid.doctor/1."""

import itertools
from typing import TYPE_CHECKING, Generic, Literal, TypeVar

from msgspec import UNSET, UnsetType

from torchid.results.record import Joint, Part, Record, Rows

Verdict = Literal["fine", "wrong", "doubtful", "cannot tell"]
VERDICTS: tuple[Verdict, ...] = ("wrong", "doubtful", "cannot tell", "fine")
"""In the order in which they are shown."""


class Choosable(Part, frozen=True):
    """One of several explanations that this log cannot tell apart.

    Attributes:
        name: by which it is chosen.
        fix: what to do, for people.
    """

    name: str
    fix: str


class CheckRecord(Part, frozen=True):
    """A verdict with its evidence.

    Attributes:
        name: of the check.
        verdict: fine, wrong (clearly), doubtful (look at it), cannot tell (this log cannot say).
        joints: from 0; empty where it is about the whole log.
        estimate: what was measured, one number or one a joint of `joints`.
        interval: of the estimate (95 %), (low, high) or one pair a joint.
        unit: of the estimate.
        evidence: in words and numbers.
        fix: what to do, for people; None where nothing.
        applicable: whether it has repairs that wait for no choice.
        choices: explanations that are equally good, where there are several; the checks that come
            after go on with the first, or with the chosen one. A single one is not sure enough to
            be applied unless it is chosen.
        chosen: name of the one that was chosen, by somebody or because bodies explain the torque
            clearly better with it.
    """

    name: str
    verdict: Verdict
    joints: tuple[Joint, ...] = ()
    estimate: float | tuple[float | None, ...] | None = None
    interval: tuple[float | tuple[float | None, ...] | None, ...] | None = None
    unit: str = ""
    evidence: str = ""
    fix: str | None = None
    applicable: bool = False
    choices: tuple[Choosable, ...] = ()
    chosen: str | None = None

    @property
    def undecided(self) -> bool:
        """Whether somebody has to choose."""
        return len(self.choices) > 1 and self.chosen is None


_C = TypeVar("_C", bound=CheckRecord)


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
