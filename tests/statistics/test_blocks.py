"""Blocks, and the correlation time that sets their length."""

import itertools
import math

import pytest
import torch

from tests.statistics.noise import ar1, correlation_time
from torchid.statistics.autocorrelation import integrated_time
from torchid.statistics.blocks import (
    CORRELATION_TIMES,
    FEWEST_BLOCKS,
    MOST_BLOCKS,
    block_length,
    block_numbers,
    block_products,
    block_sums,
)


@pytest.mark.parametrize("correlation", [1.0, 7.3, 60.0, 1e5])
@pytest.mark.parametrize("lengths", [(2000,), (1500, 400, 90), (30, 30, 30), (5, 4000), (7,)])
def test_blocks_are_contiguous_and_never_cross_trajectories(lengths, correlation):
    rows = sum(lengths)
    edges = [0, *itertools.accumulate(lengths)]
    bounds = [slice(a, b) for a, b in itertools.pairwise(edges)]
    length = block_length(rows, correlation)
    block = block_numbers(bounds, length)
    assert len(block) == rows
    assert torch.equal(block.unique(), torch.arange(int(block.max()) + 1))
    assert bool((block.diff() >= 0).all())
    for own in bounds:
        outside = torch.cat([block[: own.start], block[own.stop :]])
        assert not set(block[own].tolist()) & set(outside.tolist())
        sizes = block[own].bincount()
        assert int(sizes.max()) - int(sizes[sizes > 0].min()) <= 1
    assert int(block.bincount().max()) <= 2 * length
    wanted = max(CORRELATION_TIMES * correlation, rows / MOST_BLOCKS)
    assert length == min(math.ceil(wanted), max(1, rows // FEWEST_BLOCKS))


def test_sums_and_products_over_blocks():
    g = torch.Generator().manual_seed(0)
    a, b = torch.randn(50, 3, generator=g), torch.randn(50, 2, generator=g)
    block = torch.randint(0, 6, (50,), generator=g)
    products = block_products(a, b, block, 7)
    for k in range(7):
        own = block == k
        assert torch.allclose(products[k], a[own].T @ b[own])
    assert torch.allclose(block_sums(a.T, block)[:, 2], a[block == 2].sum(0))


@pytest.mark.parametrize("keep", [-0.5, 0.0, 0.5, 0.9, 0.98])
def test_correlation_time_of_ar1_noise(keep):
    x = ar1(2, 200_000, keep=keep, seed=0) + 5.0
    expected = max(1.0, correlation_time(keep))
    assert integrated_time(x).tolist() == pytest.approx([expected] * 2, rel=0.15)


@pytest.mark.parametrize(("rows", "parts"), [(400, 1), (1000, 1), (1000, 5), (2000, 20)])
def test_short_series_have_the_right_time_on_average(rows, parts):
    """Down to ten correlation times a trajectory, with a mean taken off all of them."""
    x = ar1(300 * parts, rows // parts, keep=0.8, seed=1).reshape(300, rows)
    bounds = [slice(k * rows // parts, (k + 1) * rows // parts) for k in range(parts)]
    assert float(integrated_time(x, bounds).mean()) == pytest.approx(9.0, rel=0.2)


def test_a_level_between_trajectories_is_slow():
    x = torch.cat([ar1(500, keep=0.0, seed=k) + 10 * (-1) ** k for k in range(4)])
    bounds = [slice(500 * k, 500 * k + 500) for k in range(4)]
    assert float(integrated_time(x, bounds)) > 100


def test_a_mean_that_is_known_to_be_zero_is_kept():
    x = ar1(3000, keep=0.0, seed=0) + 3.0
    assert float(integrated_time(x)) < 1.5
    assert float(integrated_time(x, centred=False)) > 300


def test_a_drift_does_not_look_white():
    """The centred autocovariances of a whole series sum to zero, which must not count."""
    assert float(integrated_time(torch.linspace(-1, 1, 500))) > 100
    assert float(integrated_time(torch.sin(torch.linspace(0, 6.28, 500)))) > 50


def test_constant_and_tiny_series():
    assert integrated_time(torch.zeros(3, 50)).tolist() == [1.0] * 3
    assert integrated_time(torch.ones(3, 1)).tolist() == [1.0] * 3
    assert float(integrated_time(torch.tensor([1.0, 2.0]))) >= 1.0
