"""Robots with branches: what is read of a file, which part, what follows what; and written back."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from tests.arms import states
from tests.trees import TWO_ARMS, package_urdfs, random_tree, two_arms
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.errors import RobotError
from torchid.robot.library import load_robot
from torchid.robot.model import Mimic, Robot, link_poses, tool_pose
from torchid.robot.writer import write_robot

STILL = ("quadrotor_base.urdf", "iris_simple.urdf", "ur3.urdf")
"""URDFs of the package without any joint that moves."""
QUICK = ("panda.urdf", "solo12.urdf", "romeo.urdf", "tiago_pro.urdf", "bolt.urdf")


@pytest.fixture
def arms(tmp_path: Path) -> Robot:
    return load_robot(two_arms(tmp_path))


def test_links_are_those_of_the_file_each_behind_the_one_that_carries_it(arms: Robot):
    assert (arms.n, arms.n_links, arms.is_serial) == (6, 7, False)
    assert arms.link_names == ("l1", "r1", "l2", "r2", "r3", "thumb", "finger")
    assert arms.parents == (-1, -1, 0, 1, 3, 4, 4)
    assert arms.ancestors(6) == (1, 3, 4, 6)
    assert arms.descendants(1) == (1, 3, 4, 5, 6)
    assert arms.descendants(0) == (0, 2)
    assert arms.levels == ((0, 1), (2, 3), (4,), (5, 6))
    assert arms.moved_by(5) == (5, 6)  # the finger follows the thumb
    assert [(tip.name, tip.link) for tip in arms.ends] == [
        ("camera", 2),
        ("thumb", 5),
        ("finger", 6),
    ]


def test_what_follows_a_joint_rubs_on_it(arms: Robot):
    found = {(e["effect"], e["joint"]): e for e in arms.effects}
    # 1.5 of the thumb, and 0.5 of the finger by its ratio of -2, squared.
    assert found["viscous_friction", 6]["Fv"] == pytest.approx(3.5)
    assert found["viscous_friction", 4]["Fv"] == 0.4
    assert found["coulomb_friction", 4]["Fc"] == 0.2


def test_positions_follow_and_poses_of_tips_are_chosen_by_name(arms: Robot):
    q = torch.tensor([0.1, -0.2, 0.3, 0.4, -0.5, 0.02], dtype=torch.float64)
    assert arms.on_links(q)[6] == pytest.approx(-2 * 0.02 + 0.01)
    finger = link_poses(arms, q)[6]
    torch.testing.assert_close(tool_pose(arms, q, "finger"), finger, rtol=1e-12, atol=1e-12)
    with pytest.raises(RobotError, match="several tips") as raised:
        tool_pose(arms, q)
    assert raised.value.available == ["camera", "thumb", "finger"]
    with pytest.raises(RobotError, match="no such tip"):
        tool_pose(arms, q, "nose")


def test_a_tip_takes_one_branch_and_a_root_what_it_carries(tmp_path: Path):
    path = two_arms(tmp_path)
    left = load_robot(path, tip="camera")
    assert (left.joint_names, left.is_serial) == (("l_shoulder", "l_elbow"), True)
    hand = load_robot(path, root="r2")
    assert hand.joint_names == ("r_wrist", "thumb_joint")
    assert hand.parents == (-1, 0, 0)
    assert "'r2' is the base; joints 'r_shoulder', 'r_elbow'" in hand.warnings[0]
    # Its torque is that of the whole at rest before it.
    whole = load_robot(path)
    q, dq, ddq = (x.squeeze(0) for x in states(hand, 1))
    zero = torch.zeros(2, dtype=torch.float64)
    every = [torch.cat([zero, zero, x]) for x in (q, dq, ddq)]
    expected = inverse_dynamics(whole, *every)[4:]
    torch.testing.assert_close(inverse_dynamics(hand, q, dq, ddq), expected, rtol=1e-12, atol=1e-12)
    assert load_robot(path, root="r2", tip="thumb").joint_names == ("r_wrist", "thumb_joint")


def test_locked_joints_are_held_where_they_are_said_to_be(tmp_path: Path):
    path = two_arms(tmp_path)
    whole = load_robot(path)
    part = load_robot(path, lock={"r_elbow": 0.7, "thumb_joint": 0.02})
    assert part.joint_names == ("l_shoulder", "r_shoulder", "l_elbow", "r_wrist")
    assert part.mimics == ()  # the finger is held as the thumb is
    assert dict(part.locked) == {"r_elbow": 0.7, "thumb_joint": 0.02}
    q, dq, ddq = states(part, 20)

    def at(x: torch.Tensor, elbow: float, thumb: float) -> torch.Tensor:
        held = x.new_tensor([elbow, thumb]).expand(len(x), 2)
        return torch.cat([x[:, :3], held[:, :1], x[:, 3:], held[:, 1:]], 1)

    expected = inverse_dynamics(whole, at(q, 0.7, 0.02), at(dq, 0, 0), at(ddq, 0, 0))
    torch.testing.assert_close(
        inverse_dynamics(part, q, dq, ddq), expected[:, [0, 1, 2, 4]], rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize(
    ("chosen", "words", "available"),
    [
        ({"tip": "nose"}, "no link to be the tip", "thumb"),
        ({"root": "nose"}, "no link to be the root", "r2"),
        ({"root": "l1", "tip": "thumb"}, "'l1' does not carry the tip", "camera"),
        ({"root": "finger"}, "no joint can move that 'finger' carries", None),
        ({"lock": {"camera_mount": 0.0}}, "no joint to lock", "r_wrist"),
        ({"lock": {"r_wrist": float("nan")}}, "cannot be locked there", None),
        ({"tip": "finger"}, "mimics joint 'thumb_joint', which is not", "r_wrist"),
    ],
)
def test_parts_that_are_not_there_are_refused(tmp_path: Path, chosen, words, available):
    with pytest.raises(RobotError, match=words) as raised:
        load_robot(two_arms(tmp_path), **chosen)
    if available is not None:
        assert available in raised.value.available


def test_a_base_that_floats_is_fixed_with_a_warning(tmp_path: Path):
    fixed = load_robot(two_arms(tmp_path))
    path = tmp_path / "floating.urdf"
    base = (
        '<link name="world"/><joint name="fly" type="floating"><parent link="world"/>'
        '<child link="torso"/></joint></robot>'
    )
    path.write_text(TWO_ARMS.replace("</robot>", base))
    robot = load_robot(path)
    assert robot.warnings == (
        "'torso' (joint 'fly') can float: it is taken as fixed where the file puts it, as part of "
        "the base",
    )
    motion = states(fixed, 10)
    torch.testing.assert_close(
        inverse_dynamics(robot, *motion), inverse_dynamics(fixed, *motion), rtol=1e-12, atol=1e-12
    )


def test_a_mimic_of_a_mimic_follows_the_last_and_one_of_nothing_moves_by_itself(tmp_path: Path):
    path = tmp_path / "chain.urdf"
    follows = '<mimic joint="r_wrist" multiplier="3" offset="1"/>'
    thumb = 'name="thumb_joint" type="prismatic">'
    text = TWO_ARMS.replace(thumb, thumb + follows)
    path.write_text(text)
    robot = load_robot(path)
    assert robot.n == 5
    thumb, finger = robot.mimics
    assert (thumb.coordinate, thumb.ratio, thumb.offset) == (4, 3.0, 1.0)
    assert (finger.coordinate, finger.ratio, finger.offset) == (4, -6.0, -2 * 1.0 + 0.01)
    path.write_text(TWO_ARMS.replace('mimic joint="thumb_joint"', 'mimic joint="lost"'))
    robot = load_robot(path)
    assert (robot.n, robot.mimics) == (7, ())
    assert "they move by themselves: 'finger_joint' ('lost')" in robot.warnings[0]


def test_links_in_a_wrong_order_and_mimics_of_nothing_are_refused():
    robot = random_tree([-1, 0, 0], "RRP", 1, {})
    with pytest.raises(RobotError, match="no tree in this order"):
        replace(robot, parents=(-1, 2, 0))
    with pytest.raises(RobotError, match="no tree in this order"):
        replace(robot, parents=(-1, 0))
    with pytest.raises(RobotError, match="not every link has one joint"):
        replace(robot, mimics=(Mimic(2, "m", robot.joint_types[2], 7),))


@pytest.mark.parametrize("seed", [1, 2])
def test_a_tree_written_as_yaml_is_read_back_to_the_last_bit(tmp_path: Path, seed: int):
    robot = random_tree([-1, 0, 0, -1, 3, 3, 1], "RPRRPRR", seed, {2: 1, 6: 3})
    write_robot(robot, tmp_path / "tree.yaml")
    again = load_robot(tmp_path / "tree.yaml")
    for name in ("joint_names", "link_names", "joint_types", "parents", "mimics"):
        assert getattr(again, name) == getattr(robot, name)
    for name in ("before", "after", "gravity"):
        assert torch.equal(getattr(again, name), getattr(robot, name))
    assert torch.equal(again.parameters.pi, robot.parameters.pi)
    for ours, read in zip(robot.tips, again.tips, strict=True):
        assert (ours.name, ours.link) == (read.name, read.link)
        assert torch.equal(ours.pose, read.pose)


@pytest.mark.parametrize(
    "path", [p for p in package_urdfs() if p.name in QUICK], ids=lambda p: p.name
)
def test_every_joint_of_a_published_robot_is_read(path: Path):
    joints_of(path)


@pytest.mark.slow
@pytest.mark.skipif(not package_urdfs(), reason="needs the package example-robot-data")
def test_all_published_robots_are_read_whole():
    paths = package_urdfs()
    assert len(paths) >= 69
    for path in paths:
        if path.name in STILL:
            with pytest.raises(RobotError, match=r"no joint can move|has no links"):
                load_robot(path)
        else:
            joints_of(path)


def joints_of(path: Path) -> None:
    """That a robot has every joint of its file that moves, by an own look at the file."""
    from lxml import etree

    robot = load_robot(path)
    moving = {
        node.get("name").strip()
        for node in etree.parse(path, etree.XMLParser(remove_comments=True)).getroot()
        if node.tag == "joint" and node.get("type") in ("revolute", "continuous", "prismatic")
    }
    assert {drive.joint for drive in robot.drives} == moving
    assert robot.n + len(robot.mimics) == robot.n_links


def test_joints_without_a_coordinate_are_spare(tmp_path: Path):
    path = two_arms(tmp_path)
    assert load_robot(path).spare == ("finger_joint", "camera_mount")
    part = load_robot(path, tip="camera", lock={"l_elbow": 0.1})
    assert part.joint_names == ("l_shoulder",)
    assert {"l_elbow", "r_shoulder", "r_wrist", "thumb_joint", "finger_joint"} <= set(part.spare)


@pytest.mark.parametrize("kind", ["connect", "weld"])
def test_a_closed_loop_is_refused_and_a_part_without_it_is_read(tmp_path: Path, kind: str):
    def bar(name: str, inner: str) -> str:
        return (
            f'<body name="{name}" pos="0 0 -0.1"><joint name="j_{name}" axis="0 1 0"/>'
            f'<geom size="0.02 0.05" type="capsule"/>{inner}</body>'
        )

    anchor = ' anchor="0 0 0"' if kind == "connect" else ""
    path = tmp_path / "loop.xml"
    path.write_text(
        f"<mujoco><worldbody>{bar('a', bar('b', ''))}{bar('c', '')}</worldbody>"
        f'<equality><{kind} body1="b" body2="c"{anchor}/></equality></mujoco>'
    )
    with pytest.raises(RobotError, match="'b' and 'c' are held together by an equality") as raised:
        load_robot(path)
    assert "closes a loop" in str(raised.value)
    assert load_robot(path, tip="a").joint_names == ("j_a",)
