"""Short logs of the 3R, and what is planted in them: public names only, so that the tests that use
them outlive any change inside the diagnosis."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import torch

from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.log.model import Log
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.simulation.sensors import Sensors, measured_log

ROBOT = load_robot("3r")
RATE = 125.0
NOISE = 0.05
"""Standard deviation of the torque noise [N m]."""

REPEATED = (0, 1, 2, 0)
"""Seeds of the runs: the last one repeats the first."""
ONCE = (0, 1, 2)


def friction(joint: int, **values: float) -> dict[str, Any]:
    """A record of Coulomb (Fc) or viscous (Fv) friction; joint from 1."""
    name = {"Fc": "coulomb_friction", "Fv": "viscous_friction"}[next(iter(values))]
    return {"effect": name, "joint": joint, **values}


def arm(*effects: dict[str, Any], robot: Robot = ROBOT) -> Robot:
    return replace(robot, effects=tuple(effects))


def carrying(mass: float, com: Sequence[float], inertia: float, robot: Robot = ROBOT) -> Robot:
    """With a body on the last link: mass [kg], centre [m] in the link's frame, and the moment of
    inertia about its own centre [kg m^2], the same about all axes."""
    from torchid.robot.inertia import InertialParameters

    box = InertialParameters.from_com(
        torch.tensor([mass], dtype=torch.float64),
        torch.tensor([list(com)], dtype=torch.float64),
        inertia * torch.tensor([[1, 0, 0, 1, 0, 1]], dtype=torch.float64),
    )
    pi = robot.require_parameters("a test").pi.clone()
    pi[-1] += box.pi[0]
    return robot.with_parameters(InertialParameters(pi))


@dataclass(frozen=True)
class Recording:
    """How a log is made.

    Attributes:
        runs: seeds of the motions.
        noise: standard deviation of the torque noise [N m].
        colour_hz: cut-off of AR(1) noise [Hz]; None for white noise.
        duration: of each run [s].
        rate: samples a second.
        seed: of the noise.
    """

    runs: tuple[int, ...] = REPEATED
    noise: float = NOISE
    colour_hz: float | None = None
    duration: float = 8.0
    rate: float = RATE
    seed: int = 0


@cache
def _motions(runs: tuple[int, ...], duration: float, rate: float) -> Log:
    return Log.concatenate(
        [
            trajectory_log(
                random_trajectory(ROBOT, seed, duration=duration, fill=True), rate, (f"run{seed}",)
            )
            for seed in runs
        ]
    )


def true_motion(how: Recording) -> Log:
    """t, q, dq, ddq without any noise."""
    return _motions(how.runs, how.duration, how.rate)


def logged(robot: Robot, how: Recording | None = None) -> Log:
    """What sensors make of these motions of an arm: t, q, tau."""
    how = how or Recording()
    sensors = Sensors(HonestNoise(colour_hz=how.colour_hz), torque_std=how.noise)
    true = synthetic_log(robot, _motions(how.runs, how.duration, how.rate))
    return measured_log(robot, true, [], sensors, how.seed)
