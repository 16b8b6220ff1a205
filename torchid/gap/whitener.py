"""Whitening of rows: each joint's noise as an autoregressive process.

    x_t + a_1 x_(t-1) + .. + a_p x_(t-p) = e_t,   e white of variance s_p^2

Burg's method (Burg 1975; Kay, Modern Spectral Estimation, 7.6) finds reflection coefficients k_m,
which Levinson's recursion turns into the predictors of all orders 0..p. The first p rows of a
trajectory are whitened by the predictors of order 0, 1, .., p-1 and their own variances
s_m^2 = s_(m-1)^2 (1 - k_m^2): that is the exact likelihood of a stationary start, so no row is lost
and nothing is carried across trajectories. All |k_m| < 1, so the process is stable.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.typing import Bool, Float, Tensor

ORDER = 8
"""Rows are filtered noise: white up to the cut-off and nothing beyond. Their spectrum after
whitening stays within 10 % of flat below the cut-off with order 8 and within 40 % with order 4."""

PRIOR = 10.0
"""Rows of white noise that the estimate of every reflection coefficient is shrunk with."""


@dataclass(frozen=True)
class Whitener:
    """Turns rows into rows of which noise has unit variance and no autocorrelation.

    Attributes:
        predictors: (n, p+1, p) coefficients a of orders 0..p; order m has m of them, then zeros.
        std: (n, p+1) of the innovation of each order [N m; N]; order 0: of the noise itself.
        bounds: rows of each trajectory.
    """

    predictors: Float[Tensor, "n P p"]
    std: Float[Tensor, "n P"]
    bounds: tuple[slice, ...]

    @property
    def order(self) -> int:
        """p."""
        return self.predictors.shape[-1]

    def apply(self, x: Float[Tensor, "*batch N"], joint: int) -> Float[Tensor, "*batch N"]:
        """Whitened rows (..., N) of any signals of one joint's torque."""
        a, std = self.predictors[joint].tolist(), self.std[joint].tolist()
        p = self.order
        out = x.clone()
        for k, coefficient in enumerate(a[p], 1):
            out[..., k:].add_(x[..., :-k], alpha=coefficient)
        out /= std[p]
        for rows in self.bounds:
            for m in range(min(p, rows.stop - rows.start)):
                t = rows.start + m
                first = x[..., t] + sum(a[m][k] * x[..., t - 1 - k] for k in range(m))
                out[..., t] = first / std[m]
        return out

    def apply_all(self, x: Float[Tensor, "*batch n N"]) -> Float[Tensor, "*batch n N"]:
        """Whitened rows (..., n, N), one row a joint."""
        parts = [self.apply(x[..., j, :], j) for j in range(x.shape[-2])]
        return torch.stack(parts, -2)

    def on(self, bounds: tuple[slice, ...]) -> "Whitener":
        """The same noise in other rows (same interval between them)."""
        return replace(self, bounds=bounds)

    def scaled(self, factor: Float[Tensor, " n"]) -> "Whitener":
        """For noise that is so much larger, of the same spectrum."""
        return replace(self, std=self.std * factor.unsqueeze(-1))


def fit_whitener(
    x: Float[Tensor, "n N"],
    bounds: tuple[slice, ...],
    keep: Bool[Tensor, "n N"] | None = None,
    order: int = ORDER,
) -> Whitener:
    """The whitener of noise that these rows are a sample of.

    Args:
        x: noise, one row a joint; its mean counts as noise.
        bounds: rows of each trajectory.
        keep: rows to use; all if None.
        order: p.
    """
    found = [
        _fitted(_segments(row, bounds, None if keep is None else keep[j], order), order)
        for j, row in enumerate(x)
    ]
    return Whitener(torch.stack([f[0] for f in found]), torch.stack([f[1] for f in found]), bounds)


def _segments(
    x: Float[Tensor, " N"], bounds: tuple[slice, ...], keep: Bool[Tensor, " N"] | None, order: int
) -> list[Tensor]:
    """Contiguous stretches of kept rows, long enough for the order; else the trajectories."""
    out = []
    for rows in bounds:
        kept = torch.ones_like(x[rows], dtype=torch.bool) if keep is None else keep[rows]
        edges = torch.nn.functional.pad(kept.to(torch.int8), (1, 1)).diff()
        starts, stops = (torch.nonzero(edges == s).flatten().tolist() for s in (1, -1))
        out += [x[rows][a:b] for a, b in zip(starts, stops, strict=True) if b - a > order]
    return out or [x[rows] for rows in bounds]


def _fitted(segments: Sequence[Float[Tensor, " _"]], order: int) -> tuple[Tensor, Tensor]:
    """Predictors (p+1, p) and innovations' standard deviations (p+1,) of one joint."""
    forward = backward = list(segments)
    rows = sum(len(s) for s in segments)
    variance = sum(float(s @ s) for s in segments) / max(1, rows)
    a = torch.zeros(order + 1, order).to(segments[0])
    reflections: list[float] = []
    for m in range(1, order + 1):
        forward = [f[1:] for f in forward]
        backward = [b[:-1] for b in backward]
        top = sum(float(f @ b) for f, b in zip(forward, backward, strict=True))
        energy = sum(float(f @ f + b @ b) for f, b in zip(forward, backward, strict=True))
        count = sum(len(f) for f in forward)
        k = -2 * top / energy * count / (count + PRIOR) if energy > 0 else 0.0
        a[m, : m - 1] = a[m - 1, : m - 1] + k * a[m - 1, : m - 1].flip(0)
        a[m, m - 1] = k
        pairs = [(f + k * b, b + k * f) for f, b in zip(forward, backward, strict=True)]
        forward, backward = [f for f, _ in pairs], [b for _, b in pairs]
        reflections.append(k)
    left = sum(float(f @ f) for f in forward)
    count = sum(len(f) for f in forward)
    # Coefficients fitted to these very rows: as many rows less, as in any least squares.
    last = left / max(1, count - order) if count > order else variance
    std = [last]
    for k in reversed(reflections):
        std.append(std[-1] / (1 - k * k))
    # A signal that is exactly zero has no noise to divide by; it stays zero.
    smallest = torch.finfo(a.dtype).tiny ** 0.5
    return a, a.new_tensor(std[::-1]).sqrt().clamp(min=smallest)
