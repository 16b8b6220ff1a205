"""When a search for a motion stops early, and when its result hardly beats a plain motion."""

import math
from dataclasses import replace

import pytest
import torch

from tests.excitation.usage import full_design
from torchid.excitation.limits import motion_limits
from torchid.excitation.restriction import AllOf
from torchid.excitation.search import HARDLY, LONGER, Evolution, most_telling, search
from torchid.excitation.trajectories import random_trajectory
from torchid.robot.library import load_robot


def searched(cost, iterations=60):
    """Iterations done of those asked for."""
    robot = load_robot("3r")
    start = random_trajectory(robot, 0, count=3, fill=True)
    seen = []
    search(
        start, motion_limits(robot), cost, cost, iterations, lambda done, _: seen.append(done),
        kept=AllOf.of(robot, 1.0),
    )  # fmt: skip
    return seen[-1]


@pytest.mark.parametrize("iterations", [60, 61])
def test_a_search_that_gains_nothing_stops_half_way(iterations):
    assert searched(lambda x: 0 * x.q0.sum(-1), iterations) == 30
    # What is gained is less than a tenth more driving time would bring.
    assert searched(lambda x: 1e-3 * torch.tanh(x.q0).sum(-1), iterations) == 30
    assert searched(lambda x: x.q0.sum(-1), iterations) == iterations


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


def test_a_search_without_gradients_finds_the_same():
    """The motion whose coefficients are nearest in direction to some, by a cost that jumps."""
    robot = load_robot("3r")
    wanted = random_trajectory(robot, 7, count=2, fill=True).coefficients[1]

    def cost(x):
        alike = torch.nn.functional.cosine_similarity(x.coefficients, wanted, dim=-1)
        return (1 - alike).sum(-1).mul(1000).floor() / 1000

    start = random_trajectory(robot, 0, count=2, fill=True)
    begun, best, costs = search(
        start, motion_limits(robot), cost, cost, 150, kept=AllOf.of(robot, 1.0), way=Evolution
    )
    assert torch.equal(costs[:2], cost(begun))
    assert float(cost(best)) == float(costs.min()) < 0.05 * float(costs[1])


def test_what_tells_most_is_chosen_beside_what_is_known():
    """Once the first is known the third, which is most of it again, tells less than the second."""
    told = torch.tensor([[9.0, 1.0], [0.0, 3.0], [8.0, 0.2]])
    for count, chosen in ((2, [0, 1]), (9, [0, 1, 2])):
        assert most_telling(torch.ones(2), told, lambda x: -x.log().sum(-1), count) == chosen
