"""CMA-ES for many runs at once, in batched tensor operations.

N. Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772: weighted recombination with
negative weights, rank-one and rank-mu update, cumulative step-size adaptation. Two choices differ.

- Samples are A z with A the Cholesky factor of C, in place of its symmetric root, and the path of
  the step size is kept in z's axes. The distribution is the same; a batch of factors costs about a
  twentieth of the eigendecompositions, so C is factored in every generation and never lags.
- The box is met by a smooth periodic map (torchid.extraction.cma.search): C, the paths and the mean
  live in search coordinates, which know no bounds.

Numbers that go wrong stay in their run. A covariance that is no longer positive definite gets its
eigenvalues lifted to 1e-14 of the largest (the identity if it is not finite). Coordinates' standard
deviations are held below a third of the box, as pycma does, and a run whose largest has fallen to
1e-12 stays there, able to grow again should the objective change. There, and where half of the
samples tie with the best, ranks are noise: step size and mean go on, the covariance waits.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import torch

from torchid.extraction.cma.search import (
    PERIOD,
    Objective,
    SearchState,
    evaluate,
    generator_for,
    into_box,
    population_of,
)
from torchid.typing import Float, Tensor

LARGEST_STD = 1 / 3
"""Of a coordinate, in widths of the box."""
SMALLEST_STD = 1e-12
"""Of the widest coordinate: below it, samples round to the mean."""


@dataclass(frozen=True)
class Strategy:
    """Weights and rates for n variables and a population (tutorial, table 1).

    Attributes:
        weights: by rank, best first; the first half sum to 1, the others are negative.
        mu_eff: variance-effective selection mass of the positive weights.
        c_sigma, d_sigma: rate and damping of the step size.
        c_c, c_1, c_mu: rates of the path, the rank-one and the rank-mu update.
        chi_n: expected length of a standard normal vector.
    """

    weights: tuple[float, ...]
    mu_eff: float
    c_sigma: float
    d_sigma: float
    c_c: float
    c_1: float
    c_mu: float
    chi_n: float


@lru_cache(maxsize=64)
def strategy(n: int, population: int) -> Strategy:
    """The tutorial's defaults (eq. 49-58) for n variables and a population."""
    raw = [math.log((population + 1) / 2) - math.log(i + 1) for i in range(population)]
    good, bad = [w for w in raw if w >= 0], [w for w in raw if w < 0]
    mu_eff = sum(good) ** 2 / sum(w * w for w in good)
    mu_eff_bad = sum(bad) ** 2 / sum(w * w for w in bad)
    c_1 = 2 / ((n + 1.3) ** 2 + mu_eff)
    c_mu = min(1 - c_1, 2 * (0.25 + mu_eff + 1 / mu_eff - 2) / ((n + 2) ** 2 + mu_eff))
    mass = min(1 + c_1 / c_mu, 1 + 2 * mu_eff_bad / (mu_eff + 2), (1 - c_1 - c_mu) / (n * c_mu))
    weights = [w / sum(good) for w in good] + [mass * w / -sum(bad) for w in bad]
    c_sigma = (mu_eff + 2) / (n + mu_eff + 5)
    return Strategy(
        weights=tuple(weights),
        mu_eff=mu_eff,
        c_sigma=c_sigma,
        d_sigma=1 + 2 * max(0.0, math.sqrt((mu_eff - 1) / (n + 1)) - 1) + c_sigma,
        c_c=(4 + mu_eff / n) / (n + 4 + 2 * mu_eff / n),
        c_1=c_1,
        c_mu=c_mu,
        chi_n=math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n)),
    )


