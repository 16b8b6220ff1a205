"""Standard deviations of a fit from what its blocks say: the leverage-corrected block jackknife.

Filtered residuals are strongly autocorrelated, and partly model error, so the textbook covariance
s^2 (A'A)^-1 is far too small. Here the rows are cut into blocks several correlation times long, of
which each one gives its Hessian H_k = sum a a' and its gradient g_k = sum a r at the solution. In
coordinates where H = sum_k H_k is the identity,

    V = sum_k d_k d_k'    with    d_k = (1 - H_k)^(-3/4) g_k

is the covariance of the solution without assuming white, Gaussian or equal residuals. The power
undoes the fit's own adaptation to each block; without it (Liang and Zeger 1986) standard deviations
are too small, by a fifth with twice as many columns as blocks. How much a fit adapts depends on the
noise. Where the noise of a direction is spread over the blocks as its information is, as white
noise is, the power -1/2 is unbiased (Bell and McCaffrey 2002). Where it sits in the block that
determines the direction, as slow noise beside slow columns does, E g_k g_k' is (1 - H_k) S_k
(1 - H_k) for the noise S_k, and the power -1 is, which is the solution without the block (the
delete-one jackknife, Kuensch 1989). Residuals of a robot are in between, and so is the power: the
geometric mean of both, but where what is left of real logs was measured to be misfit: there callers
ask for -1. tests/statistics and tests/calibration hold the coverage it gives.

V is itself estimated from K blocks, of which few may hold what determines a parameter. Its degrees
of freedom are those of the chi square with the mean and variance that V has for white residuals
(Bell and McCaffrey 2002; Imbens and Kolesar 2016); K - 1 where all blocks are alike. Intervals take
Student's quantile with them.

What was known beforehand is no block: its variance is given. It counts in H, and its inverse
covariance P adds H^-1 P H^-1 to V, exactly, beside the spread of the blocks and its few degrees of
freedom.

For Huber's estimate g sums psi(r) a over a block's rows and H sums a a' over its rows that are not
clipped. Repeating the fit with the weights held would take clipped rows for informative ones, and
give standard deviations that are a sixth too small.
"""

from dataclasses import dataclass

import torch
from scipy.special import stdtrit

from torchid.statistics.blocks import block_products
from torchid.statistics.proportion import HALF_95
from torchid.typing import Bool, Float, Int, Tensor

LEVERAGE = 0.75
"""Power of what the other blocks hold: 1/2 is unbiased for white noise, 1 for noise as slow as the
columns."""

ALONE = 0.05
"""Share of a direction's information below which the other blocks do not determine it."""

DETERMINED = 1e-12
"""Eigenvalue of the Hessian, scaled to unit diagonal and relative to the largest, below which a
direction is not determined by any block."""


@dataclass(frozen=True)
class Jackknife:
    """Covariance of P parameters, from the spread between blocks.

    Attributes:
        covariance: (P, P) from the blocks; zero along directions that none determines.
        given: (P, P) from what was known beforehand; zero of nothing.
        freedom: (P,) degrees of freedom of the blocks' variances, between 1 and `blocks` - 1.
        by_one_block: (P,) parameters that one block alone determines: blocks cannot tell of their
            spread, and their variance is that for white residuals, a lower bound.
        blocks: number of blocks that hold anything.
        shares: what each block says of the covariance; None where there are no normal equations.
    """

    covariance: Float[Tensor, "P P"]
    given: Float[Tensor, "P P"]
    freedom: Float[Tensor, " P"]
    by_one_block: Bool[Tensor, " P"]
    blocks: int
    shares: "Shares | None" = None

    @property
    def std(self) -> Float[Tensor, " P"]:
        """Standard deviations (P,)."""
        return (self.covariance + self.given).diagonal().clamp(min=0).sqrt()

    def widened(self) -> Float[Tensor, "P P"]:
        """The covariance (P, P) of which `HALF_95` deviations are the 95 % interval: of few
        blocks Student's; of one alone, and of what was known, that of a normal variable."""
        wide = torch.where(self.by_one_block, 1.0, self.quantile() / HALF_95)
        return self.covariance * wide * wide.unsqueeze(1) + self.given

    def quantile(self, level: float = 0.95) -> Float[Tensor, " P"]:
        """Half-widths (P,) of two-sided intervals, in standard deviations."""
        return student_quantile(level, self.freedom)

    def interval(self, values: Float[Tensor, " P"], level: float = 0.95) -> Float[Tensor, "P 2"]:
        """Confidence intervals (P, 2) about the values (P,) of the fit."""
        half = self.quantile(level).to(values) * self.std.to(values)
        return torch.stack([values - half, values + half], -1)


