"""Uniform draws in convex regions { z : a z + b > 0, F z + C positive definite }, K at once.

Hit-and-run (Smith 1984; Lovasz and Vempala 2006) in coordinates that make each region round: the
Hessian of the logarithmic barrier at its analytic centre, found by damped Newton steps (Boyd and
Vandenberghe 2004, sections 8.5 and 11.4). Matrices F z + C are 4 x 4, flattened.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.typing import Float, Tensor

BURN_IN = 20
"""Draws left out first: 40 steps a dimension."""


@dataclass(frozen=True, eq=False)
class Region:
    """K convex sets { z : a z + b > 0, F z + C positive definite }, flattened 4 x 4 matrices.

    Attributes:
        a, b: (K, R, D), (K, R) linear inequalities.
        f, c: (K, 16 L, D), (K, 16 L) of L linear matrix inequalities.
    """

    a: Float[Tensor, "K R D"]
    b: Float[Tensor, "K R"]
    f: Float[Tensor, "K M D"]
    c: Float[Tensor, "K M"]

    def part(self, rows: Tensor) -> "Region":
        """Some of the regions."""
        return Region(self.a[rows], self.b[rows], self.f[rows], self.c[rows])

    def values(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """Left sides (K, R) and (K, 16 L) at z (K, D)."""
        return self.b + times(self.a, z), self.c + times(self.f, z)

    def at(self, origin: Tensor, axes: Tensor) -> "Region":
        """The region in coordinates y of z = origin + axes y."""
        b, c = self.values(origin)
        return Region(self.a @ axes, b, self.f @ axes, c)


def times(matrix: Tensor, vector: Tensor) -> Tensor:
    """Matrices (K, R, D) times vectors (K, D)."""
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


def _derivatives(region: Region, z: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Gradient (K, D) and Hessian (K, D, D) of -sum log(a z + b) - sum log det(F z + C), and
    whether (K,) z is inside; at points outside they mean nothing."""
    rows, blocks = region.values(z)
    k = len(z)
    factor, info = torch.linalg.cholesky_ex(blocks.reshape(k, -1, 4, 4))
    inside = (rows > 0).all(-1) & (info == 0).all(-1)
    eye = torch.eye(4, dtype=z.dtype).expand_as(factor)
    safe = torch.where(inside[:, None, None, None], factor, eye)
    inverse = torch.linalg.solve_triangular(safe, eye, upper=False)
    # (inverse F inverse') flattened row by row is (inverse kron inverse) vec F.
    kron = torch.einsum("klab,klcd->klacbd", inverse, inverse).reshape(k, -1, 16, 16)
    scaled = (kron @ region.f.reshape(k, -1, 16, z.shape[1])).flatten(1, 2)
    linear = region.a / rows.unsqueeze(-1)
    gradient = -linear.sum(1) - scaled.reshape(k, -1, 16, z.shape[1])[:, :, ::5].sum((1, 2))
    hessian = linear.mT @ linear + scaled.mT @ scaled
    return gradient, hessian, inside


