"""Agreement statistics, against scipy and closed forms."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from torchid.compare.scatter import holm, monotone, scatter, typical_birge, welch


def test_two_values_are_welchs_t_test():
    a, b = [1.0, 2.0, 4.0, 3.5, 2.5], [2.0, 6.0, 4.5, 7.0, 5.0, 3.0]
    x = torch.tensor(
        [torch.tensor(v, dtype=torch.float64).mean() for v in (a, b)], dtype=torch.float64
    )
    s = torch.tensor(
        [torch.tensor(v, dtype=torch.float64).std() / len(v) ** 0.5 for v in (a, b)],
        dtype=torch.float64,
    )
    nu = torch.tensor([len(v) - 1.0 for v in (a, b)], dtype=torch.float64)
    expected = stats.ttest_ind(a, b, equal_var=False).pvalue
    assert welch(x, s, nu) == pytest.approx(expected, rel=1e-9)


def test_many_blocks_are_cochrans_chi_square():
    x, s = (
        torch.tensor([1.0, 1.4, 0.2], dtype=torch.float64),
        torch.tensor([0.3, 0.4, 0.5], dtype=torch.float64),
    )
    mean = (x / s**2).sum() / (1 / s**2).sum()
    q = float(((x - mean) / s).square().sum())
    assert welch(x, s, torch.full((3,), 1e9, dtype=torch.float64)) == pytest.approx(
        stats.chi2.sf(q, 2), rel=1e-6
    )
    assert scatter(x, s, torch.full((3,), 1e9, dtype=torch.float64)).birge == pytest.approx(
        (q / 2) ** 0.5
    )


def test_welch_keeps_its_level_with_few_degrees_of_freedom():
    g = torch.Generator().manual_seed(0)
    nu, true = 15, torch.tensor([1.0, 0.5, 2.0], dtype=torch.float64)
    p = []
    for _ in range(2000):
        x = true * torch.randn(3, generator=g, dtype=torch.float64)
        s = true * (torch.randn(3, nu, generator=g, dtype=torch.float64).square().mean(1)).sqrt()
        p.append(welch(x, s, torch.full((3,), float(nu), dtype=torch.float64)))
    assert 0.035 < (torch.tensor(p, dtype=torch.float64) < 0.05).double().mean() < 0.065


def test_between_run_variance_is_dersimonian_and_lairds():
    # With equal standard deviations tau^2 = variance of the values - s^2, and the mean is plain.
    x, s = (
        torch.tensor([1.0, 3.0, 5.0, 9.0], dtype=torch.float64),
        torch.full((4,), 0.5, dtype=torch.float64),
    )
    found = scatter(x, s, torch.full((4,), 50.0, dtype=torch.float64))
    assert found.between == pytest.approx(float((x.var() - 0.25).sqrt()))
    assert found.consensus == pytest.approx(float(x.mean()))
    assert found.std == pytest.approx(float(x.std() / 2))


def test_the_consensus_covers_the_truth_despite_too_small_claims():
    g = torch.Generator().manual_seed(1)
    hits = 0
    for _ in range(1000):
        found = scatter(
            3 * torch.randn(4, generator=g, dtype=torch.float64),
            torch.ones(4, dtype=torch.float64),
            torch.full((4,), 60.0, dtype=torch.float64),
        )
        hits += abs(found.consensus) <= found.quantile * found.std
    assert 0.92 < hits / 1000 < 0.98


def test_equal_values_without_standard_deviation_agree():
    found = scatter(
        torch.full((3,), 2.0, dtype=torch.float64),
        torch.zeros(3, dtype=torch.float64),
        torch.full((3,), 20.0, dtype=torch.float64),
    )
    assert found.p == pytest.approx(1.0)
    assert (
        scatter(
            torch.zeros(3, dtype=torch.float64),
            torch.zeros(3, dtype=torch.float64),
            torch.full((3,), 20.0, dtype=torch.float64),
        ).consensus
        == 0
    )


@given(st.lists(st.floats(0, 1), min_size=1, max_size=30))
def test_holm_is_the_step_down_definition(values):
    p = torch.tensor(values, dtype=torch.float64)
    order = sorted(range(len(values)), key=lambda k: values[k])
    running, expected = 0.0, [0.0] * len(values)
    for rank, k in enumerate(order):
        running = max(running, min(1.0, (len(values) - rank) * values[k]))
        expected[k] = running
    torch.testing.assert_close(holm(p), torch.tensor(expected, dtype=torch.float64))


@pytest.mark.slow
def test_typical_birge_is_one_for_honest_noise_and_ignores_a_few_outliers():
    g = torch.Generator().manual_seed(2)
    x = 3 * torch.randn(4000, 4, generator=g, dtype=torch.float64)
    birge = torch.stack([((v - v.mean()).square().sum() / 3 / 9).sqrt() for v in x])
    assert typical_birge(birge, torch.full((4000,), 4.0, dtype=torch.float64)) == pytest.approx(
        1.0, abs=0.04
    )
    birge[:100] *= 50
    assert typical_birge(birge, torch.full((4000,), 4.0, dtype=torch.float64)) == pytest.approx(
        1.0, abs=0.06
    )


def test_monotone_needs_three():
    assert monotone(torch.tensor([1.0, 2.0, 5.0], dtype=torch.float64))
    assert monotone(torch.tensor([3.0, 2.0, 1.0], dtype=torch.float64))
    assert not monotone(torch.tensor([1.0, 3.0, 2.0], dtype=torch.float64))
    assert not monotone(torch.tensor([1.0, 2.0], dtype=torch.float64))
