"""Robots that branch: the same to torchid and to the plant, and their motors as they are drawn."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Motion
from torchid.effects.registry import nominal_effects
from torchid.errors import TorchidError
from torchid.robot.library import load_robot
from torchid_bench.withheld.case_set import make, read_cases, write_shown
from torchid_bench.withheld.plant.arms import CORNER, ROBOTS, TREES, urdf
from torchid_bench.withheld.plant.case import draw_case, simulate_case
from torchid_bench.withheld.plant.catalogue import drawn_effect
from torchid_bench.withheld.plant.scene import nominal_of, scene_of


@pytest.fixture(params=list(TREES))
def arm(request):
    return TREES[request.param]


def read(arm, tmp_path):
    """The robot as a case shows it, with the rotors that its maker tells."""
    zeros = np.zeros(arm.n)
    columns = {"t": np.arange(2.0)}
    write_shown(urdf(arm, zeros, zeros), columns, tmp_path, [j.rotor for j in arm.joints])
    return load_robot(tmp_path / "robot.urdf")


def test_torchid_reads_the_same_dynamics(arm, tmp_path):
    robot = read(arm, tmp_path)
    assert (robot.n, robot.parents, robot.is_serial) == (arm.n, arm.parents, False)
    assert [tip.link for tip in robot.ends] == [k for k in range(arm.n) if k not in arm.parents]
    assert robot.ends[-1].pose[:3, 3].tolist() == list(arm.tool)
    rng = np.random.default_rng(0)
    q, dq, ddq = (rng.uniform(-1.5, 1.5, (20, arm.n)) for _ in range(3))
    # MuJoCo's inverse dynamics, armature included.
    ours = nominal_of(arm, np.zeros(arm.n), np.zeros(arm.n)).rigid(q, dq, ddq)
    motion = Motion(*map(torch.from_numpy, (q, dq, ddq)))
    theirs = inverse_dynamics(robot, *motion.state)
    for effect, values in nominal_effects(robot):
        theirs = theirs + effect.torque_columns(motion, robot) @ torch.tensor(values).double()
    np.testing.assert_allclose(ours, theirs.numpy(), atol=1e-6 * np.abs(ours).max())


def test_links_are_bodies_and_branches_are_alike(arm):
    for joint in arm.joints:
        body = joint.inertial()
        moments = np.eye(3) * np.trace(body.inertia) / 2 - body.inertia
        assert np.linalg.eigvalsh(moments)[0] > 0
        assert 0.05 < body.mass < 20
    # What is on the left is on the right, mirrored in y: the same masses.
    masses = [round(joint.inertial().mass, 9) for joint in arm.joints]
    limbs = 3 if arm.name == "quadruped" else (arm.n - (arm.n % 2) * 3) // 2
    assert masses[-limbs:] == masses[-2 * limbs : -limbs]


def test_motors_lose_their_torque_towards_the_free_speed(arm):
    free = np.array([joint.free_speed for joint in arm.joints])
    effort = np.array([joint.effort for joint in arm.joints])
    speeds = np.stack([0 * free, -CORNER * free, (1 + CORNER) / 2 * free, free, 2 * free])
    shares = arm.available(speeds) / effort
    np.testing.assert_allclose(shares[:, 0], [1.0, 1.0, 0.5, 0.0, 0.0], atol=1e-12)


@pytest.mark.slow
def test_a_robot_without_causes_has_no_gap():
    """The plant's friction, rotors and late bus are what the described robot has, or no matter."""
    found = simulate_case(draw_case(3, 0, kind="none", arm="quadruped", mix="tree"))
    assert max(found.key["true_gap_rms"]) < 0.02 * min(found.key["noise_std"])
    assert len(set(found.columns["traj"])) == 6
    assert found.rotors == tuple(j.rotor for j in TREES["quadruped"].joints)


def test_a_late_bus_moves_the_robot_later():
    arm = TREES["quadruped"]
    from torchid_bench.withheld.plant.model import plant_of
    from torchid_bench.withheld.plant.plan import Plan
    from torchid_bench.withheld.plant.simulate import simulated

    zeros = np.zeros(arm.n)
    spec = draw_case(3, 0, kind="none", arm="quadruped", mix="tree")
    nominal, plan = nominal_of(arm, zeros, zeros), Plan(plant_of(arm, zeros, zeros), zeros, zeros)
    motion = replace(spec.motion, shapes=(0,), pauses=(0.0,))
    step, found = 1e-3, []
    for bus in (0.0, 20 * arm.bus):
        scene = scene_of(replace(arm, bus=bus), nominal, motion, 0.01, 8.0, 1.0)
        found.append(simulated(scene, plan, nominal, step)[0].truth.tau[:, 0])
    # The command is 40 ms late: so is the torque, nearly, for it is most of it.
    ahead, behind = (x - x.mean() for x in found)
    lags = range(80)
    best = max(lags, key=lambda k: float(ahead[: len(ahead) - k] @ behind[k:]))
    assert 25 <= best <= 55


def test_neighbours_are_carried_by_one_another():
    arm = TREES["torso"]
    assert arm.neighbours(0) == [1, 3, 10]
    assert arm.neighbours(3) == [0, 4]
    assert arm.neighbours(16) == [15]
    for seed in range(20):
        spec = drawn_effect(np.random.default_rng(seed), "gear_coupling", arm)
        assert spec.joints[1] in arm.neighbours(spec.joints[0])


def test_sets_are_of_the_robots_asked_for(tmp_path):
    drawn = {draw_case(5, k, mix="tree", robots="tree").arm for k in range(12)}
    assert drawn == set(TREES)
    assert draw_case(5, 0, mix="tree", robots="torso").arm == "torso"
    assert set(ROBOTS) == {"arms", "tree", *TREES}
    with pytest.raises(TorchidError, match="one mix"):
        make(tmp_path / "set", 1, 1, mix="release", robots="tree")
    with pytest.raises(TorchidError, match="unknown robots"):
        make(tmp_path / "set", 1, 1, robots="spider")


@pytest.mark.nightly
def test_a_set_of_quadrupeds_is_sealed_and_read(tmp_path):
    made = make(tmp_path / "set", 2, 11, robots="quadruped")
    found = read_cases(tmp_path / "set")
    assert (found.robots, found.keys_sha256) == ("quadruped", made.keys_sha256)
    assert load_robot(found.robot(found.ids[0])).n == 12
