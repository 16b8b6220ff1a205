"""Robots of the package example-robot-data against Pinocchio: quadrupeds, humanoids, hands."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.arms import relative
from tests.trees import package_urdfs
from torchid.dynamics import forward
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.identification.base_parameters import base_parameters
from torchid.robot.jacobian import tool_jacobian
from torchid.robot.library import load_robot
from torchid.robot.model import Robot, Tip

QUICK = ("panda.urdf", "solo12.urdf", "romeo.urdf", "tiago_pro.urdf", "bolt.urdf")
STILL = ("quadrotor_base.urdf", "iris_simple.urdf", "ur3.urdf")


class Published:
    """Pinocchio's model of a URDF, driven by a robot's coordinates: q_all = G q + g, by hand."""

    def __init__(self, path: Path, robot: Robot):
        self.pin = pytest.importorskip("pinocchio")
        self.model = self.pin.buildModelFromUrdf(str(path))
        self.data = self.model.createData()
        self.robot = robot
        drives = {drive.joint: drive for drive in robot.drives}
        self.drives = [drives[name] for name in list(self.model.names)[1:]]
        self.g = np.zeros((self.model.nv, robot.n))
        for joint, drive in zip(list(self.model.joints)[1:], self.drives, strict=True):
            self.g[joint.idx_v, drive.coordinate] = drive.ratio

    def position(self, q: np.ndarray) -> np.ndarray:
        out = self.pin.neutral(self.model)
        for joint, drive in zip(list(self.model.joints)[1:], self.drives, strict=True):
            x = q[drive.coordinate] * drive.ratio + drive.offset
            # A continuous joint has the cosine and sine of its angle.
            out[joint.idx_q : joint.idx_q + joint.nq] = (
                x if joint.nq == 1 else (np.cos(x), np.sin(x))
            )
        return out

    def torque(self, q, dq, ddq) -> np.ndarray:
        full = (self.position(q), self.g @ dq, self.g @ ddq)
        return self.g.T @ self.pin.rnea(self.model, self.data, *full)

    def mass(self, q) -> np.ndarray:
        half = np.triu(self.pin.crba(self.model, self.data, self.position(q)))
        return self.g.T @ (half + np.triu(half, 1).T) @ self.g

    def regressor(self, q, dq, ddq) -> np.ndarray:
        full = (self.position(q), self.g @ dq, self.g @ ddq)
        y = self.pin.computeJointTorqueRegressor(self.model, self.data, *full)
        return self.g.T @ y

    def jacobian(self, q, link: int) -> np.ndarray:
        """Of a link's joint, in axes of the base: linear, then angular."""
        pin, joint = self.pin, self.model.getJointId(self.robot.drives[link].joint)
        at = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        pin.computeJointJacobians(self.model, self.data, self.position(q))
        return pin.getJointJacobian(self.model, self.data, joint, at) @ self.g


def agrees(path: Path) -> None:
    robot = load_robot(path)
    if robot.parameters is None:
        return
    oracle, draw = Published(path, robot), np.random.default_rng(0)
    q, dq, ddq = draw.uniform(-2, 2, (4, robot.n)), *draw.normal(size=(2, 4, robot.n))
    tau = torch.from_numpy(np.stack([oracle.torque(*x) for x in zip(q, dq, ddq, strict=True)]))
    assert relative(inverse_dynamics(robot, q, dq, ddq), tau) < 1e-10, path.name
    mass = torch.from_numpy(np.stack([oracle.mass(x) for x in q]))
    assert relative(forward.mass_matrix(robot, q), mass) < 1e-10, path.name


def chosen(names: tuple[str, ...]) -> list[Path]:
    return [path for path in package_urdfs() if path.name in names]


@pytest.mark.parametrize("path", chosen(QUICK), ids=lambda path: path.name)
def test_torque_and_mass_equal_pinocchios(path: Path):
    agrees(path)


@pytest.mark.nightly
@pytest.mark.skipif(not package_urdfs(), reason="needs the package example-robot-data")
def test_torque_and_mass_of_all_equal_pinocchios():
    for path in package_urdfs():
        if path.name not in STILL:
            agrees(path)


@pytest.mark.parametrize("path", chosen(("solo12.urdf", "panda.urdf")), ids=lambda path: path.name)
def test_jacobians_equal_pinocchios(path: Path):
    robot = load_robot(path)
    oracle, q = Published(path, robot), np.random.default_rng(1).uniform(-2, 2, robot.n)
    # Link frames of a URDF are where Pinocchio's joints are.
    eye = torch.eye(4, dtype=torch.float64)
    ends = tuple(Tip(name, k, eye) for k, name in enumerate(robot.link_names))
    named = replace(robot, tips=ends)
    for k, name in enumerate(robot.link_names):
        found = tool_jacobian(named, torch.from_numpy(q), name)
        np.testing.assert_allclose(found.numpy(), oracle.jacobian(q, k), rtol=0, atol=1e-11)


@pytest.mark.parametrize("path", chosen(("bolt.urdf", "panda.urdf")), ids=lambda path: path.name)
def test_base_parameters_are_as_many_as_the_rank_of_pinocchios_regressor(path: Path):
    robot = load_robot(path)
    oracle, draw = Published(path, robot), np.random.default_rng(2)
    count = 12 * robot.n
    motion = (draw.uniform(-3, 3, (count, robot.n)), *draw.normal(size=(2, count, robot.n)))
    stacked = np.concatenate([oracle.regressor(*x) for x in zip(*motion, strict=True)])
    rank = np.linalg.matrix_rank(stacked / np.linalg.norm(stacked, axis=0).max(), 1e-9)
    assert len(base_parameters(robot)) == rank
