"""The search engine: on problems with known optima, and for the invariances that CMA-ES has by
construction."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.extraction.problems import (
    PROBLEMS,
    begin,
    generations_to,
    problem,
    same,
    sphere,
)
from tests.marks import quick_first
from torchid.extraction.cma.batched import minimise
from torchid.extraction.cma.search import PERIOD, default_population
from torchid.typing import Tensor

# Finding optima.


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("n", quick_first([2, 10], 1))
def test_batched_engine_finds_the_optimum(name: str, n: int) -> None:
    p = problem(name, n)
    needed = generations_to(p, minimise, begin(12, n))
    assert needed.isfinite().double().mean() >= p.share


def test_one_dimension() -> None:
    state = minimise(sphere, begin(5, 1), generations=60, seed=0)
    torch.testing.assert_close(
        state.best, torch.full((5, 1), 0.4, dtype=torch.float64), atol=1e-6, rtol=0
    )


def test_covariance_becomes_the_inverse_hessian() -> None:
    n = 6
    q, _ = torch.linalg.qr(torch.randn(n, n, dtype=torch.float64))
    hessian = q @ torch.diag(10.0 ** torch.linspace(0, 4, n, dtype=torch.float64)) @ q.mT
    state = minimise(
        lambda x: torch.einsum("rli,ij,rlj->rl", x - 0.5, hessian, x - 0.5),
        begin(8, n),
        generations=200,
        seed=0,
    )
    root = torch.linalg.cholesky(hessian)
    values = torch.linalg.eigvalsh(root.mT @ state.covariance @ root)
    assert (values[:, -1] / values[:, 0]).median() < 15  # 1e4 before


# Invariances, determinism, independence.


@pytest.mark.parametrize(
    "transform", [lambda f: 8 * f - 64, lambda f: 1024 * f, lambda f: torch.exp2(-1 / (f + 1e-3))]
)
def test_only_ranks_matter(transform) -> None:
    """The values are a coarse grid, so that rounding in the transform makes no ties."""

    def ranks(x: Tensor) -> Tensor:
        return torch.floor(sphere(x) * 1024)

    a = minimise(ranks, begin(4, 5), generations=25, seed=3)
    b = minimise(lambda x: transform(ranks(x)), begin(4, 5), generations=25, seed=3)
    same(a, b, but=("best_value",))
    assert torch.equal(transform(a.best_value), b.best_value)


@settings(max_examples=10)
@given(runs=st.integers(1, 5), n=st.integers(2, 8), seed=st.integers(0, 2**40), data=st.data())
def test_contract(runs: int, n: int, seed: int, data: st.DataObject) -> None:
    """Samples in the box in one call a generation, the same twice, the best a running minimum."""
    population = data.draw(st.sampled_from([None, 4, 9]))
    centre = torch.tensor(
        data.draw(st.lists(st.floats(-1, 2), min_size=n, max_size=n)), dtype=torch.float64
    )
    seen: list[tuple[Tensor, Tensor]] = []

    def objective(x: Tensor) -> Tensor:
        value = (x - centre).abs().sum(-1)
        seen.append((x.clone(), value))
        return value

    first = begin(runs, n, sigma=data.draw(st.sampled_from([1e-3, 0.3, 5.0])), seed=seed)
    arguments = {"generations": 6, "seed": seed, "population": population}
    state = minimise(objective, first, **arguments)
    assert [tuple(x.shape) for x, _ in seen] == [(runs, 1, n)] + 6 * [
        (runs, population or default_population(n), n)
    ]
    assert all(((x >= 0) & (x <= 1)).all() for x, _ in seen)
    lowest = torch.stack([v.amin(1) for _, v in seen]).amin(0)
    assert torch.equal(state.best_value, lowest)
    assert torch.equal((state.best - centre).abs().sum(-1), lowest)
    assert state.generation == 6
    for name, tensor in state.tensors().items():
        assert tensor.shape == first.tensors()[name].shape
        assert bool(torch.isfinite(tensor).all())
    same(state, minimise(objective, first, **arguments))


def test_runs_do_not_see_each_other() -> None:
    def disturbed(x: Tensor) -> Tensor:
        values = sphere(x).clone()
        values[1] = float("nan")
        values[2] = -1e300 * values[2]
        values[3] = 7.0
        return values

    quiet, loud = (minimise(f, begin(6, 4), generations=40, seed=9) for f in (sphere, disturbed))
    for rows in (slice(0, 1), slice(4, 6)):
        same(quiet, loud, runs=rows)
    assert all(
        bool(torch.isfinite(a).all()) for k, a in loud.tensors().items() if k != "best_value"
    )
    assert loud.best_value[1] == float("inf")


def test_seeds_differ_and_the_world_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    before, numpys = torch.get_rng_state(), np.random.get_state()[1].copy()
    a, b = (minimise(sphere, begin(3, 4), generations=5, seed=seed) for seed in (1, 2))
    assert not torch.equal(a.mean, b.mean)
    assert len({tuple(row) for row in a.mean.tolist()}) == 3
    assert torch.equal(before, torch.get_rng_state())
    assert np.array_equal(numpys, np.random.get_state()[1])
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")


# Continuing.


@pytest.mark.parametrize("sigma", [0.3, 5.0])
@pytest.mark.parametrize("split", [1, 2, 11])
def test_two_calls_are_one(split: int, sigma: float) -> None:
    first = begin(4, 6, sigma)
    whole = minimise(sphere, first, generations=30, seed=5)
    part = minimise(sphere, first, generations=split, seed=5)
    same(whole, minimise(sphere, part, generations=30 - split, seed=5))


def test_no_generations_change_nothing() -> None:
    state = minimise(sphere, begin(3, 4), generations=5, seed=0)
    again = minimise(sphere, state, generations=0, seed=0)
    assert torch.equal(again.best, state.best)
    assert torch.equal(again.best_value, state.best_value)
    torch.testing.assert_close(again.point, state.point, atol=1e-14, rtol=0)


@pytest.mark.nightly
def test_a_grown_penalty_is_met() -> None:
    """The best of the first objective is judged by the second before the search goes on."""
    state = minimise(sphere, begin(4, 3), generations=60, seed=0)

    def penalised(x: Tensor) -> Tensor:
        return sphere(x) + 10 * (0.7 - x[..., 0]).clamp(min=0)

    same_best = minimise(penalised, state, generations=0, seed=0)
    assert torch.equal(same_best.best_value, penalised(state.best))
    after = minimise(penalised, state, generations=250, seed=0)
    torch.testing.assert_close(
        after.best[:, 0], torch.full((4,), 0.7, dtype=torch.float64), atol=1e-4, rtol=0
    )


# Numbers that go wrong.


@pytest.mark.parametrize(
    "covariance",
    [
        torch.zeros(4, 4, dtype=torch.float64),
        torch.full((4, 4), float("nan"), dtype=torch.float64),
        torch.ones(4, 4, dtype=torch.float64),
        -torch.eye(4, dtype=torch.float64),
        torch.diag(torch.tensor([1e-300, 1.0, 1.0, 1e300], dtype=torch.float64)),
    ],
)
def test_a_degenerate_covariance_is_repaired_alone(covariance: Tensor) -> None:
    sound = begin(3, 4)
    broken = sound.covariance.clone()
    broken[1] = covariance
    got = minimise(sphere, replace(sound, covariance=broken), generations=150, seed=0)
    reference = minimise(sphere, sound, generations=150, seed=0)
    for rows in (slice(0, 1), slice(2, 3)):
        same(got, reference, runs=rows)
    assert all(bool(torch.isfinite(a).all()) for a in got.tensors().values())
    if covariance.isfinite().all() and covariance.abs().max() <= 1:
        assert torch.linalg.eigvalsh(got.covariance)[1, 0] > 0


def test_a_collapsed_step_stays_alive() -> None:
    small = torch.tensor([0.0, 1e-300, 0.3], dtype=torch.float64)
    first = replace(begin(3, 4), sigma=small)
    state = minimise(sphere, first, generations=30, seed=0)
    assert all(bool(torch.isfinite(a).all()) for a in state.tensors().values())
    assert (state.sigma > 1e-13).all()


def test_far_beyond_convergence() -> None:
    state = minimise(sphere, begin(4, 3), generations=500, seed=0)
    assert all(bool(torch.isfinite(a).all()) for a in state.tensors().values())
    torch.testing.assert_close(
        state.best, torch.full((4, 3), 0.4, dtype=torch.float64), atol=1e-7, rtol=0
    )


def test_nothing_to_find_does_not_run_away() -> None:
    state = minimise(
        lambda x: torch.zeros(x.shape[:-1], dtype=torch.float64),
        begin(6, 5),
        generations=300,
        seed=0,
    )
    spread = state.sigma[:, None] * state.covariance.diagonal(dim1=1, dim2=2).sqrt()
    assert ((spread > 0) & (spread <= 0.34)).all()
    assert (state.covariance.tril(-1) == 0).all()  # nothing was learned from ties
    assert (state.mean.sub(0.5).abs() <= PERIOD / 4 + 1e-12).all()
