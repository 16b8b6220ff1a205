"""Bands that a log's rate allows, and the direction of motion."""

import math
from dataclasses import replace

import pytest
import torch

from tests.gap.motions import ROBOT, motion_at, segment_of, times
from torchid.design.bands import (
    bands,
    position_noise,
    report_band,
    resolved,
    sharp_direction,
)
from torchid.design.motion import measurements
from torchid.design.segments import Samples, segments_of
from torchid.effects.base import Motion
from torchid.effects.registry import model_torque
from torchid.errors import LogError
from torchid.log.filtering import ZeroPhaseFilter
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


def counted(step: float, rate: float = 100.0) -> tuple[Log, Log]:
    """A motion with its torque, and the same with positions counted in steps [rad]."""
    m = motion_at(torch.arange(0, 40, 1 / rate, dtype=torch.float64), seed=0)
    exact = Log(m.t, m.q, tau=model_torque(ROBOT, [], m))
    return exact, exact.replace(q=(m.q / step).round() * step)


@pytest.mark.parametrize("step", [5e-4, 5e-3])
def test_noise_of_counted_positions_in_the_torque_is_predicted(step):
    """Against the model's torque along counted positions less that along exact ones."""
    torques = []
    for log in counted(step):
        (segment,) = segments_of(measurements(log, 40.0), 40.0, 0.0)
        torque = model_torque(ROBOT, [], segment.motion)
        torques.append(ZeroPhaseFilter(100.0, 8.0).apply(torque.T))
    # The filter's ends are no part of it.
    error = (torques[1] - torques[0])[:, 100:-100].square().mean(1).sqrt()
    predicted = position_noise(counted(step)[1], ROBOT) * 8.0**2.5
    assert bool((predicted > 0.75 * error).all())
    assert bool((predicted < 1.5 * error).all())


def test_coarse_positions_resolve_less_of_the_torque():
    highest = []
    for step in (5e-5, 5e-4, 5e-3):
        log = counted(step)[1]
        highest.append(resolved(log, position_noise(log, ROBOT)))
    # The noise grows with the step, its torque with f^2.5.
    assert highest[0] / highest[1] == pytest.approx(10**0.4, rel=0.1)
    assert highest[1] / highest[2] == pytest.approx(10**0.4, rel=0.1)
    log = counted(5e-3)[1]
    assert bands(log, None, highest[2])[0] == min(8.0, highest[2])
    assert bands(log, 6.0, highest[2])[0] == 6.0
    unknown = replace(ROBOT, parameters=None)
    assert resolved(log, position_noise(log, unknown)) == math.inf


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
