"""Spreads against a dense likelihood, and their intervals, odd units and false alarms by
simulation."""

import numpy as np
import pytest
import torch
from scipy import stats
from scipy.optimize import minimize

from torchid.statistics.multiple import benjamini_hochberg
from torchid.statistics.random_effects import (
    Sessions,
    deviance,
    heterogeneity,
    means,
    pooled,
    spreads,
)


def drawn(seed, p, units, sessions, between, daily, noise) -> Sessions:
    g = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    unit = torch.arange(units).repeat_interleave(sessions)
    variance = noise**2 * (0.5 + torch.rand(p, len(unit), generator=g, dtype=torch.float64))
    y = 5 + between * normal(p, units)[:, unit] + daily * normal(p, len(unit))
    return Sessions(y + variance.sqrt() * normal(p, len(unit)), variance, unit)


def dense_deviance(data: Sessions, k: int, between: float, daily: float) -> float:
    """-2 restricted log-likelihood by dense matrices (Harville 1977)."""
    y, v, u = data.values[k].numpy(), data.variances[k].numpy(), data.unit.numpy()
    covariance = np.diag(v + daily**2) + between**2 * (u[:, None] == u)
    inverse, one = np.linalg.inv(covariance), np.ones(len(y))
    information = one @ inverse @ one
    left = y - (one @ inverse @ y) / information
    return np.linalg.slogdet(covariance)[1] + np.log(information) + left @ inverse @ left


def test_the_likelihood_is_that_of_dense_matrices() -> None:
    data = drawn(0, 3, 5, 3, 1.0, 0.5, 0.4)
    for a, b in ((0.0, 0.3), (1.0, 0.0), (0.7, 0.6)):
        ones = torch.ones(3, dtype=torch.float64)
        own = deviance(data, a * ones, b * ones).tolist()
        assert own == pytest.approx([dense_deviance(data, k, a, b) for k in range(3)], rel=1e-9)


def test_spreads_are_where_the_likelihood_is_highest() -> None:
    data = drawn(1, 4, 12, 3, 1.0, 0.5, 0.4)
    between, daily = spreads(data)
    for k in range(4):
        best = minimize(
            lambda x, k=k: dense_deviance(data, k, *x), [1.0, 0.5], method="Nelder-Mead"
        )
        found = dense_deviance(data, k, float(between[k]), float(daily[k]))
        assert found - best.fun < 1e-3


@pytest.mark.nightly
def test_intervals_and_shrunken_values_cover_at_their_level() -> None:
    hits = []
    for seed in range(3):
        found = pooled(drawn(seed, 60, 30, 3, 1.0, 0.5, 0.4))
        for ci, truth in (
            (found.between_ci95, 1.0),
            (found.daily_ci95, 0.5),
            (found.interval(), 5.0),
        ):
            hits.append(((ci[:, 0] <= truth) & (truth <= ci[:, 1])).double().mean())
    covered = torch.stack(hits).reshape(3, 3).mean(0)
    assert float(covered.min()) > 0.9  # of 180 quantities each; 95 % asked for
    assert float(covered.max()) < 0.985


def test_units_without_a_spread_shrink_to_one_value() -> None:
    found = pooled(drawn(3, 20, 20, 3, 0.0, 0.0, 1.0))
    assert float(found.between.median()) < 0.3
    assert float(found.shrunk_std.median()) < float(found.own_std.median())


@pytest.mark.nightly
def test_odd_units_are_found_and_others_hardly_ever() -> None:
    """Twelve of 60 units are 6 spreads off in one of 20 quantities: without leaving them out of
    the spread they would hide each other."""
    found, false = [], []
    for seed in range(2):
        data = drawn(seed, 20, 60, 3, 1.0, 0.3, 0.3)
        shift = torch.zeros(20, 60, dtype=torch.float64)
        shift[seed, :12] = 6.0
        odd = pooled(Sessions(data.values + shift[:, data.unit], data.variances, data.unit)).odd
        found.append(int(odd[:12].sum()))
        false.append(int(odd[12:].sum()))
    assert sum(found) >= 0.9 * 24
    assert sum(false) <= 0.1 * sum(found)


@pytest.mark.nightly
def test_what_no_session_tells_is_nothing_and_disturbs_nothing() -> None:
    data = drawn(5, 3, 6, 2, 1.0, 0.3, 0.3)
    whole = pooled(data)
    values = data.values.clone()
    values[1] = torch.nan
    values[2, :2] = torch.nan  # all sessions of unit 0
    part = pooled(Sessions(values, data.variances, data.unit))
    assert float(part.between[0]) == float(whole.between[0])
    assert bool(part.mean[1].isnan())
    assert bool(part.own[2, 0].isnan())
    assert part.units.tolist() == [6, 0, 5]


