"""Coverage of identify's 95 % intervals on many logs with noise of several kinds."""

import pytest
import torch

from tests.identification.test_statistics import noisy_source, truth
from tests.nights import seeds_of_the_night
from torchid.identification.least_squares import fit
from torchid.identification.statistics import jackknife

pytestmark = pytest.mark.nightly
RUNS = 100


@pytest.mark.parametrize("method", ["wls", "huber"])
@pytest.mark.parametrize("kind", ["white", "ar1", "heteroscedastic", "heavy tails"])
def test_intervals_of_base_parameters(kind, method):
    inside = []
    for seed in seeds_of_the_night(RUNS):
        source = noisy_source(kind, seed)
        found = fit(source, method=method)
        uncertainty = jackknife(source, found)
        half = uncertainty.quantile() * uncertainty.std
        inside.append(((found.x - truth()).abs() <= half).double())
    assert 93 < 100 * float(torch.stack(inside).mean()) < 97
