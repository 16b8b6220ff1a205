"""Standard deviations that respect autocorrelation: the delete-a-block jackknife.

Filtered residuals are strongly autocorrelated, and partly model error, so the textbook covariance
s^2 (A'A)^-1 is far too small. The data are cut into contiguous blocks several correlation times
long, the problem is solved again without each block, and the spread of the solutions

    V = (K - 1)/K sum_k (x_(k) - mean)(x_(k) - mean)'

estimates the covariance without assuming white, Gaussian or equal residuals (Kuensch 1989). For
Huber's estimate each solution is one Newton step from the whole one, x_(k) = x - (H - H_k)^-1 g_k:
g sums psi(r) a over the block's rows and H sums a a' over its rows that are not clipped. Repeating
the fit with the weights held would take clipped rows for informative ones, and give standard
deviations that are a sixth too small.
"""

import itertools
import math
from dataclasses import dataclass

import torch
from scipy.stats import t as student

from torchid.identification.least_squares import Fit, whitened_rows
from torchid.identification.rows import RowSource
from torchid.typing import Bool, Float, Int, Tensor

CORRELATION_TIMES = 4.0
ALONE = 0.05
"""Share of a direction's information below which the other blocks do not determine it."""

FEWEST_BLOCKS = 20
MOST_BLOCKS = 120


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the coefficients, in the layout's order.

    Attributes:
        covariance: (B, B); rows and columns of coefficients that are not free are 0.
        by_one_block: (B,) coefficients that one block alone determines: their standard deviation
            is the white-noise one, a lower bound.
        blocks: number of blocks.
        block_seconds: their length.
        correlation_seconds: integrated autocorrelation time of the residuals, largest over joints.
        warnings: sentences for the user.
    """

    covariance: Float[Tensor, "B B"]
    by_one_block: Bool[Tensor, " B"]
    blocks: int
    block_seconds: float
    correlation_seconds: float
    warnings: tuple[str, ...]

    @property
    def std(self) -> Float[Tensor, " B"]:
        """Standard deviations (B,)."""
        return self.covariance.diagonal().clamp(min=0).sqrt()

    def quantile(self, level: float = 0.95) -> float:
        """Half-width of a two-sided interval in standard deviations (Student, K - 1)."""
        return float(student.ppf(0.5 + level / 2, max(1, self.blocks - 1)))


def jackknife(source: RowSource, fit: Fit) -> Uncertainty:
    """Covariance of `fit` by leaving out one block at a time."""
    correlation = correlation_instants(fit.residual * (fit.robust > 0))
    block, count, length = block_numbers(source, correlation)
    interval = max(source.interval)
    warnings = []
    if length < CORRELATION_TIMES * correlation:
        warnings.append(
            f"the log holds only {source.instants / max(correlation, 1):.0f} correlation times of "
            "the residual: standard deviations are rough, and more likely too small than too large"
        )
    covariance, by_one = _spread_without_blocks(source, fit, block, count)
    seconds = (length * interval, correlation * interval)
    return Uncertainty(covariance, by_one, count, *seconds, tuple(warnings))


def correlation_instants(residual: Float[Tensor, "I n"]) -> float:
    """Integrated autocorrelation time 1 + 2 sum rho_k [instants], the largest over the joints;
    the sum ends where it exceeds a fifth of the lag (Sokal's window)."""
    centred = residual - residual.mean(0)
    size = 2 ** math.ceil(math.log2(2 * max(2, len(centred))))
    spectrum = torch.fft.rfft(centred.T, n=size)
    auto = torch.fft.irfft(spectrum.abs() ** 2, n=size)[:, : len(centred)]
    longest = 1.0
    for row in auto:
        if float(row[0]) <= 0:
            continue
        tau = 2 * torch.cumsum(row / row[0], 0) - 1
        lags = torch.arange(len(tau), dtype=tau.dtype)
        window = (lags >= 5 * tau).nonzero().flatten()
        longest = max(longest, float(tau[window[0] if len(window) else -1]))
    return longest


def block_numbers(source: RowSource, correlation: float) -> tuple[Int[Tensor, " I"], int, int]:
    """Block of each instant, their number, and their length; blocks do not cross trajectories."""
    total = source.instants
    length = max(1, math.ceil(CORRELATION_TIMES * correlation), math.ceil(total / MOST_BLOCKS))
    length = min(length, max(1, total // FEWEST_BLOCKS))
    numbers, count = [], 0
    edges = source.boundaries
    for first, last in itertools.pairwise(edges):
        here = max(1, round((last - first) / length))
        local = torch.arange(last - first) * here // max(1, last - first)
        numbers.append(local + count)
        count += here
    return torch.cat(numbers), count, length


def _spread_without_blocks(
    source: RowSource, fit: Fit, block: Tensor, count: int
) -> tuple[Float[Tensor, "B B"], Bool[Tensor, " B"]]:
    """Jackknife covariance, and the coefficients that one block alone determines.

    Computed in coordinates where the whole problem has unit Gram: an eigenvalue of a left-over H
    says how much of a direction's information the other blocks hold. Where that is next to nothing
    the jackknife is silent, and the white-noise variance stands in for it as a lower bound.
    """
    free = fit.free.nonzero().flatten()
    basis = torch.linalg.qr(fit.factor[:, free], mode="r").R
    eye = torch.eye(len(free), dtype=basis.dtype)
    inverse = torch.linalg.solve_triangular(basis, eye, upper=True)
    hessians, gradients = _block_sums(source, fit, inverse, block, count)
    left = hessians.sum(0) - hessians
    values, vectors = torch.linalg.eigh(left)
    alone = values < ALONE
    pulled = (vectors.transpose(1, 2) @ gradients.unsqueeze(-1)).squeeze(-1)
    bounded = torch.where(alone, torch.zeros_like(values), pulled / values.clamp(min=ALONE))
    steps = (vectors @ bounded.unsqueeze(-1)).squeeze(-1)
    spread = steps - steps.mean(0)
    inner = inverse @ ((count - 1) / count * spread.T @ spread) @ inverse.T
    share = (inverse @ vectors).square() * alone.unsqueeze(1)
    lone = (share.sum(-1).amax(0) > 0.5 * inverse.square().sum(-1)) if len(free) else eye[:0].any(0)
    white = _residual_variance(fit) * inverse.square().sum(-1)
    short = torch.where(lone, (white - inner.diagonal()).clamp(min=0), torch.zeros_like(white))
    covariance = torch.zeros(len(fit.x), len(fit.x), dtype=torch.float64)
    covariance[free.unsqueeze(-1), free] = inner + torch.diag(short)
    by_one = torch.zeros(len(fit.x), dtype=torch.bool)
    by_one[free] = lone
    return covariance, by_one


def _residual_variance(fit: Fit) -> float:
    """Mean square of the weighted residuals: about 1 where rows are whitened."""
    kept = int((fit.robust > 0).sum())
    return float(fit.factor[-1, -1] ** 2) / max(1, kept - int(fit.free.sum()))


def _block_sums(
    source: RowSource, fit: Fit, inverse: Tensor, block: Tensor, count: int
) -> tuple[Float[Tensor, "K F F"], Float[Tensor, "K F"]]:
    """H_k and g_k of every block."""
    free = fit.free.nonzero().flatten()
    hessians = torch.zeros(count, len(free), len(free), dtype=torch.float64)
    gradients = torch.zeros(count, len(free), dtype=torch.float64)
    unit = (fit.robust > 0).to(torch.float64)
    for piece in source:
        owner = block[piece.instant]
        weight = fit.robust[piece.instant].square()
        for i, rows in enumerate(whitened_rows(source, piece, unit, fit.whitening)):
            residual = rows[:, -1] - rows[:, :-1] @ fit.x
            z = rows[:, free] @ inverse
            informative = z * (weight[:, i] == 1).unsqueeze(-1)
            pull = z * (weight[:, i] * residual).unsqueeze(-1)
            for k in owner.unique().tolist():
                own = owner == k
                hessians[k] += informative[own].T @ z[own]
                gradients[k] += pull[own].sum(0)
    return hessians, gradients
