import copy
import math

import pytest
import torch
import yaml

from torchid.errors import RobotError
from torchid.robot.model import JointType, joint_transforms, link_poses
from torchid.robot.placement import rotation_x, rotation_z
from torchid.robot.yaml_file import from_mapping, read_yaml

JOINTS = [
    {"type": "R", "a": 0.1, "alpha_deg": 90, "d": 0.3, "theta": 0.2, "name": "waist"},
    {"type": "P", "a": -0.2, "alpha": 0.7, "d": 0.1, "theta_deg": 30},
]
GOOD = {
    "name": "two",
    "dh": {"convention": "classical", "joints": JOINTS},
    "limits": {"position": [3.0, 0.5], "velocity": [[-1.0, 2.0], [-0.1, 0.2]]},
    "parameters": {
        "mass": [2.0, 1.0],
        "com": [[0.1, 0, 0], [0, 0, 0.2]],
        "inertia_about_com": [[1, 0, 0, 1, 0, 1]] * 2,
    },
    "effects": [{"effect": "viscous_friction", "joint": 2, "Fv": 0.1}],
    "drive_gain": [10.0, 20.0],
    "gravity": [0, 9.81, 0],
}


def changed(path: str, value: object) -> dict:
    """GOOD with one entry replaced, or removed where value is `...`."""
    data = copy.deepcopy(GOOD)
    keys = [int(k) if k.isdigit() else k for k in path.split(".")]
    place = data
    for key in keys[:-1]:
        place = place[key]
    if value is ...:
        del place[keys[-1]]
    else:
        place[keys[-1]] = value
    return data


def test_a_file_is_read(tmp_path):
    path = tmp_path / "two.yaml"
    path.write_text(yaml.safe_dump(GOOD), encoding="utf-8")
    robot = read_yaml(path)
    assert (robot.name, robot.n, robot.source) == ("two", 2, str(path))
    assert robot.joint_names == ("waist", "joint_2")
    assert robot.link_names == ("link_1", "link_2")
    assert robot.joint_types == (JointType.REVOLUTE, JointType.PRISMATIC)
    assert robot.gravity.tolist() == [0.0, 9.81, 0.0]
    assert robot.drive_gain.tolist() == [10.0, 20.0]
    assert dict(robot.effects[0]) == {"effect": "viscous_friction", "joint": 2, "Fv": 0.1}
    assert robot.parameters.mass.tolist() == [2.0, 1.0]
    assert robot.parameters.inertia_about_link_frame[0].tolist() == pytest.approx(
        [1, 0, 0, 1.02, 0, 1.02]
    )


def test_only_name_and_dh_are_needed():
    robot = from_mapping({"name": "r", "dh": GOOD["dh"]}, "r")
    assert robot.parameters is None
    assert robot.limits.position is None
    assert robot.effects == ()
    assert robot.gravity.tolist() == [0.0, 0.0, -9.81]
    assert robot.tool.equal(torch.eye(4, dtype=torch.float64))


def screw(turn: torch.Tensor, x: float = 0.0, z: float = 0.0) -> torch.Tensor:
    out = torch.eye(4, dtype=torch.float64)
    out[:3, :3] = turn
    out[0, 3], out[2, 3] = x, z
    return out


@pytest.mark.parametrize("convention", ["classical", "modified"])
def test_dh_equals_an_explicit_product(convention):
    data = changed("dh.convention", convention)
    robot = from_mapping(data, "two")
    q = torch.tensor([0.4, -0.3], dtype=torch.float64)
    theta, d = [0.2 + 0.4, math.radians(30)], [0.3, 0.1 - 0.3]
    a, alpha = [0.1, -0.2], [math.pi / 2, 0.7]
    steps = []
    for i in range(2):
        about_z = screw(rotation_z(theta[i]), z=d[i])
        about_x = screw(rotation_x(alpha[i]), x=a[i])
        steps.append(about_z @ about_x if convention == "classical" else about_x @ about_z)
    assert torch.allclose(joint_transforms(robot, q), torch.stack(steps), atol=1e-15)
    assert torch.allclose(link_poses(robot, q)[1], steps[0] @ steps[1], atol=1e-15)


