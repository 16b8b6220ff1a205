"""Coverage of 95 % intervals, with as many columns as a 7R arm has base parameters."""

import pytest

from tests.nights import seeds_of_the_night
from tests.statistics.noise import coverage

pytestmark = pytest.mark.nightly
RUNS = 200


@pytest.mark.parametrize("kind", ["as the noise", "smooth"])
@pytest.mark.parametrize("blocks", [20, 40])
@pytest.mark.parametrize("keep", [0.5, 0.9, 0.97])
def test_intervals_of_given_blocks(keep, blocks, kind):
    assert 93 < coverage(seeds_of_the_night(RUNS), keep, blocks, kind=kind) < 97.3


@pytest.mark.parametrize("kind", ["as the noise", "smooth"])
@pytest.mark.parametrize("keep", [0.5, 0.9, 0.97])
def test_intervals_of_the_residuals_own_blocks(keep, kind):
    assert 93 < coverage(seeds_of_the_night(RUNS), keep, 40, kind=kind, own_blocks=True) < 97.3
