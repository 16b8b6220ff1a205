"""Servos as models of better-actuator-models: the smallest that holds their friction."""

import json
from pathlib import Path

import pytest

from tests.arms import arm
from torchid.errors import TorchidError
from torchid.export.export import export_dynamics
from torchid.export.results import servo_dynamics
from torchid.position.model import ServoArm

EVERY = {"kt", "R", "armature", "friction_base", "friction_viscous", "model", "actuator"}
FADE = {"friction_stribeck", "dtheta_stribeck", "alpha"}
SIDES = {"load_friction_motor", "load_friction_external"}
PUBLISHED = {
    "m1": EVERY, "m2": EVERY | FADE, "m3": EVERY | {"load_friction_base"},
    "m4": EVERY | FADE | {"load_friction_base", "load_friction_stribeck"},
    "m5": EVERY | FADE | SIDES | {f"{name}_stribeck" for name in SIDES},
}  # fmt: skip
"""Keys of the files of version 1.0.2, in each of which a model of its own reads all it has."""
FADES = {"stiction": 0.2, "stribeck_speed": 0.4, "stribeck_exponent": 1.5}
BOTH = {"motor_share": 0.1, "load_share": 0.1}
PLAIN = {"kp": 20.0, "kd": 0.5, "damping": 1.0, "damping_share": 0.25, "coulomb": 0.3}


@pytest.mark.parametrize(
    ("friction", "model", "numbers"),
    [
        ({}, "m1", {"friction_base": 0.3, "friction_viscous": 0.75, "kt": 0.75, "R": 0.75}),
        (FADES, "m2", {"friction_stribeck": 0.2, "dtheta_stribeck": 0.4, "alpha": 1.5}),
        (BOTH, "m3", {"load_friction_base": 0.1}),
        ({"stiction_share": 0.2}, "m4", {"load_friction_stribeck": 0.2, "load_friction_base": 0.0}),
        ({**FADES, **BOTH}, "m4", {"load_friction_stribeck": 0.0, "load_friction_base": 0.1}),
        ({"motor_share": 0.1}, "m5", {"load_friction_motor": 0.1, "friction_stribeck": 0.0}),
        (
            {**FADES, "load_share": 0.2, "stiction_share": 0.1}, "m5",
            {"load_friction_external": 0.2, "load_friction_motor_stribeck": 0.1},
        ),
    ],
)  # fmt: skip
def test_the_smallest_model_is_written(
    friction: dict[str, float], model: str, numbers: dict[str, float], tmp_path: Path
) -> None:
    own = ServoArm.of(arm("3r"), **PLAIN, **friction, clip=[5.0, float("inf"), 7.0], delay=0.02)
    done = export_dynamics(servo_dynamics(own), "bam", tmp_path, "arm", nominal=own.robot)
    (file,) = done.files
    joints = json.loads(file.read_text(encoding="utf-8"))
    assert file.name == "arm_bam.json"
    assert [one["dofs"] for one in joints.values()] == [[name] for name in own.robot.joint_names]
    for one, limit in zip(joints.values(), (5.0, 1e9, 7.0), strict=True):
        assert (one["error_gain"], one["max_pwm"]) == (20.0, limit)
        assert one["model"]["model"] == model
        assert set(one["model"]) == PUBLISHED[model]
        assert {name: one["model"][name] for name in numbers} == pytest.approx(numbers)
    assert "of the servos kd, delay are not in it" in " ".join(done.warnings)


def test_an_arm_without_servos_has_no_such_model(tmp_path: Path) -> None:
    with pytest.raises(TorchidError, match="none are known"):
        export_dynamics(arm("3r"), "bam", tmp_path, "arm", nominal=arm("3r"))
    assert not list(tmp_path.iterdir())
