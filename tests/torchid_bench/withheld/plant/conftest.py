"""Short motions of the 3R, and logs without noise."""

from dataclasses import replace

import numpy as np
import pytest

from torchid_bench.withheld.plant.arms import arm_named
from torchid_bench.withheld.plant.draw import TorqueSpec, draw_case
from torchid_bench.withheld.plant.model import plant_of
from torchid_bench.withheld.plant.motion import MotionPlan
from torchid_bench.withheld.plant.plan import Plan, Scene
from torchid_bench.withheld.plant.scene import Nominal, friction_known, nominal_of, scene_of

SHORT = MotionPlan(
    seed=3,
    shapes=(0, 1),
    levels=(0.9, 0.6),
    seconds=(4.0, 4.0),
    pauses=(0.0, 1.0),
    moving=(0, 1, 2),
)


def short(spec: TorqueSpec) -> TorqueSpec:
    """The case on short motions, logged without noise."""
    logger = replace(
        spec.logger,
        rate_hz=1000,
        encoder_bits=45,
        jitter=0.0,
        own_velocity=True,
        velocity_noise=0.0,
    )
    moving = tuple(range(arm_named(spec.arm).n))
    motion = replace(SHORT, moving=moving)
    return replace(spec, motion=motion, noise_share=1e-7, logger=logger)


def quiet(arm: str = "3r", friction: float = 0.01, number: int = 0) -> TorqueSpec:
    """A case without effects, as `short`."""
    spec = short(draw_case(1, number, kind="none", arm=arm))
    n = arm_named(arm).n
    return replace(spec, viscous=(friction,) * n, coulomb=(friction,) * n)


@pytest.fixture(scope="session")
def bench() -> tuple[Scene, Plan, Nominal]:
    """The 3R on a short motion with known friction, without effects."""
    arm = arm_named("3r")
    damping, friction = friction_known(arm, np.full(3, 0.01), np.full(3, 0.01))
    nominal = nominal_of(arm, damping, friction)
    scene = scene_of(arm, nominal, SHORT, 0.01, 5.0, 0.8)
    return scene, Plan(plant_of(arm, damping, friction), damping, friction), nominal
