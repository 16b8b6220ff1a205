"""A load that the robot's model does not have: a body of unknown mass at the last link but the jaw.

Every joint feels it through gravity and inertia, in a pattern that gains and offsets of single
joints can follow in part only. Its torques are linear in its mass and its first moments; they are
taken about a point in front of the link, and fitted together with all servos: what the servos can
do in its place is projected out joint by joint (the Schur complement of their normal equations).
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.position.data import PositionData
from torchid.position.fit import (
    HARDLY,
    LONGEST,
    NOISE,
    TOGETHER_S,
    errors_of_one,
    mean_square,
    moved,
    prior_precision,
    searched,
    sensitivities,
    weights,
)
from torchid.position.judge import Spread, alike_rows
from torchid.position.servo_model import Motions, ServoModel
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.simulation.servo import INDEX, PARAMETERS, TORQUES, Servos
from torchid.simulation.servo_loop import PROFILE, Body, Windows, body_near
from torchid.statistics.criteria import BEYOND_ROBOT
from torchid.statistics.proportion import HALF_95
from torchid.typing import Float

ITERATIONS = 8
FAR = 20.0
"""Times that torques change at most with a load [1]."""
SHARES = (1.0, 0.5, 0.2, 0.05)
"""Of a Gauss-Newton step, until one lowers the loss."""
MASSES = (0.3, 1.0, 3.0)
"""Of loads to begin with, beside the link's [1]."""
WORTH = 0.02
"""Share of all joints' loss that a load must promise to take away to be fitted [1]."""


@dataclass(frozen=True, eq=False)
class Loaded:
    """Motions of an arm with a load, and servos fitted to them.

    Attributes:
        motions: of the robot with the load.
        found: the servos.
        mass: of the load [kg].
        com: (3,) its centre of mass in the link's frame [m].
        std: (4,) half of the 95 % intervals of both, over that of a normal variable.
    """

    motions: Motions
    model: ServoModel
    mass: float
    com: Float[Tensor, "3"]
    std: Float[Tensor, "4"]


class _Load:
    """The rigid body's torques per mass and first moments of a load, in the rows of windows."""

    def __init__(self, data: PositionData, windows: Windows):
        self.data, self.point = data, data.outwards
        length = windows.length.tolist()
        self.rows = torch.cat(
            [torch.arange(a, a + n) for a, n in zip(windows.start.tolist(), length, strict=True)]
        )
        self.last = windows.length.cumsum(0) - 1
        bodies = data.robot.require_parameters("a load")
        moments = torch.eye(10, dtype=torch.float64)[1:4]
        self.plain = self._near(bodies.pi)
        self.per = []
        for column in (_ball(1.0, self.point), *moments):
            pi = bodies.pi.clone()
            pi[data.link] += column.to(pi)
            self.per.append(self._near(pi))

    def _near(self, pi: Tensor) -> Body:
        robot = self.data.robot.with_parameters(InertialParameters(pi))
        q, dq = self.data.q[self.rows], self.data.dq[self.rows]
        return body_near(robot, q, dq, self.data.link).midway(self.last)

    def carrying(self, x: Float[Tensor, "4"]) -> PositionData:
        """The motions with a load of mass and first moments x about the point, in those rows."""
        rows = self.data.body.rows.clone()
        pairs = zip(x.tolist(), self.per, strict=True)
        change = sum(size * (body.rows - self.plain.rows) for size, body in pairs)
        rows[self.rows] = self.plain.rows + change
        return replace(self.data, body=replace(self.data.body, rows=rows))

    def stronger(self, servos: Servos, x: Tensor, there: Tensor) -> Servos:
        """Servos for another load: their torques change as gravity's do, since it is mostly these
        two beside each other that motions tell."""
        before, after = (self.carrying(y).body.bias[self.rows].square().mean(0) for y in (x, there))
        joint = servos.joint.clone()
        ratio = (after / before.clamp(min=1e-12)).sqrt().clamp(1 / FAR, FAR)
        joint[:, [INDEX[name] for name in TORQUES]] *= ratio[:, None]
        return replace(servos, joint=joint)


