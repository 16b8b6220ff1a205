"""A chi-square of all parameters at once, with their correlations.

Q = sum_i (x_i - x)' C_i^-1 (x_i - x) about the generalised least-squares mean. The covariances are
jackknife estimates of nu_i degrees of freedom, often fewer than there are parameters, and then
singular. So each correlation matrix is shrunk towards that of the same estimates under white
residuals, which comes from the fit's factor without sampling noise: weight nu/(nu + D) to D/(nu +
D), as for a prior of D degrees of freedom; variances are kept. Q is then no chi-square: its
distribution without a difference is sampled, estimates and covariances (Wishart) alike, from the
shrunk covariances, and the same shrinkage applied.
"""

from dataclasses import dataclass

import torch

from torchid.typing import Float, Tensor

DRAWS = 400
AT_ONCE = 50
"""Draws, and how many at a time: bounds the memory."""


@dataclass(frozen=True)
class Whole:
    """All parameters together.

    Attributes:
        q: the statistic.
        count: D (m - 1), its degrees of freedom were the covariances known.
        expected: 2.5 %, 50 % and 97.5 % of its distribution without a difference.
        p: share of that beyond q (one more of each counted, so never 0).
        birge: sqrt(q / mean of that distribution).
        pooled: Birge ratio over the parameters, without their correlations.
        pooled_expected: the same three quantiles of it.
    """

    q: float
    count: int
    expected: tuple[float, float, float]
    p: float
    birge: float
    pooled: float
    pooled_expected: tuple[float, float, float]


def whole(
    values: Float[Tensor, "m D"],
    covariance: Float[Tensor, "m D D"],
    correlation: Float[Tensor, "m D D"],
    freedom: Float[Tensor, " m"],
    *,
    seed: int = 0,
    draws: int = DRAWS,
) -> Whole:
    """Agreement of m >= 2 estimates of D parameters.

    Args:
        values: estimates.
        covariance: of each, of `freedom` degrees of freedom; positive variances.
        correlation: towards which each is shrunk.
        freedom: (m,).
        seed: of the draws.
    """
    m, d = values.shape
    size = covariance.diagonal(dim1=-2, dim2=-1).mean(0).sqrt()  # units out: only rounding cares
    values, covariance = values / size, covariance / size / size.unsqueeze(-1)
    shrunk = _shrunk(covariance, correlation, freedom)
    q, pooled = (float(x) for x in _statistics(values, shrunk))
    generator = torch.Generator().manual_seed(seed)
    # Both statistics in worlds without a difference.
    root, null = torch.linalg.cholesky(shrunk), torch.empty(0, 2, dtype=torch.float64)
    while len(null) < draws:
        count = min(AT_ONCE, draws - len(null))
        noise = torch.randn(count, m, d, 1, generator=generator, dtype=torch.float64)
        covariances = []
        for own, nu in zip(root, freedom.tolist(), strict=True):
            sample = torch.randn(count, d, int(nu), generator=generator, dtype=torch.float64)
            covariances.append(own @ (sample @ sample.transpose(1, 2)) @ own.T / int(nu))
        seen = _shrunk(torch.stack(covariances, 1), correlation, freedom)
        drawn = torch.stack(_statistics((root @ noise).squeeze(-1), seen), -1)
        null = torch.cat([null, drawn])
    levels = torch.tensor([0.025, 0.5, 0.975], dtype=torch.float64)
    low = torch.quantile(null, levels, dim=0).T.tolist()
    return Whole(
        q=q,
        count=d * (m - 1),
        expected=tuple(low[0]),
        p=(1 + int((null[:, 0] >= q).sum())) / (draws + 1),
        birge=(q / float(null[:, 0].mean())) ** 0.5,
        pooled=pooled,
        pooled_expected=tuple(low[1]),
    )


def _shrunk(covariance: Tensor, target: Tensor, freedom: Tensor) -> Tensor:
    d = covariance.shape[-1]
    size = covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    own = covariance / size.unsqueeze(-1) / size.unsqueeze(-2)
    keep = (freedom / (freedom + d))[:, None, None]
    mixed = keep * own + (1 - keep) * target
    return mixed * size.unsqueeze(-1) * size.unsqueeze(-2)


def _statistics(values: Tensor, covariance: Tensor) -> tuple[Tensor, Tensor]:
    """Q about the generalised mean, and the pooled Birge ratio; values (..., m, D)."""
    inverse = torch.linalg.inv(covariance)
    weighted = (inverse @ values.unsqueeze(-1)).sum(-3)
    mean = torch.linalg.solve(inverse.sum(-3), weighted).squeeze(-1)
    left = (values - mean.unsqueeze(-2)).unsqueeze(-1)
    q = (left * (inverse @ left)).sum((-3, -2, -1))
    w = 1 / covariance.diagonal(dim1=-2, dim2=-1)
    own = values - ((w * values).sum(-2) / w.sum(-2)).unsqueeze(-2)
    m, d = values.shape[-2:]
    return q, ((w * own.square()).sum((-2, -1)) / (d * (m - 1))).sqrt()
