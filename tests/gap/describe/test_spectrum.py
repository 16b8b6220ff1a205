"""The level of white noise, and how much of it a filter lets through."""

from dataclasses import replace

import pytest
import torch

from tests.gap.motions import RATE, motion_at, noises, segment_of, times
from torchid.design.segments import Samples, Segment
from torchid.gap.describe.noise import bandwidth, white_level
from torchid.typing import Tensor

CUTOFF = 8.0


def segments(count: int = 2) -> list[Segment]:
    return [segment_of(motion_at(times(), seed=k)) for k in range(count)]


def with_torque(runs: list[Segment], torque: list[Tensor]) -> list[Segment]:
    return [replace(s, tau=x) for s, x in zip(runs, torque, strict=True)]


def test_white_noise_has_its_density_and_lines_do_not_raise_it():
    """Of variance one at a rate f the one-sided density is 2 / f, less two standard errors."""
    runs = segments()
    z = noises(runs, 0)
    runs = with_torque(runs, [10 * x for x in noises(runs, 1)])
    found = white_level(runs, z, CUTOFF)
    assert bool((found < 2 / RATE).all())
    assert bool((found > 0.75 * 2 / RATE).all())
    line = [x + 5 * torch.sin(2 * torch.pi * 20 * times())[:, None] for x in z]
    assert torch.allclose(white_level(runs, line, CUTOFF), found, rtol=0.1)


def test_the_measured_torque_bounds_what_a_model_s_acceleration_adds():
    runs = segments(1)
    z = noises(runs, 0)
    same = white_level(with_torque(runs, z), z, CUTOFF)
    quiet = white_level(with_torque(runs, [0.1 * x for x in z]), z, CUTOFF)
    assert torch.allclose(quiet, 0.01 * same)


@pytest.mark.parametrize("cutoff", [4.0, 8.0, 20.0])
def test_bandwidth_is_the_variance_of_noise_of_density_one(cutoff):
    runs = segments(2)
    samples = Samples(runs, cutoff)
    x = samples.of([z.T for z in noises(runs, 3)])
    expected = float(x.square().mean()) / (2 / RATE)
    assert bandwidth(samples) == pytest.approx(expected, rel=0.08)
    assert bandwidth(Samples(runs, 0.48 * RATE)) == RATE / 2
