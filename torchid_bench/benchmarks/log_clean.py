"""Clean logs of arms that are not quite as described: what the log doctor must not cry wolf at."""

from dataclasses import replace
from functools import lru_cache

import torch

from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.robot.model import Robot


@lru_cache
def clean(
    name: str,
    seed: int = 0,
    *,
    nominal: bool = False,
    rate: float = 100.0,
    gears: bool = False,
    duration: float = 20.0,
) -> tuple[Robot, Log]:
    """A robot as described and a log of what it really is.

    The real arm's joints have viscous and Coulomb friction, an offset and a rotor's inertia;
    position is counted, velocity and torque are noisy. Without `nominal` the description has no
    parameters. With `gears` the friction is as of motor currents: four times as large, of
    Stribeck's and a degressive shape, larger under load and when cold; torque has a ripple.
    """
    described = _described(name, seed)
    generator = torch.Generator().manual_seed(1000 + seed)
    n = described.n

    def uniform() -> torch.Tensor:
        return 2 * torch.rand(n, generator=generator, dtype=torch.float64) - 1

    assert described.parameters is not None
    # 0.4: masses are off by up to this share, each by itself
    factor = 1 + 0.4 * uniform()
    real = described.with_parameters(InertialParameters(described.parameters.pi * factor[:, None]))
    motion = trajectory_log(
        random_trajectory(described, seed, fill=True, usage=0.8, duration=duration), rate
    )
    log = synthetic_log(
        replace(real, effects=()),
        motion,
        HonestNoise(torque_relative=0.02, include_velocity=True, velocity_relative=0.01),
        seed,
    )
    assert log.tau is not None
    assert motion.dq is not None
    assert motion.ddq is not None
    size = log.tau.std(0)
    size = size.clamp(min=0.02 * float(size.max()))  # no joint is without friction
    spread = 1 + 0.5 * uniform()
    if gears:
        tau = log.tau + _gear_friction(size * spread, motion, log.tau)
        tau = tau + 0.05 * size * torch.randn(tau.shape, generator=generator, dtype=tau.dtype)
    else:
        tau = log.tau + size * spread * (0.1 * torch.sign(motion.dq) + 0.1 * motion.dq)
    tau = tau + size * 0.01 * (1 + uniform()) * motion.ddq + 0.02 * size * uniform()
    shown = described if nominal else described.with_parameters(None)
    return shown, log.replace(tau=tau, source=f"{name}_{seed}{'_gears' if gears else ''}")


def _gear_friction(size: torch.Tensor, motion: Log, load: torch.Tensor) -> torch.Tensor:
    """Coulomb's with Stribeck's, of the load's size too, and as the root of speed; a fifth of it
    goes as the oil warms up; a ripple twice a tenth of a turn of the joint."""
    assert motion.dq is not None
    speed = motion.dq.abs()
    dry = 0.4 * (1 + 0.4 * torch.exp(-((speed / 0.1) ** 2))) * size + 0.1 * load.abs()
    wet = 0.25 * size * (speed + 0.01).sqrt()
    warm = 1 - 0.2 * (1 - torch.exp(-3 * (motion.t - motion.t[0]) / motion.t[-1]))
    ripple = 0.03 * size * torch.sin(20 * motion.q)
    return warm[:, None] * torch.sign(motion.dq) * (dry + wet) + ripple


def _described(name: str, seed: int) -> Robot:
    """A built-in robot; limits and bodies that an arm may have where the file has none."""
    robot = load_robot(name)
    robot = replace(robot, effects=())
    if robot.parameters is None:
        robot = robot.with_parameters(_bodies(robot.n, seed))
    limits = robot.limits
    if limits.position is None or limits.velocity is None or limits.acceleration is None:
        box = torch.tensor([-1.0, 1.0], dtype=torch.float64).expand(robot.n, 2)
        robot = replace(
            robot, limits=replace(limits, position=2 * box, velocity=2 * box, acceleration=8 * box)
        )
    return robot


def _bodies(n: int, seed: int) -> InertialParameters:
    """Links as clouds of points, lighter and smaller towards the hand (8 kg and 0.1 m to 1 kg and
    0.04 m)."""
    generator = torch.Generator().manual_seed(seed)
    share = torch.linspace(0, 1, n, dtype=torch.float64)
    mass, width = 8.0 * (1 / 8) ** share, 0.1 - 0.06 * share
    x = torch.randn(n, 12, 3, generator=generator, dtype=torch.float64) * width[:, None, None]
    x = x + torch.randn(n, 1, 3, generator=generator, dtype=torch.float64) * width[:, None, None]
    outer = torch.einsum("lpi,lpj->lij", x, x) / 12
    eye = torch.eye(3, dtype=torch.float64)
    inertia = outer.diagonal(dim1=1, dim2=2).sum(-1)[:, None, None] * eye - outer
    six = inertia[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    pi = torch.cat([torch.ones(n, 1, dtype=torch.float64), x.mean(1), six], 1)
    return InertialParameters(mass[:, None] * pi)
