"""The level of white noise, and how much of it a filter lets through."""

import pytest
import torch

from tests.gap.motions import RATE, motion_at, noises, segment_of, times
from torchid.design.segments import Samples, Segment
from torchid.gap.noise.spectrum import bandwidth, white_level

CUTOFF = 8.0


def segments(count: int = 2) -> list[Segment]:
    made = [segment_of(motion_at(times(), seed=k)) for k in range(count)]
    return [Segment(s.name, s.rate, s.band, s.motion, 100 * s.motion.q, False) for s in made]


def test_white_noise_has_its_density_and_lines_do_not_raise_it():
    """Of variance one at a rate f the one-sided density is 2 / f, less two standard errors."""
    runs = segments()
    z = noises(runs, 0)
    loud = [s.tau + 10 * x for s, x in zip(runs, noises(runs, 1), strict=True)]
    runs = [
        Segment(s.name, s.rate, s.band, s.motion, x, False) for s, x in zip(runs, loud, strict=True)
    ]
    found = white_level(runs, z, CUTOFF)
    assert bool((found < 2 / RATE).all())
    assert bool((found > 0.75 * 2 / RATE).all())
    line = [x + 5 * torch.sin(2 * torch.pi * 20 * times())[:, None] for x in z]
    assert torch.allclose(white_level(runs, line, CUTOFF), found, rtol=0.1)


def test_the_measured_torque_bounds_a_model_s_own_noise():
    runs = segments(1)
    z = noises(runs, 0)
    quiet = [
        Segment(s.name, s.rate, s.band, s.motion, 0.1 * x, False)
        for s, x in zip(runs, z, strict=True)
    ]
    assert torch.allclose(white_level(quiet, z, CUTOFF), 0.01 * white_level(
        [Segment(s.name, s.rate, s.band, s.motion, x, False) for s, x in zip(runs, z, strict=True)],
        z, CUTOFF,
    ))  # fmt: skip


@pytest.mark.parametrize("cutoff", [4.0, 8.0, 20.0])
def test_bandwidth_is_the_variance_of_noise_of_density_one(cutoff):
    runs = segments(2)
    samples = Samples(runs, cutoff)
    x = samples.of([z.T for z in noises(runs, 3)])
    expected = float(x.square().mean()) / (2 / RATE)
    assert bandwidth(samples) == pytest.approx(expected, rel=0.08)
    assert bandwidth(Samples(runs, 0.48 * RATE)) == RATE / 2
