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
from scipy.stats import chi2
from scipy.stats import f as fisher

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
    spare = float(w.sum() - w.square().sum() / w.sum())
    between2 = max(0.0, (q - (m - 1)) / spare)
    v = 1 / (std**2 + between2)
    consensus = float((v * values).sum() / v.sum())
    excess = float((v * (values - consensus).square()).sum()) / (m - 1)
    spread = (max(1.0, excess) / float(v.sum())) ** 0.5
    plain = between2 == 0
    dof = float(freedom.sum()) if plain else m - 1
    return Scatter(
        welch(values, std, freedom),
        (q / (m - 1)) ** 0.5,
        between2**0.5,
        consensus,
        spread,
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
    return float(fisher.sf(statistic, m - 1, (m**2 - 1) / (3 * loss)))


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
    medians = q.new_tensor([float(chi2.median(c - 1)) for c in counts.tolist()])
    return float((q / medians).median().sqrt())


def monotone(values: Float[Tensor, " m"]) -> bool:
    """Whether three or more values rise, or fall, from each to the next."""
    steps = values.diff()
    return len(values) > 2 and (bool((steps > 0).all()) or bool((steps < 0).all()))
