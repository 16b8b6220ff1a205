"""Independent columns from left to right, against rank by singular values."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchid.identification.base_parameters import independent_columns

TOLERANCE = 1e-8


def random_matrix(rows: int, columns: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(rows, columns, generator=generator, dtype=torch.float64)


@st.composite
def planted(draw) -> tuple[torch.Tensor, list[bool]]:
    """A matrix of columns of any length, some of which combine those before them or are zero."""
    kinds = draw(st.lists(st.sampled_from(["new", "combined", "zero"]), min_size=1, max_size=20))
    seed = draw(st.integers(0, 10_000))
    scales = draw(
        st.lists(st.integers(-3, 3), min_size=len(kinds), max_size=len(kinds)).map(
            lambda powers: [10.0**p for p in powers]
        )
    )
    rows = len(kinds) + draw(st.integers(0, 30))
    fresh, weights = random_matrix(rows, len(kinds), seed), random_matrix(20, 20, seed + 1)
    unit: list[torch.Tensor] = []
    truth = []
    for j, kind in enumerate(kinds):
        independent = [u for u, new in zip(unit, truth, strict=True) if new]
        if kind == "new":
            unit.append(fresh[:, j])
        elif kind == "combined" and independent:
            unit.append(torch.stack(independent, 1) @ weights[j, : len(independent)])
        else:
            unit.append(torch.zeros(rows, dtype=torch.float64))
        truth.append(kind == "new")
    columns = [u * s for u, s in zip(unit, scales, strict=True)]
    return torch.stack(columns, 1), truth


@pytest.mark.slow
@given(planted())
@settings(max_examples=150, derandomize=True)
def test_planted_dependent_columns_are_found(case):
    matrix, truth = case
    mask, distance = independent_columns(matrix, TOLERANCE)
    assert mask.tolist() == truth
    assert bool((distance[mask] > TOLERANCE).all())
    assert bool((distance[~mask] < TOLERANCE).all())
    lengths = matrix.norm(dim=0)
    scaled = matrix / torch.where(lengths > 0, lengths, 1.0)
    assert int(mask.sum()) == int(torch.linalg.matrix_rank(scaled, rtol=1e-9))


@given(planted(), st.integers(0, 1000))
@settings(max_examples=40, derandomize=True)
def test_rows_may_be_turned_and_repeated(case, seed):
    matrix, truth = case
    turn = torch.linalg.qr(random_matrix(len(matrix), len(matrix), seed)).Q
    mask, _ = independent_columns(torch.cat([turn @ matrix, 3 * matrix]), TOLERANCE)
    assert mask.tolist() == truth


@pytest.mark.parametrize("shape", [(1, 1), (5, 5), (40, 12)])
def test_a_full_rank_matrix_keeps_all_columns(shape):
    mask, distance = independent_columns(random_matrix(*shape), TOLERANCE)
    assert bool(mask.all())
    assert float(distance[0]) == pytest.approx(1.0)


def test_fewer_rows_than_columns():
    mask, distance = independent_columns(random_matrix(3, 7), TOLERANCE)
    assert mask.tolist() == [True] * 3 + [False] * 4
    assert bool((distance[3:] == 0).all())


@pytest.mark.parametrize("shape", [(4, 3), (1, 3)])
def test_a_zero_matrix_has_none(shape):
    mask, distance = independent_columns(torch.zeros(shape, dtype=torch.float64), TOLERANCE)
    assert not bool(mask.any())
    assert bool((distance == 0).all())


def test_distance_is_the_sine_of_the_angle_to_the_span():
    a = torch.tensor([[1.0, 3.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 2.0]], dtype=torch.float64)
    _, distance = independent_columns(a, TOLERANCE)
    assert distance.tolist() == pytest.approx([1.0, 0.8, 1.0])


def test_a_residue_is_not_scaled_up():
    e = torch.eye(3, dtype=torch.float64)
    matrix = torch.stack([e[0], 1e-6 * e[1], e[0] + e[1]], 1)
    mask, distance = independent_columns(matrix, 1e-4)
    assert mask.tolist() == [True, False, True]
    assert float(distance[1]) == 0.0


def test_what_is_left_of_a_dropped_column_takes_no_direction():
    """Plain QR spends a direction on the residue (1e-5) of a column it drops, here the only one
    that the last column has to itself, and drops that too."""
    e = torch.eye(4, dtype=torch.float64)
    matrix = torch.stack([e[0], e[1], e[0] + e[1] + 1e-5 * e[2], e[2] + e[0]], 1)
    plain = torch.linalg.qr(matrix / matrix.norm(dim=0), mode="r").R.diagonal().abs()
    assert (plain > 1e-4).tolist() == [True, True, False, False], "why rank.py exists"
    mask, _ = independent_columns(matrix, 1e-4)
    assert mask.tolist() == [True, True, False, True]
