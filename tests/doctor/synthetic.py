"""Clean logs of arms that are not quite as described: bodies 30 % off, friction, noise."""

import importlib.util
import sys
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import torch

from tests.arms import arm
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.log.model import Log
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Limits, Robot

OFF = 0.3
_BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def _loaded(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, _BENCHMARKS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


log_faults = _loaded("log_faults")


@lru_cache
def clean(
    name: str, seed: int = 0, *, nominal: bool = False, rate: float = 100.0
) -> tuple[Robot, Log]:
    """A robot as described and a log of what it really is.

    The real arm's bodies have up to 30 % more or less mass than described, each by itself, its
    joints have viscous and Coulomb friction, an offset and a rotor's inertia; position is counted,
    velocity and torque are noisy. Without `nominal` the description has no parameters.
    """
    described = arm(name)
    generator = torch.Generator().manual_seed(1000 + seed)

    def uniform(*shape: int) -> torch.Tensor:
        return 2 * torch.rand(shape, generator=generator, dtype=torch.float64) - 1

    n = described.n
    limits = described.limits
    if limits.position is None or limits.velocity is None or limits.acceleration is None:
        box = torch.tensor([-1.0, 1.0], dtype=torch.float64).expand(n, 2)
        limits = Limits(position=2.0 * box, velocity=2.0 * box, acceleration=8.0 * box)
        described = Robot(**{**vars(described), "limits": limits})
    assert described.parameters is not None
    factor = 1 + OFF * uniform(n)
    real = described.with_parameters(InertialParameters(described.parameters.pi * factor[:, None]))
    motion = trajectory_log(
        random_trajectory(described, seed, fill=True, usage=0.8, duration=20.0), rate
    )
    log = synthetic_log(
        Robot(**{**vars(real), "effects": ()}),
        motion,
        HonestNoise(torque_relative=0.02, include_velocity=True, velocity_relative=0.01),
        seed,
    )
    assert log.tau is not None
    assert motion.dq is not None
    assert motion.ddq is not None
    size = log.tau.std(0)
    size = size.clamp(min=0.02 * float(size.max()))  # no joint is without friction
    friction = size * (0.1 + 0.05 * uniform(n)) * torch.sign(motion.dq)
    viscous = size * (0.1 + 0.05 * uniform(n)) * motion.dq
    rotor = size * (0.01 + 0.01 * uniform(n)) * motion.ddq
    tau = log.tau + friction + viscous + rotor + 0.02 * size * uniform(n)
    shown = described if nominal else described.with_parameters(None)
    return shown, log.replace(tau=tau, source=f"{name}_{seed}")
