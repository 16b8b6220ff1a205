"""A corrected file of a simulator, by logs of any kind: `correct`."""

from collections.abc import Sequence
from pathlib import Path

from torchid.design.sensor import sensor_of
from torchid.errors import TorchidError
from torchid.export.correct_positions import correct_positions
from torchid.export.correct_torque import correct_torque
from torchid.export.correction import Correction, CorrectionRequest
from torchid.export.export import SUFFIXES
from torchid.export.projection import Target
from torchid.export.write_actuator import Package
from torchid.gap.diagnosis import TorqueDiagnosis
from torchid.gap.settings import GapSettings
from torchid.inputs import LogLike, RobotLike, as_log, as_robot
from torchid.log.model import Log
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.model import ServoArm
from torchid.results.answer import Diagnosis
from torchid.robot.model import Robot
from torchid.robot.origin import of_own_file

_FILES: dict[str, Target] = {
    "mjcf": "mjcf", "urdf": "urdf", "mujoco": "mjcf", "mjlab": "mjcf",
    "isaaclab": "mjcf", "gazebo": "urdf",
}  # fmt: skip
"""Of formats, and of simulators that read one of them."""


def file_format(asked: str) -> Target:
    """mjcf or urdf: what a format's or simulator's files are."""
    return _FILES[asked]


def require_field(to: Target, robot: Robot, log: Log) -> None:
    """Raise TorchidError where a format does not say what logs of this kind correct."""
    if to != "mjcf" and sensor_of(log, robot) == "position":
        raise TorchidError(
            "these logs have commands and positions, and servos are written into an MJCF only.",
            got=to,
            available=["mjcf", "mujoco", "mjlab", "isaaclab"],
        )


def correct(
    robot: RobotLike,
    full: RobotLike | ServoArm | Diagnosis,
    log: LogLike,
    to: Target,
    folder: Path | str,
    name: str | None = None,
    *,
    held_out: LogLike | None = None,
    settings: GapSettings | None = None,
    with_effects: bool | Package = False,
    keep: Sequence[Path] = (),
    plain: bool = False,
) -> Correction:
    """Write a robot as a simulator's file can say it, refitted to a log, and run in its engine.

    Args:
        robot: as given: its file is edited a copy of, its bodies are what the new ones are near to.
        full: a diagnosis of it on this log, or what it corrected: a robot, or one with servos.
        log: trajectories of the arm, which the file is fitted to.
        to: format; servos are written into an MJCF.
        folder: made if need be.
        name: of the file, without suffix; the robot's own, with `_corrected`, by default.
        held_out: trajectories that judge it. Without them a diagnosis of torques is judged by fits
            without each of its folds, and all else on the log that it was fitted to.
        settings: of the diagnosis: the cut-off, band and folds of one of torques, and the seed.
        with_effects: write a second file, `_effects` after its name, fitted together with what has
            no field: it lies in a sidecar, and is added at run time. With a package's name that
            package's actuator class is written, too.
        keep: files that are never overwritten.
        plain: leave set points of servos out of the file, which are joints there.

    Raises:
        LogError: logs that do not fit the robot.
        TorchidError: another arm, servos in another format, or a file that is no better than the
            robot as given.

    >>> from tempfile import TemporaryDirectory
    >>> import torchid
    >>> simulated, arm = torchid.load_robot("3r"), torchid.load_robot("3r_friction")
    >>> motion = torchid.excite(arm, duration=6.0, restarts=1, iterations=5).log()
    >>> log = torchid.simulate(arm, motion)
    >>> with TemporaryDirectory() as folder:
    ...     done = correct(simulated, arm, log, "mjcf", folder)
    >>> bool(done.judged.engine.mean() < 0.3 * done.judged.nominal.mean())
    True
    """
    robot, _ = of_own_file(as_robot(robot), SUFFIXES[to])
    log = as_log(log, robot)
    held_out = None if held_out is None else as_log(held_out, robot)
    if isinstance(full, str | Path):
        full = ServoArm.of_file(full) or as_robot(full)
    robot.require_fixed_base("a correction")
    file_format(to)
    asked = CorrectionRequest(
        robot=robot, log=log, to=to, folder=Path(folder), name=name, held_out=held_out,
        settings=settings or GapSettings(), with_effects=with_effects, keep=keep, plain=plain,
    )  # fmt: skip
    if isinstance(full, PositionDiagnosis | ServoArm):
        require_field(to, robot, log)
        return correct_positions(asked, full)
    assert isinstance(full, Robot | TorqueDiagnosis)
    return correct_torque(asked, full)
