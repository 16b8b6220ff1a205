"""Set points as joints of a file: against the closed form of the fastest move, and as they are made
at run time."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from lxml import etree

from tests.position.planted import robot, true_servos
from torchid.effects.servo import INDEX
from torchid.export.export import export_dynamics
from torchid.export.results import servo_dynamics
from torchid.export.servo_mjcf import ServosInMujoco
from torchid.position.model import ServoArm
from torchid.robot.library import load_robot
from torchid.robot.mjcf import mjcf_servos
from torchid.robot.origin import same_places
from torchid.robot.spec import SET_POINT
from torchid.simulation.servo import Servos
from torchid.simulators.servo import SetPoints

A, TOP = 8.0, 1.2
STEP, PERIOD = 0.002, 0.02


def written(folder, name="arm", nominal=None, plain=False, **own):
    """The file of an arm whose servos have this more, by (joint, value)."""
    arm = ServoArm(robot(), true_servos(3, **own), torch.ones(3, dtype=torch.float64))
    given = robot() if nominal is None else nominal
    return export_dynamics(servo_dynamics(arm), "mjcf", folder, name, nominal=given, plain=plain)


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    """Joint 2 has limits of acceleration and speed, joint 3 one of acceleration, and a filter."""
    folder = tmp_path_factory.mktemp("limited")
    own = {"acceleration": (2, A), "speed": (2, TOP), "kd": (2, 20.0), "clip": (2, 300.0)}
    arm = true_servos(3, **own)
    arm.joint[:, INDEX["delay"]] = 0.0
    arm.joint[2, INDEX["acceleration"]], arm.joint[2, INDEX["scale"]] = 30.0, 0.9
    servos = ServoArm(robot(), arm, torch.ones(3, dtype=torch.float64))
    return export_dynamics(servo_dynamics(servos), "mjcf", folder, nominal=robot()), servos


def moved(file, commands):
    """Set points of joints 2 and 3 in every step, and their speeds, with commands (T, 3)."""
    model = mujoco.MjModel.from_xml_path(str(file))
    data, out = mujoco.MjData(model), []
    joints = [model.joint(f"{SET_POINT}joint_{k}") for k in (2, 3)]
    places, rows = (
        [int(x[0]) for x in y] for y in ([j.qposadr for j in joints], [j.dofadr for j in joints])
    )
    for command in commands:
        data.ctrl[:3] = command
        for _ in range(round(PERIOD / model.opt.timestep)):
            out.append([data.qpos[places], data.qvel[rows]])
            mujoco.mj_step(model, data)
    return np.array(out)


@pytest.mark.parametrize(("joint", "a", "top"), [(0, A, TOP), (1, 30.0, np.inf)])
@pytest.mark.parametrize("way", [0.05, 0.3])
def test_a_jump_is_the_fastest_move(limited, joint, a, top, way):
    """At full acceleration, at the limit of speed, at full deceleration (kinematics of a move from
    rest to rest), and not beyond the goal."""
    done, arm = limited
    scale = float(arm.servos.of("scale")[joint + 1])
    u = np.zeros((100, 3))
    u[:, joint + 1] = way / scale
    x, v = moved(done.files[0], u)[:, :, joint].T
    peak = min(np.sqrt(a * way), top)
    t = STEP * np.arange(len(x))
    early = t < 0.8 * peak / a
    assert x[early] == pytest.approx(a * t[early] ** 2 / 2, abs=2 * STEP * peak)
    assert v.max() == pytest.approx(peak, rel=0.12)
    assert v.max() < 1.01 * top
    assert abs(np.diff(v)).max() < 1.001 * a * STEP
    assert x.max() < way + 2e-3
    ends = peak / a + way / peak
    assert abs(x[t > ends + 0.1] - way).max() < 0.02 * way


@given(seed=st.integers(0, 20))
def test_streams_of_commands_are_followed_as_at_run_time(limited, seed):
    done, arm = limited
    draw = np.random.default_rng(seed)
    t = PERIOD * np.arange(150)[:, None]
    u = 0.4 * np.sin(2 * np.pi * draw.uniform(0.1, 0.5, 3) * t)
    u[75:] += draw.uniform(-0.2, 0.2, 3)
    scale = arm.servos.of("scale").numpy()[1:]
    # The controls of `SetPoints` hold what kd adds for the rate.
    own = replace(arm.servos, joint=arm.servos.joint.clone())
    own.joint[:, INDEX["kd"]] = 0.0
    points = SetPoints(own, PERIOD)
    expected = np.concatenate([points.feed(row, 10)[:, 1:] * scale for row in u])
    found = moved(done.files[0], u)[:, 0]
    assert np.sqrt(((found - expected) ** 2).mean(0)).max() < 0.012


def test_the_arm_is_the_same_without_them(limited):
    """Set points are no part of the robot, and its servos are read back."""
    done, arm = limited
    found = load_robot(done.files[0])
    assert found.joint_names == robot().joint_names
    assert bool(same_places(found, robot()).all())
    assert not [w for w in found.warnings if "tendon" in w]
    first, *others = mjcf_servos(done.files[0], found.joint_names)
    assert "acceleration" not in first
    for j, own in enumerate(others, start=1):
        for name in ("kp", "kd", "acceleration", "scale", "offset"):
            expected = float(arm.servos.of(name)[j])
            assert own.get(name, 0.0) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    assert [model.actuator(k).trnid[0] for k in range(3)] == [
        model.joint(name).id for name in ("joint_1", f"{SET_POINT}joint_2", f"{SET_POINT}joint_3")
    ]
    assert any("set points of servos are joints of the file" in w for w in done.warnings)


def test_a_file_is_written_once_more_without_what_is_in_it(limited, tmp_path):
    done, arm = limited
    own = load_robot(done.files[0])
    again = export_dynamics(
        servo_dynamics(replace(arm, robot=own)), "mjcf", tmp_path, "again", nominal=own
    )  # fmt: skip
    plain = export_dynamics(
        servo_dynamics(replace(arm, robot=own)), "mjcf", tmp_path, "plain", nominal=own, plain=True
    )
    first, second = (mujoco.MjModel.from_xml_path(str(x.files[0])) for x in (done, again))
    assert (first.nq, first.nu, first.ntendon) == (second.nq, second.nu, second.ntendon)
    assert mujoco.MjModel.from_xml_path(str(plain.files[0])).nq == 3
    assert any("acceleration, speed" in w for w in plain.warnings)
    assert not any("set points of servos are joints" in w for w in plain.warnings)


def test_keyframes_have_set_points_where_joints_are(tmp_path):
    file = export_dynamics(load_robot("3r"), "mjcf", tmp_path, nominal=load_robot("3r")).files[0]
    root = etree.parse(str(file)).getroot()
    key = etree.SubElement(etree.SubElement(root, "keyframe"), "key")
    key.attrib.update({"qpos": "0.1 0.2 0.3", "ctrl": "0.1 0.2 0.3"})
    path = tmp_path / "own.xml"
    etree.ElementTree(root).write(str(path))
    done = written(tmp_path, "keyed", load_robot(path), acceleration=(2, A), lag=(2, 0.05))
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    # The set point, and its filter.
    assert model.key_qpos[0] == pytest.approx([0.1, 0.2, 0.3, 0.2, 0.2])
    assert model.key_ctrl[0].tolist() == [0.1, 0.2, 0.3, *[0.0] * (model.nu - 3)]


def test_a_filter_is_behind_the_set_point(tmp_path):
    """Its answer to a set point that stands still is the exponential of its time constant."""
    done = written(tmp_path, acceleration=(2, 1e3), lag=(2, 0.1))
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    data = mujoco.MjData(model)
    data.ctrl[1] = 0.2
    place = int(model.joint(f"{SET_POINT}filter_joint_2").qposadr[0])
    behind = []
    for _ in range(150):
        mujoco.mj_step(model, data)
        behind.append(0.2 - data.qpos[place])
    rate = np.log(behind[49] / behind[149]) / (100 * model.opt.timestep)
    assert rate == pytest.approx(1 / 0.1, rel=0.05)


def test_servos_with_set_points_pull_as_they_should(limited):
    """At rest by their equation, the clip of joint 2 with its offset: `check_servos` compares them,
    and here what is beyond it."""
    done, arm = limited
    engine = ServosInMujoco(done.files[0], robot())
    u = np.array([[0.0, 5.0, 0.0]])
    force = engine.force(u, np.zeros((1, 3)), np.zeros((1, 3)))
    offset = float(arm.servos.of("offset")[1])
    assert force[0, 1] == pytest.approx(300.0 + offset)
    assert isinstance(arm.servos, Servos)


@pytest.mark.parametrize("speed", [np.inf, TOP])
def test_a_limit_holds_the_servos_own_damping_too(speed, tmp_path):
    """`check_servos` compares the force of two actuators with that of one servo; read again the
    file has the servo that was written."""
    own = {
        "acceleration": (2, A),
        "clip": (2, 40.0),
        "damping_share": (2, 0.8),
        "speed": (2, speed),
    }
    done = written(tmp_path, **own)
    (path,) = done.files[:1]
    again, given = mjcf_servos(path, robot().joint_names)[1], true_servos(3, **own)
    for name in ("clip", "damping", "damping_share", "offset"):
        assert again[name] == pytest.approx(float(given.of(name)[1]), rel=1e-6)
