"""Strategy parameters and the map into the box against pycma's; what a person can do wrong."""

import cma
import numpy as np
import pytest
import torch
from cma.transformations import BoxConstraintsLinQuadTransformation
from hypothesis import given
from hypothesis import strategies as st

from tests.extraction.problems import begin, sphere
from torchid.errors import TorchidError
from torchid.extraction.cma.batched import minimise, strategy
from torchid.extraction.cma.search import (
    MARGIN,
    PERIOD,
    default_population,
    from_box,
    into_box,
    start,
)


@pytest.mark.parametrize("n", [2, 5, 30, 91])
@pytest.mark.parametrize("factor", [1, 3])
def test_weights_and_rates_are_those_of_pycma(n: int, factor: int) -> None:
    population = factor * default_population(n)
    peer = cma.CMAEvolutionStrategy(n * [0.5], 0.3, {"verbose": -9, "popsize": population})
    ours = strategy(n, population)
    default = cma.CMAEvolutionStrategy(n * [0.5], 0.3, {"verbose": -9}).popsize
    assert population == factor * default
    np.testing.assert_allclose(ours.mu_eff, peer.sp.weights.mueff, rtol=1e-12)
    np.testing.assert_allclose(ours.c_1, peer.sp.c1, rtol=1e-12)
    np.testing.assert_allclose(ours.c_c, peer.sp.cc, rtol=0.2)
    np.testing.assert_allclose(ours.c_mu, peer.sp.cmu, rtol=1e-12)
    np.testing.assert_allclose(ours.weights, peer.sp.weights.asarray, rtol=0.02, atol=1e-12)


@given(x=st.lists(st.floats(-30, 30), min_size=1, max_size=8))
def test_box_is_pycmas(x: list[float]) -> None:
    peer = BoxConstraintsLinQuadTransformation([[0.0, 1.0]])
    got = into_box(torch.tensor(x, dtype=torch.float64))
    assert ((got >= 0) & (got <= 1)).all()
    np.testing.assert_allclose(got, peer.transform(list(x)), atol=1e-13)


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8), st.integers(-5, 5))
def test_box_and_back(x: list[float], periods: int) -> None:
    point = torch.tensor(x, dtype=torch.float64)
    search = from_box(point)
    assert ((search >= -MARGIN) & (search <= 1 + MARGIN)).all()
    torch.testing.assert_close(into_box(search), point, rtol=0, atol=1e-15)
    torch.testing.assert_close(into_box(search + periods * PERIOD), point, rtol=0, atol=1e-13)


def test_errors_say_what_is_wrong() -> None:
    for mean in (
        torch.tensor([[0.5, 1.01]], dtype=torch.float64),
        torch.tensor([[float("nan"), 0.5]], dtype=torch.float64),
    ):
        with pytest.raises(TorchidError, match="inside the unit box"):
            start(mean, 0.3)
    with pytest.raises(TorchidError, match="step size"):
        start(torch.rand(2, 2, dtype=torch.float64), 0.0)


def test_errors_of_minimise() -> None:
    state = begin(2, 3)
    with pytest.raises(TorchidError, match="generations"):
        minimise(sphere, state, generations=-1, seed=0)
    with pytest.raises(TorchidError, match="seed"):
        minimise(sphere, state, generations=1, seed=-1)
    with pytest.raises(TorchidError, match="population"):
        minimise(sphere, state, generations=1, seed=0, population=1)
    with pytest.raises(TorchidError, match="another shape"):
        minimise(lambda x: x, state, generations=1, seed=0)
