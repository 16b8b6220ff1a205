"""The next motion for a result: what it leaves in doubt, settled by driving."""

from dataclasses import replace
from pathlib import Path

import torch

from torchid.errors import TorchidError
from torchid.excitation.clearance import Clearance
from torchid.excitation.design import Goal, InformedDesign, design_for, excite
from torchid.excitation.settings import DURATION, HARMONICS, RESTARTS, USAGE
from torchid.excitation.torque import CORRECTED, TorqueLimits
from torchid.gap.record import GapRecord
from torchid.identification.record import IdentificationRecord
from torchid.identification.result import Identification
from torchid.identification.values import Prior, nominal_base, plain_effects, prior_of
from torchid.inputs import RobotLike, as_robot
from torchid.next_motion.ambiguity import open_questions, refuse_another, rivals
from torchid.next_motion.separating_motion import Separation, design_separation
from torchid.parallel.workers import Progress, stage
from torchid.position.next_motion import RATE, NextCommands, next_commands
from torchid.position.record import PositionRecord
from torchid.results.answer import Diagnosis
from torchid.results.files import read
from torchid.robot.model import Robot

Asking = GapRecord | IdentificationRecord


def read_asking(path: str | Path) -> Asking | PositionRecord:
    """A result that a motion can be designed for; of commands and positions, by `next_commands`.

    Raises:
        TorchidError: another kind of file, or a fault in it, with its place.
    """
    record = read(
        path,
        ("torchid.identification/1", "torchid.gap/2", "torchid.position_gap/1"),
        "a result that a motion can be designed for",
        "torchid identify or torchid gap ROBOT LOG... --json FILE",
    )
    assert isinstance(record, Asking | PositionRecord)
    return record


def hides_cause(record: GapRecord) -> bool:
    """Whether a diagnosis names nothing because of what its model left open of itself."""
    known = record.knowledge
    return not record.which and known is not None and any(j.hides for j in known.joints)


def prior_of_diagnosis(record: GapRecord, robot: Robot, source: str) -> Prior:
    """What is known of a diagnosis' corrected model, for the design of the next motion, whose
    torque is taken to leave as much as this log's, independent from one sample of the band to the
    next.

    Raises:
        TorchidError: another robot's, or the record of an older torchid.
    """
    model = record.corrected
    if model.knowledge is None:
        raise TorchidError(
            f"'{source}' does not say how sure the corrected model is.",
            hint="write it again: torchid gap ROBOT LOG... --json FILE",
        )
    refuse_another(source, model, robot)
    nominal = nominal_base(model)
    assert nominal.covariance is not None
    assert nominal.factor is not None
    root = nominal.factor[:-1, :-1]
    remainder = torch.tensor([j.after for j in record.how_far.per_joint], dtype=torch.float64)
    return Prior(
        nominal.base,
        plain_effects(nominal.effects, "the design of the next motion"),
        nominal.values,
        nominal.known,
        nominal.covariance.diagonal().clamp(min=0).sqrt(),
        root.T @ root,
        torch.ones_like(nominal.values),
        torch.diag(1 / remainder.clamp(min=1e-6 * float(remainder.max()))),
        2 * record.band_hz,
    )


def excite_for(
    result: str | Path | Diagnosis | Identification | Asking | PositionRecord,
    robot: RobotLike | None = None,
    *,
    goal: Goal | None = None,
    duration: float = DURATION,
    rate: float = RATE,
    harmonics: int = HARMONICS,
    restarts: int = RESTARTS,
    usage: float = USAGE,
    seed: int = 0,
    clearance: Clearance | None = None,
    progress: Progress | None = None,
) -> InformedDesign | Separation | NextCommands:
    """The motion that settles most of what a result leaves in doubt.

    Args:
        result: an identification, whose least known parameters it fixes, or a diagnosis: what that
            cannot tell apart it separates, or else it shows what the log could not have shown.
            Where its model left so much open that a cause could hide in it, the motion closes that.
            Of a diagnosis of positions the commands that make its servos' numbers known. Or the
            file of one.
        robot: with the limits to keep; the one that the result records if None.
        goal: `a_optimal` for the least known parameters (the default of an identification, and of
            a diagnosis that names nothing because its model left too much open), or `d_optimal` for
            all; of a diagnosis, of its corrected model.
        duration: [s].
        rate: of the commands of servos [Hz].
        harmonics: of the Fourier series.
        restarts: of the design, and what the search for a separation tries goes with them.
        usage: share of the limits that may be used.
        seed: of the random starts.
        clearance: distances to keep.
        progress: called with (stage, done, total).

    Returns:
        The motion, what it does, and a plain one to compare with.

    Raises:
        RobotError: the limits are incomplete, or no motion keeps them.
        TorchidError: a result of another robot, or one that leaves nothing to a motion.

    >>> import torchid
    >>> robot = torchid.load_robot("3r")
    >>> motion = torchid.excite(robot, duration=8.0, restarts=1, iterations=0).log()
    >>> settings = torchid.Settings(effects=(), cutoff=10.0)
    >>> found = torchid.identify(robot, torchid.simulate(robot, motion), settings=settings)
    >>> made = excite_for(found, duration=6.0, restarts=1)  # the same as found.next_motion(...)
    >>> made.shrinks(made.after) < 1  # standard deviations, to what they were
    True
    """
    robot = None if robot is None else as_robot(robot)
    source = str(result) if isinstance(result, str | Path) else "the result"
    record = read_asking(result) if isinstance(result, str | Path) else result.record
    assert isinstance(record, Asking | PositionRecord)
    robot = robot or (None if isinstance(record, PositionRecord) else record.model)
    if robot is None:
        raise TorchidError(f"'{source}' does not record its robot: `robot=...`.")
    if isinstance(record, PositionRecord):
        return next_commands(
            record, robot, seconds=duration, rate=rate, usage=usage, clearance=clearance,
            progress=progress,
        )  # fmt: skip
    robot.require_fixed_base("the design of motions")
    if isinstance(record, IdentificationRecord) or goal is not None or hides_cause(record):
        if isinstance(record, IdentificationRecord):
            prior = prior_of(record, robot, source)
        else:
            prior = prior_of_diagnosis(record, robot, source)
        return design_for(
            robot, prior, seed=seed, goal=goal or "a_optimal", restarts=restarts, usage=usage,
            harmonics=harmonics, duration=duration, clearance=clearance,
            progress=stage(progress, "designing"),
        )  # fmt: skip
    questions = open_questions(record, robot, source)
    limits = TorqueLimits.of(questions.setting.robot, questions.setting.given, CORRECTED, usage)
    plain = excite(
        robot, effects=(), seed=seed, restarts=restarts, torque=limits, usage=usage,
        harmonics=harmonics, duration=duration, clearance=clearance,
        progress=stage(progress, "a plain motion to compare with"),
    ).trajectory  # fmt: skip
    # 75: trajectories that the search for a separating motion tries a restart
    made = design_separation(
        questions.setting, rivals(questions, plain), plain, seed=seed, usage=usage,
        clearance=clearance, evaluations=75 * restarts, progress=stage(progress, "separating"),
    )  # fmt: skip
    return replace(made, kind=questions.kind, notes=questions.notes)
