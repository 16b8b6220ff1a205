import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from torchid.effects.base import Motion
from torchid.effects.registry import effect_torque, nominal_effects
from torchid.errors import RobotError
from torchid.robot.inertia import InertialParameters, move
from torchid.robot.library import load_robot
from torchid.robot.mjcf import mjcf_servos, read_mjcf
from torchid.robot.model import JointType, Robot, link_poses
from torchid.robot.shapes import link_shapes
from torchid.robot.writer import write_robot
from torchid.simulation.servo_loop import compensation

# Joints off the body's origin, two joints on one body, a slide, angles in degrees and `ref`,
# oblique axes, bodies without joints in the middle and at the end, inertias from geometry.
ARM = """
<mujoco model="arm">
  <compiler angle="degree"/>
  <option gravity="0.5 -1 -9"/>
  <worldbody>
    <body name="table" pos="0.1 0.2 0.3" euler="10 20 30">
      <geom size="1"/>
      <body name="b1" pos="0 0 0.4" euler="0 30 0">
        <joint name="j1" axis="0 0 1" pos="0.1 -0.05 0.2" range="-100 120" damping="0.5"/>
        <inertial pos="0.01 0.02 0.1" mass="3" fullinertia="0.05 0.04 0.03 0.002 -0.003 0.001"/>
        <body name="b2" pos="0.3 0 0" quat="0.9 0.1 -0.3 0.2">
          <joint name="j2a" axis="1 2 3" pos="0 0.1 0" ref="25" armature="0.02"/>
          <joint name="j2b" axis="0 -1 0" pos="-0.2 0 0.1" damping="0.1"/>
          <geom type="capsule" size="0.05" fromto="0 0 0 0.3 0.1 0"/>
          <body name="bracket" pos="0.3 0.1 0" euler="0 0 45">
            <geom type="box" size="0.03 0.04 0.05" pos="0 0.02 0"/>
            <body name="b3" pos="0.05 0 0" euler="90 0 0">
              <joint name="j3" type="slide" axis="0 1 1" ref="0.1" range="-0.2 0.3" damping="9"/>
              <geom type="cylinder" size="0.03 0.1" pos="0.02 0 0"/>
              <body name="hand" pos="0 0 0.2" euler="5 6 7">
                <joint name="j4" axis="0 0 -1" armature="0.01"/>
                <geom type="ellipsoid" size="0.03 0.02 0.05" pos="0.01 0 0"/>
                <body name="tcp" pos="0 0.01 0.1" euler="0 90 0">
                  <geom size="0.02"/>
                  <site name="tip" pos="0.01 0.02 0.03" euler="1 2 3"/>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
BALL = '<geom size="0.1"/>'


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "model.xml"
    path.write_text(text, encoding="utf-8")
    return path


def one_joint(tmp_path: Path, joint: str = "", rest: str = "", option: str = "") -> Robot:
    return read_mjcf(
        write(
            tmp_path,
            f'<mujoco><compiler angle="radian"/>{option}<worldbody><body name="b">'
            f'<joint name="j" {joint}/>{BALL}</body></worldbody>{rest}</mujoco>',
        )
    )


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    return write(tmp_path, ARM)


def states(count: int, n: int) -> np.ndarray:
    return np.random.default_rng(5).uniform(-1.5, 1.5, (3, count, n))


def pinocchio_model(pin, robot: Robot):
    """The robot in Pinocchio, joint by joint: a joint frame each, inertias carried into it."""
    model = pin.Model()
    model.gravity.linear = robot.gravity.numpy()
    parameters = robot.require_parameters("the test").pi
    previous, parent = torch.eye(4, dtype=torch.float64), 0
    for i in range(robot.n):
        revolute = robot.joint_types[i] is JointType.REVOLUTE
        placement = pin.SE3((previous @ robot.before[i]).numpy())
        kind = pin.JointModelRZ() if revolute else pin.JointModelPZ()
        parent = model.addJoint(parent, kind, placement, robot.joint_names[i])
        in_joint = InertialParameters(move(parameters[i], robot.after[i]))
        if in_joint.mass > 0:  # Pinocchio divides by the mass
            body = pin.Inertia.FromDynamicParameters(in_joint.to_pinocchio_order().numpy())
            model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        previous = robot.after[i]
    return model


def test_inverse_dynamics_equal_mujocos(arm):
    pin = pytest.importorskip("pinocchio")
    robot = read_mjcf(arm)
    model = mujoco.MjModel.from_xml_path(str(arm))
    # Limits and dry friction are constraints to MuJoCo, no part of the equations of motion.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(model)
    ours = pinocchio_model(pin, robot)
    extra = {name: np.zeros(5) for name in ("Fv", "Ia")}
    for effect in robot.effects:
        for name, values in extra.items():
            values[effect["joint"] - 1] += effect.get(name, 0.0)
    for q, dq, ddq in np.stack(list(states(20, 5)), 1):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        torque = pin.rnea(ours, ours.createData(), q, dq, ddq)
        torque += extra["Fv"] * dq + extra["Ia"] * ddq
        assert np.abs(torque - data.qfrc_inverse).max() < 1e-10 * np.abs(torque).max()


def test_what_the_arm_is(arm):
    robot = read_mjcf(arm)
    r, p = JointType.REVOLUTE, JointType.PRISMATIC
    assert robot.name == "arm"
    assert robot.joint_names == ("j1", "j2a", "j2b", "j3", "j4")
    assert robot.link_names == ("b1", "b2/j2a", "b2", "b3", "hand")
    assert robot.joint_types == (r, r, r, p, r)
    assert robot.gravity.tolist() == [0.5, -1.0, -9.0]
    assert robot.warnings == ()
    assert [dict(effect) for effect in robot.effects] == [
        {"effect": "viscous_friction", "joint": 1, "Fv": 0.5},
        {"effect": "viscous_friction", "joint": 3, "Fv": 0.1},
        {"effect": "viscous_friction", "joint": 4, "Fv": 9.0},
        {"effect": "rotor_inertia", "joint": 2, "Ia": 0.02},
        {"effect": "rotor_inertia", "joint": 5, "Ia": 0.01},
    ]
    position = robot.limits.position
    assert position[0].tolist() == pytest.approx([math.radians(-100), math.radians(120)])
    assert position[3].tolist() == [-0.2, 0.3]
    assert position[[1, 2, 4], 1].tolist() == [math.inf] * 3
    assert robot.limits.velocity is None
    assert robot.limits.torque is None


def test_masses_are_those_of_the_moving_bodies(arm):
    robot = read_mjcf(arm)
    mass = mujoco.MjModel.from_xml_path(str(arm)).body
    m = {name: float(mass(name).mass[0]) for name in ("b1", "b2", "bracket", "b3", "hand", "tcp")}
    expected = [m["b1"], 0.0, m["b2"] + m["bracket"], m["b3"], m["hand"] + m["tcp"]]
    assert robot.parameters.mass.tolist() == pytest.approx(expected, abs=1e-14)
    full = robot.parameters.inertia_about_com[0]
    expected = [0.05, 0.002, -0.003, 0.04, 0.001, 0.03]
    assert full.tolist() == pytest.approx(expected, abs=1e-14)


def test_ref_is_where_the_body_is_as_drawn(tmp_path):
    hinge = one_joint(tmp_path, 'axis="0 0 1" ref="0.5"')
    slide = one_joint(tmp_path, 'type="slide" axis="0 0 1" ref="0.5"')
    for robot in (hinge, slide):
        at = link_poses(robot, torch.tensor([0.5], dtype=torch.float64))[0]
        assert torch.allclose(at, torch.eye(4, dtype=torch.float64), atol=1e-15)


def test_friction_loss_is_coulomb_friction(tmp_path):
    robot = one_joint(tmp_path, 'frictionloss="0.3"')
    assert [dict(e) for e in robot.effects] == [
        {"effect": "coulomb_friction", "joint": 1, "Fc": 0.3}
    ]


def test_damping_over_speed_is_mujocos(tmp_path):
    robot = one_joint(tmp_path, 'damping="2 -1.5 0.5"')
    assert "linear part alone" in " ".join(robot.warnings)
    model = mujoco.MjModel.from_xml_path(robot.source)
    data, speeds = mujoco.MjData(model), torch.linspace(-3, 3, 13, dtype=torch.float64).unsqueeze(1)
    motion = Motion(0 * speeds, speeds, 0 * speeds)
    torques = effect_torque(robot, nominal_effects(robot), motion)
    for speed, torque in zip(speeds, torques, strict=True):
        data.qvel[:] = speed
        mujoco.mj_forward(model, data)
        assert float(torque) == pytest.approx(-data.qfrc_damper[0], rel=1e-12)


def test_damping_of_a_joint_that_follows_is_part_of_the_others(tmp_path):
    """Power: what the follower's damper takes is what the torque on its coordinate takes."""
    body = '<body><joint name="{0}"{1}/><geom size="0.1" mass="1"/>'
    upper, lower = body.format("a", ""), body.format("b", ' damping="2 -1 0.5"')
    text = f"""<mujoco><worldbody>{upper}{lower}</body></body></worldbody><equality>
    <joint joint1="b" joint2="a" polycoef="0 -2 0 0 0"/></equality></mujoco>"""
    robot = read_mjcf(write(tmp_path, text))
    speed = torch.tensor([[0.7]], dtype=torch.float64)
    torque = effect_torque(robot, nominal_effects(robot), Motion(0 * speed, speed, 0 * speed))
    assert float(torque * 0.7) == pytest.approx(2 * 1.4**2 - 1.4**3 + 0.5 * 1.4**4, rel=1e-12)