@dataclass(frozen=True)
class Shares:
    """What each of K blocks says, for what is made of the parameters later.

    Attributes:
        steps: (K, P) what each adds to the covariance, whose root they are but for parameters that
            one block alone determines.
        held: (K, D, D) what each holds of the information, in D coordinates of unit information.
        back: (P, D) from these coordinates to the parameters.
    """

    steps: Float[Tensor, "K P"]
    held: Float[Tensor, "K D D"]
    back: Float[Tensor, "P D"]

    def alone(self, share: float) -> Float[Tensor, "D A"]:
        """Orthonormal directions of which one block holds more than a share above one half."""
        values, axes = torch.linalg.eigh(self.held)
        directions = axes.transpose(1, 2)[values > share].T
        left, sizes, _ = torch.linalg.svd(directions, full_matrices=False)
        return left[:, sizes > 1e-6]

    def freedom(self, along: Float[Tensor, "Q D"]) -> Float[Tensor, " Q"]:
        """Degrees of freedom of the variances of linear combinations of the coordinates."""
        values, axes = torch.linalg.eigh(self.held)
        stretch = (1 - values).clamp(min=ALONE) ** -LEVERAGE
        adjusted = along @ ((axes * stretch.unsqueeze(1)) @ axes.transpose(1, 2))
        return _degrees_of_freedom(adjusted, self.held).clamp(1, max(1, len(self.held) - 1))


