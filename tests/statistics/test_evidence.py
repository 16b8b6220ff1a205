"""Coefficients with slabs, and how sure one explanation is beside others."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchid.statistics.criteria import DOUBT, EXPECTED
from torchid.statistics.evidence import (
    CONVERGED,
    beside,
    in_slabs,
    most_sure,
    price_of,
    probabilities_of,
    solved,
)


def in_units(full: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Normal matrices of columns and gap (K + 1, N), in units of slabs of this root."""
    full = np.concatenate([spread.T @ full[:-1], full[-1:]])
    return (full @ full.T)[None]


@given(seed=st.integers(0, 1000), count=st.integers(1, 6))
def test_coefficients_far_from_their_slabs_middle_cost_what_lies_between(
    seed: int, count: int
) -> None:
    """The same as of a gap without the torque that is expected."""
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(count, 40)), rng.normal(size=40)
    spread = np.diag(rng.uniform(0.1, 10.0, count))
    centre = rng.normal(size=count)
    samples, floor = np.array([40.0]), np.array([1e-3])
    middle = in_slabs(spread, centre)
    np.testing.assert_allclose(spread @ middle, centre)
    z, losses, half = solved(in_units(np.concatenate([x, y[None]]), spread), samples, floor, middle)
    rest = np.concatenate([x, (y - centre @ x)[None]])
    other, less, same = solved(in_units(rest, spread), samples, floor)
    # What is left first is of all the gap, or of what is not expected: the rounds begin apart.
    np.testing.assert_allclose(losses, less, rtol=1e-3)
    np.testing.assert_allclose(spread @ z, centre + spread @ other, atol=0.01)
    assert half == pytest.approx(same, abs=0.1)


@given(seed=st.integers(0, 1000), count=st.integers(1, 6))
def test_coefficients_are_those_of_the_posterior(seed: int, count: int) -> None:
    """Of known noise: the ridge solution, and what a slab costs, written out."""
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(count, 40)), rng.normal(size=40)
    spread = np.tril(rng.normal(size=(count, count))) + 2 * np.eye(count)
    full = np.concatenate([x, y[None]])
    samples, floor = np.array([40.0]), np.array([1e9])  # the floor is the noise: it stays
    z, losses, half = solved(in_units(full, spread), samples, floor)
    found = spread @ z
    weight, precision = 40 / 1e9, np.linalg.inv(spread @ spread.T)
    normal = weight * x @ x.T
    right = np.linalg.solve(normal + precision, weight * x @ y)
    np.testing.assert_allclose(found, right, rtol=1e-6, atol=1e-12)
    determinant = np.linalg.slogdet(np.eye(count) + spread.T @ normal @ spread)[1]
    assert half == pytest.approx(
        0.5 * (right @ precision @ right + determinant), rel=1e-6, abs=1e-9
    )
    assert losses == floor


@pytest.mark.parametrize(("joints", "count", "rows"), [(1, 60, 70), (2, 20, 15)])
@pytest.mark.parametrize("seed", [3, 4, 11, 20])
def test_rounds_end_by_the_evidence(joints: int, count: int, rows: int, seed: int) -> None:
    """Of many coefficients beside few samples each round changes what is left by little, and many
    rounds by much."""
    rng = np.random.default_rng(seed)
    full = rng.normal(size=(joints, count + 1, rows))
    g = full @ full.transpose(0, 2, 1)
    samples, floor = np.full(joints, float(rows)), np.full(joints, 1e-6)
    _, losses, half = solved(g, samples, floor)
    left = g[:, -1, -1]
    for _ in range(3000):
        h = np.eye(count) + np.tensordot(samples / left, g[:, :-1, :-1], 1)
        z = np.linalg.solve(h, (samples / left) @ g[:, :-1, -1])
        v = np.append(z, -1.0)
        left = np.maximum((g @ v) @ v, floor)
    ends = 0.5 * np.linalg.slogdet(h)[1] + 0.5 * z @ z + 0.5 * samples @ np.log(left)
    assert half + 0.5 * samples @ np.log(losses) == pytest.approx(ends, abs=CONVERGED)


@given(
    st.lists(st.floats(-500, 500), min_size=1, max_size=5), st.integers(1, 20), st.integers(0, 99)
)
def test_probabilities_add_up_to_one(evidence: list[float], logs: int, seed: int) -> None:
    rises = np.array(evidence)[:, None] + np.random.default_rng(seed).normal(size=logs)
    found = probabilities_of(rises)
    assert sum(found) == pytest.approx(1.0)
    assert (
        int(np.argmax(found)) == int(np.argmax(evidence))
        or min(abs(np.max(evidence) - e) for e in evidence if e != max(evidence)) < 1e-9
    )


def test_what_half_of_the_logs_want_is_half_sure() -> None:
    """One log would be sure of either."""
    gain = np.where(np.arange(40) % 2 == 0, 500.0, -500.0)
    assert probabilities_of(np.stack([np.zeros(40), gain]))[0] == pytest.approx(0.5)


def test_one_cause_of_those_looked_at_has_its_price() -> None:
    assert price_of(60) == pytest.approx(math.log(60 / EXPECTED))
    assert price_of(0) == price_of(1)


@pytest.mark.parametrize(("rest", "whole"), [(0.0, 0.0), (1.0, 0.0), (0.0, 0.25), (1.0, 0.75)])
def test_what_is_left_bounds_how_sure_a_cause_is(rest: float, whole: float) -> None:
    """By the joint that tells of it, or by the arm; another joint's rest alone is none of it."""
    told, fall = np.array([9.0, 0.0]), np.array([3.0, 0.0])
    share = max(rest / (3.0 + rest), whole)
    left = np.array([rest, 7.0])
    assert most_sure(told, fall, left, whole) == pytest.approx(1 / (1 + DOUBT * share))


@given(seed=st.integers(0, 1000), known=st.integers(0, 2))
def test_what_is_held_leaves_the_others_their_slab_beside_it(seed: int, known: int) -> None:
    """Conditional covariance, written out; of coefficients that are known exactly there is none."""
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(6, 40)), rng.normal(size=40)
    spread = rng.normal(size=(6, 6))
    spread[:known] = 0.0
    held = np.array([True, True, True, False, False, False])
    full = np.concatenate([x, y[None]])
    free = beside(spread, held)
    z, _, _ = solved(in_units(full, spread), np.array([1e9]), np.array([1e9]), free=free)
    found = spread @ z
    whole = spread @ spread.T
    own, across, others = whole[3:, 3:], whole[3:, known:3], whole[known:3, known:3]
    rest = own - across @ np.linalg.solve(others, across.T)
    ridge = np.linalg.solve(x[3:] @ x[3:].T + np.linalg.inv(rest), x[3:] @ y)
    np.testing.assert_allclose(found[3:], ridge, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(found[:3], 0.0, atol=1e-12)
