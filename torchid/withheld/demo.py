"""The whole promise on an arm whose faults are known: its log is examined, the arm identified, its
gap diagnosed; then what was withheld from the diagnosis is opened and compared.

The arm is a 6R as its maker describes it (configs/demonstration). The real one carries a load and
rubs on a joint, which is known; a third cause is drawn from the seed and sealed.
"""

import hashlib
import random
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from torchid.doctor.examine import Examination, examine
from torchid.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from torchid.effects.friction_laws import LoadDependentFriction
from torchid.effects.inertia import Payload
from torchid.effects.registry import Valued, nominal_effects
from torchid.effects.spring import JointSpring
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.files import write_text
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.settings import GapSettings
from torchid.gap.torque import STAGES, diagnose_torque
from torchid.identification.identify import Identification, identify
from torchid.json_data import plain, read_json, write_json
from torchid.log.model import Log
from torchid.log.readers import read_log, write_log
from torchid.parallel.pace import Pace
from torchid.parallel.workers import Progress
from torchid.results.cause import Cause
from torchid.robot.config_files import config_folder
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.typing import Tensor

SECONDS, RATE = 5.0, 100.0
"""Length and rate of each of the three logs."""


PLAIN: tuple[dict[str, Any], ...] = (
    Payload().record((1.0, 0.02, 0.0, 0.08, 0.01, 0.0, 0.0, 0.01, 0.0, 0.005)),
    CoulombFriction(joint=1).record((4.0,)),
)
"""Causes that are known from the start."""

SHARES = (0.03, 0.06)
"""Of the withheld cause: its torque over the joint's limit of torque, at the limit of speed."""

LOAD_SHARES = (0.05, 0.1)
"""The same of friction that grows with load: over the torque of the moment."""


@dataclass(frozen=True)
class Files:
    """Files of the demonstration: what a user would have, and the sealed key.

    Attributes:
        robot: the URDF.
        logs: that are fitted.
        new: log of a motion that takes part in nothing.
        key: what was planted; the diagnosis does not read it.
        sealed: SHA-256 of the key.
    """

    robot: Path
    logs: tuple[Path, ...]
    new: Path
    key: Path
    sealed: str


@dataclass(frozen=True)
class Comparison:
    """One planted cause beside what came out.

    Attributes:
        planted: record of the effect.
        withheld: whether it was sealed.
        finding: that names the effect at its joint; None where there is none.
    """

    planted: dict[str, Any]
    withheld: bool
    finding: Cause | None

    @property
    def coefficient(self) -> tuple[str, float]:
        """The first one: its name and the planted value."""
        name = next(k for k in self.planted if k not in ("effect", "joint"))
        return name, float(self.planted[name])


@dataclass(frozen=True, eq=False)
class Demo:
    """What came out.

    Attributes:
        files: of the demonstration.
        examination: of the logs.
        identification: of base parameters and friction.
        diagnosis: of the gap.
        opened: every planted cause beside what came out.
        others: named effects that were not planted.
    """

    files: Files
    examination: Examination
    identification: Identification
    diagnosis: TorqueDiagnosis
    opened: tuple[Comparison, ...]
    others: tuple[Cause, ...]

    def plain(self) -> dict[str, Any]:
        """The schema torchid.demo/1."""
        held_out = self.identification.held_out
        return {
            "schema": "torchid.demo/1",
            "keys_sha256": self.files.sealed,
            "doctor": [c.name for c in self.examination.checks if c.verdict == "wrong"],
            "held_out_percent_moving": plain(held_out and held_out.relative_percent_moving),
            "status": self.diagnosis.status,
            "headline": self.diagnosis.answer.headline,
            "opened": [
                {
                    **{"planted": one.planted, "withheld": one.withheld},
                    "named": one.finding is not None,
                    "value": one.finding and one.finding.parameters[one.coefficient[0]],
                    "std": one.finding and one.finding.std[one.coefficient[0]],
                }
                for one in self.opened
            ],
            "not_planted": [f.effect for f in self.others],
        }


