"""Extraction by gradients in a parametrisation in which every link is a body.

The pseudo-inertia of a link is P = U U' with

    U = e^a [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]],

so any ten numbers (a, d1, d2, d3, s12, s13, s23, t1, t2, t3) are a physically consistent link and
each consistent link has ten (C. Rucker, P. Wensing, "Smooth Parameterization of Rigid-Body
Inertia", IEEE RA-L 7(2), 2022). Here m = e^2a, t is the centre of mass, and the second moments
about it are m L L' with L the triangle of d and s.

What else is asked, bounds and conditions, is kept by a logarithmic barrier whose weight goes to
zero: phi + mu B, with -log det P in B so that no run flattens a link before it must. All runs are
one batch. The parametrisation is strongly curved where a link is nearly flat, which is where the
least loss lies if no feasible set reproduces the target: descent along straight lines in the ten
numbers, with or without their exact Hessian, crawls there or stops on plateaus. So the Hessian and
the steps are those of the affine coordinates (m, mc, J), in which the torque is linear and phi +
mu B convex (but for the bounds of the barycentric inertias), pulled back to the ten numbers. Where
those bounds are not active, every run ends at the least loss; which of the sets that have it, its
start decides the more, the smaller the barrier's weight is from the beginning (`centring`).
"""

from dataclasses import dataclass

import torch

from torchid.errors import TorchidError
from torchid.extraction.log_cholesky.merit import Merit, along, moved_inside, room_of, theta_of
from torchid.extraction.problem import Problem
from torchid.robot.inertia import second_moment
from torchid.typing import Bool, Float, Tensor

GAP = 1e-4
"""Share of phi that the barrier may hold at the end."""
CENTRING = 1.0
"""Share of phi that the barrier holds at first."""
SMALLEST = 1e-22
"""phi, relative to the target's square, below which a run has nothing to gain."""
_HALVINGS = 24
_SHRINK = 0.1
_FLAT = 1e-14
"""Smallest curvature, of a Hessian with a unit diagonal."""


@dataclass(frozen=True, eq=False)
class LogCholeskyRuns:
    """K runs.

    Attributes:
        p: (K, D) search vectors, strictly within bounds and conditions; nan for a run that could
            not start (a start that is not finite).
        phi: (K,) their losses.
        converged: (K,) whether the barrier holds less than `GAP` of phi.
        steps: taken by the slowest.
    """

    p: Float[Tensor, "K D"]
    phi: Float[Tensor, " K"]
    converged: Bool[Tensor, " K"]
    steps: int


def extract_log_cholesky(
    problem: Problem,
    start: Float[Tensor, "K D"] | None = None,
    *,
    runs: int = 10,
    seed: int = 0,
    with_conditions: bool = True,
    centring: float = CENTRING,
    steps: int = 300,
) -> LogCholeskyRuns:
    """Physical parameters of least loss, from many starts at once.

    Args:
        problem: loss, bounds and conditions.
        start: (K, D) search vectors. What is outside bounds and conditions is moved inside.
        runs: how many random starts within the bounds, if no start is given.
        seed: of the random starts.
        with_conditions: whether the problem's conditions count beside physics and bounds.
        centring: share of phi that the barrier holds at first. Large: fewer steps, and runs meet
            at the centre of the sets of least loss; small: they end nearer to where they started,
            and may not converge where the least loss is on the boundary of what is feasible.
        steps: at most.

    Raises:
        TorchidError: conditions and bounds that leave no room between them; a start of another
            size, or fewer than one run.
    """
    if start is None:
        if runs < 1:
            raise TorchidError("at least one run.", got=runs)
        generator = torch.Generator().manual_seed(seed)
        unit = torch.rand(runs, problem.size, generator=generator, dtype=torch.float64)
        start = problem.physical(unit)
    if start.ndim != 2 or start.shape[1] != problem.size:
        raise TorchidError(
            "starts are search vectors (K, D).",
            got=tuple(start.shape),
            expected=f"(K, {problem.size})",
        )
    room = room_of(problem, with_conditions)
    p0 = start.detach().cpu().double()
    usable = torch.isfinite(p0).all(-1)
    inside = moved_inside(problem, room, torch.where(usable.unsqueeze(-1), p0, room.anchor))
    mass, com, inertia, rest = problem.split(inside)
    theta = theta_of(mass, com, second_moment(inertia))
    merit = Merit(problem, room)
    theta, rest, converged, taken = _descend(merit, theta, rest, centring, steps)
    p = torch.where(usable.unsqueeze(-1), merit.search_vector(theta, rest), torch.nan)
    return LogCholeskyRuns(p, problem.phi(p), converged & usable, taken)


