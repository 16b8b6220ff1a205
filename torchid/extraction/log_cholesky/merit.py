"""The ten log-Cholesky numbers of a link, and the loss with its barrier in them.

See `torchid.extraction.log_cholesky.extract`.
"""

import torch

from torchid.extraction.log_cholesky.start import Room
from torchid.extraction.problem import Problem
from torchid.robot.inertia import InertialParameters, second_moment
from torchid.typing import Tensor


def theta_of(mass: Tensor, com: Tensor, second: Tensor) -> Tensor:
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


def along(theta: Tensor, turn: Tensor, length: Tensor) -> Tensor:
    """theta after a step that starts as length * turn and is straight in (m, mc, J)."""
    x = _AFFINE(_POINT(theta))
    x = x + length[:, None, None] * (_JACOBIAN(theta) @ turn.unsqueeze(-1)).squeeze(-1)
    parameters = InertialParameters(x)
    return theta_of(parameters.mass, parameters.com, second_moment(parameters.inertia_about_com))


def link_p(theta: Tensor) -> Tensor:
    """m, c, I (10,) of one link."""
    mass = torch.exp(2 * theta[0])
    e1, e2, e3 = torch.exp(theta[1:4]).unbind()
    s12, s13, s23 = theta[4:7].unbind()
    xx, yy, zz = e1 * e1 + s12 * s12 + s13 * s13, e2 * e2 + s23 * s23, e3 * e3
    xy, xz, yz = s12 * e2 + s13 * s23, s13 * e3, s23 * e3
    second = torch.stack([yy + zz, -xy, -xz, xx + zz, -yz, xx + yy])
    return torch.cat([mass.reshape(1), theta[7:10], mass * second])


def link_x(p: Tensor) -> Tensor:
    """m, mc, J (10,) of one link."""
    m, (x, y, z) = p[0], p[1:4].unbind()
    parallel = torch.stack([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])
    return torch.cat([m.reshape(1), m * p[1:4], p[4:] + m * parallel])


def _link_barrier(
    theta: Tensor, box: Tensor, centre: Tensor, axes: Tensor, radius: Tensor
) -> Tensor:
    """-sum of logs of one link's slacks, and of det P; infinite slacks are left out."""
    p = link_p(theta)
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
    return g @ link_x(link_p(theta)) + mu * _link_barrier(theta, box, centre, axes, radius)


_JACOBIAN = torch.func.vmap(torch.func.vmap(torch.func.jacfwd(lambda t: link_x(link_p(t)))))
_HESSIAN = torch.func.vmap(torch.func.vmap(torch.func.hessian(_link_terms), _LINKS), _ALL)
_GRADIENT = torch.func.vmap(torch.func.vmap(torch.func.grad(_link_terms), _LINKS), _ALL)
_BARRIER = torch.func.vmap(
    torch.func.vmap(_link_barrier, (0, 0, 0, 0, 0)), (0, None, None, None, None)
)
_POINT = torch.func.vmap(torch.func.vmap(link_p))
_AFFINE = torch.func.vmap(torch.func.vmap(link_x))


class Merit:
    """phi + mu B and its derivatives in (theta, coefficients)."""

    def __init__(self, problem: Problem, room: Room):
        n = problem.n
        target = problem.target
        a = target.matrix_by_link.cpu().double()
        self.problem, self.n = problem, n
        self.links, self.rest = a[:, : 10 * n], a[:, 10 * n :]
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
        x = _AFFINE(_POINT(theta)).flatten(-2)
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
        hessian[:, : 10 * n, : 10 * n] += torch.stack(
            [torch.block_diag(*h) for h in _HESSIAN(*own)]
        )
        masses = torch.zeros(k, 10 * n, dtype=theta.dtype)
        masses[:, ::10] = 2 * mass
        curve = (mu * (below**2 + above**2))[:, None, None]
        hessian[:, : 10 * n, : 10 * n] += curve * masses.unsqueeze(-1) * masses.unsqueeze(-2)
        low, high = 1 / (rest - self.rest_box[:, 0]), 1 / (self.rest_box[:, 1] - rest)
        tail = torch.arange(10 * n, hessian.shape[-1])
        hessian[:, tail, tail] += mu.unsqueeze(-1) * (low**2 + high**2)
        ends = slope @ self.rest + mu.unsqueeze(-1) * (high - low)
        return torch.cat([gradient.flatten(-2), ends], -1), hessian
