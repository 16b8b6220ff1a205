"""Arms for the tests of simulation, and short ways to make effects and references."""

from dataclasses import replace

import torch
from torch import Tensor

from tests.arms import arm
from torchid.effects.registry import Valued, effect_from_record
from torchid.excitation.trajectories import Sinusoid, trajectory_log
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import JointType, Limits, Robot
from torchid.robot.placement import pose
from torchid.simulation.closed_loop import plant_of
from torchid.simulation.integrate import Drive, Plant, State

INERTIA = 0.5
"""Of the flywheel about its axis [kg m^2]."""


def flywheel() -> Robot:
    """One joint, balanced, without gravity: I ddq = tau."""
    pi = torch.zeros(1, 10, dtype=torch.float64)
    pi[0, 0], pi[0, 4], pi[0, 7], pi[0, 9] = 1.0, INERTIA, INERTIA, INERTIA
    return Robot(
        name="flywheel",
        joint_names=("joint_1",),
        link_names=("link_1",),
        joint_types=(JointType.REVOLUTE,),
        before=pose().unsqueeze(0),
        after=pose().unsqueeze(0),
        gravity=torch.zeros(3, dtype=torch.float64),
        tool=pose(),
        limits=Limits(),
        parameters=InertialParameters(pi),
    )


def bare(name: str) -> Robot:
    """An arm of tests/arms.py without nominal effects."""
    return replace(arm(name), effects=())


def effect(robot: Robot, name: str, **entries: float) -> Valued:
    return effect_from_record({"effect": name, **entries}, robot)


def reference(robot: Robot, seconds: float, rate: float = 500.0, speed: float = 0.8) -> Log:
    """All joints swing at once, from rest; each with a period of its own."""
    n = robot.n
    period = torch.linspace(0.9, 1.7, n, dtype=torch.float64)
    start = torch.linspace(-0.4, 0.5, n, dtype=torch.float64)
    return trajectory_log(
        Sinusoid(torch.full((n,), speed, dtype=torch.float64), period, start, seconds), rate
    )


def run(plant: Plant, q: Tensor, dq: Tensor, seconds: float, h: float, tau: Tensor) -> list[State]:
    """States of arms (B, n) under a constant torque."""
    t = torch.zeros(q.shape[0], dtype=torch.float64)
    states = [plant.start(q, dq, torch.zeros_like(q), t)]
    for k in range(round(seconds / h)):
        state, _ = plant.step(states[-1], h, t + (k + 0.5) * h, Drive(tau))
        states.append(state)
    return states


def free(robot: Robot, effects: list[Valued], q: Tensor) -> Plant:
    return plant_of(robot, [effects] * q.shape[0], q)
