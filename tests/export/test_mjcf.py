"""MJCF: defaults of classes, compiler settings, included files and shapes change nothing."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lxml import etree

from tests.arms import ISSUE_ARMS, arm, mixed_arm, relative, states
from tests.export.arms import FRICTION, exported, with_other, write_mjcf, write_urdf
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.effects.registry import model_torque, nominal_effects
from torchid.errors import TorchidError
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.simulators.joint_dynamics import split


def mujoco_torque(path: Path, robot, q, dq, ddq):  # type: ignore[no-untyped-def]
    """mj_inverse without constraints, and without any code of the export."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    out = []
    for row in zip(q.numpy(), dq.numpy(), ddq.numpy(), strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = row
        mujoco.mj_inverse(model, data)
        out.append(data.qfrc_inverse.copy())
    return torch.from_numpy(np.stack(out))


def known_torque(robot, q, dq, ddq):  # type: ignore[no-untyped-def]
    """The rigid body with what MuJoCo knows as passive joint forces."""
    tau = inverse_dynamics(robot, q, dq, ddq)
    for i, joint in enumerate(split(robot, "mjcf")[0]):
        tau[:, i] += joint.damping * dq[:, i] + joint.armature * ddq[:, i]
        tau[:, i] += joint.stiffness * q[:, i] + joint.offset
    return tau


@pytest.mark.parametrize(
    "robot", [*(arm(n) for n in ISSUE_ARMS), mixed_arm()], ids=lambda r: r.name
)
def test_a_new_file(robot, tmp_path):
    robot = with_other(robot)
    done = exported(robot, "mjcf", tmp_path)
    assert all(c.difference < 1e-12 for c in done.comparisons)
    motion = states(robot, 10)
    found = mujoco_torque(done.files[0], robot, *motion)
    assert relative(found, known_torque(robot, *motion)) < 1e-12
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    assert model.dof_frictionloss[0] == 1 / 3
    assert model.nu == robot.n


def test_powers_of_the_speed_that_damping_has_are_in_the_file(tmp_path):
    laws = [{"effect": "viscous_friction", "joint": 2, "Fv": 3.1}]
    laws += [
        {"effect": "power_law_friction", "joint": 2, "F2": f, "a": a}
        for f, a in ((-0.7, 2.0), (0.2, 3.0))
    ]
    robot = with_other(arm("3r"), effects=tuple(laws))
    done = exported(robot, "mjcf", tmp_path)
    assert len(done.files) == 1, "nothing is left for a sidecar"
    motion = Motion(*states(robot, 10))
    expected = model_torque(robot, nominal_effects(robot), motion)
    assert relative(mujoco_torque(done.files[0], robot, *motion.state), expected) < 1e-12
    again = model_torque(read := load_robot(done.files[0]), nominal_effects(read), motion)
    assert relative(again, expected) < 1e-12


def test_the_copy_has_the_results_dynamics(tmp_path):
    original = write_mjcf(tmp_path)
    robot = with_other(load_robot(original))
    (tmp_path / "new").mkdir()
    done = exported(robot, "mjcf", tmp_path / "new", original)
    motion = states(robot, 10)
    found = mujoco_torque(done.files[0], robot, *motion)
    assert relative(found, known_torque(robot, *motion)) < 1e-12
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    assert model.dof_armature.tolist() == [0.0, 0.0123456789, 0.0]
    assert model.dof_damping.tolist() == [0.123456789012345, 0.0, 0.0]
    assert model.dof_frictionloss.tolist() == [1 / 3, 0.0, 0.0]
    assert model.jnt_stiffness.tolist() == [0.0, 3.3, 0.0]
    assert model.qpos_spring[1] == pytest.approx(0.4 / 3.3, rel=1e-15)
    assert model.body("motor").mass[0] == 0


def test_the_copy_keeps_everything_else(tmp_path):
    original = write_mjcf(tmp_path)
    done = exported(with_other(load_robot(original)), "mjcf", tmp_path, original)
    text = done.files[0].read_text()
    for kept in (
        "<!-- my robot, tuned by hand -->",
        "<!-- the arm proper -->",
        "<!-- bolted on -->",
        "<!-- the last two links -->",
        '<default class="small"><joint damping="0.01"/></default>',
        '<geom type="mesh" mesh="shell"/>',
        '<position name="p" joint="yaw" kp="50"/>',
        '<site name="tcp" pos="0 0 0.1"/>',
        'meshdir="meshes"',
    ):
        assert kept in text
    root = etree.fromstring(done.files[0].read_bytes())
    assert root.find("option").get("gravity") == "0 0.5 -9.7"
    assert root.find(".//joint[@name='wrist']").get("ref") == "15"


def test_springs_of_a_class_are_taken_out_where_the_result_has_none(tmp_path):
    original = write_mjcf(tmp_path)
    read = load_robot(original)
    assert [e["effect"] for e in read.effects].count("joint_spring") == 3 - 1
    done = exported(with_other(read, effects=()), "mjcf", tmp_path, original)
    assert load_robot(done.files[0]).effects == ()


def test_a_converter_gives_the_same_arm(tmp_path):
    """What was read from MJCF, with shapes' inertias and merged bodies, is written unchanged."""
    original = write_mjcf(tmp_path)
    robot = load_robot(original)
    done = exported(robot, "mjcf", tmp_path, original)
    motion = states(robot, 10)
    old, new = (mujoco_torque(path, robot, *motion) for path in (original, done.files[0]))
    assert relative(new, old) < 1e-12
    urdf = exported(robot, "urdf", tmp_path).files[0]
    again = load_robot(urdf)
    assert relative(inverse_dynamics(again, *motion), inverse_dynamics(robot, *motion)) < 1e-12


def test_massless_links_between_two_joints_of_a_body(tmp_path):
    ball = '<inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.02 0.025"/>'
    original = tmp_path / "two.xml"
    original.write_text(
        f"<mujoco><worldbody><body name='a/b'><joint name='x' axis='1 0 0'/>"
        f"<joint name='y' axis='0 1 0'/>{ball}</body></worldbody></mujoco>"
    )
    robot = load_robot(original)
    assert robot.link_names == ("a/b/x", "a/b")
    from torchid.export.dynamics import Dynamics
    from torchid.export.export import export_dynamics

    def forced(pi):  # type: ignore[no-untyped-def]
        one = robot.with_parameters(InertialParameters(pi))
        dynamics = Dynamics(one, "robot", "a test")
        return export_dynamics(dynamics, "mjcf", tmp_path, "o", nominal=one, force=True)

    pi = robot.parameters.pi.clone()
    pi[1] *= 2
    assert all(c.ok is not False for c in forced(pi).comparisons)
    pi[0, 0] = 1.0
    with pytest.raises(TorchidError, match="between two joints of one body"):
        forced(pi)


def test_unnamed_bodies_are_found_by_their_order(tmp_path):
    original = tmp_path / "anonymous.xml"
    ball = '<inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.02 0.025"/>'
    original.write_text(
        f"<mujoco><worldbody><body><joint axis='1 0 0'/>{ball}"
        f"<body pos='0 0 1'><joint axis='0 1 0'/>{ball}</body></body></worldbody></mujoco>"
    )
    robot = with_other(load_robot(original))
    done = exported(robot, "mjcf", tmp_path, original)
    motion = states(robot, 5)
    found = mujoco_torque(done.files[0], robot, *motion)
    assert relative(found, known_torque(robot, *motion)) < 1e-12


def test_bodies_that_are_not_written_out_are_refused(tmp_path):
    original = tmp_path / "many.xml"
    original.write_text(
        "<mujoco><worldbody><replicate count='1' sep='-'><body name='r'><joint name='j'/>"
        "<geom size='0.1'/></body></replicate></worldbody></mujoco>"
    )
    try:
        robot = load_robot(original)
    except TorchidError:
        pytest.skip("this MuJoCo does not replicate once")
    with pytest.raises(TorchidError, match="written out"):
        exported(with_other(robot, effects=()), "mjcf", tmp_path, original)


def test_an_infeasible_set_cannot_be_forced_into_mjcf(tmp_path):
    robot = arm("kuka_lwr4")
    from torchid.export.dynamics import Dynamics
    from torchid.export.export import export_dynamics

    dynamics = Dynamics(robot, "robot", "a test")
    with pytest.raises(TorchidError, match="nothing was kept"):
        export_dynamics(dynamics, "mjcf", tmp_path, "out", nominal=robot, force=True)
    assert list(tmp_path.iterdir()) == []


def test_a_urdf_gives_a_new_mjcf(tmp_path):
    robot = with_other(load_robot(write_urdf(tmp_path)))
    done = exported(robot, "mjcf", tmp_path)
    motion = states(robot, 10)
    found = mujoco_torque(done.files[0], robot, *motion)
    assert relative(found, known_torque(robot, *motion)) < 1e-12
    assert [e["effect"] for e in load_robot(done.files[0]).effects].count("joint_spring") == 1


@settings(max_examples=5, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10_000), scale=st.sampled_from([1e-3, 1.0, 1e3]))
def test_random_bodies_survive_the_round_trip(seed, scale, tmp_path):
    original = tmp_path / "classy.xml"
    if not original.exists():
        write_mjcf(tmp_path)
    robot = with_other(load_robot(original), seed=seed, effects=FRICTION[:4])
    robot = robot.with_parameters(InertialParameters(scale * robot.parameters.pi))
    done = exported(robot, "mjcf", tmp_path, original)
    assert all(c.difference < 1e-11 for c in done.comparisons)
    again = load_robot(done.files[0])
    assert torch.allclose(again.parameters.pi, robot.parameters.pi, rtol=1e-11, atol=1e-13 * scale)
