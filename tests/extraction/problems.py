"""Functions over [0, 1]^n with known optima, and how many generations an engine needs."""

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchid.extraction.cma.search import SearchState, start


@dataclass(frozen=True)
class Problem:
    """A function with minimum 0, the value that counts as found, and in what share of the runs."""

    name: str
    objective: Callable[[Tensor], Tensor]
    target: float
    generations: int
    share: float = 1.0


def _centre(n: int) -> Tensor:
    return torch.linspace(0.3, 0.7, n, dtype=torch.float64)


def _scales(n: int) -> Tensor:
    return 10 ** torch.linspace(0, 6, n, dtype=torch.float64)


def _on_bounds(n: int) -> Tensor:
    """Every second coordinate of the optimum at 0, one at 1, the others inside."""
    optimum = _centre(n)
    optimum[::2] = 0.0
    optimum[1] = 1.0
    return optimum


def _sphere(n: int) -> Callable[[Tensor], Tensor]:
    return lambda x: ((x - _centre(n)) ** 2).sum(-1)


def _ellipsoid(n: int) -> Callable[[Tensor], Tensor]:
    return lambda x: (_scales(n) * (x - _centre(n)) ** 2).sum(-1)


def _rotated_ellipsoid(n: int) -> Callable[[Tensor], Tensor]:
    generator = torch.Generator().manual_seed(7)
    q, _ = torch.linalg.qr(torch.randn(n, n, generator=generator, dtype=torch.float64))
    return lambda x: (_scales(n) * ((x - _centre(n)) @ q.mT) ** 2).sum(-1)


def _rosenbrock(n: int) -> Callable[[Tensor], Tensor]:
    def value(x: Tensor) -> Tensor:
        y = 4 * (x - 0.5)
        return (100 * (y[..., 1:] - y[..., :-1] ** 2) ** 2 + (1 - y[..., :-1]) ** 2).sum(-1)

    return value


def _rastrigin(n: int) -> Callable[[Tensor], Tensor]:
    def value(x: Tensor) -> Tensor:
        y = 5 * (x - _centre(n))
        return (y * y + 10 * (1 - torch.cos(2 * math.pi * y))).sum(-1)

    return value


def _corner(n: int) -> Callable[[Tensor], Tensor]:
    slope = torch.linspace(1, 10, n, dtype=torch.float64)
    return lambda x: (slope * x).sum(-1)


def _touching(n: int) -> Callable[[Tensor], Tensor]:
    """The sphere's own optimum lies on bounds: no slope is left there."""
    return lambda x: ((x - _on_bounds(n)) ** 2).sum(-1)


def _active(n: int) -> Callable[[Tensor], Tensor]:
    """An ellipsoid pushed against bounds: a slope is left there, as in a constrained fit."""
    optimum = _on_bounds(n)
    slope = torch.linspace(1, 10, n, dtype=torch.float64) * (optimum == 0)

    def value(x: Tensor) -> Tensor:
        bowl = (_scales(n).flip(0) * (x - optimum) ** 2).sum(-1)
        return bowl + (slope * x).sum(-1) + 1 - x[..., 1]

    return value


PROBLEMS: dict[str, tuple[Callable[[int], Callable[[Tensor], Tensor]], float, int, float]] = {
    "sphere": (_sphere, 1e-12, 600, 1.0),
    "ellipsoid": (_ellipsoid, 1e-8, 4000, 1.0),
    "rotated ellipsoid": (_rotated_ellipsoid, 1e-8, 4000, 1.0),
    "rosenbrock": (_rosenbrock, 1e-8, 3600, 0.6),
    "rastrigin": (_rastrigin, 15.0, 900, 0.3),
    "corner": (_corner, 1e-10, 1500, 1.0),
    "sphere touching bounds": (_touching, 1e-12, 3000, 1.0),
    "active bounds": (_active, 1e-9, 4000, 1.0),
}
"""Name -> objective of n, target, generations at most for n = 30, share of runs that find it."""


def problem(name: str, n: int) -> Problem:
    make, target, generations, share = PROBLEMS[name]
    at_most = generations if n > 10 else generations // 3
    return Problem(name, make(n), target, max(at_most, 300), share)


class _FoundError(Exception):
    """All runs have the target."""


def values_of(p: Problem, engine: Callable[..., SearchState], state: SearchState) -> Tensor:
    """(generations, R) best value so far, until all runs have the target."""
    best = torch.full((len(state.mean),), float("inf"), dtype=torch.float64)
    history = []

    def watched(x: Tensor) -> Tensor:
        nonlocal best
        value = p.objective(x)
        best = torch.minimum(best, value.amin(1))
        history.append(best)
        if bool((best < p.target).all()):
            raise _FoundError
        return value

    with contextlib.suppress(_FoundError):
        engine(watched, state, generations=p.generations, seed=3)
    return torch.stack(history)


def generations_to(p: Problem, engine: Callable[..., SearchState], state: SearchState) -> Tensor:
    """(R,) generations until the target; inf where it was not reached."""
    hit = values_of(p, engine, state) < p.target
    return torch.where(hit.any(0), hit.double().argmax(0).double(), float("inf"))


def begin(runs: int, n: int, sigma: float = 0.3, seed: int = 0) -> SearchState:
    generator = torch.Generator().manual_seed(seed)
    return start(torch.rand(runs, n, generator=generator, dtype=torch.float64), sigma)


def sphere(x: Tensor) -> Tensor:
    return ((x - 0.4) ** 2).sum(-1)


def same(a: SearchState, b: SearchState, but: tuple[str, ...] = (), runs: slice = slice(None)):
    """Bit for bit, nan equal to nan."""
    left, right = a.tensors(), b.tensors()
    for name in left.keys() - set(but):
        assert np.array_equal(left[name][runs], right[name][runs], equal_nan=True), name
    assert a.generation == b.generation
