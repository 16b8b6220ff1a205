"""Standard deviations of base parameters, by the block jackknife of torchid.statistics."""

import itertools
from collections.abc import Iterator

import torch

from torchid.identification.least_squares import Fit, orthonormal, whitened_rows
from torchid.identification.model import quantile
from torchid.identification.record import StatisticsRecord
from torchid.identification.rows import RowBlock, RowSource
from torchid.statistics import jackknife as blocks_jackknife
from torchid.statistics.autocorrelation import CORRELATION_TIMES, correlation_instants
from torchid.statistics.blocks import block_length, block_numbers, block_products
from torchid.statistics.jackknife import Shares
from torchid.typing import Bool, Float, Tensor


class Uncertainty(StatisticsRecord, frozen=True, kw_only=True):
    """Covariance of the coefficients, in the layout's order.

    Attributes:
        covariance: (B, B); rows and columns of coefficients that are not free are 0.
        by_one_block: (B,) coefficients that one block alone determines: their standard deviation
            is the white-noise one, a lower bound.
        warnings: sentences for the user.
        shares: what each block says of the free ones; None of a tree, whose blocks hold too much.
    """

    covariance: Float[Tensor, "B B"]
    by_one_block: Bool[Tensor, " B"]
    warnings: tuple[str, ...]
    shares: Shares | None = None

    @property
    def std(self) -> Float[Tensor, " B"]:
        """Standard deviations (B,)."""
        return self.covariance.diagonal().clamp(min=0).sqrt()


def _in_coordinates(
    source: RowSource, piece: RowBlock, kept: Tensor, fit: Fit, free: Tensor, inverse: Tensor
) -> Iterator[tuple[Float[Tensor, " m"], Float[Tensor, "m F"]]]:
    """Per joint the whitened residual of its rows, and its rows times the inverse."""
    scale, columns = fit.whitening.diagonal(), source.layout.columns
    if torch.equal(fit.whitening, torch.diag(scale)):
        weight = scale * piece.keep * kept[piece.instant]
        weighted = [a * w.unsqueeze(-1) for a, w in zip(piece.augmented, weight.T, strict=True)]
    else:
        weighted = whitened_rows(source, piece, kept, fit.whitening)
        columns = (tuple(range(source.layout.size)),) * len(weighted)
    # A joint may have few columns of all, and only these are multiplied.
    place = torch.full((source.layout.size,), -1)
    place[free] = torch.arange(len(free))
    for rows, own in zip(weighted, columns, strict=True):
        at = torch.tensor(own, dtype=torch.long)
        there = place[at] >= 0
        z = rows[:, :-1][:, there] @ inverse[place[at[there]]]
        yield rows[:, -1] - rows[:, :-1] @ fit.x[at], z


def jackknife(source: RowSource, fit: Fit) -> Uncertainty:
    """Covariance of `fit` from the spread between blocks of its rows."""
    bounds = [slice(first, last) for first, last in itertools.pairwise(source.boundaries)]
    residual = fit.residual * (fit.robust > 0)
    # Instants are blocked for all joints together, by the joint whose residual is slowest.
    correlation = correlation_instants(residual, bounds)
    length = block_length(source.instants, correlation)
    warnings = []
    if length < CORRELATION_TIMES * correlation:
        warnings.append(
            f"the log holds only {source.instants / correlation:.0f} correlation times of "
            "the residual: standard deviations are rough, and more likely too small than too large"
        )
    free = fit.free.nonzero().flatten()
    block = block_numbers(bounds, length)
    # Normal equations are summed in the coordinates that the fit's own triangular factor gives, one
    # pass over the rows: the columns are orthonormal there, so that no digits are lost to the
    # square of a condition number.
    inverse = orthonormal(fit.factor, free)
    count = int(block.max()) + 1
    hessians = torch.zeros(count, len(free), len(free), dtype=torch.float64)
    gradients = torch.zeros(count, len(free), dtype=torch.float64)
    kept = (fit.robust > 0).to(torch.float64)
    for piece in source:
        owner = block[piece.instant]
        # Of many short trajectories a piece holds few blocks.
        own = slice(int(owner.min()), int(owner.max()) + 1)
        held = own.stop - own.start
        weight = fit.robust[piece.instant].square()
        for i, (residual, z) in enumerate(_in_coordinates(source, piece, kept, fit, free, inverse)):
            informative = z * (weight[:, i] == 1).unsqueeze(-1)
            pull = (weight[:, i] * residual).unsqueeze(-1)
            hessians[own] += block_products(informative, z, owner - own.start, held)
            gradients[own] += block_products(z, pull, owner - own.start, held).squeeze(-1)
    # Mean square of the weighted residuals: about 1 where rows are whitened.
    rows_kept = int((fit.robust > 0).sum())
    variance = float(fit.factor[-1, -1] ** 2) / max(1, rows_kept - len(free))
    # What a log leaves is mostly misfit, as slow as the columns: each block counts as left out.
    spread = blocks_jackknife.jackknife(
        hessians, gradients, variance=variance, combinations=inverse, power=1.0
    )
    covariance = torch.zeros(len(fit.x), len(fit.x), dtype=torch.float64)
    covariance[free.unsqueeze(-1), free] = spread.covariance
    by_one = torch.zeros(len(fit.x), dtype=torch.bool)
    by_one[free] = spread.by_one_block
    interval = max(source.interval)
    return Uncertainty(
        method="leverage-corrected block jackknife", blocks=spread.blocks,
        block_seconds=length * interval, correlation_seconds=correlation * interval,
        quantile95=quantile(spread.blocks), covariance=covariance, by_one_block=by_one,
        warnings=tuple(warnings), shares=spread.shares if source.layout.robot.is_serial else None,
    )  # fmt: skip
