"""The state of many independent searches, and the box [0, 1]^n.

They search without bounds. Search coordinates are folded into the box by a smooth periodic
map: the identity in the interior, quadratic near a bound, so that an optimum on a bound is the
bottom of a smooth valley and not a kink. The idea is pycma's BoundTransform (Hansen); here the
margin is the same at both ends.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from torchid.errors import TorchidError
from torchid.typing import Float, Tensor

Objective = Callable[[Tensor], Tensor]
"""(R, L, n) points inside [0, 1]^n -> (R, L) values: all runs, all their samples, in one call."""

MARGIN = 0.05
"""Half-width of the quadratic stretch at a bound, and how far the search goes beyond it."""
PERIOD = 2 * (1 + 2 * MARGIN)
"""Search coordinates that differ by a multiple of it are the same point."""


@dataclass(frozen=True, eq=False)
class SearchState:
    """R independent searches in [0, 1]^n, between two generations. Compared by identity.

    Attributes:
        mean: (R, n) centres of the distributions, in search coordinates, from -MARGIN to
            1 + MARGIN; `point` is the same in the box. Away from the bounds both are equal.
        sigma: (R,) step sizes.
        covariance: (R, n, n) C; a sample is mean + sigma N(0, C).
        path_sigma: (R, n) evolution paths of the step sizes, in the axes of C's Cholesky factor.
        path_covariance: (R, n) evolution paths of the covariances.
        generation: how many generations the searches have had.
        best: (R, n) best points found, inside the box.
        best_value: (R,) their values; inf before the first evaluation.
    """

    mean: Float[Tensor, "R n"]
    sigma: Float[Tensor, " R"]
    covariance: Float[Tensor, "R n n"]
    path_sigma: Float[Tensor, "R n"]
    path_covariance: Float[Tensor, "R n"]
    generation: int
    best: Float[Tensor, "R n"]
    best_value: Float[Tensor, " R"]

    @property
    def point(self) -> Float[Tensor, "R n"]:
        """The centres in the box (R, n)."""
        return into_box(self.mean)

    def part(self, runs: slice) -> "SearchState":
        """Some of the searches."""
        own = {name: t[runs] for name, t in self.tensors().items()}
        return SearchState(**own, generation=self.generation)

    @staticmethod
    def joined(parts: Sequence["SearchState"]) -> "SearchState":
        """Searches of as many generations, one after another."""
        rows = {name: torch.cat([getattr(p, name) for p in parts]) for name in parts[0].tensors()}
        return SearchState(**rows, generation=parts[0].generation)

    def to(self, device: torch.device | str) -> "SearchState":
        """This state on another device."""
        moved = {name: t.to(device) for name, t in self.tensors().items()}
        return SearchState(**moved, generation=self.generation)

    def tensors(self) -> dict[str, Tensor]:
        """All but the count of generations, by name."""
        return {name: x for name, x in vars(self).items() if name != "generation"}


def start(mean: Float[Tensor, "R n"], sigma: float) -> SearchState:
    """R fresh searches: identity covariance, no paths, the means as the best so far.

    Args:
        mean: (R, n) where to start, inside [0, 1]^n; converted to float64, on its device.
        sigma: first standard deviation of every coordinate; 0.3 covers the box, and more than a
            third is of no use.

    Raises:
        TorchidError: a mean outside the box, or a sigma that is not positive.
    """
    if mean.ndim != 2 or 0 in mean.shape:
        raise TorchidError(
            "a search starts from means (R, n).", got=tuple(mean.shape), expected="R, n >= 1"
        )
    if not bool(((mean >= 0) & (mean <= 1)).all()):
        raise TorchidError(
            "a search starts inside the unit box.",
            got=f"coordinates from {float(mean.min()):g} to {float(mean.max()):g}",
            expected="every coordinate in [0, 1]",
        )
    if not 0 < sigma < float("inf"):
        raise TorchidError("sigma is not a step size.", got=sigma, expected="a positive number")
    point = mean.detach().to(torch.float64).clone()
    runs, n = point.shape
    zeros = torch.zeros_like(point)
    return SearchState(
        mean=from_box(point),
        sigma=point.new_full((runs,), sigma),
        covariance=torch.eye(n, dtype=point.dtype, device=point.device).repeat(runs, 1, 1),
        path_sigma=zeros,
        path_covariance=zeros.clone(),
        generation=0,
        best=point,
        best_value=point.new_full((runs,), float("inf")),
    )


def default_population(n: int) -> int:
    """4 + floor(3 ln n), Hansen's default (arXiv:1604.00772, eq. 48)."""
    return 4 + int(3 * np.log(n))


def into_box(x: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
    """Search coordinates (..., n) -> points (..., n) in [0, 1]^n: periodic, smooth, onto.

    With d the distance from the middle after folding (a triangle wave of period PERIOD) and e the
    part of d beyond 1/2 - MARGIN, the point is 1/2 + d - e |e| / (4 MARGIN).
    """
    half = PERIOD / 4
    wave = x - (0.5 + half)
    wave -= PERIOD * torch.round(wave / PERIOD)
    d = wave.abs_().neg_().add_(half)
    e = d - d.clamp(-0.5 + MARGIN, 0.5 - MARGIN)
    d.addcmul_(e, e.abs(), value=-0.25 / MARGIN)
    return d.add_(0.5).clamp_(0.0, 1.0)


def from_box(point: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
    """Points (..., n) of [0, 1]^n -> their search coordinates in [-MARGIN, 1 + MARGIN]^n."""
    low, high = point.clamp(max=MARGIN), (1 - point).clamp(max=MARGIN)
    below = 2 * torch.sqrt(MARGIN * low) - MARGIN
    above = 1 + MARGIN - 2 * torch.sqrt(MARGIN * high)
    return torch.where(point < MARGIN, below, torch.where(point > 1 - MARGIN, above, point))


def evaluate(objective: Objective, points: Float[Tensor, "R L n"]) -> Float[Tensor, "R L"]:
    """Values (R, L) of points (R, L, n), with inf for what is nan or infinite.

    Raises:
        TorchidError: the objective gave another shape.
    """
    values = objective(points)
    if values.shape != points.shape[:-1]:
        raise TorchidError(
            "the objective gave values of another shape.",
            got=tuple(values.shape),
            expected=f"{tuple(points.shape[:-1])}: (runs, samples)",
        )
    return torch.where(values.isfinite(), values, float("inf")).to(points)


def generator_for(seed: int, generation: int, first: int, device: torch.device) -> torch.Generator:
    """Random numbers that depend on the seed, the count of generations and the first search only.

    So 10 generations and 10 more with the same seed sample as 20 do, and no stage of a search
    repeats another's noise. NumPy's SeedSequence mixes the numbers.
    """
    mixed = np.random.SeedSequence([seed, generation, first]).generate_state(1)[0]
    return torch.Generator(device=device).manual_seed(int(mixed))


def population_of(state: SearchState, generations: int, seed: int, population: int | None) -> int:
    """The population to use, after a check of the numbers a person can set.

    Raises:
        TorchidError: generations or seed below 0, or a population below 2.
    """
    size = default_population(state.mean.shape[1]) if population is None else population
    for name, value, least in (
        ("generations", generations, 0),
        ("seed", seed, 0),
        ("population", size, 2),
    ):
        if value < least:
            raise TorchidError(f"{name} is too small.", got=value, expected=f"at least {least}")
    return size
