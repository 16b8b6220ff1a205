"""A simulator's log against the arm's: where they differ, how the simulator is set up otherwise,
and which effects only one of them has.

    aligned -> where -> faults of the set-up, one after the other -> effects of either side

Effects are causes that are new in one log beside the other, both fitted as one problem, as of an
earlier log and a later one: more of an effect, less of it, or one that only one of both has. They
are not sought while the set-up is at fault, whose traces would look like effects.

Logs without torque, of commands and positions alone, have servos that are compared in the same way.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch

from torchid.design.segments import EDGE, Segment
from torchid.doctor.first import ask_first
from torchid.effects.motion import Motion
from torchid.errors import TorchidError
from torchid.gap.describe.noise import white_level
from torchid.gap.describe.where import where
from torchid.gap.diagnosis import Trace
from torchid.gap.record import NoiseFloor
from torchid.gap.settings import GapSettings
from torchid.inputs import LogLike, RobotLike, as_log, as_robot
from torchid.log.checks import check_finite
from torchid.log.filtering import central_difference, low_passed
from torchid.log.model import Log
from torchid.pair.align import AlignedTrajectory, aligned_trajectories
from torchid.pair.effects import Progress, effects_of
from torchid.pair.faults import set_up_faults
from torchid.pair.record import Difference, Fault, OneSided, PairRecord, ServoDifference, WherePair
from torchid.pair.servos import numbers_of, servos_of
from torchid.results.answer import Diagnosis
from torchid.results.cause import Cause
from torchid.results.record import Result
from torchid.robot.model import Robot, joint_list
from torchid.typing import Float, Tensor

BAND = 20.0
"""Of what is compared [Hz]."""

NUMBERED = {"joint_order", "sign", "time_step"}
"""Faults with which no joint's motion is its own command's."""


@dataclass(frozen=True, eq=False)
class PairDiagnosis(Result):
    """What a simulator's log and the arm's are told to differ by.

    Attributes:
        found: as the JSON has it.
        robot: the model, or None.
        of_simulator, of_arm: the diagnoses of either log beside the other; None where they were not
            asked for.
    """

    found: PairRecord
    robot: Robot | None
    of_simulator: Diagnosis | None = None
    of_arm: Diagnosis | None = None

    def __repr__(self) -> str:
        return repr(self.found).replace("PairRecord", "PairDiagnosis", 1)

    @cached_property
    def record(self) -> PairRecord:
        """As the JSON has it."""
        return self.found

    def write_corrected(self, path: str | Path, *, rows: bool = True) -> None:
        """Write the simulator's robot with what the arm has otherwise, as a .yaml.

        Raises:
            TorchidError: no effects were sought, or the file cannot be written.
        """
        if self.of_arm is None:
            raise TorchidError(
                "there is no corrected model: effects of simulator and arm were not compared.",
                got="; ".join(self.found.warnings),
            )
        self.of_arm.write_corrected(path, rows=rows)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Of the set-up, in the order in which to mend them."""
        return self.found.faults

    @property
    def which(self) -> tuple[OneSided, ...]:
        """Effects that one of both has more of."""
        return self.found.which or ()

    @property
    def servos(self) -> tuple[ServoDifference, ...]:
        """Parameters of both sides' servos, where logs have commands and positions alone."""
        return self.found.servos or ()