def student_quantile(level: float, freedom: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
    """Half-widths (P,) of Student's two-sided intervals, one degree of freedom at least."""
    return torch.from_numpy(stdtrit(freedom.clamp(min=1).cpu().numpy(), 0.5 + level / 2))


def jackknife(
    hessians: Float[Tensor, "K P P"],
    gradients: Float[Tensor, "K P"],
    *,
    variance: float = 0.0,
    combinations: Float[Tensor, "Q P"] | None = None,
    known: Float[Tensor, "P P"] | None = None,
    power: float | None = None,
) -> Jackknife:
    """Covariance of a least-squares (or Huber) solution from its blocks' normal equations.

    Args:
        hessians: (K, P, P) sum of a a' over each block's rows.
        gradients: (K, P) sum of a r at the solution, which sums to zero over all blocks.
        variance: of a row's residual, for parameters that one block alone determines.
        combinations: (Q, P) linear combinations whose covariance is asked for; the parameters
            themselves if None. A caller whose columns are nearly dependent passes H and g in
            coordinates from a QR factor, and here the way back.
        known: (P, P) inverse covariance of what was known of the parameters beforehand, in units of
            the rows' residuals, with which they were solved for; nothing if None.
        power: of what the other blocks hold; LEVERAGE if None.
    """
    # Coordinates of unit Gram: columns of length one first, so that units do not matter.
    before = torch.zeros_like(hessians[0]) if known is None else known
    total = hessians.sum(0) + before
    size = total.diagonal().clamp(min=0).sqrt()
    scale = torch.where(size > 0, 1 / size, 0.0)
    values, vectors = torch.linalg.eigh(total * scale * scale.unsqueeze(1))
    kept = values > DETERMINED * values.sum()
    root = scale.unsqueeze(1) * vectors[:, kept] / values[kept].sqrt()
    back = root if combinations is None else combinations @ root  # (Q, D)
    # (K, D, D), with what was known sums to 1: what each block holds of a direction.
    held = root.T @ hessians @ root
    # Each block's pull, raised by as much as the solution followed it.
    left, axes = torch.linalg.eigh(torch.eye(held.shape[-1]).to(held) - held)
    alone = left < ALONE
    power = LEVERAGE if power is None else power
    stretch = torch.where(alone, 0.0, left.clamp(min=ALONE) ** -power)
    adjusted = back @ ((axes * stretch.unsqueeze(1)) @ axes.transpose(1, 2))  # (K, Q, D)
    steps = (adjusted @ (gradients @ root).unsqueeze(-1)).squeeze(-1)
    covariance = steps.T @ steps
    # Where a block is alone its pull is no evidence: white residuals stand in as a lower bound.
    lone_share = ((back @ axes).square() * alone.unsqueeze(1)).sum(-1)
    whole = back.square().sum(-1)
    lone = (lone_share > 0.5 * whole).any(0)
    short = (variance * whole - covariance.diagonal()).clamp(min=0)
    covariance = covariance + torch.diag(torch.where(lone, short, 0.0))
    blocks = int((held.diagonal(dim1=1, dim2=2).sum(-1) > 0).sum())
    freedom = _degrees_of_freedom(adjusted, held).clamp(1, max(1, blocks - 1))
    given = back @ (root.T @ before @ root) @ back.T
    return Jackknife(covariance, given, freedom, lone, blocks, Shares(steps, held, back))


def _degrees_of_freedom(
    adjusted: Float[Tensor, "K Q D"], held: Float[Tensor, "K D D"]
) -> Float[Tensor, " Q"]:
    """2 mean^2 / variance (Q,) of each variance were the residuals white (Satterthwaite 1946).

    Parameter q's variance is the sum of squares of K numbers, each a' X_k' (1 - X X') e with a the
    row of `adjusted`. For white e their covariance is G_kl = [k = l] a_k' H_k a_k - a_k' H_k H_l
    a_l, and the sum has mean tr G and variance 2 tr G^2.
    """
    felt = adjusted @ held  # (K, Q, D)
    by_parameter = felt.transpose(0, 1)  # (Q, K, D)
    own = (felt * adjusted).sum(-1).T  # (Q, K)
    spread = torch.diag_embed(own) - by_parameter @ by_parameter.transpose(1, 2)
    mean = spread.diagonal(dim1=1, dim2=2).sum(-1)
    square = spread.square().sum((1, 2))
    return torch.where(square > 0, mean.square() / square, 1.0)


def fit_statistics(
    columns: Float[Tensor, "R C"],
    residual: Float[Tensor, " R"],
    block: Int[Tensor, " R"],
    variance: float | None = None,
    known: Float[Tensor, "C C"] | None = None,
) -> Jackknife:
    """Covariance of a least-squares fit from its columns and its residual.

    Args:
        columns: (R, C), weighted as in the fit; they may be dependent.
        residual: (R,) what the fit leaves, weighted likewise.
        block: (R,) block of each row, from 0; rows of several joints at an instant share theirs.
        variance: of a row, for parameters that one block alone determines; as if the residual were
            white if None.
        known: (C, C) inverse covariance of what was known beforehand; see `jackknife`.
    """
    count = int(block.max()) + 1
    hessians = block_products(columns, columns, block, count)
    gradients = block_products(columns, residual.unsqueeze(1), block, count).squeeze(-1)
    if variance is None:
        variance = float(residual.square().sum()) / max(1, len(residual) - columns.shape[1])
    return jackknife(hessians, gradients, variance=variance, known=known)


def from_left_out(estimates: Float[Tensor, "K P"]) -> Jackknife:
    """Covariance of any estimator from its values (K, P) without each block in turn: the delete-one
    jackknife (K - 1)/K sum_k (x_k - mean)(x_k - mean)', for what has no normal equations."""
    k = len(estimates)
    spread = estimates - estimates.mean(0)
    p = estimates.shape[1]
    return Jackknife(
        (k - 1) / k * spread.T @ spread,
        estimates.new_zeros(p, p),
        torch.full((p,), float(max(1, k - 1))).to(estimates),
        torch.zeros(p, dtype=torch.bool),
        k,
    )