@pytest.mark.nightly
@pytest.mark.parametrize(("units", "sessions"), [(1, 1), (1, 3), (2, 1), (5, 1)])
def test_small_fleets_say_what_they_cannot_tell(units, sessions) -> None:
    found = pooled(drawn(0, 3, units, sessions, 1.0, 0.3, 0.3))
    assert bool(found.between.isnan().all()) is (units == 1)
    assert bool(found.daily.isnan().all()) is (sessions == 1)
    assert not bool(found.odd.any())
    assert bool(found.mean.isfinite().all())


def test_means_weigh_by_what_is_known() -> None:
    data = Sessions(
        torch.tensor([[1.0, 3.0, 9.0]], dtype=torch.float64),
        torch.tensor([[1.0, 1.0, 2.0]], dtype=torch.float64),
        torch.tensor([0, 0, 1]),
    )
    zero = torch.zeros(1, dtype=torch.float64)
    found = means(data, zero, zero)
    assert found.mean.tolist() == [[2.0, 9.0]]
    assert float(found.centre) == pytest.approx((2 / 0.5 + 9 / 2) / (1 / 0.5 + 1 / 2))


def test_benjamini_hochberg_as_in_their_paper() -> None:
    p = [0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262,
         0.5719, 0.6528, 0.7590, 1.0]  # fmt: skip
    adjusted = benjamini_hochberg(torch.tensor(p, dtype=torch.float64))
    assert int((adjusted <= 0.05).sum()) == 4  # section 3 of Benjamini and Hochberg (1995)


def one_each(values, std) -> Sessions:
    x, s = (torch.tensor(v, dtype=torch.float64).reshape(-1, len(v[0])) for v in (values, std))
    return Sessions(x, s.square(), torch.arange(x.shape[1]))


def test_heterogeneity_of_two_is_welchs_t_test() -> None:
    a, b = np.array([1.0, 2.0, 4.0, 3.5, 2.5]), np.array([2.0, 6.0, 4.5, 7.0, 5.0, 3.0])
    std = [[x.std(ddof=1) / len(x) ** 0.5 for x in (a, b)]]
    data = one_each([[a.mean(), b.mean()]], std)
    p = heterogeneity(data, torch.tensor([4.0, 5.0]).double())
    assert float(p) == pytest.approx(stats.ttest_ind(a, b, equal_var=False).pvalue, rel=1e-9)


def test_heterogeneity_of_known_variances_is_cochrans_q_of_what_counts() -> None:
    nan = torch.nan
    data = one_each(
        [[1.0, 1.4, 0.2, 9.0], [1.0, nan, nan, 2.0]], [[0.3, 0.4, 0.5, nan], [0.3, 0.1, 0.1, nan]]
    )
    x, w = np.array([1.0, 1.4, 0.2]), 1 / np.array([0.3, 0.4, 0.5]) ** 2
    q = (w * (x - (w * x).sum() / w.sum()) ** 2).sum()
    p = heterogeneity(data, torch.full((4,), 1e9, dtype=torch.float64))
    assert float(p[0]) == pytest.approx(stats.chi2.sf(q, 2), rel=1e-6)
    assert bool(p[1].isnan())


def test_heterogeneity_keeps_its_level_with_few_degrees_of_freedom() -> None:
    g, nu = torch.Generator().manual_seed(0), 15
    true = torch.tensor([1.0, 0.5, 2.0], dtype=torch.float64)
    x = true * torch.randn(4000, 3, generator=g, dtype=torch.float64)
    drawn = torch.randn(4000, 3, nu, generator=g, dtype=torch.float64).square().mean(-1)
    data = Sessions(x, true.square() * drawn, torch.arange(3))
    p = heterogeneity(data, torch.full((3,), float(nu), dtype=torch.float64))
    assert 0.04 < (p < 0.05).double().mean() < 0.06


def test_few_units_of_unequal_noise_are_not_odd_by_chance() -> None:
    """The tail of the distances from the others, which decides among many quantities."""
    g = torch.Generator().manual_seed(1)
    v = 0.01 * 10 ** (2 * torch.rand(600, 4, generator=g, dtype=torch.float64) - 1)
    y = 5 + v.sqrt() * torch.randn(600, 4, generator=g, dtype=torch.float64)
    found = pooled(Sessions(y, v, torch.arange(4)))
    assert (found.p < 1e-3).double().mean() < 2e-3
    assert found.deviation.abs().max() < 5
