"""The described arms: the same robot to MuJoCo's compiler, to torchid, and to the plant."""

import mujoco
import numpy as np
import pytest
import torch

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.errors import TorchidError
from torchid.robot.library import load_robot
from torchid_bench.withheld.plant.arms import ARMS, arm_named, urdf
from torchid_bench.withheld.plant.scene import nominal_of


@pytest.fixture(params=list(ARMS))
def arm(request):
    return ARMS[request.param]


def some_states(arm, count=20):
    rng = np.random.default_rng(0)
    return [rng.uniform(-1.5, 1.5, (count, arm.n)) for _ in range(3)]


def read(arm, tmp_path, damping=0.5, friction=0.25):
    path = tmp_path / "robot.urdf"
    path.write_text(urdf(arm, np.full(arm.n, damping), np.full(arm.n, friction)))
    return load_robot(path), path


def test_torchid_reads_the_same_dynamics(arm, tmp_path):
    robot, _ = read(arm, tmp_path)
    q, dq, ddq = some_states(arm)
    ours = nominal_of(arm, np.zeros(arm.n), np.zeros(arm.n)).rigid(q, dq, ddq)
    theirs = inverse_dynamics(
        robot, *(torch.tensor(x, dtype=torch.float64) for x in (q, dq, ddq))
    ).numpy()
    np.testing.assert_allclose(ours, theirs, atol=1e-6 * np.abs(theirs).max())


def test_torchid_reads_limits_friction_and_tool(arm, tmp_path):
    robot, _ = read(arm, tmp_path)
    assert not robot.warnings
    values = {(e["effect"], e["joint"]): e for e in robot.effects}
    assert values["viscous_friction", arm.n]["Fv"] == 0.5
    assert values["coulomb_friction", 1]["Fc"] == 0.25
    limits = robot.limits
    assert torch.as_tensor(limits.velocity)[:, 1].tolist() == [j.velocity for j in arm.joints]
    assert torch.as_tensor(limits.torque)[:, 1].tolist() == [j.effort for j in arm.joints]
    assert torch.as_tensor(limits.position)[:, 0].tolist() == [j.lower for j in arm.joints]
    assert robot.tool[:3, 3].tolist() == list(arm.tool)


def test_mujoco_compiles_the_urdf(arm, tmp_path):
    _, path = read(arm, tmp_path)
    model = mujoco.MjModel.from_xml_path(str(path))
    q, dq, ddq = some_states(arm, 1)
    data = mujoco.MjData(model)
    model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    data.qpos[:], data.qvel[:], data.qacc[:] = q[0], dq[0], ddq[0]
    mujoco.mj_inverse(model, data)
    ours = nominal_of(arm, np.zeros(arm.n), np.zeros(arm.n)).rigid(q, dq, ddq)[0]
    np.testing.assert_allclose(data.qfrc_inverse, ours, atol=1e-6 * np.abs(ours).max())


def test_what_is_not_known_is_not_written(arm):
    text = urdf(arm, np.zeros(arm.n), np.zeros(arm.n))
    assert "dynamics" not in text
    assert text.count("<inertia ") == arm.n


def test_links_are_bodies(arm):
    for joint in arm.joints:
        body = joint.inertial()
        moments = np.eye(3) * np.trace(body.inertia) / 2 - body.inertia
        assert np.linalg.eigvalsh(moments)[0] > 0
        assert 0.1 < body.mass < 15


def test_an_unknown_arm_is_refused():
    with pytest.raises(TorchidError, match="unknown withheld robot"):
        arm_named("8r")
