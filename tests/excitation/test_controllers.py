"""Motions for robot controllers, read back: by rosbags' message types, and line by line."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.excitation.usage import limit_usage
from torchid.errors import RobotError
from torchid.excitation.controllers import AT_START, joint_trajectory, urscript
from torchid.excitation.limits import motion_limits
from torchid.excitation.trajectories import random_trajectory, sinusoid
from torchid.robot.library import load_robot


@pytest.mark.parametrize("plan", [random_trajectory, sinusoid])
@pytest.mark.parametrize("speed", [0.1, 0.37])
def test_a_slow_motion_is_the_same_path(plan, speed):
    """q(t / speed) at once, velocity and acceleration by the chain rule, at rest at the ends."""
    robot = load_robot("ur10e")
    whole = plan(robot, 4)
    slow = whole.at_speed(speed)
    assert slow.duration == pytest.approx(whole.duration / speed)
    t = torch.linspace(0, whole.duration, 301).double()
    a, b = whole.at(t), slow.at(t / speed)
    torch.testing.assert_close(b.q, a.q)
    torch.testing.assert_close(b.dq, speed * a.dq)
    torch.testing.assert_close(b.ddq, speed**2 * a.ddq)
    used = limit_usage(slow.extremes(), motion_limits(robot))
    assert float(used[1].max()) <= speed * (1 + 1e-3)
    assert float(used[2].max()) <= speed**2 * (1 + 1e-3)


def test_the_ros_2_message_is_one():
    """rosbags builds and serialises it, and every field comes back."""
    from rosbags.typesys import Stores, get_typestore

    robot = load_robot("ur10e")
    motion = random_trajectory(robot, 1, duration=4.0).sample(30.0)
    data = joint_trajectory(robot, motion)
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types

    def message(name, fields):
        return kinds[name](**fields)

    points = [
        message(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            {k: np.array(point[k])
             for k in ("positions", "velocities", "accelerations", "effort")}
            | {"time_from_start":
               message("builtin_interfaces/msg/Duration", point["time_from_start"])},
        )
        for point in data["points"]
    ]  # fmt: skip
    stamp = message("builtin_interfaces/msg/Time", data["header"]["stamp"])
    header = message("std_msgs/msg/Header", {"stamp": stamp, "frame_id": ""})
    name = "trajectory_msgs/msg/JointTrajectory"
    assert set(data) == {"header", "joint_names", "points"}
    whole = message(name, {"header": header, "joint_names": data["joint_names"], "points": points})
    back = store.deserialize_cdr(store.serialize_cdr(whole, name), name)
    assert tuple(back.joint_names) == robot.joint_names
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in back.points]
    assert times == pytest.approx(motion.t.tolist(), abs=1e-9)
    for field, expected in zip(
        ("positions", "velocities", "accelerations"), (motion.q, motion.dq, motion.ddq), strict=True
    ):
        found = torch.stack([torch.from_numpy(getattr(p, field).copy()) for p in back.points])
        torch.testing.assert_close(found, expected, rtol=0, atol=0)


def test_the_urscript_holds_the_motion():
    robot = load_robot("ur10e")
    motion = random_trajectory(robot, 2, duration=6.0).sample(125.0)
    text = urscript(robot, motion)
    rows = re.findall(r"servoj\(\[(.*?)\], 0, 0, (.*?), (.*?), (.*?)\)", text)
    found = torch.tensor(
        [[float(x) for x in row[0].split(",")] for row in rows], dtype=torch.float64
    )
    torch.testing.assert_close(found, motion.q, rtol=0, atol=6e-7)
    assert {row[1] for row in rows} == {"0.008"}
    assert all(0.03 <= float(row[2]) <= 0.2 and 100 <= float(row[3]) <= 2000 for row in rows)
    # Blocks are closed, no line is deeper than its block, and nothing moves before the check.
    depth = 0
    for line in text.splitlines()[1:]:
        word = line.strip()
        depth -= word == "end"
        assert len(line) - len(word) == 2 * depth
        depth += word.endswith(":")
    assert depth == 0
    assert text.index("halt") < text.index("servoj")
    assert f"> {AT_START}" in text
    posture = re.search(r"Bring the arm to (.*?) deg", text).group(1)
    told = [math.radians(float(x)) for x in posture.split(",")]
    assert told == pytest.approx(motion.q[0].tolist(), abs=1e-3)


def test_no_urscript_for_other_arms():
    robot = load_robot("panda")
    with pytest.raises(RobotError, match="six revolute"):
        urscript(robot, random_trajectory(robot, 0).sample(50.0))
    kinds = load_robot("ur10e").joint_types
    slides = replace(load_robot("ur10e"), joint_types=(*kinds[:5], type(kinds[0])("P")))
    with pytest.raises(RobotError, match="RRRRRP"):
        urscript(slides, random_trajectory(load_robot("ur10e"), 0).sample(50.0))
