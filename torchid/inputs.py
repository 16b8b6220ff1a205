"""What a user gives for a log of a robot, at the doors of the public functions.

What stands for a robot is `torchid.robot.library.as_robot`'s, and for a log without a robot
`torchid.read_log`'s.
"""

from torchid.log.checks import check_finite
from torchid.log.model import Log
from torchid.log.readers import LogLike, read_log
from torchid.log.stamps import check_increasing
from torchid.robot.library import as_robot
from torchid.robot.model import Robot, RobotLike

__all__ = ["LogLike", "RobotLike", "as_log", "as_robot"]


def as_log(log: LogLike, robot: Robot | None = None, *, usable: bool = True) -> Log:
    """A log as it is, or of whatever `read_log` takes, its joints in the order of the robot; with
    torque where it has currents alone and the robot says what they make.

    Args:
        log: what stands for one.
        robot: that it is of, where that is known.
        usable: whether it must be finite, but for commands, and in the order of time; the doctor
            says so itself.

    Raises:
        LogError, MissingExtraError: as `read_log`; NaN, infinity, or time that does not increase.
    """
    if not isinstance(log, Log):
        joints, spare = ((), ()) if robot is None else (robot.driven_names, robot.spare)
        log = read_log(log, joints=joints, spare=spare)
    if usable:
        check_finite(log, commands=False)
        check_increasing(log)
    return log if robot is None else with_drive_gain(log, robot)


def with_drive_gain(log: Log, robot: Robot) -> Log:
    """The log with the torque that its currents make by the robot's drive gains; as it is where it
    has a torque, no current, or another number of joints, or where no gain is known."""
    gain = robot.drive_gain
    if log.tau is not None or log.current is None or gain is None or len(gain) != log.n:
        return log
    return log.with_torque(gain)
