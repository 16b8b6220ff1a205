"""Do estimates with standard deviations agree, and if not, by how much are those too small?

Of m estimates x_i with standard deviations s_i of nu_i degrees of freedom:

- Welch's test (1951), which is Welch's t test for m = 2: weights 1/s_i^2, an F distribution whose
  degrees of freedom account for the s_i being estimates. Holm's correction (1979) over parameters.
- Birge's ratio R = sqrt(Q / (m - 1)), Q = sum (x_i - x)^2 / s_i^2 about the weighted mean (Birge
  1932): what the s_i would have to be multiplied by.
- A between-run variance tau^2 by DerSimonian and Laird (1986), the consensus with weights
  1 / (s_i^2 + tau^2), and its standard deviation by Hartung and Knapp (2001), not below the plain.
"""

from dataclasses import dataclass

import torch
from scipy.special import chdtri, fdtrc

from torchid.compare.record import BirgeRecord, Whole
from torchid.results.replication import between
from torchid.statistics.jackknife import student_quantile
from torchid.typing import Float, Tensor

_ROUNDING = 1e-9
_TINY = 1e-100


@dataclass(frozen=True)
class Scatter:
    """Agreement of m estimates of one quantity.

    Attributes:
        p: of Welch's test.
        birge: ratio of the scatter to what the standard deviations claim.
        between: tau, the between-run standard deviation, in the quantity's unit.
        consensus, std: random-effects mean and its standard deviation.
        quantile: half-width of its 95 % interval in standard deviations.
    """

    p: float
    birge: float
    between: float
    consensus: float
    std: float
    quantile: float

    @property
    def consensus_std(self) -> float:
        """Of the consensus."""
        return self.std

    @property
    def consensus_ci95(self) -> tuple[float, float]:
        """The consensus's 95 % interval."""
        half = self.quantile * self.std
        return self.consensus - half, self.consensus + half


def scatter(
    values: Float[Tensor, " m"], std: Float[Tensor, " m"], freedom: Float[Tensor, " m"]
) -> Scatter:
    """Agreement of at least two estimates.

    Args:
        values, std: the estimates; a std of 0 counts as rounding.
        freedom: (m,) degrees of freedom of `std`.
    """
    std = std.clamp(min=_ROUNDING * max(float(values.abs().max()), _TINY))
    m = len(values)
    w = std**-2
    mean = float((w * values).sum() / w.sum())
    q = float((w * (values - mean).square()).sum())
    spread = between(values, std**2)
    v = 1 / (std**2 + spread**2)
    consensus = float((v * values).sum() / v.sum())
    excess = float((v * (values - consensus).square()).sum()) / (m - 1)
    dof = float(freedom.sum()) if spread == 0 else m - 1
    return Scatter(
        welch(values, std, freedom),
        (q / (m - 1)) ** 0.5,
        spread,
        consensus,
        (max(1.0, excess) / float(v.sum())) ** 0.5,
        float(student_quantile(0.95, torch.tensor([float(dof)]))),
    )


def welch(
    values: Float[Tensor, " m"], std: Float[Tensor, " m"], freedom: Float[Tensor, " m"]
) -> float:
    """p-value of the hypothesis that all means are equal."""
    m = len(values)
    w = std**-2
    mean = (w * values).sum() / w.sum()
    q = float((w * (values - mean).square()).sum()) / (m - 1)
    loss = float(((1 - w / w.sum()).square() / freedom).sum())
    statistic = q / (1 + 2 * (m - 2) / (m**2 - 1) * loss)
    return float(fdtrc(m - 1, (m**2 - 1) / (3 * loss), statistic))


def holm(p: Float[Tensor, " D"]) -> Float[Tensor, " D"]:
    """p-values adjusted for being D (Holm 1979)."""
    order = torch.argsort(p)
    factor = torch.arange(len(p), 0, -1, dtype=p.dtype)
    raised = torch.cummax(p[order] * factor, 0).values.clamp(max=1.0)
    out = torch.empty_like(p)
    out[order] = raised
    return out


def typical_birge(birge: Float[Tensor, " D"], counts: Float[Tensor, " D"]) -> float:
    """Birge ratio of the typical parameter: median of Q over its median under chi^2."""
    q = birge.square() * (counts - 1)
    medians = q.new_tensor([float(chdtri(c - 1, 0.5)) for c in counts.tolist()])
    return float((q / medians).median().sqrt())


def monotone(values: Float[Tensor, " m"]) -> bool:
    """Whether three or more values rise, or fall, from each to the next."""
    steps = values.diff()
    return len(values) > 2 and (bool((steps > 0).all()) or bool((steps < 0).all()))


DRAWS = 400
AT_ONCE = 50
"""Draws, and how many at a time: bounds the memory."""


def whole(
    values: Float[Tensor, "m D"],
    covariance: Float[Tensor, "m D D"],
    correlation: Float[Tensor, "m D D"],
    freedom: Float[Tensor, " m"],
    *,
    seed: int = 0,
    draws: int = DRAWS,
) -> tuple[Whole, BirgeRecord]:
    """Agreement of m >= 2 estimates of D parameters: a chi-square of all of them at once.

    Q = sum_i (x_i - x)' C_i^-1 (x_i - x) about the generalised least-squares mean. The covariances
    are jackknife estimates of nu_i degrees of freedom, often fewer than there are parameters, and
    then singular. So each correlation matrix is shrunk towards that of the same estimates under
    white residuals, which comes from the fit's factor without sampling noise: weight nu/(nu + D) to
    D/(nu + D), as for a prior of D degrees of freedom; variances are kept. Q is then no chi-square:
    its distribution without a difference is sampled, estimates and covariances (Wishart) alike,
    from the shrunk covariances, and the same shrinkage applied.

    Args:
        values: estimates.
        covariance: of each, of `freedom` degrees of freedom; positive variances.
        correlation: towards which each is shrunk.
        freedom: (m,).
        seed: of the draws.

    Returns:
        All parameters together, and by how much they scatter without their correlations.
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
    together = Whole(
        q=q,
        count=d * (m - 1),
        expected=tuple(low[0]),
        p=(1 + int((null[:, 0] >= q).sum())) / (draws + 1),
        birge=(q / float(null[:, 0].mean())) ** 0.5,
    )
    return together, BirgeRecord(pooled=pooled, pooled_expected=tuple(low[1]))


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
