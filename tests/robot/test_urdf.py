import math
from pathlib import Path

import numpy as np
import pytest
import torch

from torchid.errors import RobotError
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, link_poses, tool_pose
from torchid.robot.shapes import link_shapes
from torchid.robot.urdf import read_urdf

EXACT = 1e-12
INERTIAL = (
    '<inertial><mass value="1"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
)


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside}</joint>"
    )


def link(name: str, inside: str = INERTIAL) -> str:
    return f'<link name="{name}">{inside}</link>'


def write(tmp_path: Path, *parts: str, root: str = 'robot name="r"') -> Path:
    path = tmp_path / "r.urdf"
    path.write_text(f"<{root}>{''.join(parts)}</{root.split()[0]}>", encoding="utf-8")
    return path


def one_joint(tmp_path: Path, inside: str = "", kind: str = "revolute", body: str = INERTIAL):
    return read_urdf(
        write(tmp_path, link("a"), link("b", body), joint("j", "a", "b", kind, inside))
    )


# The arm, against independent readers


def test_link_poses_equal_pinocchios(arm_urdf, configurations):
    pin = pytest.importorskip("pinocchio")
    robot = read_urdf(arm_urdf)
    model = pin.buildModelFromUrdf(str(arm_urdf))
    data = model.createData()
    ours, tool = link_poses(robot, configurations), tool_pose(robot, configurations)
    for k, q in enumerate(configurations.numpy()):
        # A continuous joint is (cos, sin) in Pinocchio's configuration.
        pin.framesForwardKinematics(model, data, pin.integrate(model, pin.neutral(model), q))
        for i in range(6):
            expected = data.oMi[i + 1].homogeneous
            assert np.abs(ours[k, i].numpy() - expected).max() < EXACT
        expected = data.oMf[model.getFrameId("tcp")].homogeneous
        assert np.abs(tool[k].numpy() - expected).max() < EXACT


def test_merged_inertias_equal_pinocchios(arm_urdf):
    pin = pytest.importorskip("pinocchio")
    robot = read_urdf(arm_urdf)
    model = pin.buildModelFromUrdf(str(arm_urdf))
    ours = robot.require_parameters("the test").to_pinocchio_order()
    for i in range(6):
        expected = model.inertias[i + 1].toDynamicParameters()
        assert np.abs(ours[i].numpy() - expected).max() < EXACT
    masses = robot.parameters.mass.tolist()
    # l2 carries the elbow, l3 the camera, l6 the tool; the base's 9 kg are nobody's.
    assert masses == pytest.approx([4.0, 3.5, 1.8, 1.0, 0.8, 0.65], abs=1e-14)


def test_what_the_arm_is(arm_urdf):
    robot = read_urdf(arm_urdf)
    r, p = JointType.REVOLUTE, JointType.PRISMATIC
    assert robot.name == "arm"
    assert robot.joint_names == ("j1", "j2", "j3", "j4", "j5", "j6")
    assert robot.link_names == ("l1", "l2", "l3", "l4", "l5", "l6")
    assert robot.joint_types == (r, r, p, r, r, r)
    assert robot.source == str(arm_urdf)
    assert robot.warnings == ()
    assert robot.gravity.tolist() == [0.0, 0.0, -9.81]
    for tensor in (robot.before, robot.after, robot.tool, robot.gravity, robot.parameters.pi):
        assert tensor.dtype == torch.float64
    axes = [[0, 0, 1], [0, -1, 0], [1 / 3, 2 / 3, -2 / 3], [1, 0, 0], [0, 0, -1]]
    assert torch.allclose(robot.axes[:5], torch.tensor(axes, dtype=torch.float64), atol=1e-15)


def test_limits_and_friction_of_the_arm(arm_urdf):
    robot = read_urdf(arm_urdf)
    inf = math.inf
    position = [[-2.9, 2.5], [-inf, inf], [0.0, 0.4], [-1.0, 1.0], [-3.0, 3.0], [-3.0, 3.0]]
    assert robot.limits.position.tolist() == position
    assert robot.limits.velocity[:, 1].tolist() == [2.0, 1.5, 0.5, 3.0, 3.0, 4.0]
    assert robot.limits.torque[:, 0].tolist() == [-80.0, -60.0, -100.0, -20.0, -20.0, -10.0]
    assert robot.limits.acceleration is None
    assert [dict(effect) for effect in robot.effects] == [
        {"effect": "viscous_friction", "joint": 1, "Fv": 0.7},
        {"effect": "viscous_friction", "joint": 3, "Fv": 12.0},
        {"effect": "viscous_friction", "joint": 6, "Fv": 0.1},
        {"effect": "coulomb_friction", "joint": 1, "Fc": 0.25},
        {"effect": "coulomb_friction", "joint": 6, "Fc": 0.05},
    ]


