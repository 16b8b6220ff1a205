"""Inverse dynamics at many motions that differ in one joint alone: what the links before it do is
computed once for all of them."""

import torch

from torchid.dynamics.newton_euler import CHUNK, components
from torchid.dynamics.recursion import chain_geometry, forces, kinematics
from torchid.robot.model import Robot
from torchid.typing import Float, Tensor


def torques_of_one_joint(
    robot: Robot,
    state: tuple[Float[Tensor, "T n"], Float[Tensor, "T n"], Float[Tensor, "T n"]],
    joint: int,
    own: tuple[Float[Tensor, "*batch T"], Float[Tensor, "*batch T"], Float[Tensor, "*batch T"]],
) -> Float[Tensor, "*batch T n"]:
    """Torques of the rigid body [N m; N for prismatic joints], one joint moving otherwise.

    Args:
        robot: with parameters.
        state: q, dq, ddq of all joints [rad, rad/s, rad/s^2; m for prismatic joints].
        joint: whose motion is another one, from 0.
        own: its q, dq, ddq.
    """
    geometry = chain_geometry(robot)
    pi = components(robot.require_parameters("inverse dynamics").pi.to(state[0]).double())
    instants, n = state[0].shape
    batch = own[0].shape[:-1]
    # Joint by joint, time last: filters along time find it contiguous.
    out = torch.empty(*batch, n, instants, dtype=torch.float64, device=own[0].device)
    step = max(1, CHUNK // max(1, batch.numel()))
    for start in range(0, instants, step):
        some = slice(start, start + step)
        motion = [list(x[some].T.contiguous().double().unbind(0)) for x in state]
        for signals, x in zip(motion, own, strict=True):
            signals[joint] = x[..., some].double()
        torques, _ = forces(geometry, kinematics(geometry, *motion), pi)
        for j, torque in enumerate(torques):
            out[..., j, some] = torque
    return out.mT
