"""From a simulator and any log of the real arm to a diagnosis: what the log measured decides which
error is explained (see `torchid.design.sensor`)."""

import math
from dataclasses import fields, replace
from statistics import median
from time import monotonic

from threadpoolctl import threadpool_limits

from torchid.design.motion import no_torque
from torchid.design.sensor import sensor_of
from torchid.doctor.first import Doubts, ask_first
from torchid.errors import TorchidError
from torchid.gap.describe.verdict import CHECK_FIRST
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.early import Watch
from torchid.gap.rows import LogRows, rows_of, source_of
from torchid.gap.settings import GapSettings
from torchid.gap.stacked import LEFT_OUT
from torchid.gap.torque import MUST, SEARCH, STAGES, diagnose_torque
from torchid.identification.logs import refuse_repeated
from torchid.identification.settings import require_between
from torchid.inputs import LogLike, RobotLike, as_log, as_robot
from torchid.log.model import Log
from torchid.parallel.pace import Pace
from torchid.parallel.workers import Progress
from torchid.position.diagnose import MUST as MUST_OF_SERVOS
from torchid.position.diagnose import STAGES as SERVO_STAGES
from torchid.position.diagnose import diagnose_positions
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.nominal import nominal_servos, servos_as_given, sheets_of, types_of
from torchid.results.answer import Diagnosis, Stopped
from torchid.robot.model import Robot
from torchid.statistics.criteria import OTHER_UNIT

OF_POSITIONS = ("parameters", "worthwhile", "seed")
"""Settings that logs of commands and positions have a use for."""


def diagnose(
    robot: RobotLike,
    log: LogLike,
    *,
    held_out: LogLike | None = None,
    settings: GapSettings | None = None,
    servo: str | None = None,
    force: bool = False,
    progress: Progress | None = None,
    watch: Watch | None = None,
    before: LogLike | None = None,
    rows: bool = True,
    time: float | None = None,
) -> Diagnosis:
    """Where the simulator disagrees with the arm, which effects cause it, how far they close it.

    Args:
        robot: the simulator: nominal parameters and effects. With torques and without parameters
            they are fitted first, together with `settings.background`; with positions alone links
            without masses are taken for rods.
        log: trajectories of the real arm: torques or currents; or commanded and measured positions.
        held_out: trajectories that take part in no choice. If None, every trajectory (or stretch)
            is left out in turn.
        settings: how; defaults if None. Of logs of positions whether
            `parameters` are `trusted`, `worthwhile` and the seed have a meaning.
        servo: what the servos are said to be, for logs of positions: `STS3215`, `kp=12`; shown
            beside what is found.
        force: diagnose a log that the doctor's decisive checks say is wrong (order or sign of
            joints, units, lag, a run with a load of its own), and say so first.
        progress: called with (stage, done, total).
        watch: called with an `Answer` of status `searching` whenever more is known: first of the
            gap alone. Its errors are of data that were fitted.
        before: an earlier log of the arm, with torques: each cause is then new since that log, or
            in both; base parameters and the model's own effects are fitted to both. If None, the
            log that the model's own file names. It is asked the doctor's first questions, too; one
            in which nothing moves, or whose torque is in another unit or of another robot, is
            left out, and so is the model's own where the model does not explain it: that is the
            first of the warnings.
        rows: whether that file is read (MODEL.rows.npz, as `--save-model` writes it).
        time: in which the answer is to be there [s], reading the log included: what is not looked
            at then is said, and is in `stopped_after`. What no answer goes without (reading and
            checking the log, judging what was found) may take longer. None: as long as it takes.

    Returns:
        A `TorqueDiagnosis` [N m; N] or a `PositionDiagnosis` [mrad]: `answer` is the same for both.

    Raises:
        WrongLogError: a decisive check of `torchid.doctor.first` says that a log is wrong.
        LogError: logs that do not fit the robot or cannot be used.
        RobotError: the file of the model's log is another one than the model was written with.
        TorchidError: settings, a servo or an earlier log that the log has no use for, or no time.

    >>> import torch, torchid
    >>> robot = torchid.load_robot("3r")
    >>> motion = torchid.excite(robot, duration=8.0, restarts=1, iterations=0).log()
    >>> friction = {"effect": "viscous_friction", "joint": 2, "Fv": 0.5}
    >>> log = torchid.simulate(robot, motion, effects=[friction])
    >>> settings = GapSettings(effects=("viscous_friction",))
    >>> [(c.effect, c.joints) for c in diagnose(robot, log, settings=settings).answer.causes]
    [('viscous_friction', (1,))]
    """
    begun = monotonic()
    if time is not None:
        require_between("the time", time, 0.0, math.inf, "seconds")
    robot = as_robot(robot)
    log = as_log(log, robot)
    held_out = None if held_out is None else as_log(held_out, robot)
    torques = sensor_of(log, robot) != "position"
    if torques and servo is not None:
        raise TorchidError(
            "`servo=...` is for logs of commands and positions.", got=f"{log.label}: torques"
        )
    if not torques and before is not None:
        raise TorchidError(
            "`before=...` is for logs of torques.", got=f"{log.label}: commands and positions"
        )
    earlier, missing = earlier_log(robot, before, log, rows=rows and torques)
    if torques:
        pace = Pace(progress, STAGES, SEARCH, MUST, time, begun=begun)
    else:
        pace = Pace(progress, SERVO_STAGES, (), MUST_OF_SERVOS, time, begun=begun)
    pace("checking the log")
    # Several threads of BLAS make small matrices many times slower.
    with threadpool_limits(1, "blas"):
        doubts = ask_first(robot, log, force=force)
        # What speaks against a held-out log is said, and changes nothing of the answer.
        of_held_out = () if held_out is None else ask_first(robot, held_out, force=force).warnings
        of_earlier = ""
        if isinstance(earlier, Log):
            earlier, missing, of_earlier = earlier_asked(robot, earlier, doubts, force)
        handed = [log]  # a long log is let go as soon as it is prepared
        del log
        found: TorqueDiagnosis | PositionDiagnosis
        if torques:
            found = diagnose_torque(
                robot, handed.pop(), held_out=held_out, settings=settings, pace=pace,
                watch=watch, force=force, before=earlier,
            )  # fmt: skip
        else:
            found = _of_positions(robot, handed.pop(), held_out, settings, servo, pace, watch)
    answer = found.answer
    less = answer.less
    if isinstance(found, TorqueDiagnosis) and found.how_far.left_out is not None:
        less = found.how_far.left_out.less
    # 0.9: share of the error that a diagnosis takes away where it has answered what was doubted
    settled = answer.status in ("no_gap", "negligible") or less >= 0.9
    text = "" if settled and not doubts.wrong else doubts.short or doubts.foreign
    text = text or of_earlier
    # What the doctor has decided is said once.
    told = [w for w in found.warnings if not (doubts.foreign and w.startswith(CHECK_FIRST))]
    # That an earlier log is left out is said before all else.
    told = sorted(
        (*missing, *doubts.warnings, *of_held_out, *told),
        key=lambda w: not w.startswith(LEFT_OUT),
    )
    found = replace(found, doubt=text, warnings=tuple(told))
    if pace.stopped_after is not None:
        stopped = Stopped(pace.stopped_after, pace.left_out)
        found = replace(found, stopped_after=stopped, warnings=(str(stopped), *found.warnings))
    mark = found.answer.unconfirmed
    if not mark or not isinstance(found, TorqueDiagnosis):
        return found
    return replace(found, corrected=replace(found.corrected, warnings=(mark,)))