def test_numbers_keep_all_their_digits(tmp_path):
    # Through float32, as other readers have it, 0.1 would be 0.10000000149.
    robot = one_joint(tmp_path, '<origin xyz="0.1 0.2 0.3"/>')
    assert robot.before[0, :3, 3].tolist() == [0.1, 0.2, 0.3]


def test_a_tip_in_the_middle_ends_the_chain(arm_urdf, configurations):
    whole, part = read_urdf(arm_urdf), read_urdf(arm_urdf, tip="elbow")
    assert part.joint_names == ("j1", "j2")
    assert torch.equal(part.parameters.pi, whole.parameters.pi[:2])
    (warning,) = part.warnings
    assert "j3" in warning
    assert "'l6'" in warning
    assert "not included" in warning
    expected = link_poses(whole, configurations)[..., 1, :, :] @ part.tool
    torch.testing.assert_close(
        tool_pose(part, configurations[:, :2]), expected, rtol=1e-12, atol=1e-12
    )
    assert part.tool[:3, 3].tolist() == [0.4, 0.01, -0.02]


# Single values


def test_missing_axis_is_x(tmp_path):
    assert one_joint(tmp_path).axes.tolist() == [[1.0, 0.0, 0.0]]


@pytest.mark.parametrize("axis", ["0 0 3", "0 -1 0", "-1 0 0", "1 1 1"])
def test_axis_is_normalised(tmp_path, axis):
    robot = one_joint(tmp_path, f'<axis xyz="{axis}"/>')
    expected = np.array([float(v) for v in axis.split()])
    assert robot.axes[0].numpy() == pytest.approx(expected / np.linalg.norm(expected), abs=1e-15)


