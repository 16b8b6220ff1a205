"""Statistics of sets with equal torque find what was planted, and nothing where nothing was."""

from dataclasses import replace

import numpy as np
import pytest

from torchid.study.equal_torque.statistics import (
    Samples,
    other_truths,
    statistics,
    stratified_delta,
)


def planted(error: np.ndarray, **changes: np.ndarray) -> Samples:
    """60 feasible and 60 inertia-only sets in clusters of 3."""
    k = np.arange(120)
    degree = np.where(k < 60, 1.0, -1.0) * (k % 60 + 1) / 60
    base = Samples(
        kind=np.where(k < 60, "feasible", "inertia"),
        error=error,
        degree=degree,
        carried=error,
        coordinates=np.zeros(120),
        tightest=np.full(120, "inertia"),
        cluster=k // 3,
    )
    return replace(base, **changes)


def test_statistics_find_a_planted_effect_of_the_degree() -> None:
    rng = np.random.default_rng(0)
    degree = planted(np.ones(120)).degree
    error = np.exp(-degree + 0.01 * rng.normal(size=120))
    found = statistics(planted(error), resamples=100)
    by = {c.kind: c for c in found.correlations}
    for kind in ("all", "feasible", "inertia"):
        assert by[kind].degree.value < -0.99
        assert by[kind].degree.high < -0.9
    medians = {(t.kind, t.third): t.median for t in found.thirds}
    assert medians["inertia", "furthest from it"] > medians["inertia", "nearest the boundary"]
    assert medians["feasible", "furthest from it"] < medians["feasible", "nearest the boundary"]


def test_statistics_find_none_where_there_is_none() -> None:
    error = np.exp(np.random.default_rng(1).normal(size=120))
    found = statistics(planted(error), resamples=200)
    for c in found.correlations:
        assert c.degree.low < 0 < c.degree.high
    assert found.matched[0].unmatched.low < 0 < found.matched[0].unmatched.high


def test_matching_takes_out_what_the_carried_mass_explains() -> None:
    """Infeasible sets are further away in mass, and the error is a function of the mass only."""
    rng = np.random.default_rng(2)
    carried = rng.uniform(1, 3, 120) + np.where(np.arange(120) < 60, 0.0, 0.7)
    noisy = carried * np.exp(0.1 * rng.normal(size=120))
    found = statistics(planted(noisy, carried=carried), resamples=200).matched[0]
    assert found.unmatched.low > 0.2
    assert found.delta.low < 0 < found.delta.high


def test_stratified_delta_by_hand() -> None:
    by = np.repeat([0.0, 1.0], 50)
    low, high = np.where(by > 0, 10.0, 1.0), np.where(by > 0, 11.0, 2.0)
    assert stratified_delta(high, low, by, by) == 1.0
    assert stratified_delta(low, low, by, by) == 0.0
    assert np.isnan(stratified_delta(low, low, by, by + 5))


def test_other_truths_on_a_line() -> None:
    """Sets at points of a line: five feasible within 0..4, infeasible at 10 and -6."""
    place = np.array([0.0, 1, 2, 3, 4, 10, 10, -6, -6])
    kind = np.array(["feasible"] * 5 + ["com"] * 4)
    degree = np.array([0.1, 0.2, 0.3, 0.2, 0.1, -1, -1, -1, -1])
    distances = np.abs(place[:5, None] - place)
    (com,), firm = other_truths(kind, degree, distances)
    assert com.kind == "com"
    assert com.better == (0.0, 0.0, 0.0)
    # Medians: 8 of the infeasible; of the other feasible 2.5 seen from the ends, else 1.5.
    assert com.ratio[0] == pytest.approx(8 / 1.5)
    assert com.ratio[1] == pytest.approx(8 / 2.5)
    assert len(firm) == 3
