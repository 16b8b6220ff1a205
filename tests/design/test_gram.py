"""Roots of normal equations, and fits by them beside what is known."""

import pytest
import torch

from torchid.design.bodies import Prior
from torchid.design.gram import inverse_root
from torchid.typing import Tensor


def random(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_a_ridge_is_a_row_more_for_every_coefficient() -> None:
    ridge = torch.tensor([3.0, 0.0, 50.0, 1e3, 2.0], dtype=torch.float64)
    a, y = random(120, 5, seed=1), random(120, seed=2)
    more = torch.cat([a, ridge.sqrt().diag()]), torch.cat([y, torch.zeros(5, dtype=torch.float64)])
    expected = torch.linalg.lstsq(*more).solution
    assert torch.allclose(Prior(ridge).solve(a.T @ a, a.T @ y), expected, atol=1e-9)


def test_a_column_of_zeros_has_no_part() -> None:
    a = random(3, 120, seed=3)
    a[1] = 0.0
    root = inverse_root(a @ a.T)
    assert float(root[1].abs().max()) == 0.0
    other = inverse_root(a[[0, 2]] @ a[[0, 2]].T)
    found = (root @ root.T)[[0, 2]][:, [0, 2]]
    assert torch.allclose(found, other @ other.T, rtol=1e-9)


@pytest.mark.parametrize("close", [1e-1, 1e-3, 1e-5])
def test_a_root_is_that_of_eigenvectors_however_close_columns_are(close: float) -> None:
    """Of the closest two the difference is not determined: neither factor nor trace may say so."""
    a = random(3, 200, seed=12)
    a[2] = a[1] + close * a[2]
    matrix = a @ a.T
    size = matrix.diagonal().sqrt()
    values, vectors = torch.linalg.eigh(matrix / size / size.unsqueeze(1))
    kept = values > 1e-7 * values[-1]
    assert int(kept.sum()) == (2 if close < 1e-4 else 3)
    root = vectors[:, kept] / values[kept].sqrt() / size.unsqueeze(1)
    found = inverse_root(matrix)
    assert torch.allclose(found @ found.T, root @ root.T, rtol=1e-6)
