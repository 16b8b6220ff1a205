"""Power densities beside those of scipy."""

import numpy as np
import pytest
from scipy.signal import welch

from torchid.statistics.spectrum import density


@pytest.mark.parametrize("length", [64, 65, 400])
def test_densities_are_those_of_scipy(length: int) -> None:
    x = np.random.default_rng(0).normal(size=(400, 3)).cumsum(0)
    frequency, power = density(x, 100.0, length)
    expected = welch(x, 100.0, nperseg=length, axis=0)
    np.testing.assert_allclose(frequency, expected[0])
    np.testing.assert_allclose(power, expected[1], rtol=1e-9)
