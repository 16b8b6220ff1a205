"""The ten log-Cholesky numbers of a link, the loss with its barrier in them, where runs may go,
and starts strictly inside.

See `torchid.extraction.log_cholesky.extract`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch

from torchid.errors import TorchidError
from torchid.extraction.problem import Problem
from torchid.feasibility.conditions import Conditions, physics_only
from torchid.robot.inertia import InertialParameters, second_moment
from torchid.typing import Bool, Float, Tensor

_ROOM = 1e-3
"""Share of an interval by which a run starts away from its ends."""
_BISECTIONS = 30


@dataclass(frozen=True, eq=False)
class Room:
    """Where runs may go.

    Attributes:
        box: (D, 2) of p, the boxes of the centres of mass narrowed by the conditions'.
        conditions: shapes and total mass.
        anchor: (D,) a point well inside.
    """

    box: Tensor
    conditions: Conditions
    anchor: Tensor


def room_of(problem: Problem, with_conditions: bool) -> Room:
    """The room that bounds and conditions leave, with a point well inside.

    Raises:
        TorchidError: they leave none.
    """
    n = problem.n
    asked = problem.conditions.to("cpu") if with_conditions else physics_only(n)
    box = problem.box.cpu().double().clone()
    own = asked.com_box.reshape(-1, 2)
    box[:n, 0] = box[:n, 0].clamp(min=0.0)
    box[n : 4 * n, 0] = torch.maximum(box[n : 4 * n, 0], own[:, 0])
    box[n : 4 * n, 1] = torch.minimum(box[n : 4 * n, 1], own[:, 1])
    shut = (box[:, 0] >= box[:, 1]).nonzero().flatten().tolist()
    names = [f"com_{(k - n) // 3 + 1}{'xyz'[(k - n) % 3]}" for k in shut if n <= k < 4 * n]
    names += [f"mass_{k + 1}" for k in shut if k < n]
    anchor = box.mean(-1)
    low, high = torch.maximum(asked.total_mass[0], box[:n, 0].sum()), asked.total_mass[1]
    high = torch.minimum(high, box[:n, 1].sum())
    if not low < high:
        names.append("total_mass")
    else:
        share = ((low + high) / 2 - box[:n, 0].sum()) / (box[:n, 1] - box[:n, 0]).sum()
        anchor[:n] = box[:n, 0] + share * (box[:n, 1] - box[:n, 0])
    com = anchor[n : 4 * n].reshape(n, 3)
    near = torch.clamp(asked.round_centre, *_inner(box[n : 4 * n]).reshape(n, 3, 2).unbind(-1))
    out = ~_in_shape(asked, com)
    com = torch.where(out.unsqueeze(-1), near, com)
    names += [f"shape_{i + 1}" for i in (~_in_shape(asked, com)).nonzero().flatten().tolist()]
    # Inertias as near a sphere's as the bounds allow.
    low, high = _inner(box[4 * n : 10 * n].reshape(n, 6, 2)).unbind(-1)
    inertia = torch.clamp(torch.zeros_like(low), low, high)
    diagonal = [0, 3, 5]
    middle = (low[:, diagonal].amax(-1) + high[:, diagonal].amin(-1)) / 2
    inertia[:, diagonal] = torch.clamp(middle.unsqueeze(-1), low[:, diagonal], high[:, diagonal])
    names += [f"inertia_{i + 1}" for i in (~_is_body(inertia)).nonzero().flatten().tolist()]
    if names:
        raise TorchidError(
            "conditions and bounds leave no room between them.",
            got=", ".join(names),
            hint="the certificate says which exclude each other; or leave the conditions out",
        )
    anchor[n : 4 * n] = com.flatten()
    anchor[4 * n : 10 * n] = inertia.flatten()
    return Room(box, asked, anchor)


def _inner(box: Tensor) -> Tensor:
    """The box without a rim."""
    rim = _ROOM * (box[..., 1] - box[..., 0])
    return torch.stack([box[..., 0] + rim, box[..., 1] - rim], -1)


def _in_shape(asked: Conditions, com: Float[Tensor, "*batch n 3"]) -> Bool[Tensor, "*batch n"]:
    away = ((com - asked.round_centre) * asked.round_axes).norm(dim=-1)
    return away < (1 - _ROOM) * asked.round_radius


def _is_body(inertia: Float[Tensor, "*batch 6"]) -> Bool[Tensor, "*batch"]:
    """Whether second moments are positive definite, not nearly singular."""
    values = torch.linalg.eigvalsh(second_moment(inertia))
    return values[..., 0] > 1e-3 * _ROOM * values[..., 2].abs()


def moved_inside(problem: Problem, room: Room, p: Float[Tensor, "K D"]) -> Float[Tensor, "K D"]:
    """p moved towards the anchor until it is inside: masses, each centre of mass and each inertia
    by as much as they need, which is possible as their conditions are convex."""
    n, asked = problem.n, room.conditions
    box = _inner(room.box)
    p = torch.clamp(p, box[:, 0], box[:, 1])
    mass, com, inertia, rest = problem.split(p)
    mass0, com0, inertia0, _ = problem.split(room.anchor.expand_as(p))
    low, high = asked.total_mass
    rim = _ROOM * (high - low) if bool(torch.isfinite(high - low)) else 0.0

    def light(m: Tensor) -> Tensor:
        total = m.sum(-1)
        return (total > low + rim) & (total < high - rim)

    limits = box[4 * n : 10 * n].reshape(n, 6, 2)
    values, vectors = torch.linalg.eigh(second_moment(inertia))
    values = torch.maximum(values, _ROOM * values[..., 2:].clamp(min=1e-12))
    s = vectors @ torch.diag_embed(values) @ vectors.mT
    trace = s.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    i, j = torch.triu_indices(3, 3)
    body = (trace * torch.eye(3, dtype=s.dtype) - s)[..., i, j]

    def consistent(x: Tensor) -> Tensor:
        within = ((x >= limits[..., 0]) & (x <= limits[..., 1])).all(-1)
        return within & _is_body(x)

    mass = _towards(mass, mass0, light)
    com = _towards(com, com0, lambda c: _in_shape(asked, c)).flatten(-2)
    return torch.cat([mass, com, _towards(body, inertia0, consistent).flatten(-2), rest], -1)


def _towards(point: Tensor, anchor: Tensor, good: Callable[[Tensor], Tensor]) -> Tensor:
    """The first good point on the way from `point` to `anchor`, by bisection on the last axis."""
    bad, fine = torch.zeros_like(point[..., :1]), torch.ones_like(point[..., :1])
    at_once = good(point).unsqueeze(-1)
    for _ in range(_BISECTIONS):
        middle = (bad + fine) / 2
        ok = good(point + middle * (anchor - point)).unsqueeze(-1)
        bad, fine = torch.where(ok, bad, middle), torch.where(ok, middle, fine)
    return torch.where(at_once, point, point + fine * (anchor - point))


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
