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
from torchid.extraction.log_cholesky_start import Room, moved_inside, room_of, second_moments
from torchid.extraction.problem import Problem
from torchid.robot.inertia import InertialParameters, paper_order
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
        converged: (K,) whether the barrier holds less than the gap asked for.
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
    gap: float = GAP,
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
        gap: share of phi at which a run ends.
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
    theta, rest = _to_theta(problem, inside)
    merit = _Merit(problem, room)
    theta, rest, converged, taken = _descend(merit, theta, rest, gap, centring, steps)
    p = torch.where(usable.unsqueeze(-1), merit.search_vector(theta, rest), torch.nan)
    return LogCholeskyRuns(p, problem.phi(p), converged & usable, taken)


def _to_theta(problem: Problem, p: Float[Tensor, "K D"]) -> tuple[Tensor, Tensor]:
    """(K, n, 10) log-Cholesky parameters and (K, E) coefficients of p."""
    mass, com, inertia, rest = problem.split(p)
    return _theta_of(mass, com, second_moments(inertia)), rest


def _theta_of(mass: Tensor, com: Tensor, second: Tensor) -> Tensor:
    """(K, n, 10) of masses (K, n), centres of mass and second moments (K, n, 3, 3) about them; nan
    where these are no body."""
    safe = torch.where(mass > 0, mass, torch.ones_like(mass))
    # An upper triangular root: the lower one of the matrix read backwards.
    moments = (second / safe[..., None, None]).flip(-1, -2)
    found = torch.linalg.cholesky_ex(moments)
    root = found.L.flip(-1, -2)
    off = torch.stack([root[..., 0, 1], root[..., 0, 2], root[..., 1, 2]], -1)
    log = root.diagonal(dim1=-2, dim2=-1).log()
    theta = torch.cat([safe.log().unsqueeze(-1) / 2, log, off, com], -1)
    body = (found.info == 0) & (mass > 0)
    return torch.where(body.unsqueeze(-1), theta, torch.nan)


def _along(theta: Tensor, turn: Tensor, length: Tensor) -> Tensor:
    """theta after a step that starts as length * turn and is straight in (m, mc, J)."""
    x = torch.func.vmap(torch.func.vmap(_link_x))(_POINT(theta))
    x = x + length[:, None, None] * (_JACOBIAN(theta) @ turn.unsqueeze(-1)).squeeze(-1)
    parameters = InertialParameters(x)
    return _theta_of(parameters.mass, parameters.com, second_moments(parameters.inertia_about_com))


def _link_p(theta: Tensor) -> Tensor:
    """m, c, I (10,) of one link."""
    mass = torch.exp(2 * theta[0])
    e1, e2, e3 = torch.exp(theta[1:4]).unbind()
    s12, s13, s23 = theta[4:7].unbind()
    xx, yy, zz = e1 * e1 + s12 * s12 + s13 * s13, e2 * e2 + s23 * s23, e3 * e3
    xy, xz, yz = s12 * e2 + s13 * s23, s13 * e3, s23 * e3
    second = torch.stack([yy + zz, -xy, -xz, xx + zz, -yz, xx + yy])
    return torch.cat([mass.reshape(1), theta[7:10], mass * second])


def _link_x(p: Tensor) -> Tensor:
    """m, mc, J (10,) of one link."""
    m, (x, y, z) = p[0], p[1:4].unbind()
    parallel = torch.stack([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])
    return torch.cat([m.reshape(1), m * p[1:4], p[4:] + m * parallel])


def _link_barrier(
    theta: Tensor, box: Tensor, centre: Tensor, axes: Tensor, radius: Tensor
) -> Tensor:
    """-sum of logs of one link's slacks, and of det P; infinite slacks are left out."""
    p = _link_p(theta)
    slack = torch.cat([p - box[:, 0], box[:, 1] - p])
    away = (((p[1:4] - centre) * axes) ** 2).sum() / radius**2
    slack = torch.cat([slack, (1 - away).reshape(1)])
    logs = torch.where(torch.isfinite(slack), slack, torch.ones_like(slack)).log().sum()
    return -logs - 2 * (4 * theta[0] + theta[1:4].sum())


_ALL = (0, 0, 0, None, None, None, None)
"""How `_link_terms` takes its arguments over runs; over links all but mu have one each."""
_LINKS = (0, 0, None, 0, 0, 0, 0)


def _link_terms(
    theta: Tensor, g: Tensor, mu: Tensor, box: Tensor, centre: Tensor, axes: Tensor, radius: Tensor
) -> Tensor:
    """g'x + mu B of one link: its Hessian is what a constant slope g of phi in x leaves."""
    return g @ _link_x(_link_p(theta)) + mu * _link_barrier(theta, box, centre, axes, radius)


_JACOBIAN = torch.func.vmap(torch.func.vmap(torch.func.jacfwd(lambda t: _link_x(_link_p(t)))))
_HESSIAN = torch.func.vmap(torch.func.vmap(torch.func.hessian(_link_terms), _LINKS), _ALL)
_GRADIENT = torch.func.vmap(torch.func.vmap(torch.func.grad(_link_terms), _LINKS), _ALL)
_BARRIER = torch.func.vmap(
    torch.func.vmap(_link_barrier, (0, 0, 0, 0, 0)), (0, None, None, None, None)
)
_POINT = torch.func.vmap(torch.func.vmap(_link_p))


