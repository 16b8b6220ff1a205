"""Component arithmetic: floats fold, tensors compute, any mixture gives the same numbers."""

import itertools
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchid.dynamics.scalars import (
    ZERO,
    Scalar,
    Vec3,
    add,
    add3,
    add_cross,
    add_scaled,
    cross,
    dot,
    fma,
    mul,
)

NUMBERS = (0.0, 1.0, -1.0, 2.5)
scalars = st.sampled_from(NUMBERS) | st.floats(-10, 10)
forms = st.sampled_from([float, lambda value: torch.tensor(value, dtype=torch.float64)])
mixed = st.builds(lambda value, form: form(value), scalars, forms)
vectors = st.builds(Vec3, mixed, mixed, mixed)


def number(x: Scalar) -> float:
    return float(x)


def array(v: Vec3) -> torch.Tensor:
    return torch.tensor([number(c) for c in v], dtype=torch.float64)


@pytest.mark.parametrize("kinds", list(itertools.product([float, torch.tensor], repeat=3)))
@pytest.mark.parametrize("scale", [1.0, -1.0, 0.0, 3.0])
def test_fma_in_every_mixture(kinds: tuple, scale: float) -> None:
    for values in itertools.product(NUMBERS, repeat=3):
        acc, a, b = (kind(v) for kind, v in zip(kinds, values, strict=True))
        expected = values[0] + scale * values[1] * values[2]
        assert math.isclose(number(fma(acc, a, b, scale)), expected, abs_tol=1e-15)


def test_known_products_cost_nothing() -> None:
    x = torch.randn(3, dtype=torch.float64)
    assert fma(x, torch.randn(3, dtype=torch.float64), 0.0) is x
    assert fma(x, 0.0, torch.randn(3, dtype=torch.float64)) is x
    assert mul(x, 1.0) is x
    assert mul(x, 0.0) == 0.0
    assert add(x, 0.0) is x
    assert add(0.0, x) is x
    assert cross(ZERO, Vec3(x, x, x)) == ZERO
    assert type(dot(Vec3(1.0, 2.0, 3.0), Vec3(x, 0.0, 0.0))) is torch.Tensor
    assert dot(Vec3(1.0, 2.0, 3.0), Vec3(4.0, 5.0, 6.0)) == 32.0


@settings(max_examples=100)
@given(a=vectors, b=vectors, c=vectors, k=mixed)
def test_vectors_as_in_torch(a: Vec3, b: Vec3, c: Vec3, k: Scalar) -> None:
    x, y, z = array(a), array(b), array(c)
    close = {"rtol": 1e-12, "atol": 1e-9}
    torch.testing.assert_close(array(cross(a, b)), torch.linalg.cross(x, y), **close)
    torch.testing.assert_close(array(add_cross(c, a, b)), z + torch.linalg.cross(x, y), **close)
    torch.testing.assert_close(array(add3(a, b)), x + y, **close)
    torch.testing.assert_close(array(add_scaled(a, b, k, 2.0)), x + 2 * number(k) * y, **close)
    assert math.isclose(number(dot(a, b)), float(x @ y), rel_tol=1e-12, abs_tol=1e-9)
