"""What a user gives for a log of a robot, at the doors of the public functions.

What stands for a robot is `torchid.robot.library.as_robot`'s, and for a log without a robot
`torchid.read_log`'s.
"""

from torchid.log.model import Log
from torchid.log.readers import LogLike, read_log
from torchid.robot.library import as_robot
from torchid.robot.model import Robot, RobotLike

__all__ = ["LogLike", "RobotLike", "as_log", "as_robot"]


def as_log(log: LogLike, robot: Robot | None = None) -> Log:
    """A log as it is, or of whatever `read_log` takes, its joints in the order of the robot.

    Raises:
        LogError, MissingExtraError: as `read_log`.
    """
    if isinstance(log, Log):
        return log
    if robot is None:
        return read_log(log)
    return read_log(log, joints=robot.driven_names, spare=robot.spare)