def test_a_spring_is_an_effect(tmp_path):
    robot = one_joint(tmp_path, 'stiffness="4" springref="0.2"')
    (spring,) = robot.effects
    assert (spring["effect"], spring["joint"], spring["k"]) == ("joint_spring", 1, 4.0)
    assert spring["c0"] == pytest.approx(-0.8, rel=1e-14)
    assert robot.warnings == ()


@pytest.mark.parametrize(
    ("joint", "actuators", "torque"),
    [
        ('actuatorfrcrange="-2 3"', "", [-2.0, 3.0]),
        ("", '<motor joint="j" gear="-10" forcerange="-1 2"/>', [-20.0, 10.0]),
        ("", '<motor joint="j"/>', None),
        ("", '<motor joint="j" forcerange="-1 1"/>' * 2, None),
    ],
)
def test_torque_limits(tmp_path, joint, actuators, torque):
    robot = one_joint(tmp_path, joint, f"<actuator>{actuators}</actuator>")
    if torque is None:
        assert robot.limits.torque is None
    else:
        assert robot.limits.torque.tolist() == [torque]


@pytest.mark.parametrize(
    ("joint", "rest", "option", "words"),
    [
        ("", '<equality><joint joint1="j"/></equality>', "", "1 equality constraint"),
        ("", '<tendon><fixed><joint joint="j" coef="1"/></fixed></tendon>', "", "1 tendon"),
        ("", "", '<option density="1000"/>', "fluid"),
        ("", "", '<option><flag gravity="disable"/></option>', "gravity off"),
    ],
)
def test_what_is_not_modelled_is_told(tmp_path, joint, rest, option, words):
    (warning,) = one_joint(tmp_path, joint, rest, option).warnings
    assert words in warning


