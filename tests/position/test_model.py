"""A robot with its servos."""

import math

import pytest

from tests.position.planted import robot
from torchid.errors import TorchidError
from torchid.position.model import ServoArm


def test_a_servo_of_all_joints_or_of_each(tmp_path):
    arm = ServoArm.of(robot(), kp=20.0, stop_high=[math.inf, 0.5, math.inf])
    assert arm.servos.of("kp").tolist() == [20.0] * 3
    assert arm.servos.of("stop_high").tolist() == [math.inf, 0.5, math.inf]
    assert arm.servos.of("scale").tolist() == [1.0] * 3
    arm.write(tmp_path / "model.yaml")
    again = ServoArm.read(tmp_path / "model.yaml")
    assert again.servos.joint.tolist() == arm.servos.joint.tolist()


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"gain": 1.0}, "available: .*kp"),
        ({"kp": [1.0, 2.0]}, r"'kp'.*got: \[1.0, 2.0\].*expected: a number, or 3"),
        ({"kp": [1.0, 2.0, "x"]}, "kp"),
        ({"kp": math.nan}, "'kp'.*got: nan"),
    ],
)
def test_what_no_servo_has(values, said):
    with pytest.raises(TorchidError, match=f"(?s){said}"):
        ServoArm.of(robot(), **values)
