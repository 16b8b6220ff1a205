"""Which axes of an arm could as well point the other way: sign patterns that leave the span of its
regressor unchanged.

With q, dq, ddq and tau of some joints negated, an arm that is its own mirror image in those axes
has the torques of its mirrored bodies: no log tells the two apart. These patterns are a group: two
of them, one after the other, are another one.
"""

import itertools
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch

from torchid.dynamics.regressor import regressor
from torchid.robot.model import Robot

Group = frozenset[int]
"""Joints, from 0, whose axes are turned around together."""
MOST = 8
"""Joints up to which every pattern is tried; of more, those of one, two and all of them."""
_ROWS = 24
_SAME = 1e-8


def invisible_groups(robot: Robot, gravity: tuple[float, ...]) -> tuple[Group, ...]:
    """Groups of axes that mirrored bodies explain, by the geometry alone, smallest first.

    Args:
        robot: its kinematics.
        gravity: (3,) in the base frame [m/s^2].
    """
    return _groups(id(robot), gravity, _Held(robot))


class _Held:
    """A robot that is no part of a cache's key: tensors have no hash."""

    def __init__(self, robot: Robot):
        self.robot = robot

    def __hash__(self) -> int:
        return id(self.robot)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Held) and other.robot is self.robot


@lru_cache(maxsize=8)
def _groups(_: int, gravity: tuple[float, ...], held: _Held) -> tuple[Group, ...]:
    robot = replace(held.robot, gravity=torch.tensor(gravity, dtype=torch.float64))
    n = robot.n
    generator = torch.Generator().manual_seed(0)
    motion = torch.randn(3, _ROWS, n, generator=generator, dtype=torch.float64)
    bodies = torch.randn(10 * n, generator=generator, dtype=torch.float64)
    tau = regressor(robot, *motion) @ bodies
    return tuple(g for g in _candidates(n) if _explains(robot, motion, tau, g))


def _candidates(n: int) -> list[Group]:
    every = range(n)
    sizes = range(1, n + 1) if n <= MOST else (1, 2, n)
    return [frozenset(g) for size in sizes for g in itertools.combinations(every, size)]


def _explains(robot: Robot, motion: torch.Tensor, tau: torch.Tensor, group: Group) -> bool:
    """Whether some bodies make the torques of these axes turned around."""
    sign = torch.ones(robot.n, dtype=torch.float64)
    sign[list(group)] = -1.0
    matrix = regressor(robot, *(x * sign for x in motion)).flatten(0, 1).numpy()
    target = (tau * sign).flatten().numpy()
    size = np.linalg.norm(matrix, axis=0)
    matrix = matrix / np.where(size > 0, size, 1.0)
    left = target - matrix @ np.linalg.lstsq(matrix, target, rcond=1e-11)[0]
    return bool(np.linalg.norm(left) < _SAME * np.linalg.norm(target))


def least_groups(groups: tuple[Group, ...]) -> list[Group]:
    """Those that hold no other one."""
    return [g for g in groups if not any(other < g for other in groups)]


def alternatives(turned: Group, groups: tuple[Group, ...]) -> list[Group]:
    """All groups that explain a log as well as this one, smallest first; axes that may point either
    way by themselves are left as they are."""
    alone = frozenset().union(*(g for g in groups if len(g) == 1))
    found = {turned - alone, *((turned ^ g) - alone for g in groups)}
    return sorted(found, key=lambda g: (len(g), sorted(g)))
