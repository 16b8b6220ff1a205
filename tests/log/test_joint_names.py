"""The robot's joints among those of a recording."""

from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchid.errors import LogError
from torchid.log.joint_names import in_robot_order

UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint")
PANDA = tuple(f"panda_joint{k}" for k in range(1, 8))
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")


@given(st.permutations([*PANDA, *FINGERS]))
def test_any_order_and_a_gripper(names: list[str]) -> None:
    found, (note,) = in_robot_order(names, PANDA, "log")
    assert found == list(PANDA)
    left_out = [name for name in names if name in FINGERS]
    assert note == f"log: left out: {', '.join(left_out)}"


@pytest.mark.parametrize(
    ("recorded", "robot"),
    [
        ([f"ur10e_{name}" for name in UR], UR),
        ([f"left/{name}" for name in UR], UR),
        (["shoulder_pan", "shoulder_lift", "elbow", "wrist_1"], UR),
        (["joint1", "joint2"], ("joint_1", "joint_2")),
        (["iiwa_joint_1", "iiwa_joint_2"], ("joint1", "joint2")),
        (["A1", "A2"], ("lwr_a1", "lwr_a2")),
    ],
)
def test_prefixes_and_spelling(recorded: list[str], robot: tuple[str, ...]) -> None:
    for names in permutations(recorded):
        assert in_robot_order(names, robot, "log") == (recorded, ())


def test_numbers_where_names_do_not_fit() -> None:
    """The arm's joints are told from the fingers by their number alone."""
    robot = tuple(f"axis_{k}" for k in range(1, 8))
    found, (note,) = in_robot_order([*reversed(PANDA), *FINGERS], robot, "log")
    assert found == list(PANDA)
    assert "do not have the robot's names" in note
    many = tuple(f"j{k}" for k in range(12))
    assert in_robot_order(sorted(many), (), "log")[0] == list(many)


def test_a_shorter_robot_is_another_robot() -> None:
    with pytest.raises(LogError, match="do not identify"):
        in_robot_order(PANDA, ("joint_1", "joint_2", "joint_3"), "log")
    found, (note,) = in_robot_order(PANDA, PANDA[:3], "log", PANDA[3:])  # a chain of it
    assert found == list(PANDA[:3])
    assert note == f"log: left out: {', '.join(PANDA[3:])}"


def test_a_joint_that_the_robot_lacks_is_refused() -> None:
    with pytest.raises(LogError, match="joints that the robot lacks") as info:
        in_robot_order([*UR, "lift_joint", "head_joint"], UR, "log", ("head_joint",))
    assert (info.value.got, info.value.expected) == ("lift_joint", ", ".join(UR))


@pytest.mark.parametrize(
    "names",
    [
        UR,
        ("a", "b", "c", "d"),
        PANDA,
        ("a_1", "a_2", "b_1", "b_2"),
        ("shoulder", "w_1", "w_2", "w_3", "w_4"),
        (),
    ],
)
def test_what_cannot_be_told_is_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(LogError, match="do not identify") as info:
        in_robot_order(names, ("axis_1", "axis_2", "axis_3", "axis_4"), "log")
    assert info.value.expected == "axis_1, axis_2, axis_3, axis_4"