def earlier_log(
    robot: Robot, before: LogLike | None, log: Log, *, rows: bool = True
) -> tuple[Log | LogRows | None, tuple[str, ...]]:
    """The log that another is held against, and a warning where the model's own is missing.

    Args:
        robot: the simulator.
        before: that log, if it is given.
        log: that is asked.
        rows: whether that of the model's own file is read.

    Raises:
        LogError: the earlier log is the one that is asked, or has no torque.
        RobotError: as `LogRows.read`.
    """
    if before is not None:
        earlier = as_log(before, robot)
        if sensor_of(earlier, robot) == "position":
            raise no_torque(earlier)
        refuse_repeated(log, earlier, "is in the earlier log and also in the one that is asked")
        return earlier, ()
    found = rows_of(robot) if rows else None
    return (None, (found,)) if isinstance(found, str) else (found, ())


def earlier_asked(
    robot: Robot, earlier: Log, asked: Doubts, force: bool
) -> tuple[Log | None, tuple[str, ...], str]:
    """An earlier log where it can be held against the one that is asked, what the doctor doubts of
    it, and what a headline says of one that is wrong and forced. It is none where its torque
    follows no model of the robot, or is in another unit; the model that both are held against may
    be of any size.

    Args:
        robot, earlier: to be examined.
        asked: what speaks against the log that is asked.
        force: whether a wrong log is a doubt, and no error.

    Raises:
        WrongLogError: a decisive check says that the earlier log is wrong.
    """
    own = ask_first(robot, earlier, force=force)
    headline = f"Earlier log: {own.short}" if own.wrong else ""
    ratios = [own.sizes[j] / asked.sizes[j] for j in own.sizes.keys() & asked.sizes.keys()]
    why = own.foreign if not asked.foreign else ""
    if ratios and abs(math.log(ratio := median(ratios))) > math.log(OTHER_UNIT):
        why = f"Its torque is {ratio:.3g} times that of the log that is asked, on like motion."
    source = source_of(earlier.names)
    if why:
        return None, (f"{LEFT_OUT} {source}. {why}",), headline
    about = (f"Earlier log in doubt: {source}. {own.short}",) if own.short else ()
    return earlier, about, headline


def _of_positions(
    robot: Robot,
    log: Log,
    held_out: Log | None,
    settings: GapSettings | None,
    servo: str | None,
    pace: Pace,
    watch: Watch | None,
) -> PositionDiagnosis:
    """The diagnosis of logs of commands and positions."""
    settings, default = settings or GapSettings(), GapSettings()
    changed = [
        f.name
        for f in fields(settings)
        if f.name not in OF_POSITIONS and getattr(settings, f.name) != getattr(default, f.name)
    ]
    if changed:
        raise TorchidError(
            "these logs have commands and positions and no torques.",
            got=", ".join(f"`{name}=...`" for name in changed),
            expected=f"of the options on how to search {', '.join(OF_POSITIONS)} alone",
        )
    nominal, notes = nominal_servos(robot, servo), tuple[str, ...]()
    if not nominal and log.servos:
        nominal = nominal_servos(robot, log.servos)
        notes = (
            f"{log.label} was recorded from servos {log.servos}, as `servo=...` says it; "
            "`servo=kp=unknown` is for servos of no known type",
        )
    found = diagnose_positions(
        robot, log, held_out=held_out, trusted=settings.parameters == "trusted",
        types=types_of(nominal), sheets=sheets_of(nominal), start=servos_as_given(robot, nominal),
        worthwhile=settings.worthwhile, pace=pace, watch=watch,
    )  # fmt: skip
    return replace(found, nominal=nominal, warnings=(*notes, *found.warnings))
