"""Classes, effect sizes and intervals: against SciPy, all pairs by hand, and by their coverage."""

from itertools import product

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from torchid.errors import TorchidError
from torchid_study.wrenches.classes import class_of
from torchid_study.wrenches.compare import Comparison, compare
from torchid_study.wrenches.resampling import cliffs_delta, hodges_lehmann_ratio, spearman

FINITE = st.lists(st.integers(1, 20).map(float), min_size=2, max_size=12)


@pytest.mark.parametrize(
    ("reasons", "name"),
    [
        ((), "feasible"),
        (frozenset({"inertia_3"}), "inertia only"),
        (("inertia_1", "inertia_7"), "inertia only"),
        (("com_7z", "com_2x"), "CoM only"),
        (("mass_4",), "mass only"),
        (("total_mass",), "total mass only"),
        (("mass_4", "total_mass"), "mixed"),
        (("inertia_1", "com_2x"), "mixed"),
        (("friction_2",), "friction only"),
    ],
)
def test_classes(reasons: tuple[str, ...], name: str) -> None:
    assert class_of(reasons) == name


@given(FINITE, FINITE)
def test_effect_sizes_are_those_of_all_pairs(a: list[float], b: list[float]) -> None:
    x, y = np.array(a), np.array(b)
    pairs = list(product(a, b))
    assert cliffs_delta(x, y) == pytest.approx(
        sum((p > q) - (p < q) for p, q in pairs) / len(pairs)
    )
    expected = np.exp(np.median([np.log(p) - np.log(q) for p, q in pairs]))
    assert hodges_lehmann_ratio(x, y) == pytest.approx(expected)


def test_many_pairs_by_bisection() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.lognormal(1, 1, 301), rng.lognormal(0, 2, 203)
    expected = np.exp(np.median(np.log(a)[:, None] - np.log(b)))
    assert hodges_lehmann_ratio(a, b) == pytest.approx(expected, rel=1e-9)


@given(FINITE)
def test_spearman_is_scipys(a: list[float]) -> None:
    x = np.array(a)
    y = np.roll(x, 1)
    with np.errstate(all="ignore"):
        expected = stats.spearmanr(x, y).statistic if np.ptp(x) else np.nan
    assert spearman(x, y) == pytest.approx(expected, nan_ok=True)


