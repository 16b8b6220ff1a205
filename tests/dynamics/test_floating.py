"""A base that moves, against Pinocchio's free-flyer: rows of the joints, and of the base."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.arms import relative
from tests.trees import two_arms
from torchid.dynamics import forward
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.regressor import regressor
from torchid.errors import RobotError
from torchid.identification.base_parameters import base_parameters
from torchid.log.base_motion import coordinates_of, rates_of
from torchid.robot.floating import COORDINATES, on_moving_base
from torchid.robot.inertia import PARAMETERS_PER_LINK
from torchid.robot.library import load_robot
from torchid.robot.model import Robot

TORSO = (
    '<link name="torso"><inertial><origin xyz="0.01 0.02 0.2" rpy="0.1 0 0.2"/><mass value="9"/>'
    '<inertia ixx="0.3" ixy="0.01" ixz="-0.02" iyy="0.25" iyz="0.03" izz="0.15"/></inertial></link>'
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Two arms on a torso that is a body, and that floats in the file."""
    path = two_arms(tmp_path)
    text = path.read_text().replace('<link name="torso"/>', TORSO)
    base = (
        '<link name="world"/><joint name="fly" type="floating"><parent link="world"/>'
        '<child link="torso"/><origin xyz="0.5 -0.2 1.1" rpy="0.1 0.2 -0.4"/></joint></robot>'
    )
    path.write_text(text.replace("</robot>", base))
    return path


class FreeFlyer:
    """Pinocchio's model of the torso and its arms; the finger follows the thumb by hand."""

    def __init__(self, path: Path, robot: Robot):
        self.pin = pytest.importorskip("pinocchio")
        text = path.read_text().split('<link name="world"/>')[0] + "</robot>"
        self.model = self.pin.buildModelFromXML(text, self.pin.JointModelFreeFlyer())
        self.data = self.model.createData()
        self.robot = robot
        drives = {drive.joint: drive for drive in robot.drives}
        self.joints = [(j, drives[n]) for n, j in self._named()]

    def _named(self):
        return list(zip(list(self.model.names)[2:], list(self.model.joints)[2:], strict=True))

    def state(self, q, dq, ddq):
        """Configuration, velocity and acceleration; of the base in its own axes, by differences of
        poses and not by the formulas that are to be checked."""
        pin, step = self.pin, 1e-5

        def pose(t):
            x = q[:6] + dq[:6] * t + ddq[:6] * t * t / 2
            turn = pin.rpy.rpyToMatrix(x[5], x[4], x[3])
            return pin.SE3(turn, x[:3])

        def twist(t):
            # Eighth-order differences of the pose would be exact to rounding; log6 of short steps.
            after, before = pose(t + step), pose(t - step)
            return pin.log6(before.actInv(after)).vector / (2 * step)

        now = pose(0.0)
        v = twist(0.0)
        # Second differences amplify rounding: a wider step.
        wide = 1e-3
        a = (twist(wide) - twist(-wide)) / (2 * wide)
        full = pin.neutral(self.model)
        full[:3], full[3:7] = now.translation, pin.Quaternion(now.rotation).coeffs()
        vel, acc = np.zeros(self.model.nv), np.zeros(self.model.nv)
        vel[:6], acc[:6] = v, a
        for joint, drive in self.joints:
            x = q[drive.coordinate] * drive.ratio + drive.offset
            at = slice(joint.idx_q, joint.idx_q + joint.nq)
            full[at] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
            vel[joint.idx_v] = dq[drive.coordinate] * drive.ratio
            acc[joint.idx_v] = ddq[drive.coordinate] * drive.ratio
        return full, vel, acc

    def torque(self, q, dq, ddq):
        """Torques of the robot's coordinates: of the base by virtual work of unit rates."""
        tau = self.pin.rnea(self.model, self.data, *self.state(q, dq, ddq))
        out = np.zeros(self.robot.n)
        for k in range(6):
            unit = np.zeros(self.robot.n)
            unit[k] = 1.0
            still = np.zeros(self.robot.n)
            _, rate, _ = self.state(np.r_[q[:6], still[6:]], unit, still)
            out[k] = rate[:6] @ tau[:6]
        for joint, drive in self.joints:
            out[drive.coordinate] += drive.ratio * tau[joint.idx_v]
        return out


def states(robot: Robot, count: int, seed: int = 0):
    draw = np.random.default_rng(seed)
    q, dq, ddq = draw.uniform(-1, 1, (3, count, robot.n))
    return q, 2 * dq, 4 * ddq


