from dataclasses import replace

import torch

from torchid.robot.chain import to_chain
from torchid.robot.library import built_in_robots, load_robot
from torchid.robot.model import Limits, link_poses, tool_pose
from torchid.robot.placement import pose, roll_pitch_yaw
from torchid.robot.urdf import read_urdf
from torchid.robot.yaml_file import from_mapping

EXACT = 1e-12


def robots(arm_urdf):
    tool = pose(roll_pitch_yaw([0.3, -0.8, 2.0]), (0.1, -0.2, 0.3))
    rows = [
        {"type": kind, "a": 0.1 * i, "alpha": 0.7 * i, "d": 0.2, "theta": -0.4 * i}
        for i, kind in enumerate("RPRPPR")
    ]
    mixed = [
        from_mapping({"name": c, "dh": {"convention": c, "joints": rows}}, c)
        for c in ("classical", "modified")
    ]
    built_in = [load_robot(name) for name in built_in_robots()]
    return [read_urdf(arm_urdf), *(replace(robot, tool=tool) for robot in [*built_in, *mixed])]


def positions(n: int, *batch: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(n)
    return torch.rand(*batch, n, generator=generator, dtype=torch.float64) * 6 - 3


def test_forward_kinematics_equals_ours(arm_urdf):
    for robot in robots(arm_urdf):
        q = positions(robot.n, 50)
        chain = to_chain(robot)
        end = chain.forward_kinematics(q).get_matrix()
        assert end.dtype == torch.float64
        assert (end - tool_pose(robot, q)).abs().max() < EXACT
        frames = chain.forward_kinematics(q, end_only=False)
        for i, name in enumerate(robot.link_names):
            ours = link_poses(robot, q)[:, i]
            assert (frames[name].get_matrix() - ours).abs().max() < EXACT


def test_joint_names_and_limits_are_carried(arm_urdf):
    robot = read_urdf(arm_urdf)
    chain = robot.to_chain()
    assert tuple(chain.get_joint_parameter_names()) == robot.joint_names
    assert chain.low.equal(robot.limits.position[:, 0])
    assert chain.high.equal(robot.limits.position[:, 1])
    assert chain.get_joint_velocity_limits()[1] == robot.limits.velocity[:, 1].tolist()
    assert chain.get_joint_effort_limits()[0] == robot.limits.torque[:, 0].tolist()
    unlimited = to_chain(replace(robot, limits=Limits()))
    assert unlimited.low.tolist() == [-torch.inf] * 6


def test_float32_is_the_callers_choice(arm_urdf):
    robot = read_urdf(arm_urdf)
    q = positions(6, 5)
    end = to_chain(robot, torch.float32).forward_kinematics(q.float()).get_matrix()
    assert end.dtype == torch.float32
    assert (end - tool_pose(robot, q)).abs().max() < 1e-5


def test_links_may_have_the_names_of_our_frames():
    rows = {"convention": "classical", "joints": [{"a": 1.0, "alpha": 0.3}] * 3}
    robot = from_mapping({"name": "r", "dh": rows}, "r")
    robot = replace(robot, link_names=("base", "tool", "joint_2/moved"))
    q = positions(3, 4)
    end = to_chain(robot).forward_kinematics(q).get_matrix()
    assert (end - tool_pose(robot, q)).abs().max() < EXACT