@dataclass
class _Runs:
    """The state in work, changed in place, with the factor of its covariance."""

    mean: Tensor
    sigma: Tensor
    covariance: Tensor  # only the lower triangle is read
    factor: Tensor
    path_sigma: Tensor
    path_covariance: Tensor
    adapts: Tensor  # (R,) whether the covariance learns in this generation
    best: Tensor
    best_value: Tensor


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
    """Continue R searches for a number of generations.

    Args:
        objective: (R, L, n) points -> (R, L) values. It may differ from the last call's:
            `state.best` is evaluated again first. nan and infinite values rank last.
        state: where to continue.
        generations: how many, for every run.
        seed: with the state's count of generations and `first` it decides all samples: the
            same arguments give the same bits on a CPU.
        population: L samples per run and generation; `default_population` if None.
        first: number of the first of these searches, where they are some of many: no others
            sample as they do.

    Returns:
        The state afterwards: its best is inside [0, 1]^n and never worse than `state.best`.

    Raises:
        TorchidError: an argument out of range, or values of another shape than (R, L).
    """
    size = population_of(state, generations, seed, population)
    n_runs, n = state.mean.shape
    rates = strategy(n, size)
    weights = state.mean.new_tensor(rates.weights)
    own = {name: x.clone() for name, x in state.tensors().items()}
    adapts = torch.ones_like(state.sigma, dtype=torch.bool)
    runs = _Runs(**own, factor=_factor(own["covariance"]), adapts=adapts)
    runs.best = runs.best.clamp(0.0, 1.0)
    _limit(runs)
    runs.best_value = evaluate(objective, runs.best.unsqueeze(1)).squeeze(1)
    for generation in range(state.generation, state.generation + generations):
        generator = generator_for(seed, generation, first, runs.mean.device)
        noise = runs.mean.new_empty(n_runs, size, n).normal_(generator=generator)
        steps = torch.bmm(noise, runs.factor.mT)
        by_sample = _select(objective, runs, steps, weights)
        _adapt(runs, rates, noise, steps, by_sample, generation)
        _fold(runs)
        _limit(runs)
    lower = runs.covariance.tril()
    own_values = {name: getattr(runs, name) for name in own}
    own_values["covariance"] = lower + lower.tril(-1).mT
    return SearchState(**own_values, generation=state.generation + generations)


