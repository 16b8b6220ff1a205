"""Inverse dynamics of motions that differ in one joint is that of each of them."""

import math

import pytest
import torch

from tests.arms import arm
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.one_joint import torques_of_one_joint


@pytest.mark.parametrize("name", ["3r", "mixed"])
@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 3)])
def test_one_joint_s_torques_are_those_of_the_whole_motion(
    name: str, batch: tuple[int, ...]
) -> None:
    robot, generator = arm(name), torch.Generator().manual_seed(4)
    many = 13_001 // math.prod(batch)
    state = tuple(torch.randn(3, many, robot.n, generator=generator, dtype=torch.float64).unbind())
    own = tuple(torch.randn(3, *batch, many, generator=generator, dtype=torch.float64).unbind())
    for joint in range(robot.n):
        found = torques_of_one_joint(robot, state, joint, own)
        motion = [x.expand(*batch, *x.shape).clone() for x in state]
        for x, moved in zip(motion, own, strict=True):
            x[..., joint] = moved
        assert found.shape == (*batch, many, robot.n)
        assert torch.allclose(found, inverse_dynamics(robot, *motion), atol=1e-10)
