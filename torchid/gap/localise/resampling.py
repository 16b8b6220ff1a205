"""Tests over blocks, corrected for the maximum over everything that is looked at.

A residual is autocorrelated, so whole blocks of several correlation times are what is resampled:

- permuted, where a statistic compares the residual with the motion or with elapsed time: without
  any connection the blocks of the residual may stand in any order;
- turned in sign, where it is a sum over blocks that vanishes on average;
- and where neither applies, a Gaussian process of the same spectrum takes the residual's place.

The same draws serve all joints and regimes. Statistics are brought to a common scale by the mean
and standard deviation of their draws; the maximum over all of them, draw by draw, is the null
distribution of every one (Westfall and Young 1993, max-T).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from torchid.typing import Float, Int, Tensor

DRAWS = 499

Energy = Callable[[Float[Tensor, "R K"]], Float[Tensor, "R n"]]
"""Squared gap of a regime [(N m)^2 samples] from how often each block counts."""


@dataclass(frozen=True)
class Draws:
    """Resamplings of K blocks.

    Attributes:
        order: (D, K) permutations.
        signs: (D, K) +1 or -1.
        generator: for draws of other kinds.
    """

    order: Int[Tensor, "D K"]
    signs: Float[Tensor, "D K"]
    generator: torch.Generator

    @classmethod
    def of(cls, blocks: int, seed: int, count: int = DRAWS) -> "Draws":
        """`count` draws."""
        g = torch.Generator().manual_seed(seed)
        order = torch.rand(count, blocks, generator=g).argsort(-1)
        signs = torch.randint(0, 2, (count, blocks), generator=g).to(torch.float64) * 2 - 1
        return cls(order, signs, g)

    def __len__(self) -> int:
        return self.order.shape[0]


@dataclass(frozen=True)
class Look:
    """One statistic on every joint: large where there is structure.

    Attributes:
        observed: (n,).
        null: (D, n) without structure.
        energy: what the regime holds, for its excess.
        possible: (n,) where the data allow the look.
    """

    observed: Float[Tensor, " n"]
    null: Float[Tensor, "D n"]
    energy: Energy
    possible: Tensor

    def standardised(self) -> "Look":
        """With mean 0 and standard deviation 1 of the draws; -inf where not possible."""
        # A look that cannot be, or never varies, counts as minus infinity.
        mean, std = self.null.mean(0), self.null.std(0)
        usable = self.possible & (std > 0)
        std = std.where(usable, torch.ones_like(std))
        never = torch.full_like(mean, -torch.inf)
        return Look(
            ((self.observed - mean) / std).where(usable, never),
            ((self.null - mean) / std).where(usable, never),
            self.energy,
            usable,
        )


def best_of(looks: Sequence[Look]) -> Look:
    """The look with the largest standardised statistic on each joint, and so in every draw."""
    scaled = [look.standardised() for look in looks]
    observed, which = torch.stack([look.observed for look in scaled]).max(0)
    null = torch.stack([look.null for look in scaled]).amax(0)
    possible = torch.stack([look.possible for look in scaled]).any(0)

    def energy(weights: Tensor) -> Tensor:
        each = torch.stack([look.energy(weights) for look in scaled])
        return each.gather(0, which.expand(1, *each.shape[1:])).squeeze(0)

    return Look(observed, null, energy, possible)


def corrected(looks: Sequence[Look]) -> Float[Tensor, "R n"]:
    """p-values, corrected for the maximum over all looks and joints."""
    scaled = [look.standardised() for look in looks]
    # The largest of all looks in each draw is what each look is held against.
    largest = torch.stack([look.null for look in scaled]).amax((0, 2)).sort().values
    observed = torch.stack([look.observed for look in scaled])
    below = torch.searchsorted(largest, observed)
    p = (1 + len(largest) - below) / (1 + len(largest))
    possible = torch.stack([look.possible for look in scaled])
    return torch.where(possible, p, torch.ones_like(p)).to(torch.float64)


def linear(parts: Float[Tensor, "K n"]) -> Energy:
    """Energy that is a sum over blocks."""
    return lambda weights: weights @ parts


def quadratic(parts: Tensor, scale: Float[Tensor, " n"]) -> Energy:
    """scale |sum of parts|^2 without the products of a block with itself, which hold its noise."""

    def energy(weights: Tensor) -> Tensor:
        w = weights.to(parts.dtype)
        whole = (w @ parts).abs().square()
        return scale * (whole - weights.square() @ parts.abs().square())

    return energy


def permuted(
    regime: Float[Tensor, "K L n"], signal: Float[Tensor, "K L n"], draws: Draws
) -> tuple[Float[Tensor, " n"], Float[Tensor, "D n"]]:
    """sum over instants of regime times signal, and with the signal's blocks in other orders."""
    # Each block of the regime with each block of the signal; an order picks one of each.
    products = torch.einsum("aln,bln->abn", regime, signal)
    places = torch.arange(products.shape[0])
    null = torch.stack([products[places, order].sum(0) for order in draws.order])
    return products[places, places].sum(0), null


def flipped(
    parts: Float[Tensor, "K n"], draws: Draws, two_sided: bool
) -> tuple[Float[Tensor, " n"], Float[Tensor, "D n"]]:
    """Sum over blocks in units of its root sum of squares, and with random signs."""
    size = parts.square().sum(0).sqrt().clamp(min=1e-300)
    observed, null = parts.sum(0) / size, draws.signs @ parts / size
    return (observed.abs(), null.abs()) if two_sided else (observed, null)
