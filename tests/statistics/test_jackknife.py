"""The leverage-corrected block jackknife: what it is, what leaves it as it is, what it covers."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import t as student

from tests.statistics.noise import ar1, coverage, fitted
from torchid.statistics import jackknife as module
from torchid.statistics.jackknife import (
    Jackknife,
    fit_statistics,
    jackknife,
)

BLOCKS, LONG, C = 12, 60, 5
BLOCK = torch.arange(BLOCKS).repeat_interleave(LONG)


def problem(seed: int = 0):
    columns = ar1(C, BLOCKS * LONG, keep=0.8, seed=seed).T.contiguous()
    y = ar1(BLOCKS * LONG, keep=0.8, seed=seed + 1000)
    x = torch.linalg.lstsq(columns, y.unsqueeze(1)).solution[:, 0]
    return columns, y, x


def statistics(columns, y, block=BLOCK) -> Jackknife:
    x = torch.linalg.lstsq(columns, y.unsqueeze(1)).solution[:, 0]
    return fit_statistics(columns, y - columns @ x, block)


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["as the noise", "smooth"])
def test_intervals_hold_the_truth_in_95_percent(kind):
    """Twice as many columns as blocks, AR(1) noise: standard deviations from block scores, with a
    normal quantile, hold it in less than 90 %."""
    assert 93 < coverage(range(200), 0.9, 20, kind=kind) < 97.3


def test_the_whole_leverage_is_the_solution_without_the_block(monkeypatch):
    monkeypatch.setattr(module, "LEVERAGE", 1.0)
    columns, y, x = problem()
    without = []
    for k in range(BLOCKS):
        rest = k != BLOCK
        without.append(torch.linalg.lstsq(columns[rest], y[rest].unsqueeze(1)).solution[:, 0] - x)
    expected = torch.stack(without).T @ torch.stack(without)
    assert torch.allclose(statistics(columns, y).covariance, expected, rtol=1e-8)


def test_half_the_leverage_is_unbiased_for_white_noise(monkeypatch):
    """Bell and McCaffrey 2002; the mean over many fits of the same columns, unequal blocks."""
    monkeypatch.setattr(module, "LEVERAGE", 0.5)
    monkeypatch.setattr(module, "ALONE", 1e-9)
    columns = problem()[0] * torch.linspace(0.1, 3, BLOCKS).repeat_interleave(LONG).unsqueeze(1)
    noise = torch.randn(400, len(columns), generator=torch.Generator().manual_seed(1))
    mean = torch.stack([statistics(columns, y).std.square() for y in noise]).mean(0)
    assert torch.allclose(mean, torch.linalg.inv(columns.T @ columns).diagonal(), rtol=0.15)


def test_degrees_of_freedom_of_equal_blocks_of_one_column():
    """The mean: K blocks alike have K - 1."""
    y = ar1(BLOCKS * LONG, keep=0.0, seed=3)
    found = statistics(torch.ones(len(y), 1), y)
    assert found.freedom.tolist() == pytest.approx([BLOCKS - 1])
    assert found.quantile().tolist() == pytest.approx([student.ppf(0.975, BLOCKS - 1)])


def test_what_few_blocks_hold_has_few_degrees_of_freedom():
    columns, y, _ = problem()
    columns[:, 0] *= (BLOCK < 3).double()
    found = statistics(columns, y)
    assert float(found.freedom[0]) < 3.0
    assert float(found.freedom[1:].min()) > 6.0


def test_what_one_block_holds_has_at_least_the_white_standard_deviation():
    columns, y, _ = problem()
    columns[:, 0] *= (BLOCK == 4).double()
    found = statistics(columns, y)
    assert found.by_one_block.tolist() == [True] + 4 * [False]
    x = torch.linalg.lstsq(columns, y.unsqueeze(1)).solution[:, 0]
    variance = (y - columns @ x).square().sum() / (len(y) - C)
    white = (variance * torch.linalg.inv(columns.T @ columns)[0, 0]).sqrt()
    assert float(found.std[0]) >= float(white) * (1 - 1e-9)


def test_dependent_columns_share_what_is_determined():
    """A column twice: the same fit, its coefficient in two halves of no more spread."""
    columns, y, _ = problem()
    once = statistics(columns, y)
    twice = torch.cat([columns, columns[:, :1], torch.zeros(len(y), 1)], 1)
    x = torch.linalg.lstsq(columns, y.unsqueeze(1)).solution[:, 0]
    found = fit_statistics(twice, y - columns @ x, BLOCK)
    assert torch.allclose(found.covariance[1:C, 1:C], once.covariance[1:, 1:], rtol=1e-7)
    assert float(2 * found.std[0]) == pytest.approx(float(once.std[0]), rel=1e-6)
    assert float(found.std[-1]) == 0.0


@settings(max_examples=25)
@given(seed=st.integers(0, 50), copies=st.integers(2, 4))
def test_repeated_rows_tell_nothing_new(seed, copies):
    columns, y, x = problem(seed)
    r = y - columns @ x
    plain = fit_statistics(columns, r, BLOCK)
    found = fit_statistics(columns.repeat(copies, 1), r.repeat(copies), BLOCK.repeat(copies))
    assert torch.allclose(found.covariance, plain.covariance, rtol=1e-8, atol=1e-15)


def test_combinations_are_those_of_the_covariance():
    columns, y, x = problem()
    hessians = torch.stack([columns[k == BLOCK].T @ columns[k == BLOCK] for k in range(BLOCKS)])
    pulls = columns * (y - columns @ x).unsqueeze(1)
    gradients = torch.stack([pulls[k == BLOCK].sum(0) for k in range(BLOCKS)])
    c = torch.randn(3, C, generator=torch.Generator().manual_seed(0))
    whole = jackknife(hessians, gradients).covariance
    found = jackknife(hessians, gradients, combinations=c)
    assert torch.allclose(found.covariance, c @ whole @ c.T, rtol=1e-9)
    assert found.freedom.shape == (3,)


def test_one_block_and_no_column_are_no_error():
    columns, y, _ = problem()
    alone = fit_statistics(columns, y, torch.zeros(len(y), dtype=torch.long))
    assert bool(alone.by_one_block.all())
    assert bool((alone.std > 0).all())
    assert bool(alone.quantile().isfinite().all())
    assert fit_statistics(columns[:, :0], y, BLOCK).std.shape == (0,)


def test_more_columns_than_a_block_has_rows():
    x, found = fitted(0.5, 20, seed=0)
    assert found.blocks == 20
    assert bool((found.std > 0).all())
    assert x.shape == found.std.shape


def test_what_was_known_is_no_block_of_one_degree_of_freedom():
    """A coefficient known to 0.5 beforehand, and by how much it has changed: blocks tell their sum,
    and of the change alone what was known tells, as exactly as it was known."""
    g = torch.Generator().manual_seed(4)
    column = torch.randn(4000, 1, generator=g, dtype=torch.float64)
    block, left = torch.arange(4000) // 200, torch.randn(4000, generator=g, dtype=torch.float64)
    known = torch.diag(torch.tensor([0.5**-2, 0.0], dtype=torch.float64))
    found = fit_statistics(column.repeat(1, 2), left, block, variance=1.0, known=known)
    data = float(fit_statistics(column, left, block, variance=1.0).std[0])
    change = float(found.widened()[1, 1].sqrt())
    assert change == pytest.approx(math.hypot(0.5, data), rel=0.02)
    both = torch.ones(2, dtype=torch.float64)
    assert float((both @ found.widened() @ both).sqrt()) == pytest.approx(data, rel=0.2)


def test_with_what_was_known_the_covariance_is_the_spread_of_the_solution():
    """Rows of white noise, and values drawn as they are known."""
    g = torch.Generator().manual_seed(5)
    columns = torch.randn(300, 3, generator=g, dtype=torch.float64)
    root = torch.tensor([[12.0, 3.0, 0.0], [0.0, 9.0, 0.0], [0.0, 0.0, 20.0]], dtype=torch.float64)
    known, block = root.T @ root, torch.arange(300) // 5
    total = columns.T @ columns + known
    spread, told = [], []
    for _ in range(400):
        noise = torch.randn(300, generator=g, dtype=torch.float64)
        drawn = root.T @ torch.randn(3, generator=g, dtype=torch.float64)
        x = torch.linalg.solve(total, columns.T @ noise + drawn)
        spread.append(x.outer(x))
        told.append(fit_statistics(columns, noise - columns @ x, block, known=known))
    true = torch.stack(spread).mean(0)
    mean = torch.stack([f.covariance + f.given for f in told]).mean(0)
    unit = true.diagonal().sqrt()
    assert float(((mean - true) / unit / unit[:, None]).abs().max()) < 0.15


def test_nothing_known_is_no_known():
    g = torch.Generator().manual_seed(6)
    columns = torch.randn(200, 4, generator=g, dtype=torch.float64)
    left, block = torch.randn(200, generator=g, dtype=torch.float64), torch.arange(200) // 10
    one = fit_statistics(columns, left, block)
    two = fit_statistics(columns, left, block, known=torch.zeros(4, 4, dtype=torch.float64))
    torch.testing.assert_close(one.covariance, two.covariance, rtol=1e-12, atol=1e-12)
    assert not two.given.any()
    assert torch.equal(one.freedom, two.freedom)


def test_shares_of_blocks_give_covariance_and_freedom_again():
    found = statistics(*problem()[:2])
    assert found.shares is not None
    torch.testing.assert_close(found.shares.steps.T @ found.shares.steps, found.covariance)
    torch.testing.assert_close(found.shares.freedom(found.shares.back), found.freedom)
    assert found.shares.alone(0.9).shape == (C, 0)


def test_a_direction_that_one_block_holds_is_alone():
    columns, y, _ = problem()
    columns[:, 2] *= BLOCK == 3
    found = statistics(columns, y)
    assert found.shares is not None
    alone = found.shares.alone(0.9)
    assert alone.shape == (C, 1)
    torch.testing.assert_close(alone.norm(), torch.tensor(1.0).to(alone))
    # Nothing but the third column changes along it.
    along = (found.shares.back @ alone).squeeze(1)
    assert float(along[[0, 1, 3, 4]].abs().max()) < 0.2 * float(along[2].abs())
