import pytest
import torch

from tests.robot.test_chain import EXACT, positions
from torchid.robot.jacobian import tool_jacobian
from torchid.robot.urdf import read_urdf


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
