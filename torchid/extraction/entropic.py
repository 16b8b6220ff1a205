"""Bodies nearest to the nominal ones among all with nearly the least torque error.

Torque is linear in the links' inertial parameters pi and in coefficients c of joints, so its
squared error is a quadratic form. A body's pseudo-inertia P(pi) is positive definite, and how far
it is from another, R, is in the entropic metric (T. Lee, P. Wensing, F. Park, "Geometric Robot
Dynamic Identification: A Convex Programming Approach", IEEE T-RO 36(2), 2020, section IV)

    D(P, R) = tr(R^-1 P) - log det(R^-1 P) - 4,

which depends on no frame and no unit. With N the nominal bodies, U a small one of each link's size
(beside which a change counts: placeholders in a file are no knowledge), and e the least error,

    |A x - y|^2 / (2 e^2) + lambda sum_links [D(P + U, N + U) - w log det(P - L)]

with L the least body that each link holds, is smooth, convex and infinite where a link stops being
a body: Newton steps minimise it from the inside (Boyd and Vandenberghe 2004, section 9.6). Of a
path of lambdas the largest whose error is within `SPENT_SHARE` of the least one is answered: what
the log determines is the log's, all else stays nominal.
"""

from dataclasses import dataclass, replace

import torch

from torchid.design.bodies import INSIDE, usual_bodies
from torchid.feasibility.plausibility import DENSITIES
from torchid.robot.inertia import InertialParameters, pseudo_inertia_basis
from torchid.robot.model import Robot
from torchid.robot.shapes import joint_points, link_lengths, link_shapes, typical_bodies
from torchid.typing import Float, Tensor

SPENT_SHARE = 0.02
"""Share of the least torque error that may be spent on bodies nearer to the nominal ones."""


SPREAD = 5.0
"""Factor by which a person believes that second moments of a nominal body shrink, at most."""


_WALL = 1e-3
"""w: how much of the metric keeps bodies, masses and centres off their limits."""

EXACT_SHARE = 1e-6
"""Share of the squared torque that counts as no error."""

_SIGN = 1e-5
"""Weight of a coefficient's sign in units of the squared error: a coefficient that the torque asks
to be negative is left with as small a share of it."""

_FLAT = 1e-6
"""The least weight of any limit, in the same units: below it rounding decides."""

_PATH = 10.0 ** torch.arange(2.0, -6.25, -0.5, dtype=torch.float64)
_FURTHER = (1e4, 1e3, 1e2, 10.0, 1.0)
"""How many times as strong the walls are, one after the other, where Newton steps are stuck at
one."""
AT_A_WALL = 0.01
"""Share of the nominal mass, or of the width of the centre's box, from a wall at which a body is
said to stand at it: the search stays inside."""
_CENTRE = [f"centre of mass {axis}" for axis in "xyz"]
_WALLS = [("mass", "lower"), ("mass", "upper"), *((c, "lower") for c in _CENTRE)]
_WALLS += [(c, "upper") for c in _CENTRE]
"""What the rows of `Room` are of, in their order."""


@dataclass(frozen=True, eq=False)
class Quadratic:
    """The squared torque error x'Hx - 2 b'x + y'y.

    Attributes:
        h, b, square: H (K, K), b (K,) and y'y; x is ten parameters a link, then coefficients.
        positive: (C, E) sums of coefficients that physics forbids to be negative; no weight is.
    """

    h: Float[Tensor, "K K"]
    b: Float[Tensor, " K"]
    square: float
    positive: Float[Tensor, "C E"]

    def error(self, x: Float[Tensor, " K"]) -> float:
        """Root of the squared error."""
        return max(0.0, float(x @ self.h @ x - 2 * self.b @ x) + self.square) ** 0.5

    def unit(self, x: Float[Tensor, " K"]) -> float:
        """The squared error, or that of an exact fit."""
        return max(self.error(x) ** 2, EXACT_SHARE * self.square, 1e-300)