def planted(seed: int = 0, k: int = 120, resamples: int = 300) -> Comparison:
    """A third each feasible, inertia only, CoM only; the CoM's errors are three times larger."""
    g = torch.Generator().manual_seed(seed)
    reasons = [((), ("inertia_2",), ("com_1x",))[i % 3] for i in range(k)]
    factor = torch.tensor([1.0, 1.0, 3.0], dtype=torch.float64).repeat(k // 3)
    errors = factor * torch.exp(0.5 * torch.randn(k, generator=g, dtype=torch.float64))
    degree = torch.tensor([0.0, 1.0, 2.0], dtype=torch.float64).repeat(k // 3) + 0.1 * torch.rand(
        k, generator=g, dtype=torch.float64
    )
    return compare(errors, reasons, degree, resamples=resamples, seed=seed)


def test_planted_effects_are_found() -> None:
    found = planted()
    assert [c.name for c in found.classes] == ["feasible", "inertia only", "CoM only"]
    assert [r.name for r in found.per_reason] == ["com_1x", "inertia_2"]
    assert all(c.sets == c.usable == 40 for c in found.classes)
    inertia, com = found.effects
    assert (inertia.first, inertia.second) == ("inertia only", "feasible")
    assert inertia.delta.low < 0 < inertia.delta.high
    assert inertia.ratio.low < 1 < inertia.ratio.high
    assert com.delta.low > 0.5
    assert com.ratio.low < 3 < com.ratio.high
    assert com.ratio.low > 1.5
    assert found.correlation.rho.low > 0.2
    assert found.correlation_infeasible.sets == 80
    assert found.of("CoM only").median == pytest.approx(3.0, rel=0.3)


@pytest.mark.nightly
def test_same_seed_same_intervals() -> None:
    assert planted(1) == planted(1)
    assert planted(1).effects != planted(2).effects


@pytest.mark.nightly
def test_intervals_cover() -> None:
    """95 % intervals hold the planted ratio in about 95 of 100 samples, clusters and all."""
    inside = 0
    for seed in range(100):
        g = torch.Generator().manual_seed(seed)
        cluster = torch.arange(40).repeat_interleave(5)
        chain = 0.8 * torch.randn(40, generator=g, dtype=torch.float64)[cluster]
        second = cluster % 2 == 1
        errors = torch.exp(
            chain + 0.2 * torch.randn(200, generator=g, dtype=torch.float64) + second * np.log(2.0)
        )
        reasons = [("com_1x",) if s else () for s in second.tolist()]
        found = compare(errors, reasons, second.double(), cluster=cluster, resamples=300, seed=seed)
        ratio = found.effects[0].ratio
        inside += ratio.low <= 2 <= ratio.high
    assert 86 <= inside <= 100


@pytest.mark.nightly
def test_clusters_widen_the_interval() -> None:
    """Ten copies of each set are no more evidence than one: alone, they would look like it."""
    g = torch.Generator().manual_seed(0)
    errors = torch.exp(torch.randn(24, generator=g, dtype=torch.float64))
    degree = torch.rand(24, generator=g, dtype=torch.float64)
    reasons = [() if i % 2 else ("mass_1",) for i in range(24)]
    many = {
        "errors": errors.repeat_interleave(10),
        "reasons": [r for r in reasons for _ in range(10)],
        "degree": degree.repeat_interleave(10),
    }
    cluster = torch.arange(24).repeat_interleave(10)
    honest = compare(**many, cluster=cluster, resamples=400)
    naive = compare(**many, resamples=400)
    once = compare(errors, reasons, degree, resamples=400)
    for of in (lambda c: c.correlation.rho, lambda c: c.effects[0].delta):
        width = {
            name: of(c).high - of(c).low
            for name, c in {"honest": honest, "naive": naive, "once": once}.items()
        }
        assert width["honest"] > 2 * width["naive"]
        assert width["honest"] == pytest.approx(width["once"], rel=0.25)
    assert honest.correlation.rho.clusters == 24


def test_too_few_sets_give_no_numbers() -> None:
    reasons = [()] * 6 + [("inertia_1",)] * 4
    found = compare(
        torch.rand(10, dtype=torch.float64) + 1,
        reasons,
        torch.arange(10.0, dtype=torch.float64),
        resamples=20,
    )
    assert found.of("feasible").median is not None
    few = found.of("inertia only")
    assert few.median is None
    assert "4 sets" in few.note
    assert "at least 5" in few.note
    assert np.isnan(found.effects[0].delta.value)
    assert "at least 5" in found.effects[0].note


def test_few_clusters_give_a_value_without_interval() -> None:
    reasons = [(), ("com_1x",)] * 10
    cluster = torch.arange(20) // 10
    found = compare(
        torch.rand(20, dtype=torch.float64) + 1,
        reasons,
        torch.rand(20, dtype=torch.float64),
        cluster=cluster,
        resamples=20,
    )
    assert np.isfinite(found.correlation.rho.value)
    assert np.isnan(found.correlation.rho.low)
    assert "clusters" in found.correlation.note
    assert np.isnan(found.effects[0].ratio.high)


def test_bad_sets_are_counted_and_left_out() -> None:
    errors = torch.rand(20, dtype=torch.float64) + 1
    errors[3] = torch.nan
    reasons = [(), ("com_1x",)] * 10
    found = compare(errors, reasons, torch.rand(20, dtype=torch.float64), resamples=20)
    assert (found.of("CoM only").sets, found.of("CoM only").usable) == (10, 9)
    assert found.correlation.sets == 19


def test_an_error_of_zero_has_no_ratio() -> None:
    errors = torch.rand(20, dtype=torch.float64)
    errors[0] = 0.0
    found = compare(
        errors, [(), ("com_1x",)] * 10, torch.rand(20, dtype=torch.float64), resamples=20
    )
    assert np.isnan(found.effects[0].ratio.value)
    assert "zero" in found.effects[0].note
    assert np.isfinite(found.effects[0].delta.low)


def test_chosen_pairs() -> None:
    errors = torch.rand(30, dtype=torch.float64) + 1
    reasons = [(), ("com_1x",), ("com_1x", "mass_1")] * 10
    found = compare(
        errors,
        reasons,
        torch.rand(30, dtype=torch.float64),
        pairs=[("mixed", "CoM only")],
        resamples=20,
    )
    assert [(e.first, e.second) for e in found.effects] == [("mixed", "CoM only")]
    with pytest.raises(TorchidError, match="available: feasible, CoM only, mixed"):
        compare(
            errors, reasons, torch.rand(30, dtype=torch.float64), pairs=[("mixed", "mass only")]
        )
    with pytest.raises(TorchidError, match="no set is in this class"):
        found.of("mass only")


def test_bad_input_is_refused() -> None:
    errors = torch.rand(3, dtype=torch.float64)
    with pytest.raises(TorchidError, match="2 of reasons"):
        compare(errors, [(), ()], torch.rand(3, dtype=torch.float64))
    with pytest.raises(TorchidError, match="0 errors"):
        compare(errors[:0], [], torch.rand(0, dtype=torch.float64))
    with pytest.raises(TorchidError, match="resamples"):
        compare(errors, [()] * 3, torch.rand(3, dtype=torch.float64), resamples=0)


def test_a_string_is_not_a_list_of_reasons(types_unchecked: None) -> None:
    with pytest.raises(TorchidError, match="collection of names"):
        compare(
            torch.rand(2, dtype=torch.float64),
            ["inertia_1", ()],
            torch.rand(2, dtype=torch.float64),
        )


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.floats(0.01, 100))
def test_units_do_not_matter(seed: int, unit: float) -> None:
    """Errors in another unit: the same ranks, deltas and ratios."""
    g = torch.Generator().manual_seed(seed)
    errors, degree = (
        torch.rand(24, generator=g, dtype=torch.float64) + 0.1,
        torch.rand(24, generator=g, dtype=torch.float64),
    )
    reasons = [(), ("com_1x",)] * 12
    a, b = (compare(e, reasons, degree, resamples=10) for e in (errors, errors * unit))
    assert a.correlation == b.correlation
    assert a.effects[0].delta == b.effects[0].delta
    assert a.effects[0].ratio.value == pytest.approx(b.effects[0].ratio.value)
