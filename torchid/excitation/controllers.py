"""Planned motions as robot controllers take them: ROS 2 and Universal Robots."""

from typing import Any

from torchid.effects.base import Motion
from torchid.errors import RobotError
from torchid.json_data import plain
from torchid.robot.config_files import filled_template
from torchid.robot.model import JointType, Robot

AT_START = 0.02
"""How far from the start posture a script lets the arm begin [rad]."""

_LOOKAHEAD = 0.1  # [s], of servoj; its default
_GAIN = 300  # of servoj; its default


def joint_trajectory(robot: Robot, motion: Motion) -> dict[str, Any]:
    """The fields of a ROS 2 message trajectory_msgs/msg/JointTrajectory.

    Args:
        robot: its joints' names.
        motion: of one trajectory with its times, (T, n).
    """
    nanoseconds = (motion.require("t", "a controller") * 1e9).round().long().tolist()
    states = zip(*(plain(x) for x in motion.state), strict=True)
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(robot.joint_names),
        "points": [
            {
                "positions": q,
                "velocities": dq,
                "accelerations": ddq,
                "effort": [],
                "time_from_start": {"sec": ns // 10**9, "nanosec": ns % 10**9},
            }
            for ns, (q, dq, ddq) in zip(nanoseconds, states, strict=True)
        ],
    }


def urscript(robot: Robot, motion: Motion) -> str:
    """A URScript program that moves an arm of Universal Robots along a motion, sample by sample.

    It does not drive to the start, for nobody has checked that way: away from the start posture it
    tells the user where that is, and halts.

    Args:
        robot: with six revolute joints.
        motion: of one trajectory with its times, (T, 6).

    Raises:
        RobotError: not six revolute joints.
    """
    require_six_joints(robot)
    rows = [f"[{','.join(f'{x:.6f}' for x in q)}]" for q in motion.q.tolist()]
    degrees = ", ".join(f"{x:.1f}" for x in motion.q[0].rad2deg().tolist())
    t = motion.require("t", "a controller")
    step = float(t[1] - t[0])
    points = (f"  servoj({row}, 0, 0, {step:.6g}, {_LOOKAHEAD}, {_GAIN})" for row in rows)
    return filled_template(
        "motion.urscript",
        robot=robot.name,
        duration=f"{float(t[-1]):g}",
        milliseconds=f"{1000 * step:g}",
        start=rows[0],
        apart=AT_START,
        degrees=degrees,
        points="\n".join(points),
    )


def require_six_joints(robot: Robot) -> None:
    """Raise RobotError unless the robot has six revolute joints, as those of Universal Robots."""
    kinds = "".join(robot.joint_types)
    if kinds != 6 * JointType.REVOLUTE:
        raise RobotError(
            f"robot '{robot.name}' cannot run a URScript program.",
            got=f"{robot.n} joints: {kinds}",
            expected="the six revolute joints of an arm of Universal Robots",
        )
