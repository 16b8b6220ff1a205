"""Power densities beside those of scipy."""

import numpy as np
import pytest
from scipy.signal import welch

from torchid.statistics import spectrum


@pytest.mark.parametrize("samples", [128, 255, 300_000])
@pytest.mark.parametrize("length", [127, 128])
def test_a_density_is_that_of_welch(samples, length, monkeypatch):
    monkeypatch.setattr(spectrum, "AT_ONCE", 1000)
    x = np.random.default_rng(samples).standard_normal((samples, 2)).cumsum(0)
    frequency, power = spectrum.density(x, 250.0, length)
    expected = welch(x, 250.0, nperseg=length, axis=0)
    assert np.array_equal(frequency, expected[0])
    assert np.allclose(power, expected[1], rtol=1e-9, atol=0)