def test_gravity_turned_off_is_zero(tmp_path):
    robot = one_joint(tmp_path, option='<option><flag gravity="disable"/></option>')
    assert robot.gravity.tolist() == [0.0, 0.0, 0.0]


def test_gravity_compensation_is_told(tmp_path):
    text = f'<mujoco><worldbody><body gravcomp="1"><joint/>{BALL}</body></worldbody></mujoco>'
    robot = read_mjcf(write(tmp_path, text))
    assert "gravcomp" in robot.warnings[0]
    assert (robot.name, robot.joint_names, robot.link_names) == ("model", ("joint_0",), ("body_1",))


COMPENSATED = """<mujoco><option gravity="1 2 -9"/><worldbody>
  <body name="a" gravcomp="0.7" pos="0 0 1"><joint name="j" axis="0 1 0"/>
    <inertial pos="0.1 0 0.2" mass="2" diaginertia="0.1 0.1 0.1"/>
    <body name="bolted" gravcomp="0.2" pos="0.3 0 0">
      <inertial pos="0 0.1 0" mass="1" diaginertia="0.1 0.1 0.1"/>
      <body name="b"><joint name="k" axis="1 0 0" pos="0 0.1 0" actuatorgravcomp="true"/>
        <inertial pos="0 0 0.3" mass="0.5" diaginertia="0.1 0.1 0.1"/></body></body></body>
</worldbody></mujoco>"""


def test_what_gravcomp_takes_of_the_weight_is_mujocos(tmp_path):
    """Shares of bodies that move as one, which differ; in yaml as in the file."""
    robot = read_mjcf(write(tmp_path, COMPENSATED))
    assert robot.compensated[0].tolist() == pytest.approx([1.6, 0.2, 0.02, 0.28])
    assert robot.compensated[1].tolist() == [0.0] * 4
    model = mujoco.MjModel.from_xml_string(COMPENSATED)
    data, q = mujoco.MjData(model), [0.4, -0.7]
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    write_robot(robot, tmp_path / "arm.yaml")
    for one in (robot, load_robot(tmp_path / "arm.yaml")):
        found = compensation(one, torch.tensor([q]).double())
        assert found[0].tolist() == pytest.approx(data.qfrc_gravcomp.tolist())
    assert compensation(replace(robot, compensated=None), torch.tensor([q])).tolist() == [[0, 0]]