class _Merit:
    """phi + mu B and its derivatives in (theta, coefficients)."""

    def __init__(self, problem: Problem, room: Room):
        n = problem.n
        target = problem.target
        a = (target.weight @ target.base.grouping.to(target.weight)).cpu().double()
        self.problem, self.n = problem, n
        self.links = torch.empty(a.shape[0], 10 * n, dtype=a.dtype)
        self.links[:, paper_order(n)] = a[:, : 10 * n]
        self.rest = a[:, 10 * n :]
        self.offset = target.offset.cpu().double()
        c = room.conditions
        own = [room.box[:n, None], room.box[n : 4 * n].unflatten(0, (n, 3))]
        own.append(room.box[4 * n : 10 * n].unflatten(0, (n, 6)))
        self.limits = (torch.cat(own, 1), c.round_centre, c.round_axes, c.round_radius)
        self.total = c.total_mass
        self.rest_box = room.box[10 * n :]
        self.count = 2 * room.box.shape[0] + 4 * n + 2 + n

    def search_vector(self, theta: Tensor, rest: Tensor) -> Tensor:
        """p (K, D), never outside the bounds by rounding."""
        link = _POINT(theta)
        p = torch.cat([link[..., 0], link[..., 1:4].flatten(-2), link[..., 4:].flatten(-2)], -1)
        low, high = self.problem.box.to(p).unbind(-1)
        return torch.clamp(torch.cat([p, rest], -1), low, high)

    def residual(self, theta: Tensor, rest: Tensor) -> Tensor:
        """W pi_R - t (K, R)."""
        x = torch.func.vmap(torch.func.vmap(_link_x))(_POINT(theta)).flatten(-2)
        return x @ self.links.T + rest @ self.rest.T - self.offset

    def value(self, theta: Tensor, rest: Tensor, mu: Tensor) -> Tensor:
        """phi + mu B (K,); nan or infinite outside."""
        barrier = _BARRIER(theta, *self.limits).sum(-1)
        slack = torch.cat([rest - self.rest_box[:, 0], self.rest_box[:, 1] - rest], -1)
        total = torch.exp(2 * theta[..., 0]).sum(-1, keepdim=True)
        slack = torch.cat([slack, total - self.total[0], self.total[1] - total], -1)
        slack = torch.where(torch.isfinite(slack), slack, 1.0)
        barrier = barrier - slack.log().sum(-1)
        return self.residual(theta, rest).square().sum(-1) + mu * barrier

    def jacobian(self, theta: Tensor) -> Tensor:
        """Of the residual (K, R, 10 n + E)."""
        own = torch.einsum(
            "ria,kiab->krib", self.links.unflatten(-1, (self.n, 10)), _JACOBIAN(theta)
        )
        return torch.cat([own.flatten(-2), self.rest.expand(len(theta), -1, -1)], -1)

    def derivatives(
        self, theta: Tensor, rest: Tensor, mu: Tensor, wide: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Gradient (K, 10 n + E) and Hessian, given the residual's Jacobian."""
        k, n = theta.shape[0], self.n
        slope = 2 * self.residual(theta, rest)
        mass = torch.exp(2 * theta[..., 0])
        below = 1 / (mass.sum(-1) - self.total[0])
        above = 1 / (self.total[1] - mass.sum(-1))
        g = (slope @ self.links).unflatten(-1, (n, 10))
        g[..., 0] += (mu * (above - below)).unsqueeze(-1)
        gradient = _GRADIENT(theta, g, mu, *self.limits)
        # Of the barrier alone, in x: with it in place of phi's slope (they are opposite on the
        # central path) the Hessian is that in x, where the merit is convex.
        pull = torch.linalg.solve(_JACOBIAN(theta).mT, gradient.unsqueeze(-1)).squeeze(-1) - g
        own = (theta, -pull, mu, *self.limits)
        hessian = 2 * wide.mT @ wide
        blocks = torch.stack([_block_diagonal(h) for h in _HESSIAN(*own)])
        hessian[:, : 10 * n, : 10 * n] += blocks
        masses = torch.zeros(k, 10 * n, dtype=theta.dtype)
        masses[:, ::10] = 2 * mass
        curve = (mu * (below**2 + above**2))[:, None, None]
        hessian[:, : 10 * n, : 10 * n] += curve * masses.unsqueeze(-1) * masses.unsqueeze(-2)
        low, high = 1 / (rest - self.rest_box[:, 0]), 1 / (self.rest_box[:, 1] - rest)
        tail = torch.arange(10 * n, hessian.shape[-1])
        hessian[:, tail, tail] += mu.unsqueeze(-1) * (low**2 + high**2)
        ends = slope @ self.rest + mu.unsqueeze(-1) * (high - low)
        return torch.cat([gradient.flatten(-2), ends], -1), hessian


def _block_diagonal(blocks: Float[Tensor, "n 10 10"]) -> Tensor:
    return torch.block_diag(*blocks)


def _descend(
    merit: _Merit, theta: Tensor, rest: Tensor, gap: float, centring: float, steps: int
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
        step = -_times(inverse, gradient)
        decrement = -(gradient * step).sum(-1)
        # Within mu of the central path, the barrier's share bounds what is left to gain.
        near = decrement <= mu
        holds = (mu * merit.count <= gap * phi) & near
        done |= holds | (phi <= floor)
        if bool(done.all()):
            break
        taken += 1
        theta, rest, moved = _advance(merit, theta, rest, mu, step, decrement, ~done)
        phi = merit.residual(theta, rest).square().sum(-1)
        held = phi / merit.count
        lower = torch.minimum(torch.where(near | ~moved, _SHRINK * mu, mu), centring * held)
        lower = torch.where(near | ~moved, torch.minimum(lower, _SHRINK * held), lower)
        mu = torch.where(done, mu, torch.maximum(lower, 0.5 * gap * held))
    return theta, rest, done, taken


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


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
    merit: _Merit,
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
        tried = _along(theta, turn, length), rest + length[:, None] * move
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
