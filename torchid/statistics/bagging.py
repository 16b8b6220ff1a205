"""Probabilities that do not hang on a second of a log: means over logs that might have been.

Where no explanation is quite true, the evidence of one log is sure of whichever is least wrong on
it, and of another log of the same arm it would be sure of another. So blocks of samples, several
correlation times long, are drawn again with replacement, half as many as there are, and a
probability is its mean over the draws (BayesBag, Huggins and Miller 2023, Bayesian Analysis 18(4)).
"""

from dataclasses import dataclass

import torch

from torchid.statistics.blocks import block_sums
from torchid.typing import Bool, Float, Int, Tensor

DRAWS, DRAWN_SHARE = 40, 0.5
"""Logs that are drawn from the blocks of one, and how many blocks each has of those that there are
[1]: half, as Huggins and Miller advise."""

PARTED = 8
"""Blocks of samples that are drawn among themselves [1]."""


@dataclass(frozen=True, eq=False)
class Draws:
    """M logs that might have been.

    Attributes:
        block: (N,) number of each sample's block, from 0.
        times: (M, B) how often each block was drawn.
    """

    block: Int[Tensor, " N"]
    times: Float[Tensor, "M B"]

    @classmethod
    def of(cls, block: Int[Tensor, " N"], seed: int = 0) -> "Draws":
        """Draws of a log whose samples are in these blocks (N,)."""
        count = int(block.max()) + 1
        g = torch.Generator().manual_seed(seed)
        numbers = torch.randint(count, (DRAWS, max(1, round(DRAWN_SHARE * count))), generator=g)
        times = torch.zeros(DRAWS, count, dtype=torch.float64)
        return cls(block, times.scatter_add_(1, numbers, torch.ones_like(numbers).double()))

    def parting(self, some: Bool[Tensor, " N"], seed: int = 0) -> "Draws":
        """The same logs, in which some samples (N,) are blocks of their own and drawn among
        themselves: each log has as much of what happened in them alone."""
        number = (some.cumsum(0) - 1) * PARTED // some.sum()
        own = Draws.of(number[some], seed)
        block = torch.where(some, self.times.shape[1] + number, self.block)
        return Draws(block, torch.cat([self.times, own.times], 1))

    def sums(self, x: Float[Tensor, "n N"]) -> Float[Tensor, "M n"]:
        """Sums over each draw."""
        return self.times @ block_sums(x, self.block).T