def _newton(region: Region, z: Tensor, slope: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """One damped Newton step on slope' z + barrier: it stays inside and descends, because the
    barrier is self-concordant. Returns z, the Cholesky factor of the Hessian, the decrement."""
    gradient, hessian, _ = _derivatives(region, z)
    gradient = gradient + slope
    ridge = 1e-12 * hessian.diagonal(dim1=-2, dim2=-1).amax(-1)
    eye = torch.eye(z.shape[1], dtype=z.dtype)
    factor, _ = torch.linalg.cholesky_ex(hessian + ridge[:, None, None] * eye)
    step = -torch.cholesky_solve(gradient.unsqueeze(-1), factor).squeeze(-1)
    decrement = (-(gradient * step).sum(-1)).clamp(min=0.0).sqrt()
    length = torch.where(decrement < 0.25, torch.ones_like(decrement), 1 / (1 + decrement))
    moved = z + length.unsqueeze(-1) * step
    rows, blocks = region.values(moved)
    _, info = torch.linalg.cholesky_ex(blocks.reshape(len(z), -1, 4, 4))
    fine = (rows > 0).all(-1) & (info == 0).all(-1)
    return torch.where(fine.unsqueeze(-1), moved, z), factor, decrement


def analytic_centre(region: Region, z: Tensor, steps: int) -> tuple[Tensor, Tensor]:
    """Minimisers (K, D) of the barrier from interior points, and axes (K, D, D) in which the
    regions are round there."""
    slope = torch.zeros_like(z)
    for _ in range(steps):
        z, factor, decrement = _newton(region, z, slope)
        if bool((decrement < 1e-6).all()):
            break
    eye = torch.eye(z.shape[1], dtype=z.dtype).expand_as(factor)
    return z, torch.linalg.solve_triangular(factor, eye, upper=False).mT.contiguous()


def interior_point(region: Region) -> tuple[Tensor, Tensor]:
    """Points (K, D) strictly inside, and whether (K,) one was found: the origin, or the first
    stage of the barrier method, which lowers a slack s in a z + b + s w > 0, F z + C + s E > 0."""
    k, _, d = region.a.shape
    z = torch.zeros(k, d, dtype=region.a.dtype)
    inside = _derivatives(region, z)[2]
    if bool(inside.all()):
        return z, inside
    outside = (~inside).nonzero().flatten()
    z[outside], inside[outside] = _first_stage(region.part(outside))
    return z, inside


def _first_stage(region: Region) -> tuple[Tensor, Tensor]:
    k, _, d = region.a.shape
    weight = region.a.norm(dim=-1).clamp(min=1e-6)
    eye = torch.eye(4, dtype=weight.dtype).flatten().repeat(region.c.shape[1] // 16)
    size = region.f.reshape(k, -1, 16 * d).norm(dim=-1).clamp(min=1e-6)
    grown = eye * size.repeat_interleave(16, -1) / 16
    lowest = torch.linalg.eigvalsh(region.c.reshape(k, -1, 4, 4))[..., 0] / (size / 16)
    slack = 1.5 * torch.maximum((-region.b / weight).amax(-1), (-lowest).amax(-1)).clamp(min=0.1)
    floor = torch.zeros(k, 1, d + 1, dtype=weight.dtype)
    floor[..., -1] = 1.0
    widened = Region(
        torch.cat([torch.cat([region.a, weight.unsqueeze(-1)], -1), floor], 1),
        torch.cat([region.b, slack.unsqueeze(-1)], -1),
        torch.cat([region.f, grown.unsqueeze(-1)], -1),
        region.c,
    )
    z = torch.cat([torch.zeros(k, d, dtype=weight.dtype), slack.unsqueeze(-1)], -1)
    best, inside = z[:, :d].clone(), torch.zeros(k, dtype=torch.bool)
    slope = torch.zeros_like(z)
    slope[:, -1] = 1 / slack
    # 150: Newton steps at most
    for _ in range(150):
        z, _, _ = _newton(widened, z, slope)
        now = _derivatives(region, z[:, :d])[2] & ~inside
        best = torch.where(now.unsqueeze(-1), z[:, :d], best)
        inside = inside | now
        if bool(inside.all()):
            break
        slope = slope * 1.3
    return best, inside


def hit_and_run(region: Region, seeds: Sequence[int], draws: int, thin: int) -> Tensor:
    """Draws (K, draws, D), uniform in each region in the limit, from the origin.

    `BURN_IN` draws are left out. Each chain has its own generator.
    """
    k, r, d = region.a.shape
    matrix = torch.cat([region.a, region.f], 1)
    value = torch.cat([region.b, region.c], 1)
    generators = [torch.Generator().manual_seed(seed) for seed in seeds]
    y = torch.zeros(k, d, dtype=value.dtype)
    factor = torch.linalg.cholesky_ex(value[:, r:].reshape(k, -1, 4, 4)).L
    kept = []
    for round_ in range(-BURN_IN, draws):
        # Directions (K, D) and places on the chord (K,), in (0, 1), of every step.
        normal = [torch.randn(thin, d, generator=g, dtype=y.dtype) for g in generators]
        uniform = [torch.rand(thin, generator=g, dtype=y.dtype) for g in generators]
        for way, share in zip(torch.stack(normal, 1), torch.stack(uniform, 1), strict=True):
            change = times(matrix, way)
            # The chord: 1 + t change / value > 0, and 1 + t mu > 0 with mu the eigenvalues of
            # L^-1 change L^-T.
            blocks = change[:, r:].reshape(k, -1, 4, 4)
            half = torch.linalg.solve_triangular(factor, blocks, upper=False)
            whole = torch.linalg.solve_triangular(factor, half.mT, upper=False)
            mu = torch.linalg.eigvalsh(whole).flatten(1)
            rate = torch.cat([change[:, :r] / value[:, :r], mu], -1)
            low, high = -1 / rate.amax(-1), -1 / rate.amin(-1)
            step = (low + (high - low) * share).unsqueeze(-1)
            moved = value + step * change
            trial, info = torch.linalg.cholesky_ex(moved[:, r:].reshape(k, -1, 4, 4))
            # Rounding at the very boundary: stay.
            fine = (moved[:, :r] > 0).all(-1) & (info == 0).all(-1)
            value = torch.where(fine[:, None], moved, value)
            factor = torch.where(fine[:, None, None, None], trial, factor)
            y = torch.where(fine[:, None], y + step * way, y)
        if round_ >= 0:
            kept.append(y)
    return torch.stack(kept, 1)