def withheld_cause(robot: Robot, seed: int) -> dict[str, Any]:
    """A cause of one joint, drawn from the seed: which, where and how large."""
    g = random.Random(seed)
    joint, share = g.randrange(robot.n), g.uniform(*SHARES)
    torque, speed = _highest(robot.limits.torque, joint), _highest(robot.limits.velocity, joint)
    causes: tuple[Valued, ...] = (
        (LoadDependentFriction(joint), [g.uniform(*LOAD_SHARES)]),
        (ViscousFriction(joint), [share * torque / speed]),
        (TorqueOffset(joint), [share * torque]),
        (JointSpring(joint), [share * torque, 0.0]),
    )
    effect, values = g.choice(causes)
    return effect.record(values)


def _highest(limits: Tensor | None, joint: int) -> float:
    """The upper limit of a joint."""
    assert limits is not None  # the arm's file has them
    return float(limits[joint, 1])


def write_files(folder: Path, seed: int) -> Files:
    """Robot, logs and the sealed key.

    Args:
        folder: that they go to; it exists.
        seed: of the withheld cause, the motions and the noise.
    """
    files = Files(
        folder / "arm.urdf",
        (folder / "run1.parquet", folder / "run2.parquet"),
        folder / "new.parquet",
        folder / "withheld.json",
        "",
    )
    # The maker's file says nothing of friction.
    arm = config_folder("demonstration") / "arm.urdf"
    write_text(files.robot, arm.read_text(encoding="utf-8"))
    robot = load_robot(arm)
    withheld = withheld_cause(robot, seed)
    key = write_json({"schema": "torchid.demo.key/1", "withheld": withheld}, files.key)
    # 8.0: of the motions [rad/s^2]
    moving = robot.with_limits(acceleration=8.0)
    motions = [
        trajectory_log(random_trajectory(moving, 10 * seed + k, duration=SECONDS, fill=True), RATE)
        for k in range(3)
    ]
    real = replace(robot, effects=(*PLAIN, withheld))
    log = synthetic_log(real, Log.concatenate(motions), HonestNoise(), seed)
    for path, run in zip((*files.logs, files.new), log.trajectories(), strict=True):
        # A controller logs no accelerations.
        write_log(run.replace(ddq=None), path)
    return replace(files, sealed=hashlib.sha256(key).hexdigest())


def demonstrate(files: Files, seed: int, progress: Progress | None = None) -> Demo:
    """Examine, identify, diagnose, and only then open the key.

    Args:
        files: of the demonstration.
        seed: of resampling.
        progress: called with (stage, done, total).
    """
    robot, log, new = load_robot(files.robot), read_log(files.logs), read_log(files.new)
    examination = examine(robot, log)
    identification = identify(robot, log, held_out=new, progress=progress)
    settings, pace = GapSettings(seed=seed), Pace(progress, STAGES)
    diagnosis = diagnose_torque(robot, log, held_out=new, settings=settings, pace=pace)
    withheld = read_json(files.key, "the key of the demonstration")["withheld"]
    opened = tuple(
        Comparison(one, one is withheld, _finding(diagnosis, one, robot))
        for one in (*PLAIN, withheld)
    )
    right = [one.finding for one in opened]
    others = tuple(f for f in diagnosis.which if not any(f is one for one in right))
    return Demo(files, examination, identification, diagnosis, opened, others)


def _finding(diagnosis: TorqueDiagnosis, planted: dict[str, Any], robot: Robot) -> Cause | None:
    """The finding that names a planted effect, at its joint where it has one."""
    ((effect, _),) = nominal_effects(replace(robot, effects=(planted,)))
    joint = planted.get("joint")
    for f in diagnosis.which:
        if f.effect == effect.name and (joint is None or joint - 1 in f.joints):
            return f
    return None
