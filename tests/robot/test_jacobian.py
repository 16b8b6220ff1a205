import pytest
import torch

from tests.robot.test_chain import EXACT, positions, robots
from torchid.robot.jacobian import tool_jacobian
from torchid.robot.model import tool_pose
from torchid.robot.urdf import read_urdf


def numerical_jacobian(robot, q: torch.Tensor, step: float = 1e-6) -> torch.Tensor:
    """Central differences of the tool's position and rotation, in axes of the base."""
    rotation = tool_pose(robot, q)[:3, :3]
    columns = []
    for i in range(robot.n):
        delta = torch.zeros_like(q)
        delta[i] = step
        change = (tool_pose(robot, q + delta) - tool_pose(robot, q - delta)) / (2 * step)
        spin = change[:3, :3] @ rotation.T
        omega = torch.stack([spin[2, 1], spin[0, 2], spin[1, 0]])
        columns.append(torch.cat([change[:3, 3], omega]))
    return torch.stack(columns, -1)


def test_jacobian_equals_differences_of_the_tool_pose(arm_urdf):
    for robot in robots(arm_urdf):
        q = positions(robot.n, 4)
        jacobian = tool_jacobian(robot, q)
        for k in range(4):
            assert (jacobian[k] - numerical_jacobian(robot, q[k])).abs().max() < 1e-8


def test_jacobian_equals_pinocchios(arm_urdf, configurations):
    pin = pytest.importorskip("pinocchio")
    robot = read_urdf(arm_urdf)
    model = pin.buildModelFromUrdf(str(arm_urdf))
    data = model.createData()
    ours = tool_jacobian(robot, configurations)
    for k, q in enumerate(configurations.numpy()):
        at = pin.integrate(model, pin.neutral(model), q)
        frame = model.getFrameId("tcp")
        expected = pin.computeFrameJacobian(
            model, data, at, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        assert (ours[k] - torch.from_numpy(expected)).abs().max() < EXACT


@pytest.mark.parametrize("batch", [(), (1,), (7,), (2, 3), (2, 0), (2, 1, 3)])
def test_jacobian_takes_any_batch(arm_urdf, batch):
    robot = read_urdf(arm_urdf)
    q = positions(6, *batch)
    jacobian = tool_jacobian(robot, q)
    assert jacobian.shape == (*batch, 6, 6)
    flat = tool_jacobian(robot, q.reshape(-1, 6))
    assert jacobian.reshape(-1, 6, 6).equal(flat)
