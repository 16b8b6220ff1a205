"""The yaml beside a URDF or MJCF that holds what the file cannot say."""

import pytest

from torchid.errors import RobotError
from torchid.robot.library import load_robot
from torchid.robot.sidecar import sidecar_path, sidecar_yaml

OFFSET = {"effect": "torque_offset", "joint": 2, "F0": 0.1}
JOINTS = ["j1", "j2", "j3", "j4", "j5", "j6"]


def test_it_is_read_with_the_file(arm_urdf):
    plain = load_robot(arm_urdf)
    side = sidecar_path(arm_urdf)
    assert side.name == "arm.urdf.effects.yaml"
    side.write_text(sidecar_yaml("arm.urdf", JOINTS, [OFFSET], [0.1, 0.2, -9.0]))
    robot = load_robot(arm_urdf)
    assert robot.effects == (*plain.effects, OFFSET)
    assert robot.gravity.tolist() == [0.1, 0.2, -9.0]


def test_of_another_chain_it_is_refused(arm_urdf):
    sidecar_path(arm_urdf).write_text(sidecar_yaml("arm.urdf", JOINTS[:5], [OFFSET], None))
    with pytest.raises(RobotError, match="another chain"):
        load_robot(arm_urdf)
    assert load_robot(arm_urdf, tip="l5").effects[-1] == OFFSET


@pytest.mark.parametrize("text", ["- 1", "joints: [", "joints: [j1]\nmass: 3", "\0"])
def test_what_is_no_sidecar_is_refused(arm_urdf, text):
    sidecar_path(arm_urdf).write_text(text)
    with pytest.raises(RobotError, match=r"effects\.yaml"):
        load_robot(arm_urdf)
