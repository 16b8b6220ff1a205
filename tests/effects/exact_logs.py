"""Smooth motions with exact derivatives, and what a model effect leaves of the gap it makes."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import ModelEffect, Motion
from torchid.robot.model import Robot

EDGE = 40
"""Samples at either end that delays and differences may spoil."""


def smooth_motion(
    robot: Robot, samples: int = 1500, rate: float = 1000.0, seed: int = 5, speed: float = 6.0
) -> Motion:
    """Sums of three sines a joint, with the torque of the robot."""
    g = torch.Generator().manual_seed(seed)
    shape = (3, 1, robot.n)
    size = 0.4 * (0.3 + torch.rand(shape, generator=g, dtype=torch.float64))
    w = speed * (0.3 + torch.rand(shape, generator=g, dtype=torch.float64))
    phase = 6 * torch.rand(shape, generator=g, dtype=torch.float64)
    centre = 2 * torch.rand(robot.n, generator=g, dtype=torch.float64) - 1
    t = torch.arange(samples, dtype=torch.float64) / rate
    angle = w * t.unsqueeze(-1) + phase
    q = centre + (size * torch.sin(angle)).sum(0)
    dq = (size * w * torch.cos(angle)).sum(0)
    ddq = -(size * w**2 * torch.sin(angle)).sum(0)
    return Motion(q, dq, ddq, t=t, torque=inverse_dynamics(robot, q, dq, ddq))


def gap(effect: ModelEffect, robot: Robot, values: Sequence[float]) -> tuple[Tensor, Tensor]:
    """Measured torque minus the model's along the measured motion, without and with the effect.

    The arm is the effect's `plant`, the log what `measured` makes of its true motion; the columns
    see only what a diagnosis has: the measured motion and the torque of the model along it.
    """
    true = smooth_motion(effect.plant(robot, values))
    log = effect.measured(true, values, robot)
    assert log.torque is not None
    model = inverse_dynamics(robot, *log.state)
    columns = effect.torque_columns(log._replace(torque=model), robot)
    before = log.torque - model
    after = before - columns @ torch.tensor(values, dtype=torch.float64)
    return before[EDGE:-EDGE], after[EDGE:-EDGE]


def order(effect: ModelEffect, robot: Robot, values: Sequence[float]) -> float:
    """Power of the coefficients with which the rest shrinks: 2 where the columns are exact
    derivatives."""
    rests = [
        gap(effect, robot, [v * scale for v in values])[1].square().mean().sqrt()
        for scale in (1.0, 0.5)
    ]
    return float(torch.log2(rests[0] / rests[1]))


def closed(effect: ModelEffect, robot: Robot, values: Sequence[float]) -> float:
    """Rest over gap, both root mean square."""
    before, after = gap(effect, robot, values)
    return float((after.square().mean() / before.square().mean()).sqrt())
