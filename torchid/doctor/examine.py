"""The whole examination: the table of faults, one after the other, each on the log as the ones
before have mended it; then what torque tells of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from torchid.doctor import clock, motion, torque, velocity
from torchid.doctor.case import Case
from torchid.doctor.check import Check, judged
from torchid.doctor.estimates import check_gravity, check_lag, lag_of
from torchid.doctor.faults import UNTOLD, confirmed, denied_faults, fault_checks, unseen_faults
from torchid.doctor.hypothesis import Hypothesis, Judge
from torchid.doctor.kind import check_kind, holds_no_gravity, weightless
from torchid.doctor.number_format import check_number_format
from torchid.doctor.record import CheckRecord, DoctorRecord, Examined
from torchid.doctor.repair import Repair, repaired
from torchid.doctor.runs import check_runs
from torchid.doctor.samples import samples
from torchid.doctor.search import Search, rms, search
from torchid.doctor.size import check_nominal, check_size
from torchid.errors import LogError
from torchid.feasibility.units import unit_findings
from torchid.inputs import LogLike, RobotLike, as_log, as_robot
from torchid.json_data import plain
from torchid.log.checks import check_joints
from torchid.log.model import Log
from torchid.results.record import Result
from torchid.robot.model import Robot, joint_list
from torchid.statistics.criteria import CLEAR_GAIN

LEAST_SAMPLES = 10
"""Of the longest trajectory: fewer have no usual step, nor a usual change."""
FILE = "masses of the file"
"""Check of the robot's nominal parameters alone."""
COUNTS = "positions are in counts or another unit that is not known"
_MINOR = "unseen joint sign"
"""No fault is hidden where it cannot be told: a mirrored arm has the same torques."""


SIGNALS: tuple[Callable[[Case], Check | Sequence[Check]], ...] = (
    clock.check_values,
    check_number_format,
    clock.check_clock,
    clock.check_held,
    clock.check_time_unit,
    motion.check_jumps,
    clock.check_stamps,
    clock.check_dropouts,
    # Before the positions alone, which would take their commands with them.
    velocity.check_command_unit,
    motion.check_position_unit,
    motion.check_zeros,
    # Before the velocities, which would be taken for what is wrong.
    velocity.check_channel_units,
    velocity.check_velocity,
    motion.check_standstill,
    torque.check_torque,
    torque.check_silent_runs,
    torque.check_channels,
    velocity.check_commands,
    torque.check_saturation,
    torque.check_resolution,
    torque.check_content,
)
"""The table of faults that need no dynamics to be seen, each with its test and repair, and with its
words in checks.yaml. Each is looked for in the log as those before mend it; a test that does not
apply says nothing. The faults that torque tells are `torchid.doctor.moves.FAULTS`."""
MODEL_CHECKS = (
    "torque explained", "joint order", "torque sign", "position sign", "gain of a joint", "gravity",
    "lag", "torque unit",
)  # fmt: skip
"""What cannot be told without a model's fit."""


@dataclass(frozen=True, eq=False)
class Examination(Examined[Check], Result):
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

    def __repr__(self) -> str:
        return f"Examination('{self.robot.name}': {conclusion(self)})"

    @cached_property
    def record(self) -> DoctorRecord:
        """As the JSON has it."""
        return record(self)

    @property
    def repairs(self) -> tuple[Repair, ...]:
        """Everything that would mend the log and is not for somebody to choose, in order."""
        return tuple(r for c in self.applied for r in c.repairs)

    @property
    def waiting(self) -> int:
        """Number of checks whose repairs wait for such a choice."""
        later = self.checks[len(self.applied) :]
        return sum(bool(c.repairs) and not c.undecided for c in later)

    @property
    def silent(self) -> bool:
        """Whether nothing is wrong or doubtful."""
        return all(c.verdict in ("fine", "cannot tell") for c in self.checks)

    def mended(self) -> Log:
        """A copy of the log with the repairs applied."""
        return repaired(self.log, self.repairs)


def examine(
    robot: RobotLike, log: LogLike, fixes: Sequence[str] = (), *, first: bool = False
) -> Examination:
    """Examine a log before anything is fitted to it.

    Args:
        robot: kinematics and gravity; nominal parameters and limits help, and are not needed.
        log: as it was read; other commands may refuse it.
        fixes: names of the choices to take where explanations are equally good.
        first: only what a diagnosis asks first, in half the time: order, signs, units, lag, and
            runs that contradict each other.

    Raises:
        LogError: another number of joints than the robot's, too few samples, no usable row, or a
            fix that is not among the choices.

    >>> import numpy as np, torchid
    >>> robot = torchid.load_robot("3r")
    >>> t = np.arange(1500) / 50
    >>> angle = t[:, None] * np.array([0.9, 1.3, 1.7])
    >>> q, dq, ddq = np.sin(angle), 1.3 * np.cos(angle), -1.69 * np.sin(angle)
    >>> log = torchid.Log(t, np.degrees(q), tau=torchid.inverse_dynamics(robot, q, dq, ddq))
    >>> found = examine(robot, log)
    >>> [check.name for check in found.applied if check.repairs]
    ['position unit']
    >>> bool((found.mended().q - torchid.Log(t, q).q).abs().max() < 1e-9)
    True
    """
    robot = as_robot(robot)
    log = as_log(log, robot, usable=False)
    robot.require_fixed_base("the log doctor")
    check_joints(log, robot.name, robot.n)
    longest = max(rows.stop - rows.start for rows in log.slices())
    if longest < LEAST_SAMPLES:
        raise LogError(
            f"log '{log.source}' is too short to be examined.",
            got=f"{longest} samples",
            expected=f"at least {LEAST_SAMPLES} in a trajectory",
        )
    case = _walked(Case(robot, log, fixes))
    by_bodies = by_torque(robot, log, case.checks)
    if by_bodies is not None:
        case = _walked(Case(robot, log, (*fixes, by_bodies)))
    # What a fit has made of the links is no mistake of a file.
    if robot.knowledge is None and (odd := unit_findings(robot)):
        text = "; ".join(finding.sentence for finding in odd)
        case = case.after(judged(FILE, "doubtful", text, fix="correct the robot's file"))
    if case.stopped:
        result = Examination(robot, log, case.checks)
    else:
        result = _with_model(replace(case, fixes=fixes), log, first)
    offered = [choice.name for c in result.checks for choice in c.choices]
    unknown = [name for name in fixes if name not in offered]
    if unknown:
        raise LogError(
            f"log '{result.log.source}': there is no such fix to choose.",
            got=", ".join(unknown),
            available=offered,
        )
    return result


