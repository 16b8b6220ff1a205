"""The whole examination: every check in turn, each on the log as the ones before have mended it."""

from dataclasses import dataclass

from torchid.doctor.check import VERDICTS, Check
from torchid.doctor.clock import (
    check_clock,
    check_dropouts,
    check_held,
    check_stamps,
    check_time_unit,
    check_values,
)
from torchid.doctor.content import check_excitation, check_side
from torchid.doctor.faults import fault_checks, unseen
from torchid.doctor.gravity import check_gravity
from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.doctor.lag import check_lag
from torchid.doctor.motion import (
    check_jumps,
    check_position_unit,
    check_standstill,
)
from torchid.doctor.repair import Repair, repaired
from torchid.doctor.samples import samples
from torchid.doctor.search import Search, search
from torchid.doctor.size import check_nominal, check_size
from torchid.doctor.torque import check_resolution, check_saturation, check_torque
from torchid.doctor.velocity import check_velocity
from torchid.errors import LogError
from torchid.log.model import Log
from torchid.robot.model import Robot

MODEL_CHECKS = (
    "torque explained", "joint order", "torque sign", "position sign", "gain of a joint", "gravity",
    "lag", "torque unit", "torque side", "excitation",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Examination:
    """What the doctor found.

    Attributes:
        robot, log: what was examined, as given.
        checks: in the order in which they were made.
        search: of the model checks, or None where they could not be made.
        judge: who made it.
    """

    robot: Robot
    log: Log
    checks: tuple[Check, ...]
    search: Search | None = None
    judge: Judge | None = None

    @property
    def repairs(self) -> tuple[Repair, ...]:
        """Everything that would mend the log, in order."""
        return tuple(r for c in self.checks for r in c.repairs)

    @property
    def silent(self) -> bool:
        """Whether nothing is wrong or doubtful."""
        return all(c.verdict in ("fine", "cannot tell") for c in self.checks)

    def mended(self) -> Log:
        """A copy of the log with everything applied that can be."""
        return repaired(self.log, self.repairs)

    def by_verdict(self) -> list[Check]:
        """The checks, wrong ones first."""
        return sorted(self.checks, key=lambda c: VERDICTS.index(c.verdict))


def examine(robot: Robot, log: Log) -> Examination:
    """Examine a log before anything is fitted to it.

    Args:
        robot: kinematics and gravity; nominal parameters and limits help, and are not needed.
        log: as it was read; other commands may refuse it.

    Raises:
        LogError: another number of joints than the robot's, or no usable row.
    """
    if log.n != robot.n:
        raise LogError(
            f"log '{log.source}' has another number of joints than robot '{robot.name}'.",
            got=f"{log.n} (q1..q{log.n})",
            expected=f"{robot.n} (q1..q{robot.n})",
        )
    if log.tau is None and log.current is not None and robot.drive_gain is not None:
        log = log.with_torque(robot.drive_gain)
    checks, now = signal_checks(robot, log)
    if any(c.name == "clock" and c.verdict == "wrong" and not c.repairs for c in checks):
        return Examination(robot, log, tuple(checks))
    return _with_model(robot, log, now, checks)


def signal_checks(robot: Robot, log: Log) -> tuple[list[Check], Log]:
    """The checks that need no dynamics, and the log as they mend it."""
    checks: list[Check] = []
    now = log

    def add(check: Check) -> None:
        nonlocal now
        checks.append(check)
        now = repaired(now, check.repairs)

    add(check_values(now))
    add(check_clock(now))
    if not checks[-1].repairs and checks[-1].verdict == "wrong":
        return checks, now
    add(check_held(now))
    add(check_time_unit(now))
    add(check_jumps(robot, now))
    add(check_stamps(now))
    add(check_dropouts(now))
    add(check_position_unit(robot, now))
    add(check_velocity(now))
    add(check_standstill(now))
    add(check_torque(now))
    if now.tau is not None or now.current is not None:
        add(check_saturation(now))
        add(check_resolution(now))
    return checks, now


def _with_model(robot: Robot, log: Log, now: Log, checks: list[Check]) -> Examination:
    rows = samples(now)
    if rows is None:
        why = "there is no torque, or no motion long enough"
        none = tuple(Check(name, "cannot tell", why) for name in MODEL_CHECKS)
        return Examination(robot, log, (*checks, *none))
    judge = Judge(robot, rows)
    found = search(judge, Hypothesis.literal(robot))
    end = found.final.hypothesis
    more = [
        *fault_checks(judge, found),
        check_gravity(judge, found),
        check_lag(judge, found),
        check_size(judge, robot, now, end),
        *check_nominal(judge, robot, now, end),
        check_side(judge, found),
        check_excitation(judge, end, now),
        *unseen(judge, found),
    ]
    return Examination(robot, log, (*checks, *more), found, judge)
