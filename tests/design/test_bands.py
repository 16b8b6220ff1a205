"""Bands that a log's rate allows, and the direction of motion."""

import pytest
import torch

from tests.gap.motions import ROBOT, motion_at, segment_of, times
from torchid.design.bands import bands, report_band, sharp_direction
from torchid.design.segments import Samples
from torchid.effects.base import Motion
from torchid.errors import LogError
from torchid.log.model import Log
from torchid.typing import Tensor


def log(rate: float) -> Log:
    t = torch.arange(0, 8, 1 / rate, dtype=torch.float64)
    return Log(t, torch.zeros(len(t), ROBOT.n, dtype=torch.float64))


def test_a_slow_log_is_cut_lower():
    narrow, wide = bands(log(25.0), None)
    assert narrow < 25.0 / 4
    assert wide < 25.0 / 2


def test_a_cut_off_beyond_the_log_is_refused():
    with pytest.raises(LogError, match="cut-off"):
        bands(log(25.0), 12.0)


def test_the_report_s_band_is_no_wider_than_the_segments():
    m = motion_at(times(8.0), seed=0)
    samples = Samples([segment_of(m, torch.zeros_like(m.q))], 8.0)
    assert report_band(samples, 20.0) == 20.0
    assert report_band(samples, 1e4) < samples.segments[0].band
    assert report_band(samples, 0.1) == samples.cutoff


@pytest.mark.parametrize("amplitude", [0.01, 1.0])
def test_directions_of_a_sinusoid_are_exact(amplitude):
    """The mean of sgn(cos) over each sampling interval, reversals between samples included."""
    rate, w = 40.0, 5.3
    t = torch.arange(0, 10, 1 / rate, dtype=torch.float64)
    angle = w * t[:, None] + torch.tensor([0.1, 1.0, 2.0])
    motion = Motion(amplitude * angle.sin(), amplitude * w * angle.cos(),
                    -amplitude * w**2 * angle.sin(), t=t)  # fmt: skip

    # Integral of sgn(cos): a triangle wave.
    def triangle(x: Tensor) -> Tensor:
        return torch.asin(torch.sin(x))

    half = 0.5 * w / rate
    expected = (triangle(angle + half) - triangle(angle - half)) / (2 * half)
    found = sharp_direction(segment_of(motion, rate=rate), torch.full((3,), 1e-3 * amplitude))
    # dq and ddq vary over the interval: at third order in its length.
    assert torch.allclose(found, expected, atol=(w / rate) ** 2)
    inside = expected.abs() == 1
    assert torch.equal(found[inside], expected[inside])