@dataclass(frozen=True, eq=False)
class Room:
    """Where a person looks for n links.

    Attributes:
        nominal: (n, 10), bodies.
        small: (n, 10) of each link's size.
        least: (n, 10) what each of them holds at least.
        rows, offset: (n, C, 10), (n, C): rows pi + offset is positive of every link; no row where
            nothing is asked but that it is a body.
    """

    nominal: Float[Tensor, "n 10"]
    small: Float[Tensor, "n 10"]
    least: Float[Tensor, "n 10"]
    rows: Float[Tensor, "n C 10"]
    offset: Float[Tensor, "n C"]

    def touched(self, pi: Float[Tensor, "n 10"]) -> tuple[str, ...]:
        """Walls that bodies stand at, e.g. `mass of link 2 (upper)`; a mass of 0 is no wall."""
        left = (self.rows @ pi.unsqueeze(-1)).squeeze(-1) + self.offset
        near = left < AT_A_WALL
        near[:, :1] &= self.offset[:, :1] < 0
        return tuple(
            f"{_WALLS[c][0]} of link {i + 1} ({_WALLS[c][1]})" for i, c in near.nonzero().tolist()
        )

    @property
    def bodies_alone(self) -> "Room":
        """This room, asking for nothing but bodies."""
        none = {"rows": self.rows[:, :0], "offset": self.offset[:, :0]}
        return replace(self, least=INSIDE * self.small, **none)


def room_of(robot: Robot) -> Room:
    """Masses within a factor 2 of the nominal ones, and of nothing denser than the densest
    material; second moments of at least a fifth of theirs; centres of mass within 5 cm of the
    link's shape, or of the nominal one where no shape is known.

    Of nominal links that are no bodies the nearest bodies are taken. A robot without parameters has
    `typical_bodies`, and their centres are asked to be within a link's length of its joints.

    Raises:
        RobotError: the file of the shapes is no longer what the robot was read from.
    """
    ends, length = joint_points(robot), link_lengths(robot)
    body, small = expected_bodies(robot)
    # A link to which its file gives no mass may have that of a small body.
    # Factor from a link's nominal mass, up and down, within which a person believes it
    believable = 2.0
    has = body[:, 0] > small[:, 0] / believable
    mass = torch.where(has, body[:, 0], small[:, 0])
    com = (body + 1e-6 * small)[:, 1:4] / (body + 1e-6 * small)[:, :1]
    low, high = torch.where(has, mass / believable, 0.0), believable * mass
    # How far outside its shape a centre of mass may be; from the nominal one, where there is no
    # shape [m]
    near_shape = 0.05
    below, above = com - near_shape, com + near_shape
    shapes = link_shapes(robot)
    if robot.parameters is None:
        low, high = low / 10, high * 10
        below = ends.amin(1) - length.unsqueeze(1)
        above = ends.amax(1) + length.unsqueeze(1)
    if shapes is not None:
        dense = DENSITIES[1] * shapes.volumes
        high = torch.where(dense > mass, torch.minimum(high, dense), high)
        known = torch.isfinite(shapes.boxes).all(-1).all(-1).unsqueeze(1)
        corners = shapes.boxes + torch.tensor([-near_shape, near_shape])
        below = torch.where(known, torch.minimum(corners[..., 0], com - 0.1 * near_shape), below)
        above = torch.where(known, torch.maximum(corners[..., 1], com + 0.1 * near_shape), above)
    least = INSIDE * small + torch.where(has[:, None], body / SPREAD, 0.0)
    return _room(body, small, least, mass, torch.stack([low, high], 1), below, above)


def room_within(robot: Robot, mass: Float[Tensor, "n 2"], com: Float[Tensor, "n 3 2"]) -> Room:
    """Bodies within bounds of the masses [kg] and boxes of the centres of mass [m], and nothing
    else; nominal bodies, or typical ones, that lie outside are moved inside.

    Raises:
        RobotError: the file of the shapes is no longer what the robot was read from.
    """
    body, small = expected_bodies(robot)
    body = torch.where(body[:, :1] > small[:, :1], body, small)
    own = InertialParameters(body)
    low, high = com.double().unbind(-1)
    least, most = mass.double().clamp(min=0.0).unbind(-1)

    def moved(value: Tensor, low: Tensor, high: Tensor) -> Tensor:
        margin = 0.01 * (high - low)
        there = (low < value) & (value < high)
        return torch.where(there, value, value.clamp(low + margin, high - margin))

    heavy = moved(own.mass, least, most)
    inertia = (heavy / own.mass).unsqueeze(1) * own.inertia_about_com
    inside = InertialParameters.from_com(heavy, moved(own.com, low, high), inertia)
    limits, small = torch.stack([least, most], 1), usual_bodies(inside.pi)
    return _room(inside.pi, small, INSIDE * small, inside.mass, limits, low, high)


