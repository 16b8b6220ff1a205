"""Noise of positions from motions that were commanded more than once."""

import math
from dataclasses import replace
from functools import cache

import pytest
import torch

from tests.marks import some
from tests.position.diagnosed import diagnosis
from tests.position.planted import COUNT, planted, robot, true_servos
from torchid.effects.servo import INDEX
from torchid.log.model import Log
from torchid.position.data import prepare
from torchid.position.judge import closed_share
from torchid.position.repeats import PositionNoise, noise_of_repeats
from torchid.simulation.servo import Servos

SIZES = (1.0, 3.0, 8.0)
"""RMS of what does not repeat, of each joint [mrad]."""


@cache
def repeated(seed: int) -> Log:
    """Three motions, each made three times, with slow noise of its own each time."""
    once = planted(true_servos(3), motions=3, seconds=12.0, seed=seed)
    log = Log(
        t=once.t.repeat(3),
        q=once.q.repeat(3, 1),
        u=once.u.repeat(3, 1),
        trajectory=torch.arange(9).repeat_interleave(len(once.t) // 3),
        source="repeated",
    )
    g = torch.Generator().manual_seed(seed)
    white = torch.randn(log.q.T.shape, generator=g, dtype=torch.float64)
    slow = torch.nn.functional.avg_pool1d(white, 11, 1, 5)
    slow /= slow.std(1, keepdim=True)
    return log.replace(q=log.q + 1e-3 * torch.tensor(SIZES).double() * slow.T)


@pytest.mark.parametrize("seed", some(range(4), slow=1, quick=1))
@pytest.mark.parametrize("wrong", [False, True])
def test_noise_is_what_does_not_repeat(seed: int, wrong: bool) -> None:
    """However wrong the servos are whose errors are compared."""
    servos = true_servos(3)
    if wrong:
        joint = servos.joint.clone()
        joint[:, INDEX["coulomb"]] *= 4
        joint[:, INDEX["offset"]] -= 20.0
        servos = Servos(joint, servos.plane, servos.link)
    noise = noise_of_repeats(prepare(robot(), repeated(seed)), servos)
    true = 1e-3 * torch.tensor(SIZES)
    # Windows begin at measured positions, so that they have a start's noise besides.
    assert bool((noise.low < 1.15 * true).all())
    assert bool((noise.high > 0.95 * true).all())
    assert bool((noise.high < 1.4 * true + COUNT).all())
    assert bool((noise.windows < 2.2 * true + COUNT).all())


def test_a_log_that_repeats_nothing_tells_no_noise() -> None:
    servos = true_servos(3)
    data = prepare(robot(), planted(servos, motions=3, seconds=10.0))
    noise = noise_of_repeats(data, servos)
    assert bool(noise.low.isnan().all())
    assert bool(noise.windows.isnan().all())
    assert bool((noise.square == 0).all())


def test_of_the_error_beyond_noise_all_is_closed() -> None:
    before, noise = torch.tensor([25.0, 16.0]), torch.tensor([9.0, 4.0])
    assert closed_share(before, noise, noise) == 1
    assert closed_share(before, before, noise) == 0
    halved = closed_share(before, before / 4, torch.zeros(2))
    assert float(halved) == pytest.approx(0.5)


def test_only_measured_noise_is_said_to_be_noise() -> None:
    found = diagnosis()
    assert not found.answer.noise_measured
    assert all(math.isnan(x) for x in found.record.where.joints[0].noise_mrad)
    told = torch.full((3,), 2e-3, dtype=torch.float64)
    measured = replace(found, noise=PositionNoise(told, told, told / 2))
    assert measured.answer.noise_measured
    assert measured.answer.joints[0].noise == pytest.approx((2.0, 2.0))
    assert measured.closed > found.closed
