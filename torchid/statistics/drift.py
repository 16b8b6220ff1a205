"""Has a quantity that is measured session after session changed? An alarm that may be looked at
after every session, for ever.

Each measurement is compared with what the ones before it predict: recursive residuals, which are
independent and standard normal as long as nothing changes (Brown, Durbin and Evans 1975).
Covariates (a temperature) are fitted along. With z_t of these residuals and a step of d of their
standard deviations, exp(d z - d^2/2) is an e-value; the Shiryaev-Roberts sum M_t = (1 + M_t-1)
exp(d z_t - d^2/2), averaged over steps of several sizes and both signs, exceeds c once in c
sessions at most, on average, while nothing changes (Shin, Ramdas and Rinaldo 2023, e-detectors).
"""

from dataclasses import dataclass

import torch
from scipy.special import ndtri, stdtr

from torchid.typing import Float, Tensor

STEPS = (-4.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 4.0)
"""Changes that are thought of, in standard deviations of a residual."""

LARGEST = 8.0
"""Residuals beyond this are told no more: rounding of the normal distribution's tail."""


@dataclass(frozen=True, eq=False)
class Drift:
    """One quantity over T sessions.

    Attributes:
        evidence: (T,) M_t; 0 while there is nothing to compare with.
        since: first session after the likeliest change; None with fewer than two residuals.
        before, after: weighted means on both sides of it, at the mean of the covariates.
        slope: (C,) of the covariates.
    """

    evidence: Float[Tensor, " T"]
    since: int | None
    before: float
    after: float
    slope: Float[Tensor, " C"]


def drift(
    values: Float[Tensor, " T"],
    variances: Float[Tensor, " T"],
    freedom: Float[Tensor, " T"],
    covariates: Float[Tensor, "T C"],
) -> Drift:
    """Evidence of a change, session by session.

    Args:
        values: in the order of time.
        variances: of each about a constant: of its estimate, and of days.
        freedom: degrees of freedom of the variances.
        covariates: that may explain a change; none where C is 0.
    """
    count, c = covariates.shape
    centred = covariates - covariates.mean(0)
    h = torch.cat([torch.ones(count, 1, dtype=torch.float64), centred], 1)
    information = torch.zeros(c + 1, c + 1, dtype=torch.float64)
    pull = torch.zeros(c + 1, dtype=torch.float64)
    steps = torch.tensor(STEPS, dtype=torch.float64)
    detectors, evidence = torch.zeros_like(steps), torch.zeros(count, dtype=torch.float64)
    z = torch.full((count,), torch.nan, dtype=torch.float64)
    for k in range(count):
        row, variance = h[k], variances[k]
        if int(torch.linalg.matrix_rank(information, hermitian=True)) == c + 1:
            inverse = torch.linalg.inv(information)
            spread = (variance + row @ inverse @ row).sqrt()
            residual = float((values[k] - row @ inverse @ pull) / spread)
            # A residual over an estimated deviation is Student's; its normal equal is an e-value's.
            z[k] = ndtri(stdtr(float(freedom[k].clamp(min=1)), residual))
            z[k] = z[k].clamp(-LARGEST, LARGEST)
            detectors = (1 + detectors) * (steps * z[k] - steps.square() / 2).exp()
            evidence[k] = detectors.mean()
        information = information + row.unsqueeze(1) * row / variance
        pull = pull + row * values[k] / variance
    told = z.isfinite().nonzero().flatten().tolist()
    if len(told) < 2:
        mean = float((values / variances).sum() / (1 / variances).sum())
        return Drift(evidence, None, mean, mean, torch.zeros(c, dtype=torch.float64))
    # The step whose fit beside the covariates leaves least says since when.
    fits = []
    for first in range(1, count):
        late = (torch.arange(count) >= first).double().unsqueeze(1)
        columns = torch.cat([h, late], 1) / variances.sqrt().unsqueeze(1)
        y = values / variances.sqrt()
        x = torch.linalg.lstsq(columns, y.unsqueeze(1), driver="gelsd").solution[:, 0]
        fits.append((float((y - columns @ x).square().sum()), first, x))
    _, since, x = min(fits, key=lambda fit: fit[0])
    return Drift(evidence, since, float(x[0]), float(x[0] + x[-1]), x[1:-1])
