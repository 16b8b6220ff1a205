"""A motion that shows every effect, and instances of every kind, for the battery."""

from functools import lru_cache

import torch
from torch import Tensor

from tests.arms import arm
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import Effect, JointEffect, ModelEffect, Motion
from torchid.robot.model import Robot

ROBOT = "mixed"
JOINT = 2
"""A revolute joint in the middle of the arm."""
SAMPLES = 600
RATE = 100.0
WARM_UP = 1.5
"""Seconds between dwells."""


@lru_cache
def trajectory(robot_name: str = ROBOT, seed: int = 5) -> Motion:
    """Smooth motion of all joints (T, n) that reverses, is slow and fast, and dwells now and then;
    with time, the model's torque, and torque samples of different age.

    Sines of the path parameter s, whose rate 1 - cos(2 pi t / P) is zero once a period.
    """
    robot = arm(robot_name)
    g = torch.Generator().manual_seed(seed)
    t = torch.arange(SAMPLES, dtype=torch.float64) / RATE
    beat = 2 * torch.pi / WARM_UP
    s, ds = t - torch.sin(beat * t) / beat, 1 - torch.cos(beat * t)
    dds = beat * torch.sin(beat * t)
    size, rate, phase = (
        low + (high - low) * torch.rand(3, robot.n, generator=g, dtype=torch.float64)
        for low, high in ((0.2, 0.6), (0.6, 3.0), (0.0, 6.0))
    )
    angle = rate.unsqueeze(1) * s[:, None] + phase.unsqueeze(1)
    q, slope, bend = (
        (size.unsqueeze(1) * rate.unsqueeze(1) ** k * f).sum(0)
        for k, f in enumerate((angle.sin(), angle.cos(), -angle.sin()))
    )
    q = q + torch.linspace(-1, 1, robot.n, dtype=torch.float64)
    dq = slope * ds[:, None]
    ddq = bend * ds[:, None] ** 2 + slope * dds[:, None]
    age = 0.004 * (torch.arange(SAMPLES) % 3).to(t).unsqueeze(-1).expand(-1, robot.n)
    torque = inverse_dynamics(robot, q, dq, ddq)
    return Motion(q, dq, ddq, t=t, torque=torque, age=age)


def scale(name: str, motion: Motion, joint: int) -> float:
    """What a shape is relative to, on a joint."""
    if name == "one":
        return 1.0
    if name == "travel":
        return float(motion.q[:, joint].max() - motion.q[:, joint].min())
    signal = {"speed": motion.dq, "torque": motion.torque}[name]
    assert signal is not None
    return float(torch.quantile(signal[:, joint].abs(), 0.99))


def shape_grid(kind: type[Effect], motion: Motion, joint: int = JOINT) -> list[Tensor]:
    """Per shape parameter its grid (S,), for this motion."""
    return [
        torch.tensor(s.grid, dtype=torch.float64) * scale(s.scale, motion, joint)
        for s in kind.shapes
    ]


def on_joint(kind: type[JointEffect], joint: int = JOINT) -> JointEffect:
    """An instance on a joint of the trajectory, its shapes in the middle of their grids."""
    grids = shape_grid(kind, trajectory(), joint)
    shapes = {s.name: float(g[len(g) // 2]) for s, g in zip(kind.shapes, grids, strict=True)}
    return kind(joint, **shapes)


def instances(kind: type[Effect]) -> list[Effect]:
    """A joint effect on every joint, or what a model effect proposes."""
    robot = arm(ROBOT)
    if issubclass(kind, JointEffect):
        return [on_joint(kind, joint) for joint in range(robot.n)]
    assert issubclass(kind, ModelEffect)
    return list(kind.candidates(robot))


def planted(effect: Effect) -> list[float]:
    """Values of an effect's coefficients."""
    return [0.37 + 0.2 * k for k in range(len(effect.coefficients))]


def instants(motion: Motion, *batch: int) -> Motion:
    """Instants of a trajectory, picked at random: signals (*batch, n), t (*batch)."""
    g = torch.Generator().manual_seed(11)
    picks = torch.randint(0, motion.q.shape[0], batch, generator=g)
    return Motion(*(None if x is None else x[picks] for x in motion))


def robot() -> Robot:
    """The arm of the trajectory."""
    return arm(ROBOT)