def test_limits_are_symmetric_or_low_and_high():
    limits = from_mapping(GOOD, "two").limits
    assert limits.position.tolist() == [[-3.0, 3.0], [-0.5, 0.5]]
    assert limits.velocity.tolist() == [[-1.0, 2.0], [-0.1, 0.2]]
    assert limits.torque is None


def test_limits_may_be_infinite_and_then_are_missed_where_needed():
    robot = from_mapping(changed("limits.position", [math.inf, 1.0]), "two")
    assert robot.limits.position.tolist() == [[-math.inf, math.inf], [-1.0, 1.0]]
    with pytest.raises(RobotError, match="no finite position limits"):
        robot.limits.require("position", "velocity", robot="two", purpose="the test")
    robot.limits.require("velocity", robot="two", purpose="the test")


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("name", ..., "missing required field `name`"),
        ("dh", ..., "'dh' is missing"),
        ("dh.joints", ..., "missing required field `joints` - at `$.dh`"),
        ("dh.convention", "denavit", "'denavit' - at `$.dh.convention`"),
        ("dh.joints", [], "length >= 1 - at `$.dh.joints`"),
        ("dh.joints.1.type", "S", "'S' - at `$.dh.joints[1].type`"),
        ("dh.joints.0.alpha", 1.5, "both alpha and alpha_deg"),
        ("dh.joints.1.theta", 0, "both theta and theta_deg"),
        ("dh.joints.0.a", "x", "a: not a finite number"),
        ("dh.joints.0.d", math.nan, "d: not a finite number"),
        ("gravity", [0, 0, math.nan], "gravity: not all finite"),
        ("tool", [[1, 0], [0, 1]], "tool: wrong size"),
        ("limits.speed", [1, 2], "unknown field `speed` - at `$.limits`"),
        ("limits.position", [1], "limits.position: wrong size"),
        ("limits.position", [1, -1], "not below"),
        ("limits.position", [[1, 1], [0, 1]], "not below"),
        ("limits.position", [[0, 1], 1], "not numbers, or rows"),
        ("parameters.inertia_about_com", ..., "needs mass, com"),
        ("parameters.inertia_about_link_frame", [[1] * 6] * 2, "needs mass, com"),
        ("parameters.mass", [1, 2, 3], "mass: wrong size"),
        ("parameters.inertia_about_com", [[1] * 6, [1] * 5], "not numbers, or rows"),
        ("parameters.mass", ["1e-3", 1], "not numbers"),
        ("drive_gain", [1], "drive_gain: wrong size"),
        ("effects", "friction", "list of records"),
        ("effects", [{"joint": 1}], "'effect'"),
        ("effects.0.joint", 3, "joint that does not exist"),
        ("effects.0.joint", "2", "joint that does not exist"),
        ("basis", "khalil", "'khalil' - at `$.basis`"),
    ],
)
def test_errors_say_what_is_wrong_and_where(path, value, message):
    with pytest.raises(RobotError) as raised:
        from_mapping(changed(path, value), "two.yaml")
    assert message in str(raised.value)
    assert "two.yaml" in str(raised.value)


def test_numbers_that_yaml_takes_for_text_get_a_hint():
    for path, value in (("dh.joints.0.a", "1e-3"), ("parameters.mass", ["1e-3", 1.0])):
        with pytest.raises(RobotError) as raised:
            from_mapping(changed(path, value), "two")
        assert "1.0e-3" in raised.value.hint


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"name: [1", "not valid yaml"),
        (b"\xff\xfe\x00\xd8", "not valid yaml"),
        (b"!!python/object:os.system {}", "not valid yaml"),
        (b"", "not a robot description"),
        (b"just text", "not a robot description"),
        (b"name: r", "'dh' is missing"),
    ],
)
def test_other_files_are_refused(tmp_path, content, message):
    path = tmp_path / "r.yaml"
    path.write_bytes(content)
    with pytest.raises(RobotError) as raised:
        read_yaml(path)
    assert message in str(raised.value)
    assert str(path) in str(raised.value)