def _select(
    objective: Objective, runs: _Runs, steps: Float[Tensor, "R L n"], weights: Float[Tensor, " L"]
) -> Float[Tensor, "R L"]:
    """Evaluate the samples, keep the best, and give every sample the weight of its rank."""
    search = torch.addcmul(runs.mean.unsqueeze(1), runs.sigma[:, None, None], steps)
    points = into_box(search)
    values = evaluate(objective, points)
    order = values.argsort(dim=1, stable=True)
    first = order[:, :1]
    value = values.gather(1, first).squeeze(1)
    better = value < runs.best_value
    runs.best_value = torch.where(better, value, runs.best_value)
    index = first.unsqueeze(-1).expand(-1, 1, points.shape[-1])
    point = points.gather(1, index).squeeze(1)
    runs.best = torch.where(better.unsqueeze(1), point, runs.best)
    middle = values.gather(1, order[:, values.shape[1] // 2].unsqueeze(1)).squeeze(1)
    runs.adapts &= value < middle  # else the order is that of the draw
    return torch.empty_like(values).scatter_(1, order, weights.expand_as(values))


def _adapt(
    runs: _Runs,
    rates: Strategy,
    noise: Float[Tensor, "R L n"],
    steps: Float[Tensor, "R L n"],
    weights: Float[Tensor, "R L"],
    generation: int,
) -> None:
    """Move the mean and adapt paths, covariance and step size (tutorial, eq. 41-47)."""
    n = noise.shape[-1]
    parents = weights.clamp(min=0.0).unsqueeze(1)
    step = torch.bmm(parents, steps).squeeze(1)
    runs.mean.addcmul_(runs.sigma.unsqueeze(1), step)

    c = rates.c_sigma
    runs.path_sigma *= 1 - c
    gain = math.sqrt(c * (2 - c) * rates.mu_eff)
    runs.path_sigma.add_(torch.bmm(parents, noise).squeeze(1), alpha=gain)
    length = runs.path_sigma.norm(dim=1)

    # A long path means that sigma lags: the covariance's path waits (h_sigma).
    settled = math.sqrt(1 - (1 - c) ** (2 * (generation + 1)))
    moves = (length < settled * (1.4 + 2 / (n + 1)) * rates.chi_n).to(length)
    gain = math.sqrt(rates.c_c * (2 - rates.c_c) * rates.mu_eff)
    runs.path_covariance *= 1 - rates.c_c
    runs.path_covariance.add_(moves.unsqueeze(1) * step, alpha=gain)

    # What the samples, the old covariance and the path count in the new one (eq. 46, 47). Bad
    # samples count as if they had unit Mahalanobis length per variable, whatever their own.
    squares = torch.linalg.vecdot(noise, noise)
    samples = torch.where(weights < 0, weights * n / squares, weights)
    waiting = rates.c_1 * rates.c_c * (2 - rates.c_c) * (1 - moves)
    kept = 1 - rates.c_1 - rates.c_mu * sum(rates.weights) + waiting
    learns = runs.adapts.to(noise)
    scaled = rates.c_mu * samples * learns.unsqueeze(1)
    path = runs.path_covariance.unsqueeze(1)
    rows = torch.cat([steps, path], dim=1)
    one = (rates.c_1 * learns)[:, None, None]
    weighted = torch.cat([scaled.unsqueeze(2) * steps, one * path], dim=1)
    runs.covariance *= torch.where(runs.adapts, kept, 1.0)[:, None, None]
    runs.covariance.baddbmm_(rows.mT, weighted)
    runs.factor = _factor(runs.covariance)

    growth = (c / rates.d_sigma) * (length / rates.chi_n - 1)
    runs.sigma *= torch.exp(growth.clamp(max=1.0))


def _fold(runs: _Runs) -> None:
    """Bring means that left for a mirror image of the box back, and mirror their distributions.

    The map into the box is periodic and even about its turning points, so nothing is lost.
    """
    offset = runs.mean - 0.5
    away = offset.abs() > PERIOD / 4
    if not bool(away.any()):
        return
    offset -= PERIOD * torch.round(offset / PERIOD)
    mirrored = offset.abs() > PERIOD / 4
    image = torch.where(mirrored, offset.sign() * (PERIOD / 2) - offset, offset)
    runs.mean = torch.where(away, 0.5 + image, runs.mean)
    sign = torch.where(mirrored, -1.0, 1.0).to(offset)
    both = sign.unsqueeze(2) * sign.unsqueeze(1)
    runs.covariance *= both
    runs.factor *= both
    runs.path_sigma *= sign
    runs.path_covariance *= sign


def _limit(runs: _Runs) -> None:
    """Hold the standard deviations between SMALLEST_STD and LARGEST_STD."""
    spread = runs.covariance.diagonal(dim1=1, dim2=2).sqrt()
    stds = runs.sigma.unsqueeze(1) * spread
    # Within it a standard deviation is at its limit, and is left alone
    tolerance = 1 + 1e-9
    if bool((stds > LARGEST_STD * tolerance).any()):
        scale = (LARGEST_STD / stds).clamp(max=1.0)
        runs.covariance *= scale.unsqueeze(2) * scale.unsqueeze(1)
        # Anew, not scaled: a continued search factors it anew too, to the same bits.
        runs.factor = _factor(runs.covariance)
        runs.path_covariance *= scale
        spread = spread * scale
    widest = spread.amax(dim=1)
    torch.maximum(runs.sigma, SMALLEST_STD / widest, out=runs.sigma)
    runs.adapts = runs.sigma * widest > SMALLEST_STD * tolerance


def _factor(covariance: Float[Tensor, "R n n"]) -> Float[Tensor, "R n n"]:
    """Cholesky factors (R, n, n); covariances that have none are repaired in place first."""
    factor, failed = torch.linalg.cholesky_ex(covariance)
    bad = (failed > 0) | ~factor.diagonal(dim1=1, dim2=2).sum(1).isfinite()
    if bool(bad.any()):
        # The nearest covariances of condition 1e14; the identity where nothing is left of one.
        eye = torch.eye(covariance.shape[-1], dtype=covariance.dtype, device=covariance.device)
        lower = covariance[bad].tril()
        whole = lower + lower.tril(-1).mT
        finite = whole.isfinite().all(dim=(1, 2))
        values, vectors = torch.linalg.eigh(torch.where(finite[:, None, None], whole, eye))
        largest = values[:, -1:]
        # 1e-14: of a repaired covariance, relative to its largest
        values = torch.where(largest > 0, values.maximum(1e-14 * largest), 1.0)
        covariance[bad] = (vectors * values.unsqueeze(1)) @ vectors.mT
        factor[bad] = torch.linalg.cholesky_ex(covariance[bad])[0]
    return factor