def two_arms(tmp_path: Path, second: str = "<joint name='k'/>") -> Path:
    return write(
        tmp_path,
        f"<mujoco><worldbody><body name='a'><joint name='j'/>{BALL}</body>"
        f"<body name='b'>{second}{BALL}</body></worldbody></mujoco>",
    )


def test_several_bodies_are_read_whole_or_one_chain(tmp_path):
    both = read_mjcf(two_arms(tmp_path))
    assert (both.joint_names, both.parents) == (("j", "k"), (-1, -1))
    assert [tip.name for tip in both.tips] == ["a", "b"]
    robot = read_mjcf(two_arms(tmp_path), tip="b")
    assert robot.joint_names == ("k",)
    assert robot.warnings == ()


def test_a_free_object_beside_the_arm_is_part_of_the_base(tmp_path):
    path = two_arms(tmp_path, "<freejoint name='k'/>")
    robot = read_mjcf(path)
    assert robot.joint_names == ("j",)
    assert "'b' (joint 'k') can float: it is taken as fixed" in robot.warnings[0]
    with pytest.raises(RobotError, match="no joint can move between the root 'world'"):
        read_mjcf(path, tip="b")


def test_ball_joints_are_refused(tmp_path):
    with pytest.raises(RobotError, match="'j' is a ball joint"):
        one_joint(tmp_path, 'type="ball"')


def test_unknown_tip_lists_the_bodies(arm):
    with pytest.raises(RobotError) as raised:
        read_mjcf(arm, tip="nose")
    assert "hand" in raised.value.available


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco><worldbody><body/></worldbody></mujoco>", "no joint can move"),
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "cannot compile"),
        ("<mujoco><wrong/></mujoco>", "cannot compile"),
        ("<mujoco>", "not valid XML"),
        ("<robot/>", "this is a URDF"),
    ],
)
def test_broken_files_are_refused(tmp_path, text, message):
    with pytest.raises(RobotError) as raised:
        load_robot(write(tmp_path, text))
    assert message in str(raised.value)


@pytest.mark.parametrize(
    "text",
    [
        '<mujoco><asset><mesh name="m" file="no.stl"/></asset><worldbody><body><joint/>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>',
        '<mujoco><include file="no.xml"/></mujoco>',
    ],
)
def test_missing_meshes_are_told_with_a_hint(tmp_path, text):
    with pytest.raises(RobotError, match=r"no\.(stl|xml)") as raised:
        read_mjcf(write(tmp_path, text))
    assert "meshes" in raised.value.hint


@pytest.mark.parametrize("explicit", [True, False])
def test_absent_meshes_matter_only_where_masses_come_from_them(tmp_path, explicit):
    inertial = '<inertial pos="0.1 0 0" mass="2" diaginertia="0.02 0.03 0.04"/>'
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><asset><mesh name="far" file="far.stl"/></asset><worldbody><body name="link">'
        f'<joint name="hinge" axis="0 1 0"/>{inertial if explicit else ""}'
        '<geom type="mesh" mesh="far"/></body></worldbody></mujoco>'
    )
    if not explicit:
        with pytest.raises(RobotError, match="cannot compile"):
            read_mjcf(path)
        return
    robot = read_mjcf(path)
    assert robot.parameters is not None
    assert robot.parameters.mass.tolist() == [2.0]
    assert any("mesh files are absent" in warning for warning in robot.warnings)


WORLD_MESH = """<mujoco><compiler angle="radian"{compiler}/><asset><mesh name="far" file="far.stl"/>
<texture name="wood" type="2d" file="wood.png"/><material name="wood" texture="wood"/></asset>
<worldbody>{world}<body name="base">{base}<body name="link"><joint name="hinge" axis="0 1 0"/>
{inertial}{link}</body></body></worldbody></mujoco>"""
MESH = '<geom type="mesh" mesh="far"{}/>'
INERTIAL = '<inertial pos="0 0 0.1" mass="2" diaginertia="0.02 0.03 0.04"/>'