def compare_pair(
    simulated: LogLike,
    real: LogLike,
    robot: RobotLike | None = None,
    *,
    settings: GapSettings | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> PairDiagnosis:
    """Hold a simulator's log against the arm's.

    Args:
        simulated, real: of the same commands, trajectory by trajectory; u says what was commanded.
        robot: the model that the simulator was made from; without it effects are not named.
        settings: of the search for effects.
        force: name effects of an arm's log that the doctor's decisive checks say is wrong.
        progress: called with (stage, done, total).

    Raises:
        WrongLogError: both logs agree, and a decisive check of `torchid.doctor.first` says that the
            arm's is wrong; or either is, of which servos are compared.
        LogError: logs of other arms or commands, or that cannot be used.

    >>> import torch, torchid
    >>> robot = torchid.load_robot("3r")
    >>> motion = torchid.excite(robot, duration=6.0, restarts=1, iterations=5).log()
    >>> simulated = torchid.simulate(robot, motion)
    >>> turned = simulated.tau * torch.tensor([1.0, -1.0, 1.0])
    >>> found = compare_pair(simulated.replace(tau=turned), simulated)
    >>> [(f.fault, f.joints) for f in found.faults]
    [('sign', (1,))]
    """
    robot = None if robot is None else as_robot(robot)
    simulated, real = as_log(simulated, robot), as_log(real, robot)
    for log in (simulated, real):
        check_finite(log)
    settings = settings or GapSettings()
    say = progress or (lambda stage, done, total: None)
    if robot is not None:
        _check_model(robot, simulated, real)
    say("aligning", 0, 1)
    both = aligned_trajectories(simulated, real)
    say("locating", 0, 1)
    torques, commands = (all(name in b.simulated for b in both) for name in ("tau", "u"))
    torque, floor = _where(both, "tau", settings.seed) if torques else (None, None)
    position, _ = _where(both, "q", settings.seed)
    say("looking at the set-up", 0, 1)
    faults = set_up_faults(robot, simulated, real, both)
    warnings: list[str] = [_BY_MOTION] if both[0].clock.by == "q" else []
    which: tuple[OneSided, ...] | None = None
    lacking = tuple[Cause, ...]()
    servos: tuple[ServoDifference, ...] | None = None
    diagnoses: tuple[Diagnosis | None, Diagnosis | None] = (None, None)
    if not torques:
        own = robot is not None and commands
        warnings.append(_NO_TORQUES + (_OF_SERVOS if own else ""))
    if not torques and commands and robot and not NUMBERED & {f.fault for f in faults}:
        say("servos", 0, 1)
        for log in (simulated, real):
            warnings += ask_first(robot, log, force=force).sentences
        which, lacking, sides = servos_of(robot, simulated, real, say)
        diagnoses, servos = sides, tuple(numbers_of(sides, which))
        warnings += [w for side in sides for w in side.warnings]
        shares = sorted({one.joint for one in servos if one.per_kp})
        warnings += [_RATIO.format(joint_list(shares))] if shares else []
    if faults or robot is None:
        warnings.append(_MEND_FIRST if faults else "without a ROBOT no effect can be named")
    elif torques:
        say("checking the log", 0, 1)
        warnings += ask_first(robot, real, force=force).sentences
        which, lacking, diagnoses = effects_of(robot, simulated, real, settings, say)
    say("done", 1, 1)
    record = PairRecord(
        robot=None if robot is None else robot.name,
        simulated=simulated.source or "simulated",
        real=real.source or "real",
        clocks=tuple(b.clock for b in both),
        torque=torque,
        position=position,
        torque_noise=floor,
        faults=faults,
        which=which,
        both=lacking,
        servos=servos,
        warnings=tuple(dict.fromkeys([*simulated.warnings, *real.warnings, *warnings])),
    )
    return PairDiagnosis(record, robot, *diagnoses)


_BY_MOTION = (
    "not both logs hold commands u1.., so they are aligned by their motion: a servo that follows "
    "badly looks like another command"
)
_NO_TORQUES = "not both logs hold torques, so only motion is compared"
_OF_SERVOS = ", and the servos that commands and positions show"
_RATIO = (
    "{}: the motions leave a common factor of all torques open, so torques are compared as shares "
    "of the gain kp"
)
_MEND_FIRST = "effects were not sought: mend the set-up first, whose traces look like effects"


def _check_model(robot: Robot, simulated: Log, real: Log) -> None:
    robot.require_fixed_base("a comparison of two logs")
    for log, whose in ((simulated, "simulator's"), (real, "arm's")):
        if log.n != robot.n:
            raise TorchidError(
                f"the {whose} log is of another arm than the model.",
                got=f"{log.n} joints",
                expected=f"{robot.n} as '{robot.name}'",
            )


def _where(both: Sequence[AlignedTrajectory], name: str, seed: int) -> tuple[WherePair, NoiseFloor]:
    """Where a signal differs, on the common clock, below a band that the slower log holds."""
    band = min(BAND, *(0.2 / b.dt for b in both))
    traces, segments, left = [], [], []
    clock = 0.0
    for b in both:
        rate = 1 / b.dt

        def low(x: Float[Tensor, "T n"], rate: float = rate) -> Float[Tensor, "T n"]:
            return low_passed(x.T, rate, band).T.contiguous()

        q = low(b.real["q"])
        dq = central_difference(q.T, rate).T
        ddq = central_difference(dq.T, rate).T
        t = torch.arange(len(q), dtype=torch.float64) * b.dt + clock
        clock = float(t[-1]) + 1.0
        motion = Motion(q, dq.contiguous(), ddq.contiguous(), t=t)
        edge = int(EDGE * rate / band)
        valid = torch.zeros(len(q), dtype=torch.bool)
        valid[edge : len(q) - edge] = True
        arm, simulator = low(b.real[name]), low(b.simulated[name])
        traces.append(Trace(b.name, rate, motion, arm, simulator, simulator, valid))
        segments.append(Segment(b.name, rate, 0.4 * rate, motion, b.real[name], False))
        left.append(b.real[name] - b.simulated[name])
    noise = (white_level(segments, left, band) * band).sqrt()
    floor = NoiseFloor(noise, noise, "bracket")
    joints, regimes = where(traces, floor, seed, band=band)
    whole = torch.cat([t.measured[t.valid] for t in traces])
    if name == "q":
        whole = whole - whole.mean(0)
    size = whole.square().mean(0).sqrt().clamp(min=1e-300)
    rows = [
        Difference(
            x.joint, x.gap_rms, float(noise[x.joint]), float(100 * x.gap_rms / size[x.joint])
        )
        for x in joints
    ]
    return WherePair(tuple(rows), regimes), floor