def test_torque_is_pinocchios_with_a_free_flyer(path: Path):
    robot = load_robot(path, base="moving")
    assert (robot.n, robot.n_links, robot.floating) == (12, 13, True)
    assert robot.joint_names[:6] == COORDINATES
    assert robot.link_names[5] == "torso"
    assert robot.warnings == ()
    oracle, motion = FreeFlyer(path, robot), states(robot, 12)
    expected = np.stack([oracle.torque(*x) for x in zip(*motion, strict=True)])
    found = inverse_dynamics(robot, *motion)
    # The differences of poses are good to 1e-6.
    assert relative(found, torch.from_numpy(expected)) < 2e-6


def test_the_mass_matrix_is_pinocchios_with_a_free_flyer(path: Path):
    robot = load_robot(path, base="moving")
    oracle = FreeFlyer(path, robot)
    q = states(robot, 1)[0][0]
    still = np.zeros(robot.n)
    # Rates of all coordinates of Pinocchio's for a unit rate of each of ours.
    jacobian = np.stack([oracle.state(q, unit, still)[1] for unit in np.eye(robot.n)], 1)
    full = oracle.pin.crba(oracle.model, oracle.data, oracle.state(q, still, still)[0])
    full = np.triu(full) + np.triu(full, 1).T
    found = forward.mass_matrix(robot, q)
    expected = torch.from_numpy(jacobian.T @ full @ jacobian)
    assert relative(found, expected) < 1e-8


def test_a_base_at_rest_is_a_base_that_is_held(path: Path):
    # In the file the torso leans by a roll of 0.1 and a pitch of 0.2; its heading is no matter.
    held, moving = load_robot(path, root="torso"), load_robot(path, base="moving")
    q, dq, ddq = states(held, 20)
    still = np.zeros((20, 6))
    leaning = np.tile([0.3, -1.0, 2.0, 0.7, 0.2, 0.1], (20, 1))
    motion = (np.hstack(x) for x in ((leaning, q), (still, dq), (still, ddq)))
    found = inverse_dynamics(moving, *motion)[:, 6:]
    torch.testing.assert_close(found, inverse_dynamics(held, q, dq, ddq), rtol=1e-12, atol=1e-11)
    # What holds a robot at rest is its weight, upwards.
    rest = np.zeros((20, moving.n))
    force = inverse_dynamics(moving, np.hstack([leaning, q]), rest, rest)[:, :3]
    weight = torch.tensor([0.0, 0.0, 9.81], dtype=torch.float64) * moving.parameters.mass.sum()
    torch.testing.assert_close(force, weight.expand(20, 3), rtol=1e-12, atol=1e-9)


def test_the_bases_own_parameters_have_columns_and_the_frames_none(path: Path):
    robot = load_robot(path, base="moving")
    motion = [torch.from_numpy(x) for x in states(robot, 5)]
    tau = regressor(robot, *motion) @ robot.parameters.to_paper_order()
    torch.testing.assert_close(tau, inverse_dynamics(robot, *motion), rtol=1e-11, atol=1e-10)
    base = base_parameters(robot)
    # All ten of the base are seen: of a held base none is.
    stand = base_parameters(load_robot(path))
    grown = len(base) - len(stand)
    assert grown >= PARAMETERS_PER_LINK
    assert not any(name.startswith(f"m{k} ") for name in base.names for k in range(1, 6))
    oracle = np.concatenate(
        [y.numpy() for y in regressor(robot, *map(torch.from_numpy, states(robot, 200, 3)))]
    )
    assert len(base) == np.linalg.matrix_rank(oracle, 1e-9 * np.abs(oracle).max())


def test_what_says_nothing_of_its_base_has_none_that_moves():
    with pytest.raises(RobotError, match="nothing of the link that is its base"):
        on_moving_base(load_robot("3r"))
    with pytest.raises(RobotError, match="chooses a part"):
        load_robot("3r", base="moving")


def test_poses_and_twists_of_logs_are_the_coordinates(path: Path):
    pin = pytest.importorskip("pinocchio")
    draw = np.random.default_rng(4)
    x, rate = draw.uniform(-1.3, 1.3, (30, 6)), draw.normal(size=(30, 6))
    turns = [pin.rpy.rpyToMatrix(*row[[5, 4, 3]]) for row in x]
    quaternions = np.stack([pin.Quaternion(r).coeffs() for r in turns])
    found = np.concatenate(
        [coordinates_of(p[None, :3], o[None], "log") for p, o in zip(x, quaternions, strict=True)]
    )
    np.testing.assert_allclose(found, x, atol=1e-12)
    # The gyroscope's reading by differences of rotations.
    step, spins = 1e-6, []
    for row, v in zip(x, rate, strict=True):
        ends = [pin.rpy.rpyToMatrix(*(row + s * step * v)[[5, 4, 3]]) for s in (-1, 1)]
        spins.append(pin.log3(ends[0].T @ ends[1]) / (2 * step))
    np.testing.assert_allclose(rates_of(x, rate[:, :3], np.stack(spins)), rate, atol=1e-7)