def with_load(motions: Motions, model: ServoModel) -> Loaded | None:
    """The arm with a load that takes error away beside all servos; None where none does, or where
    its mass is not told from none.

    Args:
        motions: to fit to.
        model: servos, fitted without a load.
    """
    data, windows = motions.data, motions.windows
    load, x = _Load(data, windows), torch.zeros(4, dtype=torch.float64)
    names = tuple(name for name in model.free if name not in PROFILE)
    mask = torch.stack([model.free[name] for name in names], 1)
    at = torch.tensor([INDEX[name] for name in names])
    logs = torch.tensor([PARAMETERS[k].kind == "log" for k in at.tolist()])
    # What the link weighs, or a twentieth of the arm: steps and priors are shares of that.
    masses = data.robot.require_parameters("a load").mass
    mass = max(float(masses[data.link]), 0.05 * float(masses.sum()))
    size = mass * torch.cat([x.new_ones(1), load.point.norm().clamp(min=1e-3).expand(3)])
    spread = size * torch.tensor([3.0, 0.5, 0.5, 0.5])
    servos = model.servos
    for iteration in range(ITERATIONS):
        carried = load.carrying(x)
        s = sensitivities(carried, servos, names, windows)
        w = weights(s.residual, windows)
        square = mean_square(s.residual, w, windows)
        slopes = []
        for k in range(4):
            there = x.clone()
            there[k] += 0.02 * size[k]
            along = load.stronger(servos, x, there)
            error = errors_of_one(load.carrying(there), along, windows)
            slopes.append((error - s.residual) / (0.02 * size[k]))
        # Normal equations of every joint's servo (a), of the load (b), and between them.
        root = w.sqrt()[..., None]
        a = (s.slope * root).flatten(0, 1).transpose(0, 1) * mask[:, None]
        b = (torch.stack(slopes, -1) * root).flatten(0, 1).transpose(0, 1)
        r = (s.residual[..., None] * root).flatten(0, 1).transpose(0, 1)
        alike = TOGETHER_S / data.tracks.dt
        expected = torch.where(mask, prior_precision(names, square, alike), 1.0)
        gram = a.mT @ a + torch.diag_embed(expected)
        cross, pull = a.mT @ b, a.mT @ r
        # What servos can do in the load's place is no sign of it.
        alone = b - a @ torch.linalg.solve(gram, cross)
        prior = (alike * square.clamp(max=NOISE**2).mean() / spread**2).diag()
        reduced = (alone.mT @ b).sum(0) + prior
        towards = (alone.mT @ r).sum(0)[:, 0] + prior @ x
        step, began = -torch.linalg.solve(reduced, towards), x
        before = _total(carried, servos, windows)
        if iteration == 0:
            if not -float(towards @ step) > WORTH * before:
                return None
            x, servos = _begun(load, model, windows, size[0] * x.new_tensor(MASSES))
            if not bool(x.any()):
                return None  # servos do as well without any mass in front of the link
            continue
        answered = -torch.linalg.solve(gram, pull + cross @ step[:, None])[..., 0]
        # No further than logarithms may go.
        longest = float(torch.where(logs & mask, answered, 0.0).abs().amax())
        reach = min(1.0, LONGEST / max(longest, 1e-9))
        for share in (reach * part for part in SHARES):
            tried = searched(servos)
            tried[:, at] += share * answered
            there = x + share * step
            there[0] = there[0].clamp(min=0)
            moved_there = load.stronger(moved(servos, tried), x, there)
            after = _total(load.carrying(there), moved_there, windows)
            if after < before:
                break
        else:
            break
        servos, x = moved_there, there
        if after > (1 - HARDLY) * before:
            break
    # A search that has not come to rest knows no more than how far it still wants to go.
    still_to_go = x - (began + step)
    rows = float(alike_rows(s.residual, windows).mean())
    std = (_deviations(alone, r, prior, windows, rows).square() + still_to_go.square()).sqrt()
    # First moments without a mass are no body, nor has a load many times the arm's own: something
    # else bends these joints.
    if not HALF_95 * float(std[0]) < float(x[0]) < BEYOND_ROBOT * float(masses.sum()):
        return None
    std = std / torch.cat([x.new_ones(1), x[:1].expand(3)])
    com = load.point + x[1:] / x[0]
    robot = _carrying(data, float(x[0]), com)
    body = body_near(robot, data.q, data.dq, data.link).midway(data.tracks.last)
    heavy = Motions(replace(data, robot=robot, body=body), windows)
    carrying = replace(model, servos=servos).fitted(heavy, 2, plane=True)
    return Loaded(heavy, carrying, float(x[0]), com, std)


def _begun(
    load: _Load, model: ServoModel, windows: Windows, masses: Float[Tensor, " m"]
) -> tuple[Float[Tensor, "4"], Servos]:
    """The best of some loads at the point, with servos fitted beside it."""
    none = torch.zeros(4, dtype=torch.float64)
    best = _total(load.data, model.servos, windows), none, model.servos
    for mass in masses:
        x = none.clone()
        x[0] = mass
        carried, servos = load.carrying(x), load.stronger(model.servos, none, x)
        begun = replace(model, servos=servos)
        servos = begun.fitted(Motions(carried, windows), 4, plane=True).servos
        total = _total(carried, servos, windows)
        if total < best[0]:
            best = total, x, servos
    return best[1:]


def _deviations(
    columns: Tensor, residual: Tensor, prior: Tensor, windows: Windows, alike: float
) -> Tensor:
    """(4,) of mass and first moments, as `Equations.deviations` has those of servos: the larger of
    what motions and what noise tell.

    Args:
        columns, residual: (n, L W, 4 or 1), weighted, of every joint.
        prior: (4, 4) precision.
        windows: W of them.
        alike: rows whose errors are as good as one [1].
    """
    motions = int(windows.motion.max()) + 1
    of = windows.motion.repeat(columns.shape[1] // len(windows.motion))
    grams = torch.zeros(motions, 4, 4, dtype=columns.dtype)
    pulls = torch.zeros(motions, 4, dtype=columns.dtype)
    grams.index_add_(0, of, torch.einsum("jri,jrk->rik", columns, columns))
    pulls.index_add_(0, of, torch.einsum("jri,jr->ri", columns, residual[..., 0]))
    noise = alike * float(residual.square().sum()) / windows.rows / len(columns)
    spread = Spread.of(grams, pulls, prior, noise, torch.eye(4, dtype=columns.dtype))
    return spread.deviations(spread.excess)


def _carrying(data: PositionData, mass: float, com: Tensor) -> Robot:
    """The robot with a load."""
    pi = data.robot.require_parameters("a load").pi.clone()
    pi[data.link] += _ball(mass, com).to(pi)
    return data.robot.with_parameters(InertialParameters(pi))


def _ball(mass: float, com: Float[Tensor, "3"]) -> Float[Tensor, "10"]:
    """Inertial parameters of a small ball."""
    none = torch.zeros(1, 6, dtype=torch.float64)
    return InertialParameters.from_com(com.new_tensor([mass]), com[None], none).pi[0]


def _total(data: PositionData, servos: Servos, windows: Windows) -> float:
    return float(Motions(data, windows).losses(servos).sum())