def by_torque(robot: Robot, log: Log, checks: Sequence[Check]) -> str | None:
    """The name of the one choice between repairs of the motion with which bodies explain the
    torque clearly better than with any other; None where there is none, or nothing to choose."""
    place = next((k for k, c in enumerate(checks) if c.undecided), None)
    if place is None:
        return None
    before = repaired(log, [r for c in checks[:place] for r in c.repairs])
    losses = {}
    for choice in checks[place].choices:
        rows = samples(repaired(before, choice.repairs))
        if isinstance(rows, str):
            return None
        errors = rms(Judge(robot, rows).held_out(Hypothesis.literal(robot)))
        losses[choice.name] = float(np.log(errors).sum())
    best, second, *_ = sorted(losses, key=lambda name: losses[name])
    return best if losses[second] - losses[best] > CLEAR_GAIN else None


def signal_checks(robot: Robot, log: Log, fixes: Sequence[str] = ()) -> tuple[list[Check], Log]:
    """The checks that need no dynamics, and the log as they mend it."""
    case = _walked(Case(robot, log, fixes))
    return list(case.checks), case.log


def _walked(case: Case) -> Case:
    """The case with all checks of the table."""
    for check in SIGNALS:
        if not case.stopped:
            case = case.after(check(case))
    return case


def _with_model(case: Case, given: Log, first: bool) -> Examination:
    """All that is said of the log that was given: what the signals say, and what torque does."""
    robot, fixes, start = case.robot, case.fixes, Hypothesis.literal(case.robot)
    rows = COUNTS if case.counts else samples(case.log)
    if isinstance(rows, str):
        none = [judged(name, "cannot tell", rows) for name in MODEL_CHECKS]
        return Examination(robot, given, (*case.checks, *none))
    judge = Judge(robot, rows)
    searched = search(judge, start, fixes, first=first)
    lag = lag_of(judge, searched, first=first)
    # What currents without gains hold is asked when there are gains.
    kind = None if case.log.tau is None else check_kind(judge, searched.final.hypothesis)
    if kind is not None and not holds_no_gravity(kind):
        # Nothing else can be said of what is left once the model has been taken out.
        none = [judged(name, "cannot tell", "the torque is external") for name in MODEL_CHECKS]
        return Examination(robot, given, (*case.checks, kind, *none), searched, judge)
    if kind is not None:
        searched = search(judge, weightless(start), fixes)
        lag = lag_of(judge, searched, first=first)
    end, checks = searched.final.hypothesis, list(case.checks)
    if searched.explained:
        case = replace(
            case, log=repaired(case.log, [r for f in searched.faults for r in f.move.repairs])
        )
        # Positions beyond the limits may be another joint's, or of another sign.
        for k, check in enumerate(checks):
            if check.name == "zero of positions" and not check.repairs:
                checks[k : k + 1] = motion.check_zeros(case)
    turned = any(f.move.kind == "gravity" for f in searched.faults)
    # First: if it leaves a choice, the others wait.
    if kind is not None:
        checks.append(kind)
    elif turned or not first:
        checks.append(check_gravity(judge, searched, fixes))
    denied = denied_faults(judge, searched)
    checks += fault_checks(judge, searched, denied, fixes, case.checks)
    sized = confirmed(searched, denied)
    checks.append(check_lag(judge, searched, lag))
    if searched.explained or case.log.tau is None:
        checks.append(check_size(judge, case.log, sized, fixes))
    else:
        checks.append(judged("torque unit", "cannot tell", UNTOLD))
    checks += check_runs(judge, end) if searched.explained else ()
    if not first:
        checks += check_nominal(judge, case.log, sized)
        checks += unseen_faults(judge, searched)
    return Examination(robot, given, tuple(checks), searched, judge)


def record(examination: Examination, columns: str | None = None) -> DoctorRecord:
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
        untold=untold_checks(examination),
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


def conclusion(examination: Examination) -> str:
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
    summary = "; ".join(said) or "no fault found in what could be checked"
    text = f"{summary[0].upper()}{summary[1:]}."
    if not hidden:
        return text
    reasons = {c.evidence for c in hidden}
    reason = f" ({reasons.pop()})" if len(reasons) == 1 < len(hidden) else ""
    return f"{text} This log cannot tell: {', '.join(untold_checks(examination))}{reason}."


def untold_checks(examination: Examination) -> tuple[str, ...]:
    """What may hide a fault since this log cannot tell."""
    kinds = [(c.name.removeprefix("unseen "), c) for c in _hidden(examination)]
    return tuple(
        kind if kind == c.name else f"{kind} of {joint_list(c.joints)}" for kind, c in kinds
    )


def _hidden(examination: Examination) -> list[Check]:
    return [c for c in examination.checks if c.verdict == "cannot tell" and c.name != _MINOR]
