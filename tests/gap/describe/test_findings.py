"""What is told: of a load beside corrected base parameters, which do whatever it does; of the
coefficient that is shown first."""

import pytest
import torch

from tests.gap.motions import ROBOT
from tests.gap.problems import explanation_of, measured, search_of, term
from torchid.effects.friction import ViscousFriction
from torchid.effects.inertia import Payload
from torchid.effects.spring import JointSpring
from torchid.gap.describe.covariance import covariance_of
from torchid.gap.describe.model import PAYLOAD, Solution
from torchid.gap.describe.replication import factors, motions, own_torque
from torchid.gap.wanted import BASE

LOAD = [0.5, 0.05, -0.02, 0.1, 0.08, 0.0, 0.0, 0.08, 0.0, 0.08]


@pytest.fixture(scope="module")
def solution() -> Solution:
    """A load, explained by itself and all links at once."""
    data = measured([(Payload(), LOAD)], noise=0.01)
    search = search_of(data, (PAYLOAD,), inertial=True)
    terms = {t.name: t for t in search.library.terms}
    return explanation_of(search, [terms[BASE], terms[PAYLOAD]]).solution


def test_a_load_is_the_load_and_not_the_links(solution: Solution) -> None:
    """What is known of the links beforehand decides, not how a fit divides the sum."""
    base, load = (solution.torque(k) for k in range(2))
    torque = torch.tensordot(torch.tensor(LOAD).double(), solution.a[solution.at(1)], 1)
    assert float((load - torque).norm()) < 0.2 * float(torque.norm())
    assert float(base.norm()) < 0.2 * float(torque.norm())


def test_a_load_is_known_no_better_than_the_body_that_carries_it(solution: Solution) -> None:
    """Its moments, beside those of a last link that may be off by 10 %."""
    std = solution.std[1]
    moments = ROBOT.require_parameters("a test").pi[-1, 1:4].abs().max()
    assert float(std[1:4].max()) > 0.05 * float(moments)


def test_links_and_loads_stay_bodies(solution: Solution) -> None:
    margin = solution.model.robot.require_parameters("a test").consistency_margin()
    assert bool((margin > 0).all())


def test_the_covariance_is_told_with_the_names_of_all_coefficients(solution: Solution) -> None:
    told = covariance_of(solution)
    assert told is not None
    names = [name for c in told.coefficients for name in c.names]
    assert len(names) == len(set(names)) == len(told.matrix)
    assert told.coefficients[-10].effect == PAYLOAD
    torch.testing.assert_close(told.matrix, solution.covariance)


@pytest.mark.parametrize(("k", "c0", "main"), [(-0.8, 8.9, 1), (8.9, -0.8, 0)])
def test_the_number_shown_first_makes_most_of_the_torque(k: float, c0: float, main: int) -> None:
    planted = JointSpring(1, 1.0)
    search = search_of(measured([(planted, [k, c0])], noise=0.01), (planted.name,))
    assert explanation_of(search, [term(search, planted)]).solution.main(0) == main


@pytest.mark.parametrize("second", [1.0, 0.0])
def test_each_motion_wants_the_cause_by_its_own_factor(second: float) -> None:
    """Friction that both runs have, or the first alone."""
    planted = ViscousFriction(1)
    there = measured([(planted, [1.0])], noise=0.01)
    other = measured([(planted, [second])], noise=0.01, seed=1)
    segments = [there.segments[0], other.segments[1]]
    data = type(there)(**{**vars(there), "samples": type(there.samples)(segments, 8.0)})
    search = search_of(data)
    found = explanation_of(search, [term(search, planted)]).solution
    left = found.left * found.weight.sqrt().unsqueeze(1)
    rows = [own for _, own in motions(data.samples)]
    every = factors(own_torque(found, 0), left, rows)
    value = float(found.values[0])
    for (factor, std), right in zip(every, (1.0, second), strict=True):
        assert factor * value == pytest.approx(right, abs=max(0.02, 4 * std))