def test_joint_at_zero_is_its_origin(tmp_path):
    robot = one_joint(tmp_path, '<origin xyz="1 2 3" rpy="0 0 0.4"/><axis xyz="1 2 3"/>')
    at_zero = link_poses(robot, torch.zeros(1, dtype=torch.float64))[0]
    c, s = math.cos(0.4), math.sin(0.4)
    expected = [[c, -s, 0, 1], [s, c, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    assert torch.allclose(at_zero, torch.tensor(expected, dtype=torch.float64), atol=1e-15)


def test_quaternion_origin(tmp_path):
    half = math.sqrt(0.5)
    robot = one_joint(tmp_path, f'<origin quat_xyzw="0 0 {half} {half}"/><axis xyz="0 0 1"/>')
    assert robot.before[0, :3, :3].tolist() == [[0, -1, 0], [1, 0, 0], [0, 0, 1]]


def test_inertial_origin_turns_the_tensor(tmp_path):
    body = (
        '<inertial><origin rpy="0 0 1.5707963267948966"/><mass value="2"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="2.5"/></inertial>'
    )
    pi = one_joint(tmp_path, body=body).parameters.pi[0]
    assert pi.tolist() == [2, 0, 0, 0, 2, 0, 0, 1, 0, 2.5]


def test_inertia_is_about_the_centre_of_mass_of_the_same_body(tmp_path):
    # Seen elsewhere: the inertia taken as about the link frame, or that of the next body.
    body = (
        '<inertial><origin xyz="0.5 0 0"/><mass value="2"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    )
    path = write(
        tmp_path, link("a"), link("b", body), link("c"), joint("j", "a", "b"), joint("k", "b", "c")
    )
    parameters = read_urdf(path).parameters
    assert parameters.pi[0].tolist() == [2, 1, 0, 0, 1, 0, 0, 1.5, 0, 1.5]
    assert parameters.inertia_about_com.tolist() == [[1, 0, 0, 1, 0, 1]] * 2
    assert parameters.pi[1].tolist() == [1, 0, 0, 0, 1, 0, 0, 1, 0, 1]


def test_limits_not_given_are_infinite_or_none(tmp_path):
    assert one_joint(tmp_path).limits.position is None
    assert one_joint(tmp_path, kind="continuous").limits.position is None
    path = write(
        tmp_path,
        link("a"),
        link("b"),
        link("c"),
        joint("j", "a", "b", inside='<limit upper="2" effort="inf"/>'),
        joint("k", "b", "c", inside='<limit velocity="3"/>'),
    )
    limits = read_urdf(path).limits
    assert limits.position.tolist() == [[0.0, 2.0], [-math.inf, math.inf]]
    assert limits.velocity.tolist() == [[-math.inf, math.inf], [-3.0, 3.0]]
    assert limits.torque is None


def test_zero_limits_are_told_and_not_used(tmp_path):
    robot = one_joint(tmp_path, '<limit lower="0" upper="0" effort="0" velocity="0"/>')
    assert (robot.limits.position, robot.limits.velocity, robot.limits.torque) == (None,) * 3
    (warning,) = robot.warnings
    assert warning.endswith("position of 'j'; velocity of 'j'; effort of 'j'")


def test_negative_damping_is_told(tmp_path):
    robot = one_joint(tmp_path, '<dynamics damping="-1"/>')
    assert robot.effects[0]["Fv"] == -1.0
    assert any("negative damping" in warning for warning in robot.warnings)


def test_without_any_inertial_there_are_no_parameters(tmp_path):
    robot = one_joint(tmp_path, body="")
    assert robot.parameters is None
    assert robot.warnings == ("no link of the chain has inertial parameters",)
    with pytest.raises(RobotError, match="no inertial parameters"):
        robot.require_parameters("the test")


def test_some_missing_inertials_are_zeros_by_name(tmp_path):
    path = write(
        tmp_path, link("a"), link("b", ""), link("c"), joint("j", "a", "b"), joint("k", "b", "c")
    )
    robot = read_urdf(path)
    assert robot.parameters.pi[0].abs().max() == 0
    assert robot.parameters.mass.tolist() == [0.0, 1.0]
    (warning,) = robot.warnings
    assert "'b'" in warning
    assert "zeros" in warning


@pytest.mark.parametrize(
    ("tensor", "consistent"),
    [((1, 1, 1), True), ((1, 1, 2), True), ((1, 1, 2.01), False), ((1, 1, -1), False)],
)
def test_inconsistent_inertias_are_told(tmp_path, tensor, consistent):
    body = (
        '<inertial><origin xyz="0.3 0.2 0.1" rpy="1 2 3"/><mass value="2"/><inertia '
        'ixx="{}" ixy="0" ixz="0" iyy="{}" iyz="0" izz="{}"/></inertial>'.format(*tensor)
    )
    robot = one_joint(tmp_path, body=body)
    told = [w for w in robot.warnings if "not physically consistent" in w and "'b'" in w]
    assert bool(told) is not consistent


# Structure


def gripper(tmp_path: Path) -> Path:
    return write(
        tmp_path,
        *(link(name) for name in ("base", "arm", "hand", "left", "right", "pad")),
        joint("j", "base", "arm"),
        joint("h", "arm", "hand", "fixed"),
        joint("f1", "hand", "left", "prismatic"),
        joint("f2", "hand", "right", "prismatic", '<mimic joint="f1"/>'),
        joint("p", "left", "pad", "fixed"),
    )


def test_branches_are_read_whole(tmp_path):
    robot = read_urdf(gripper(tmp_path))
    assert robot.joint_names == ("j", "f1")
    assert robot.link_names == ("arm", "left", "right")
    assert robot.parents == (-1, 0, 0)
    (mimic,) = robot.mimics
    assert (mimic.joint, mimic.link, mimic.coordinate, mimic.ratio) == ("f2", 2, 1, 1.0)
    assert [(tip.name, tip.link) for tip in robot.tips] == [("pad", 1), ("right", 2)]
    assert robot.parameters.mass.tolist() == [2.0, 2.0, 1.0]
    assert robot.warnings == ()


def test_a_tip_before_the_branching_leaves_the_fingers_out(tmp_path):
    robot = read_urdf(gripper(tmp_path), tip="hand")
    assert robot.n == 1
    assert robot.parameters.mass.tolist() == [2.0]
    assert len(robot.warnings) == 2
    assert "'f1'" in robot.warnings[0]
    assert "'left', 'pad' (2 kg)" in robot.warnings[0]
    assert "'right' (1 kg)" in robot.warnings[1]


def test_a_tip_on_a_finger_takes_one_branch(tmp_path):
    robot = read_urdf(gripper(tmp_path), tip="pad")
    assert robot.joint_names == ("j", "f1")
    assert robot.parameters.mass.tolist() == [2.0, 2.0]
    assert [w.split("'")[1] for w in robot.warnings] == ["f2"]


def test_a_mimic_of_what_is_not_part_of_the_chain_is_refused(tmp_path):
    with pytest.raises(RobotError, match="'f2' mimics joint 'f1'") as raised:
        read_urdf(gripper(tmp_path), tip="right")
    assert "lock 'f2'" in raised.value.hint
    assert read_urdf(gripper(tmp_path), tip="right", lock={"f2": 0.1}).joint_names == ("j",)


def test_joints_of_more_freedom_are_refused(tmp_path):
    with pytest.raises(RobotError, match="'j' is planar"):
        one_joint(tmp_path, kind="planar")


def test_two_fixed_ends_leave_the_tool_at_the_link(tmp_path):
    path = write(
        tmp_path,
        *(link(name) for name in "abcd"),
        joint("j", "a", "b"),
        joint("t", "b", "c", "fixed", '<origin xyz="1 0 0"/>'),
        joint("s", "b", "d", "fixed", '<origin xyz="0 1 0"/>'),
    )
    robot = read_urdf(path)
    assert robot.tool.equal(torch.eye(4, dtype=torch.float64))
    assert "(c, d)" in robot.warnings[0]
    assert read_urdf(path, tip="d").tool[:3, 3].tolist() == [0.0, 1.0, 0.0]
    assert read_urdf(path, tip="d").warnings == ()


def test_a_world_that_is_nowhere_declared_is_what_the_base_stands_on(tmp_path):
    parts = (joint("stand", "world", "a", "fixed"), link("a"), link("b"), joint("j", "a", "b"))
    path = write(tmp_path, *parts)
    robot = read_urdf(path)
    assert (robot.n, robot.root) == (1, None)
    assert any("'world' is nowhere declared" in said for said in robot.warnings)
    assert link_shapes(robot) is not None


def test_a_link_may_be_named_as_mujocos_own(tmp_path):
    parts = (joint("stand", "world", "a", "fixed"), link("world", ""), A, B, joint("j", "a", "b"))
    robot = read_urdf(write(tmp_path, *parts))
    assert (robot.base.name, robot.link_names, robot.warnings) == ("world", ("b",), ())
    assert read_urdf(tmp_path / "r.urdf", root="world").joint_names == ("j",)


def test_limits_that_do_not_count_are_numbers_too(tmp_path):
    for kind in ("continuous", "planar"):
        with pytest.raises(RobotError, match="<limit lower> is not a number"):
            one_joint(tmp_path, '<limit lower="x"/>', kind)


def test_unknown_tip_lists_the_links(tmp_path):
    with pytest.raises(RobotError) as raised:
        read_urdf(gripper(tmp_path), tip="nose")
    assert raised.value.got == "nose"
    assert raised.value.available == ["base", "arm", "hand", "left", "right", "pad"]


def test_a_tip_nothing_moves_is_refused(tmp_path):
    with pytest.raises(RobotError, match="no joint can move between"):
        read_urdf(gripper(tmp_path), tip="base")


A, B, C = link("a"), link("b"), link("c")


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((), "no links"),
        ((A,), "no joint can move"),
        ((A, B, joint("j", "a", "b", "fixed")), "no joint can move"),
        ((A, A, joint("j", "a", "b")), "two links have the same name"),
        ((A, B, C, joint("j", "a", "b"), joint("j", "b", "c")), "two joints have the same name"),
        ((A, B, joint("j", "a", "z")), "parent or child missing"),
        ((A, B, joint("j", "z", "b")), "parent or child missing"),
        ((A, B, C, joint("j", "a", "c"), joint("k", "b", "c")), "multiple parents"),
        ((A, B, joint("j", "a", "b"), joint("k", "b", "a")), "cycle"),
        ((A, B, C, joint("j", "b", "c"), joint("k", "c", "b")), "cycle"),
        ((A, B, joint("j", "b", "b")), "cycle"),
        ((A, B, C, joint("j", "a", "b")), "one root"),
        ((A, B, joint("j", "a", "b", "hinge")), "invalid joint type"),
        ((A, B, '<joint name="j"><parent link="a"/><child link="b"/></joint>'), "'type'"),
        ((A, B, '<joint name="j" type="revolute"><child link="b"/></joint>'), "<parent>"),
        ((A, "<link/>"), "'name'"),
    ],
)
def test_broken_structures_are_refused(tmp_path, parts, message):
    with pytest.raises(RobotError) as raised:
        read_urdf(write(tmp_path, *parts))
    assert message in str(raised.value)


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ('<origin xyz="0 0 zero"/>', "bad format in attribute 'xyz'"),
        ('<origin xyz="0,1 0 0"/>', "bad format in attribute 'xyz'"),
        ('<origin xyz="0 0"/>', "'xyz' does not have enough data"),
        ('<origin rpy="0 nan 0"/>', "<origin rpy> is not finite"),
        ('<origin xyz="0 inf 0"/>', "not all numbers are finite"),
        ('<origin quat_xyzw="0 0 0 0"/>', "quat_xyzw"),
        ('<axis xyz="0 0 0"/>', "no direction"),
        ('<axis xyz="0 0 1e-200"/>', "no direction"),
        ('<limit lower="x"/>', "<limit>: bad format in attribute 'lower'"),
        ('<limit lower="nan"/>', "<limit lower> is not finite"),
        ('<limit lower="1" upper="-1"/>', "not below"),
        ('<limit effort="-5"/>', "negative"),
        ('<dynamics damping="soft"/>', "<dynamics>: bad format in attribute 'damping'"),
        ('<origin xyz="${d} 0 0"/>', "xacro macro"),
    ],
)
def test_broken_values_of_a_joint_are_named(tmp_path, inside, message):
    with pytest.raises(RobotError, match=r"(joint 'j'|link 'b')") as raised:
        one_joint(tmp_path, inside)
    assert message in str(raised.value)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("<inertial/>", "missing element: 'mass'"),
        ('<inertial><mass value="1"/></inertial>', "missing element: 'inertia'"),
        (INERTIAL.replace('value="1"', 'value="heavy"'), "<mass>: bad format in attribute 'value'"),
        (INERTIAL.replace('value="1"', ""), "'value'"),
        (INERTIAL.replace('ixy="0"', ""), "'ixy'"),
        (INERTIAL.replace('izz="1"', 'izz="1 2"'), "'izz' has too much data"),
    ],
)
def test_broken_values_of_a_link_are_named(tmp_path, body, message):
    with pytest.raises(RobotError, match="link 'b'") as raised:
        one_joint(tmp_path, body=body)
    assert message in str(raised.value)


# Files


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"<robot><link></robot>", "not valid XML"),
        (b"", "not valid XML"),
        (b"\x00\x01\xff", "not valid XML"),
        (b"<mujoco/>", "this is MJCF"),
        (b"<sdf/>", "this is SDF"),
        (b"<html/>", "not a URDF"),
        (b'<robot><xacro:include filename="a"/></robot>', "xacro"),
    ],
)
def test_other_files_are_refused(tmp_path, content, message):
    path = tmp_path / "r.urdf"
    path.write_bytes(content)
    with pytest.raises(RobotError) as raised:
        read_urdf(path)
    assert message in str(raised.value)


def test_blank_lines_namespaces_and_encodings_are_forgiven(tmp_path):
    text = (
        '\n\n<?xml version="1.0" encoding="iso-8859-1"?><robot xmlns="http://drake.mit.edu">'
        f"<!-- \xe9 --><?pi?>{A}{B}{joint('j', 'a', 'b')}</robot>"
    )
    path = tmp_path / "plain.urdf"
    path.write_bytes(text.encode("latin-1"))
    robot = read_urdf(path)
    assert robot.name == "plain"
    assert isinstance(robot.parameters, InertialParameters)
