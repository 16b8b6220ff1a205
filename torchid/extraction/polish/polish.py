"""Gradient polish after the population search, which never leaves the bounds.

An interior-point method for all runs in one batch: Newton steps on

    phi(x) + mu D(x, x0),     D(x, x0) = B(x) - B(x0) - B'(x0) (x - x0),     mu -> 0,

with B = - sum log(slack_j), in x = (m, m c, J about the link frames) and coefficients. There phi is
a quadratic with a constant Hessian, and positive masses, CoM boxes, cylinders, spheres, total mass
and positive definite pseudo-inertias are convex conditions, with the usual self-concordant
barriers. The barrier enters as its Bregman distance from the start x0: of all minimisers of phi it
picks the one nearest to what the search found, so runs stay different where the loss leaves a
choice. Only the bounds on the *barycentric* inertias are not convex in x: their barrier's Hessian
is replaced by its positive semidefinite part, so every step is a Cholesky solve and a descent
direction all the same. Where those bounds are not active, the method ends at the minimum over all
feasible sets, which the certificate confirms from the outside.
"""

from collections.abc import Callable

import torch

from torchid.extraction.polish.barrier import Barrier
from torchid.extraction.polish.region import Region
from torchid.extraction.problem import Problem
from torchid.typing import Bool, Float, Tensor

_STEPS = 200
_TO_BOUNDARY = 0.95
_BACKTRACK = (1.0, 0.7, 0.4, 0.2, 0.1, 0.03, 0.01, 1e-3, 1e-4)
_DAMPING = 1e-14
"""Levenberg damping of the Hessian scaled to a unit diagonal: directions in which neither phi nor
the barrier changes must not move."""
_GAP = {True: 1e-3, False: 1e-6}
"""Share of phi that the barrier may hold at the end. With conditions this much of phi is given for
a distance to the boundary of feasibility, where every set ends that has the smallest phi."""
_SMALLEST = 1e-28
"""phi below which nothing is gained: rounding of the coefficients."""
_INWARD = 0.01
"""Share of the way to the interior point that every start is moved. A start on the boundary would
be an infinitely strong attraction to it."""


def polish(
    problem: Problem, region: Region, p: Float[Tensor, "R D"], *, steps: int = _STEPS
) -> Float[Tensor, "R D"]:
    """Improve all runs without leaving the region.

    Args:
        problem: loss.
        region: from `region.region`; bounds alone, or with the conditions.
        p: (R, D) search vectors within the bounds; those outside the region are first moved
            towards its interior point, as little as it takes.
        steps: Newton steps at most.

    Returns:
        (R, D) strictly inside the region. A run with a value that is not finite is returned as
        it came, and so are all where the region has no interior (masses that must be negative).
    """
    barrier = Barrier(problem, region)
    usable = torch.isfinite(p).all(-1)
    first = barrier.entered(torch.where(usable.unsqueeze(-1), p, region.inside.to(p)), _INWARD)
    usable &= torch.isfinite(barrier.value(first))
    pull = barrier.derivatives(first)[0]
    gap = _GAP[region.physical]
    x, ended = _follow(problem, barrier, first, pull, ~usable, gap, steps)
    # The plain barrier forgets the start, but converges from anywhere.
    x, _ = _follow(problem, barrier, x, 0 * pull, ended, gap, steps)
    return torch.where(usable.unsqueeze(-1), barrier.search_vector(x), p)


def _follow(
    problem: Problem,
    barrier: Barrier,
    first: Float[Tensor, "R P"],
    pull: Float[Tensor, "R P"],
    ended: Bool[Tensor, " R"],
    gap: float,
    steps: int,
) -> tuple[Float[Tensor, "R P"], Bool[Tensor, " R"]]:
    """Follow the path of minimisers as mu falls: x, and which runs reached its end.

    A run that has ended stays where it is, so that none depends on how long its neighbours take.
    """
    x, a, t = first, barrier.weight.to(first), problem.target.offset.to(first)
    quadratic = 2 * a.T @ a
    # With the start 1 % inside, phi is above its minimum by at most about 100 mu a slack.
    count = barrier.count / _INWARD
    phi = _phi(a, t, x)
    mu = 0.1 * phi.clamp(min=_SMALLEST) / barrier.count

    def merit(at: Tensor) -> Tensor:
        return _phi(a, t, at) + mu * (barrier.value(at) - ((at - first) * pull).sum(-1))

    for _ in range(steps):
        slope, curve = barrier.derivatives(x)
        gradient = 2 * (x @ a.T - t) @ a + mu.unsqueeze(-1) * (slope - pull)
        step, decrement = _newton(gradient, quadratic + mu[:, None, None] * curve)
        small = (mu * count <= gap * phi) & (decrement <= gap * phi) | (phi <= _SMALLEST)
        ended = ended | small
        if bool(ended.all()):
            break
        tried, moved = _advance(barrier, merit, x, step, (gradient * step).sum(-1))
        x = torch.where(ended.unsqueeze(-1), x, tried)
        phi = _phi(a, t, x)
        # On the path (decrement below mu) the barrier shrinks; also when no step is possible.
        near = (decrement <= mu) | ~moved
        lower = torch.minimum(0.1 * mu, 0.1 * phi / barrier.count)
        mu = torch.where(near, torch.maximum(lower, 0.5 * gap * phi / count), mu)
    return x, ended


def _phi(a: Tensor, t: Tensor, x: Tensor) -> Float[Tensor, " R"]:
    return (x @ a.T - t).square().sum(-1)


def _newton(gradient: Tensor, hessian: Tensor) -> tuple[Tensor, Tensor]:
    """Newton step (R, P), and its decrement (R,): twice the decrease the quadratic promises."""
    diagonal = hessian.diagonal(dim1=-2, dim2=-1)
    # Scaled to a unit diagonal: the barrier's entries span twenty orders of magnitude.
    scale = diagonal.clamp(min=1e-300).rsqrt()
    scaled = hessian * scale.unsqueeze(-1) * scale.unsqueeze(-2)
    scaled.diagonal(dim1=-2, dim2=-1).add_(_DAMPING)
    factor, info = torch.linalg.cholesky_ex(scaled)
    failed = info > 0
    if bool(failed.any()):
        scaled.diagonal(dim1=-2, dim2=-1).add_(1e-10 * failed.unsqueeze(-1))
        factor, info = torch.linalg.cholesky_ex(scaled)
    step = torch.cholesky_solve((-gradient * scale).unsqueeze(-1), factor).squeeze(-1) * scale
    step = torch.where((info > 0).unsqueeze(-1) | ~torch.isfinite(step), 0.0, step)
    return step, -(gradient * step).sum(-1)


def _advance(
    barrier: Barrier, merit: Callable[[Tensor], Tensor], x: Tensor, step: Tensor, slope: Tensor
) -> tuple[Tensor, Bool[Tensor, " R"]]:
    """A step that stays inside and lowers the merit; and whether there was one, per run."""
    longest = (_TO_BOUNDARY * barrier.reach(x, step)).clamp(max=1.0)
    now = merit(x)
    found = torch.zeros_like(now, dtype=torch.bool)
    out = x
    for share in _BACKTRACK:
        length = share * longest
        tried = x + length.unsqueeze(-1) * step
        better = (merit(tried) < now + 1e-4 * length * slope) & ~found
        out = torch.where(better.unsqueeze(-1), tried, out)
        found |= better
        if bool(found.all()):
            break
    return out, found