def expected_bodies(robot: Robot) -> tuple[Float[Tensor, "n 10"], Float[Tensor, "n 10"]]:
    """The links' nominal parameters, with what is negative of a pseudo-inertia cut off, or
    `typical_bodies` of a robot without; and of each a small body of its size."""
    own = robot.parameters
    pi = typical_bodies(robot).pi if own is None else own.pi.double()
    values, vectors = torch.linalg.eigh(InertialParameters(pi).pseudo_inertia)
    cut = (vectors * values.clamp(min=0).unsqueeze(-2)) @ vectors.mT
    basis = pseudo_inertia_basis().flatten(1)
    body = torch.where(values[:, :1] < 0, cut.flatten(1) @ torch.linalg.pinv(basis), pi)
    return body, usual_bodies(pi)


def _room(
    body: Tensor,
    small: Tensor,
    least: Tensor,
    unit: Tensor,
    mass: Tensor,
    low: Tensor,
    high: Tensor,
) -> Room:
    """Rows of limits of the mass (n, 2) and of the centre of mass (n, 3), every row in the size of
    the unit mass (n,), so that all of them count alike."""
    one = torch.eye(10, dtype=torch.float64).expand(len(body), 10, 10)
    m, moment, size = one[:, :1], one[:, 1:4], unit[:, None, None]
    width = size * (high - low).unsqueeze(-1)
    rows = [
        m / size,
        -m / size,
        (moment - low.unsqueeze(-1) * m) / width,
        (high.unsqueeze(-1) * m - moment) / width,
    ]
    offset = torch.zeros(len(body), 8, dtype=torch.float64)
    offset[:, 0], offset[:, 1] = -mass[:, 0] / unit, mass[:, 1] / unit
    return Room(body, small, least, torch.cat(rows, 1), offset)


@dataclass(frozen=True, eq=False)
class NearBodies:
    """Bodies and coefficients that have nearly the least torque error.

    Attributes:
        pi: (n, 10).
        coefficients: (E,).
        error: root of their squared error.
        least: that of any bodies in the same room, next to it.
        strength: lambda.
    """

    pi: Float[Tensor, "n 10"]
    coefficients: Float[Tensor, " E"]
    error: float
    least: float
    strength: float


def nearest_bodies(
    torque: Quadratic,
    room: Room,
    *,
    spent: float = SPENT_SHARE,
    strength: float | None = None,
    near: NearBodies | None = None,
) -> NearBodies:
    """The bodies nearest to the nominal ones with nearly the least error.

    Args:
        torque: its squared error.
        room: where they are looked for.
        spent: share of the least error that nearness may cost.
        strength: lambda, where it is known, e.g. from all of the data.
        near: answer to a question that differs little: its lambda is taken, and the search begins
            there.

    >>> import torch
    >>> from torchid import load_robot
    >>> robot = load_robot("3r")
    >>> zero = torch.zeros(30, 30, dtype=torch.float64)
    >>> nothing = Quadratic(zero, zero[0], 1.0, torch.zeros(0, 0).double())
    >>> found = nearest_bodies(nothing, room_of(robot))
    >>> bool((found.pi[:, 0] / robot.parameters.mass - 1).abs().max() < 0.05)
    True
    """
    question = _Question.of(torque, room)
    n = len(room.nominal)
    if near is not None:
        x = torch.cat([near.pi.flatten(), near.coefficients])
        x = question.about(x).minimum(x, near.strength)
        error = torque.error(x)
        return NearBodies(x[: 10 * n].view(n, 10), x[10 * n :], error, error, near.strength)
    x = question.start
    minima: list[tuple[float, Tensor]] = []
    for value in _PATH.tolist():
        # In units of what was last left, which comes down to the least.
        x = question.about(x).minimum(x, value)
        minima.append((value, x))
        if strength is not None and value <= strength:
            break
    errors = [torque.error(x) for _, x in minima]
    k = len(minima) - 1
    if strength is None:
        k = next(i for i, e in enumerate(errors) if e <= (1 + spent) * min(errors))
    pi, coefficients = minima[k][1][: 10 * n].view(n, 10), minima[k][1][10 * n :]
    return NearBodies(pi, coefficients, errors[k], min(errors), minima[k][0])


