"""When a search for a motion stops early, and when its result hardly beats a plain motion."""

import math
from dataclasses import replace

import pytest
import torch

from tests.excitation.usage import full_design
from torchid.excitation.descent import HARDLY, LONGER, descend
from torchid.excitation.limits import motion_limits
from torchid.excitation.trajectories import random_trajectory
from torchid.robot.library import load_robot


def searched(cost, iterations=60):
    """Iterations done of those asked for."""
    robot = load_robot("3r")
    start = random_trajectory(robot, 0, count=3, fill=True)
    seen = []
    descend(start, motion_limits(robot), cost, iterations, lambda done, _: seen.append(done))
    return seen[-1]


@pytest.mark.parametrize("iterations", [60, 61])
def test_a_search_that_gains_nothing_stops_half_way(iterations):
    assert searched(lambda x, t: 0 * x.q0.sum(-1), iterations) == 30
    # What is gained is less than a tenth more driving time would bring.
    assert searched(lambda x, t: 1e-3 * torch.tanh(x.q0).sum(-1), iterations) == 30
    assert searched(lambda x, t: x.q0.sum(-1), iterations) == iterations


def test_a_tenth_more_driving_time_is_that_much_standard_deviation():
    assert math.exp(HARDLY) == pytest.approx(math.sqrt(LONGER))
    design = full_design(load_robot("3r"), seed=0, restarts=3, iterations=40)
    assert not design.hardly
    # The cost is the logarithm of the condition number, along 100 instants instead of 1000.
    gained = math.log(design.start_condition / design.condition_after)
    assert design.gain == pytest.approx(gained, abs=0.02)
    assert replace(design, gain=0.99 * HARDLY).hardly
    unsearched = full_design(load_robot("3r"), seed=0, restarts=1, iterations=0)
    assert unsearched.hardly
    assert unsearched.gain == 0
