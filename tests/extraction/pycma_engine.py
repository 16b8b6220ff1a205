"""pycma as a search engine: one CMAEvolutionStrategy per run, stepped together.

Every call starts pycma anew from the runs' means and step sizes: covariance and paths are not
carried from call to call, so many short calls learn less than the engine `batched` does. Bounds
are pycma's own BoundTransform; its termination criteria are not asked.
"""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from torchid.errors import TorchidError
from torchid.extraction.cma.search import (
    Objective,
    SearchState,
    evaluate,
    generator_for,
    population_of,
    start,
)

SMALLEST_SIGMA = 1e-12


@torch.no_grad()
def minimise(
    objective: Objective,
    state: SearchState,
    *,
    generations: int,
    seed: int,
    population: int | None = None,
    first: int = 0,
) -> SearchState:
    """Continue R searches (see `torchid.extraction.cma.batched.minimise`), for n >= 2.

    A run in which pycma fails (a degenerate covariance) stays where it is for the rest of the
    call. The returned covariance is the identity, the paths are zero, and sigma is the root
    mean square of pycma's standard deviations.

    Raises:
        TorchidError: n = 1, which pycma does not do, or as Engine says.
    """
    size = population_of(state, generations, seed, population)
    if state.mean.shape[1] < 2:
        raise TorchidError(
            "pycma does not search in one dimension.", got="n = 1", hint="use engine 'batched'"
        )
    best = state.best.clamp(0.0, 1.0)
    best_value = evaluate(objective, best.unsqueeze(1)).squeeze(1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        runs = _strategies(state, seed, size, first)
        for _ in range(generations):
            asked = np.stack([run.ask() for run in runs]).clip(0.0, 1.0)
            points = torch.as_tensor(asked).to(state.mean)
            values = evaluate(objective, points)
            value, index = values.min(dim=1)
            better = value < best_value
            chosen = points[torch.arange(len(points), device=points.device), index]
            best = torch.where(better.unsqueeze(1), chosen, best)
            best_value = torch.where(better, value, best_value)
            for run, told in zip(runs, values.cpu().numpy(), strict=True):
                run.tell(told)
    centres = [run.centre() for run in runs]
    mean = torch.as_tensor(np.stack([point for point, _ in centres])).to(state.mean)
    fresh = start(mean, 1.0)
    sigma = torch.tensor([sigma for _, sigma in centres], dtype=torch.float64)
    return replace(
        fresh,
        sigma=sigma.to(state.sigma),
        generation=state.generation + generations,
        best=best,
        best_value=best_value,
    )


class _Run:
    """One CMAEvolutionStrategy, frozen where it was once it fails."""

    def __init__(self, strategy: Any, point: np.ndarray, sigma: float, population: int) -> None:
        self._strategy = strategy
        self._population = population
        self._asked: list[np.ndarray] = []
        self._failed = False
        self._start = point, sigma

    def ask(self) -> np.ndarray:
        """(L, n) points."""
        if not self._failed:
            try:
                self._asked = self._strategy.ask()
                return np.asarray(self._asked)
            except Exception:  # pycma raises many kinds; the other runs must go on
                self._failed = True
        return np.tile(self.centre()[0], (self._population, 1))

    def tell(self, values: np.ndarray) -> None:
        """Their values (L,); infinite ones are told as worse than every finite one."""
        if self._failed:
            return
        finite = values[np.isfinite(values)]
        worst = float(finite.max()) if finite.size else 0.0
        told = np.where(np.isfinite(values), values, worst + max(1.0, abs(worst)))
        try:
            self._strategy.tell(self._asked, told)
        except Exception:  # as above
            self._failed = True

    def centre(self) -> tuple[np.ndarray, float]:
        """Mean (n,) in the box and standard deviation; those of the start if pycma's are lost."""
        point = np.clip(self._strategy.result.xfavorite, 0.0, 1.0)
        sigma = float(np.sqrt(np.mean(np.square(self._strategy.stds))))
        lost = not (np.isfinite(point).all() and np.isfinite(sigma) and sigma > 0)
        return self._start if lost else (point, sigma)


def _strategies(state: SearchState, seed: int, population: int, first: int) -> list[_Run]:
    """A pycma strategy for every run, each with its own random numbers."""
    import cma  # takes a second: only where it is asked for

    generator = generator_for(seed, state.generation, first, torch.device("cpu"))
    seeds = torch.randint(2**62, (state.mean.shape[0],), generator=generator).tolist()
    runs = []
    points, sigmas = state.point.cpu().numpy(), state.sigma.cpu().numpy()
    for point, sigma, own in zip(points, sigmas, seeds, strict=True):
        random = np.random.default_rng(own)
        options = {
            "bounds": [0, 1],
            "popsize": population,
            "verbose": -9,
            # Its own generator, so that pycma neither reads nor seeds NumPy's global one.
            "seed": np.nan,
            "randn": lambda *shape, random=random: random.standard_normal(shape),
        }
        step = max(float(sigma), SMALLEST_SIGMA)
        strategy = cma.CMAEvolutionStrategy(point, step, options)
        runs.append(_Run(strategy, point, step, population))
    return runs
