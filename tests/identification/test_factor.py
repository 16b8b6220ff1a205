"""The streamed triangular factor against Householder QR of the whole matrix."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from tests.arms import relative
from torchid.identification.least_squares import TriangularFactor, block_factors, stacked_factor


def streamed(a: Tensor, size: int) -> Tensor:
    factor = TriangularFactor(a.shape[1])
    for start in range(0, a.shape[0], size):
        factor.add(a[start : start + size])
    return factor.factor()


def householder(a: Tensor) -> Tensor:
    r = torch.linalg.qr(a, mode="r").R
    return r * torch.where(r.diagonal() < 0, -1.0, 1.0).unsqueeze(-1)


def with_condition(rows: int, columns: int, condition: float) -> Tensor:
    u = torch.linalg.qr(torch.randn(rows, columns, dtype=torch.float64)).Q
    v = torch.linalg.qr(torch.randn(columns, columns, dtype=torch.float64)).Q
    return (
        u
        * torch.logspace(
            0, -torch.tensor(condition, dtype=torch.float64).log10(), columns, dtype=torch.float64
        )
        @ v
    )


def assert_gram_kept(r: Tensor, a: Tensor, tolerance: float = 1e-13) -> None:
    """R'R = A'A, with every column judged by its own size."""
    size = torch.linalg.vector_norm(a, dim=0)
    size = torch.where(size > 0, size, torch.ones_like(size))
    difference = (r.T @ r - a.T @ a) / size / size.unsqueeze(-1)
    assert float(difference.abs().max()) < tolerance
    assert torch.equal(r, r.triu())
    assert bool((r.diagonal() >= 0).all())


@pytest.mark.parametrize("size", [1, 3, 10, 41, 64, 1000])
def test_pieces_of_any_size(size: int) -> None:
    a = torch.randn(500, 10, dtype=torch.float64)
    r = streamed(a, size)
    assert_gram_kept(r, a)
    assert relative(r, householder(a)) < 1e-13


def test_accuracy_of_householder_at_condition_1e6() -> None:
    a = with_condition(5000, 20, 1e6)
    r = streamed(a, 700)
    assert_gram_kept(r, a)
    # Both are backward stable, so they agree to about condition x rounding in the worst entry;
    # the Gram matrix's Cholesky factor would lose condition^2 x rounding = 1e-4.
    x, expected = (f[:, -1] / f[-1, -1] for f in (r, householder(a)))
    assert relative(x, expected) < 1e-8
    singular = torch.linalg.svdvals(r)
    torch.testing.assert_close(singular, torch.linalg.svdvals(a), rtol=1e-9, atol=0)


def test_factors_of_many_blocks_at_once_are_those_of_each() -> None:
    g = torch.Generator().manual_seed(0)
    rows = [torch.randn(n, 5, generator=g, dtype=torch.float64) for n in (30, 3, 0, 31)]
    for r, own in zip(block_factors(rows), rows, strict=True):
        assert torch.allclose(r, stacked_factor([own]), rtol=0, atol=1e-14)


def test_columns_of_very_different_size() -> None:
    a = (
        torch.randn(3000, 12, dtype=torch.float64)
        * torch.logspace(-6, 6, 12, dtype=torch.float64)[torch.randperm(12)]
    )
    r = streamed(a, 500)
    assert_gram_kept(r, a)
    size = torch.linalg.vector_norm(a, dim=0)
    assert relative(r / size, householder(a) / size) < 1e-12


def made(kind: str) -> Tensor:
    a = torch.randn(2000, 8, dtype=torch.float64)
    if kind == "a first piece that lacks rank":
        a[:300, 4:] = a[:300, :4] @ torch.randn(4, 4, dtype=torch.float64)
    elif kind == "a first piece at rest":  # most columns are zero, then everything moves
        a[:300, 1:] = 0.0
    elif kind == "rows that grow":
        a *= torch.logspace(-6, 6, 2000, dtype=torch.float64).unsqueeze(-1)
    elif kind == "no full rank":
        a[:, 4:] = a[:, :4] @ torch.randn(4, 4, dtype=torch.float64)
    elif kind == "a column of zeros":
        a[:, 2] = 0.0
    return a[:3] if kind == "fewer rows than columns" else a


@pytest.mark.parametrize("kind", ["a first piece that lacks rank", "a first piece at rest",
                                  "rows that grow", "no full rank", "a column of zeros",
                                  "fewer rows than columns"])  # fmt: skip
def test_odd_matrices(kind: str) -> None:
    a = made(kind)
    r = streamed(a, 100)
    assert_gram_kept(r, a)
    if kind in ("a first piece that lacks rank", "rows that grow"):
        assert relative(r, householder(a)) < 1e-12
    if kind == "no full rank":
        assert float(r.diagonal()[4:].max()) < 1e-6 * float(r.diagonal().max())
    if kind == "a column of zeros":
        assert float(r[:, 2].abs().max()) < 1e-14


def test_zero_rows_and_no_rows() -> None:
    assert torch.equal(TriangularFactor(4).factor(), torch.zeros(4, 4, dtype=torch.float64))
    factor = TriangularFactor(4)
    factor.add(torch.zeros(0, 4, dtype=torch.float64))
    factor.add(torch.zeros(5, 4, dtype=torch.float64))
    assert torch.equal(factor.factor(), torch.zeros(4, 4, dtype=torch.float64))
    a = torch.randn(50, 4, dtype=torch.float64)
    for rows in (a[:20], torch.zeros(7, 4, dtype=torch.float64), a[20:]):
        factor.add(rows)
    assert_gram_kept(factor.factor(), a)


def test_residual_and_solution_of_least_squares() -> None:
    a, x = with_condition(4000, 10, 1e4), torch.randn(10, dtype=torch.float64)
    b = a @ x + 1e-3 * torch.randn(4000, dtype=torch.float64)
    r = streamed(torch.cat([a, b.unsqueeze(-1)], 1), 300)
    found = torch.linalg.solve_triangular(r[:-1, :-1], r[:-1, -1:], upper=True).squeeze(-1)
    expected = torch.linalg.lstsq(a, b.unsqueeze(-1)).solution.squeeze(-1)
    assert relative(found, expected) < 1e-10
    residual = torch.linalg.vector_norm(b - a @ expected)
    torch.testing.assert_close(r[-1, -1], residual, rtol=1e-10, atol=0)


def test_factors_on_top_of_each_other() -> None:
    a = torch.randn(900, 6, dtype=torch.float64)
    r = stacked_factor([streamed(part, 100) for part in a.split(300)])
    assert relative(r, householder(a)) < 1e-13


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**31),
    rows=st.integers(1, 200),
    columns=st.integers(1, 8),
    size=st.integers(1, 60),
    spread=st.floats(0, 6),
)
def test_gram_is_kept_for_any_split(
    seed: int, rows: int, columns: int, size: int, spread: float
) -> None:
    g = torch.Generator().manual_seed(seed)
    a = torch.randn(rows, columns, generator=g, dtype=torch.float64)
    scales = 10 ** (spread * (2 * torch.rand(columns, generator=g, dtype=torch.float64) - 1))
    assert_gram_kept(streamed(a * scales, size), a * scales, 1e-12)