@pytest.mark.parametrize(
    "parts",
    [
        {"world": MESH.format("")},
        {"base": MESH.format("")},
        {"link": MESH.format("")},
        {"link": '<geom size="0.1" material="wood"/>'},
        {"inertial": "", "link": MESH.format(' mass="0"') + '<geom size="0.1" mass="2"/>'},
        {
            "inertial": "",
            "link": MESH.format(' group="4"') + '<geom size="0.1" mass="2"/>',
            "compiler": ' inertiagrouprange="0 2"',
        },
    ],
)
def test_absent_files_stop_no_reader_where_masses_are_given(tmp_path, parts):
    text = WORLD_MESH.format(
        **dict.fromkeys(("world", "base", "link", "compiler"), "") | {"inertial": INERTIAL} | parts
    )
    robot = read_mjcf(write(tmp_path, text))
    assert robot.parameters.mass.tolist() == [2.0]
    meshes = "mesh" in "".join(parts.values())
    assert any("mesh files are absent" in warning for warning in robot.warnings) == meshes
    shapes = link_shapes(robot)
    # Half of a link's shapes say nothing of where its centre of mass is.
    assert shapes.known == ("mesh" not in parts.get("link", "mesh"),)
    assert (shapes.base is None) == bool({"world", "base"} & parts.keys())


@pytest.mark.parametrize("always", ["", ' inertiafromgeom="true"'])
def test_absent_meshes_that_give_a_mass_are_missed(tmp_path, always):
    parts = {"inertial": INERTIAL if always else "", "link": MESH.format(""), "compiler": always}
    text = WORLD_MESH.format(**{"world": "", "base": ""} | parts)
    with pytest.raises(RobotError, match="cannot compile"):
        read_mjcf(write(tmp_path, text))


ACTUATORS = {
    "position": '<position joint="hinge" kp="40" kv="2" forcerange="-5 5"/>',
    "gear": '<position joint="hinge" kp="40" kv="2" gear="3"/>',
    "backwards": '<position joint="hinge" kp="40" dampratio="0.7" gear="-2"/>',
    "general": '<general joint="hinge" gainprm="30" biastype="affine" biasprm="0.5 -40 -2"/>',
    "tendon": '<position tendon="cord" kp="40" kv="2" gear="2"/>',
    "class": '<position class="strong" joint="hinge"/>',
    "filter": '<position joint="hinge" kp="40" kv="2" timeconst="0.03"/>',
}


def geared(actuator):
    return f"""<mujoco><compiler angle="radian"/>
<default><default class="strong"><position kp="90" kv="3" gear="2"/></default></default>
<worldbody><body name="first"><joint name="free" axis="0 0 1"/>{INERTIAL}<body name="link">
<joint name="hinge" axis="0 1 0" damping="0.3" range="-2 2"/>{INERTIAL}</body></body></worldbody>
<tendon><fixed name="cord"><joint joint="hinge" coef="0.5"/></fixed></tendon>
<actuator>{actuator}</actuator></mujoco>"""


@pytest.mark.parametrize("name", list(ACTUATORS))
def test_servos_of_actuators_have_their_forces(tmp_path, name):
    path = write(tmp_path, geared(ACTUATORS[name]))
    none, servo = mjcf_servos(path, ("free", "hinge"))
    assert none == {}
    model = mujoco.MjModel.from_xml_path(str(path))
    data, draw = mujoco.MjData(model), np.random.default_rng(0)
    for u, q, dq in draw.uniform(-0.3, 0.3, (20, 3)):
        data.ctrl[0], data.qpos[1], data.qvel[1] = u, q, dq
        if model.na:
            data.act[0] = u
        mujoco.mj_forward(model, data)
        pull = servo["kp"] * (servo["scale"] * u - q) + servo["offset"]
        own = pull - (servo["damping"] - 0.3) * dq
        limit = servo.get("clip", np.inf)
        assert data.qfrc_actuator[1] == pytest.approx(np.clip(own, -limit, limit), abs=1e-9)
    assert servo.get("lag", 0.0) == (0.03 if name == "filter" else 0.0)


@pytest.mark.parametrize(
    "actuator",
    ['<motor joint="hinge" gear="2"/>', '<velocity joint="hinge" kv="2"/>', ACTUATORS["gear"] * 2],
)
def test_other_actuators_are_no_servos(tmp_path, actuator):
    assert mjcf_servos(write(tmp_path, geared(actuator)), ("free", "hinge")) == [{}, {}]
