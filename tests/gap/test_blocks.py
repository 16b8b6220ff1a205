"""Tests on blocks against what they promise, on noise that is autocorrelated."""

import pytest
import torch
from scipy.stats import binomtest, kstest

from tests.gap.problems import ar_noise, random
from torchid.gap.blocks import (
    block_numbers,
    block_sums,
    held_out_gain,
    mean_bound,
    sign_flip_p,
    wald_p,
)
from torchid.typing import Tensor

ROWS, LENGTH, CASES = 1200, 50, 300
POLE = 0.9  # a correlation time of ten rows: a fifth of a block


@pytest.fixture(scope="module")
def cases() -> tuple[Tensor, Tensor, Tensor]:
    """Columns (CASES, 2, R) and noise (CASES, R), equally autocorrelated; and the block numbers."""
    x = ar_noise(CASES, 2, ROWS, pole=POLE, seed=1)
    return x, ar_noise(CASES, ROWS, pole=POLE, seed=2), block_numbers((slice(0, ROWS),), LENGTH)


def ordinary_p(columns: Tensor, r: Tensor) -> float:
    """F test that takes rows for independent."""
    from scipy.stats import f

    gram = columns @ columns.T
    pull = columns @ r
    gain = float(pull @ torch.linalg.solve(gram, pull))
    k, rest = len(columns), len(r) - len(columns)
    return float(f.sf(gain / k / ((float(r @ r) - gain) / rest), k, rest))


def test_random_signs_are_uniform_where_there_is_nothing(cases):
    """Rows taken as independent would be called significant in most cases."""
    x, noise, block = cases
    p = [
        sign_flip_p(block_sums(c * r, block).T, seed=k)
        for k, (c, r) in enumerate(zip(x, noise, strict=True))
    ]
    assert kstest(p, "uniform").pvalue > 0.01
    wrong = [ordinary_p(c, r) for c, r in zip(x, noise, strict=True)]
    assert sum(v < 0.05 for v in wrong) / CASES > 0.3


def test_random_signs_see_what_is_there(cases):
    x, noise, block = cases
    p = [
        sign_flip_p(block_sums(c * (r + c[0]), block).T, seed=0)
        for c, r in zip(x[:40], noise, strict=False)
    ]
    assert max(p) < 0.02


def test_random_signs_do_not_depend_on_units(cases):
    x, noise, block = cases
    scores = block_sums(x[0] * noise[0], block).T
    units = torch.tensor([1e-2, 1e2])
    assert sign_flip_p(scores, seed=3) == sign_flip_p(scores * units, seed=3)


def test_the_wald_test_holds_its_level(cases):
    x, noise, block = cases
    p = [wald_p(c, r, block) for c, r in zip(x, noise, strict=True)]
    for level in (0.01, 0.05, 0.2):
        hits = sum(v < level for v in p)
        assert binomtest(hits, CASES, level).pvalue > 0.005, (level, hits)


def test_the_wald_test_sees_what_is_there(cases):
    x, noise, block = cases
    p = [wald_p(c, r + 0.8 * c[0], block) for c, r in zip(x[:40], noise, strict=False)]
    assert max(p) < 1e-3


def test_one_block_says_nothing():
    assert wald_p(random(1, 30, seed=0), random(30, seed=1), torch.zeros(30, dtype=torch.long)) == 1


def test_the_wald_test_counts_a_repeated_column_once(cases):
    x, noise, block = cases
    once = wald_p(x[0, :1], noise[0], block)
    assert wald_p(x[0, :1].repeat(2, 1), noise[0], block) == pytest.approx(once, rel=1e-6)


@pytest.mark.parametrize("length", [7, 50, 10_000])
def test_blocks_do_not_cross_trajectories(length):
    bounds = (slice(0, 130), slice(130, 133), slice(133, 500))
    block = block_numbers(bounds, length)
    assert len(block) == 500
    own = [set(block[b].tolist()) for b in bounds]
    assert len(set().union(*own)) == sum(len(one) for one in own)
    assert bool((block.diff() >= 0).all())
    assert sorted(set().union(*own)) == list(range(int(block.max()) + 1))
    sizes = torch.bincount(block[:130])
    assert int(sizes.max()) - int(sizes.min()) <= 1
    assert int(sizes.max()) < 2 * length


def test_block_sums_are_sums(cases):
    x, _, block = cases
    sums = block_sums(x[0], block)
    assert torch.allclose(sums[:, 3], x[0][:, block == 3].sum(-1))
    assert torch.allclose(sums.sum(-1), x[0].sum(-1))


@pytest.mark.parametrize("folds", [2, 5])
def test_gain_on_held_out_blocks_is_that_of_refits(cases, folds):
    x, noise, block = cases
    c, r = x[0], noise[0] + 0.3 * x[0, 1]
    gain = held_out_gain(c, r, block, folds)
    fold = torch.arange(int(block.max()) + 1) * folds // (int(block.max()) + 1)
    for f in range(folds):
        fitted = fold[block] != f
        values = torch.linalg.lstsq(c[:, fitted].T, r[fitted].unsqueeze(1)).solution[:, 0]
        fall = r.square() - (r - values @ c).square()
        for k in (fold == f).nonzero().flatten().tolist():
            assert float(gain[k]) == pytest.approx(float(fall[block == k].sum()), abs=1e-9)


def test_gain_on_held_out_blocks_is_negative_for_nothing(cases):
    """On average, by about one unit of variance a column: the price of fitting noise."""
    x, noise, block = cases
    gains = torch.stack([held_out_gain(c, r, block).sum() for c, r in zip(x, noise, strict=True)])
    assert float(gains.mean()) < 0
    confirmed = [
        mean_bound(held_out_gain(c, r, block), 0.95) > 0 for c, r in zip(x, noise, strict=True)
    ]
    assert sum(confirmed) / CASES < 0.05


def test_the_bound_of_a_sum_covers_it():
    """Exact for Gaussian blocks: the bound is above the true sum in 5 % of the cases."""
    draws = random(2000, 12, seed=4) + 0.7
    above = sum(mean_bound(x, 0.95) > 12 * 0.7 for x in draws)
    assert binomtest(above, 2000, 0.05).pvalue > 0.01
    assert mean_bound(draws[0, :2], 0.95) == -torch.inf