def response(
    torque: Quadratic, room: Room, bodies: NearBodies, pull: Float[Tensor, " K"]
) -> Float[Tensor, " K"]:
    """What further torque would add to the answer, to first order.

    Args:
        torque, room, bodies: the question and its answer.
        pull: (K,) A'z of a small torque z.
    """
    x = torch.cat([bodies.pi.flatten(), bodies.coefficients])
    question = _Question.of(torque, room).about(x)
    _, hessian = question.slopes(x, bodies.strength)
    return _solved(hessian, pull / question.unit)


def _solved(hessian: Float[Tensor, "K K"], right: Float[Tensor, " K"]) -> Float[Tensor, " K"]:
    """The hessian's inverse times a vector; every unknown in its own unit, so that rounding does
    not decide."""
    size = hessian.diagonal().clamp(min=1e-300).rsqrt()
    scaled = hessian * size * size.unsqueeze(1)
    scaled.diagonal().add_(1e-12)
    return size * torch.linalg.solve(scaled, size * right)


@dataclass(frozen=True, eq=False)
class _Question:
    """The function that is minimised, with walls so many times as strong, and where its minimum is
    looked for from."""

    torque: Quadratic
    room: Room
    unit: float
    near: Float[Tensor, "n 10 4 4"]
    start: Float[Tensor, " K"]
    walls: float = 1.0

    @staticmethod
    def of(torque: Quadratic, room: Room) -> "_Question":
        n, count = len(room.nominal), torque.positive.shape[1]
        free = torch.linalg.lstsq(torque.h, torque.b, driver="gelsd").solution
        unit = torque.unit(free)
        basis = pseudo_inertia_basis()
        # Pseudo-inertias in units of N + U, in which nearness is counted.
        root = torch.linalg.cholesky(InertialParameters(room.nominal + room.small).pseudo_inertia)
        inner = torch.linalg.inv(root).unsqueeze(1)
        # Coefficients that carry a hundredth of what is left.
        own = torque.h.diagonal()[10 * n :]
        sizes = (unit / own.clamp(min=1e-12 * float(own.max()) if count else 0.0)).sqrt()
        sizes = torch.where(own > 0, sizes, torch.ones_like(sizes))
        start = torch.cat([_inside(room).flatten(), sizes * torque.positive.any(0)])
        return _Question(torque, room, unit, inner @ basis @ inner.mT, start)

    def about(self, x: Float[Tensor, " K"]) -> "_Question":
        """This function in units of the error there."""
        return replace(self, unit=self.torque.unit(x))

    def minimum(self, x: Float[Tensor, " K"], strength: float) -> Float[Tensor, " K"]:
        """Where Newton steps from inside lead; beside walls that hold from afar first, where they
        get nowhere near the last ones."""
        there, settled = self._descent(x, strength)
        if settled:
            return there
        for further in _FURTHER:
            there, _ = replace(self, walls=further)._descent(there, strength)
        return there

    def _descent(self, x: Float[Tensor, " K"], strength: float) -> tuple[Float[Tensor, " K"], bool]:
        """Newton steps from inside, as long as they lead anywhere, and whether they came to an end,
        or nearly: the second half of them gained nothing to speak of."""
        value = half = self.value(x, strength)
        steps = 80
        for k in range(steps):
            half = value if k == steps // 2 else half
            gradient, hessian = self.slopes(x, strength)
            step = -_solved(hessian, gradient)
            fall = float(gradient @ step)
            # 1e-9: fall below this share of the value is rounding
            if -fall < 1e-9 * max(1.0, abs(value)):
                return x, True
            share = 1.0
            while share > 1e-8:
                there = self.value(x + share * step, strength)
                if there <= value + 0.1 * share * fall:
                    break
                share /= 2
            else:
                return x, True
            x, value = x + share * step, there
        # 1e-4: share of the value that a Newton step must gain
        return x, half - value < 1e-4 * abs(value)

    def value(self, x: Float[Tensor, " K"], strength: float) -> float:
        """The function; infinite outside."""
        n = len(self.room.nominal)
        pi, c = x[: 10 * n].view(n, 10), x[10 * n :]
        own, near, inside = self._parts(pi)
        signs = self.torque.positive @ c
        if bool((inside <= 0).any()) or bool((signs <= 0).any()):
            return float("inf")
        logs = []
        for p in (near, own):
            root, bad = torch.linalg.cholesky_ex(p)
            if bool(bad.any()):
                return float("inf")
            logs.append(2 * root.diagonal(dim1=-2, dim2=-1).log().sum())
        metric = near.diagonal(dim1=-2, dim2=-1).sum() - logs[0]
        walls = logs[1] + inside.log().sum()
        total = self.torque.error(x) ** 2 / (2 * self.unit) + strength * metric
        total = total - self.walls * (_WALL * strength + _FLAT) * walls
        return float(total - _SIGN * signs.log().sum())

    def _parts(self, pi: Float[Tensor, "n 10"]) -> tuple[Tensor, Tensor, Tensor]:
        """Pseudo-inertias, less what they hold at least and with U, in units of N + U; and the
        half-spaces' values."""
        own, small, least = (
            torch.einsum("na,naij->nij", each, self.near)
            for each in (pi, self.room.small, self.room.least)
        )
        inside = (self.room.rows @ pi.unsqueeze(-1))[..., 0] + self.room.offset
        return own - least, own + small, inside

    def slopes(self, x: Float[Tensor, " K"], strength: float) -> tuple[Tensor, Tensor]:
        """Gradient (K,) and Hessian (K, K)."""
        n = len(self.room.nominal)
        pi, c = x[: 10 * n].view(n, 10), x[10 * n :]
        own, near, inside = self._parts(pi)
        wall = self.walls * (_WALL + _FLAT / strength)
        gradient = (self.torque.h @ x - self.torque.b) / self.unit
        hessian = self.torque.h / self.unit
        of_links = torch.einsum("naii->na", self.near).clone()
        curved = torch.zeros(n, 10, 10, dtype=torch.float64)
        for weight, p in ((1.0, near), (wall, own)):
            turned = torch.linalg.solve(p.unsqueeze(1), self.near)
            of_links -= weight * torch.einsum("naii->na", turned)
            curved += weight * torch.einsum("naij,nbji->nab", turned, turned)
        rows = self.room.rows / inside.unsqueeze(-1)
        of_links -= wall * rows.sum(1)
        curved += wall * rows.mT @ rows
        gradient = gradient + strength * torch.cat([of_links.flatten(), torch.zeros_like(c)])
        hessian = hessian.clone()
        for k in range(n):
            part = slice(10 * k, 10 * k + 10)
            hessian[part, part] += strength * curved[k]
        signs = self.torque.positive / (self.torque.positive @ c).unsqueeze(1)
        gradient[10 * n :] -= _SIGN * signs.sum(0)
        hessian[10 * n :, 10 * n :] += _SIGN * signs.T @ signs
        return gradient, hessian


def _inside(room: Room) -> Float[Tensor, "n 10"]:
    """Bodies strictly inside the room: the nominal ones, a little of the small ones added about
    their centre, and of a mass between its bounds."""
    out = room.nominal + 0.01 * room.small
    if room.rows.shape[1]:
        low, high = -room.offset[:, 0] / room.rows[:, 0, 0], room.offset[:, 1] / -room.rows[:, 1, 0]
        mass = out[:, 0].clamp(low + 0.01 * (high - low), high - 0.01 * (high - low))
        out = out * (mass / out[:, 0]).unsqueeze(1)
    return out