def _descend(
    merit: Merit, theta: Tensor, rest: Tensor, centring: float, steps: int
) -> tuple[Tensor, Tensor, Tensor, int]:
    """Follow mu to zero: theta, coefficients, which runs have converged, and steps taken."""
    phi = merit.residual(theta, rest).square().sum(-1)
    floor = SMALLEST * merit.offset.square().sum() + 1e-300
    mu = centring * phi.clamp(min=floor) / merit.count
    done = torch.zeros_like(phi, dtype=torch.bool)
    taken = 0
    while taken < steps:
        jacobian = merit.jacobian(theta)
        gradient, hessian = merit.derivatives(theta, rest, mu, jacobian)
        inverse = _inverse(hessian)
        step = -(inverse @ gradient.unsqueeze(-1)).squeeze(-1)
        decrement = -(gradient * step).sum(-1)
        # Within mu of the central path, the barrier's share bounds what is left to gain.
        near = decrement <= mu
        holds = (mu * merit.count <= GAP * phi) & near
        done |= holds | (phi <= floor)
        if bool(done.all()):
            break
        taken += 1
        theta, rest, moved = _advance(merit, theta, rest, mu, step, decrement, ~done)
        phi = merit.residual(theta, rest).square().sum(-1)
        held = phi / merit.count
        lower = torch.minimum(torch.where(near | ~moved, _SHRINK * mu, mu), centring * held)
        lower = torch.where(near | ~moved, torch.minimum(lower, _SHRINK * held), lower)
        mu = torch.where(done, mu, torch.maximum(lower, 0.5 * GAP * held))
    return theta, rest, done, taken


def _inverse(hessian: Tensor) -> Tensor:
    """Inverse of the Hessians (K, d, d) with every negative curvature counted by its size, so that
    it makes a descent direction; zero where a Hessian is not finite."""
    scale = hessian.diagonal(dim1=-2, dim2=-1).abs().clamp(min=1e-300).rsqrt()
    scaled = hessian * scale.unsqueeze(-1) * scale.unsqueeze(-2)
    finite = torch.isfinite(scaled).flatten(1).all(-1)[:, None, None]
    eye = torch.eye(scaled.shape[-1], dtype=scaled.dtype)
    values, vectors = torch.linalg.eigh(torch.where(finite, scaled, eye))
    wide = vectors * scale.unsqueeze(-1)
    inverse = wide / values.abs().clamp(min=_FLAT).unsqueeze(-2) @ wide.mT
    return torch.where(finite, inverse, torch.zeros_like(inverse))


def _advance(
    merit: Merit,
    theta: Tensor,
    rest: Tensor,
    mu: Tensor,
    step: Tensor,
    decrement: Tensor,
    active: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """A step that lowers the merit, by halving; and whether there was one, for each run."""
    n10 = theta[0].numel()
    turn, move = step[:, :n10].reshape(theta.shape), step[:, n10:]
    length = torch.ones_like(mu)
    now = merit.value(theta, rest, mu)
    found = ~active
    for _ in range(_HALVINGS):
        tried = along(theta, turn, length), rest + length[:, None] * move
        value = merit.value(*tried, mu)
        # nan, outside, compares as false.
        better = (value < now - 1e-4 * length * decrement) & ~found
        theta = torch.where(better[:, None, None], tried[0], theta)
        rest = torch.where(better[:, None], tried[1], rest)
        found |= better
        if bool(found.all()):
            break
        length = torch.where(found, length, length / 2)
    return theta, rest, found
