"""A load that the robot's model does not have: a body of unknown mass at the last link but the jaw.

Every joint feels it through gravity and inertia, in a pattern that gains and offsets of single
joints can follow in part only. Its torques are linear in its mass and its first moments; they are
taken about a point in front of the link, and fitted together with all servos: what the servos can
do in its place is projected out joint by joint (the Schur complement of their normal equations).

No torque is measured, so a heavier load and stronger servos move nearly alike: the more so, the
less the arm's own masses weigh beside the load. No curvature at one mass tells how far that goes.
So servos and first moments are fitted beside one mass after the other, and what they leave says how
likely each is: the profile likelihood (Barndorff-Nielsen and Cox 1994, Inference and Asymptotics,
section 3.4), of which the interval is read.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchid.effects.servo import INDEX, PARAMETERS, TORQUES
from torchid.position.data import PositionData
from torchid.position.evidence import samples_of
from torchid.position.fit import (
    HARDLY,
    LONGEST,
    TOGETHER_S,
    errors_of_one,
    mean_square,
    moved,
    prior_precision,
    searched,
    sensitivities,
    weights,
)
from torchid.position.judge import alike_rows
from torchid.position.problem import some_of
from torchid.position.servo_model import Motions, ServoModel
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import PROFILE, Body, Windows, body_near
from torchid.statistics.criteria import BEYOND_ROBOT
from torchid.statistics.proportion import HALF_95
from torchid.typing import Bool, Float

FAR = 20.0
"""Times that torques change at most with a load [1]."""
SHARES = (1.0, 0.5, 0.2, 0.05)
"""Of a Gauss-Newton step, until one lowers the loss."""
MASSES = (0.3, 1.0, 3.0)
"""Of loads to begin with, beside the link's [1]."""
STEP = 1.4
"""From one mass that servos and first moments are fitted beside to the next [1]."""
ROUNDS = 4
"""Of Gauss-Newton beside a mass."""
ABOUT = 0.5
"""How far a load's centre is expected from its point, over the point's distance [1]."""
WORTH = 0.02
"""Share of all joints' loss that a load must promise to take away to be fitted [1]."""
MOST_WINDOWS = 100
"""That masses are tried in [1]: a load acts in all of them."""
LEAST = 0.01
"""The lightest load that is looked at, beside the link [1]."""
NEARER = 0.5
"""By which another place must be likelier to be the centre of a search [nats]."""
LESS_LIKELY = HALF_95**2 / 2
"""By which a mass is less likely than the best one at the ends of its 95 % interval [nats]."""


@dataclass(frozen=True, eq=False)
class Loaded:
    """Motions of an arm with a load, and servos fitted to them.

    Attributes:
        motions: of the robot with the load.
        model: the servos.
        mass: of the load [kg].
        between: ends of its 95 % interval, if the masses of the robot's file are right [kg].
        com: (3,) its centre of mass in the link's frame [m].
        std: (3,) half of the 95 % intervals of that, over that of a normal variable [m].
    """

    motions: Motions
    model: ServoModel
    mass: float
    between: tuple[float, float]
    com: Float[Tensor, "3"]
    std: Float[Tensor, "3"]


class _Load:
    """The rigid body's torques per mass and first moments of a load, in the rows of windows."""

    def __init__(self, data: PositionData, windows: Windows, scales: Bool[Tensor, " n"]):
        self.data, self.point, self.scales = data, data.outwards, scales
        length = windows.length.tolist()
        self.rows = torch.cat(
            [torch.arange(a, a + n) for a, n in zip(windows.start.tolist(), length, strict=True)]
        )
        self.last = windows.length.cumsum(0) - 1
        pi = data.robot.require_parameters("a load").pi
        self.plain = self._near(pi)
        changes = []
        for column in torch.eye(10, dtype=torch.float64):
            there = pi.clone()
            there[data.link] += column.to(pi)
            changes.append((self._near(there) - self.plain).flatten())
        self.changes = torch.stack(changes)
        self.carried = data.body.rows.clone()

    def _near(self, pi: Tensor) -> Tensor:
        robot = self.data.robot.with_parameters(InertialParameters(pi))
        q, dq = self.data.q[self.rows], self.data.dq[self.rows]
        return body_near(robot, q, dq, self.data.link).midway(self.last).rows

    def _body(self, x: Float[Tensor, "4"]) -> Body:
        """The body with a load, in those rows."""
        none = x.new_zeros(6)
        pi = _ball(x[0], self.point + x[1:] / x[0]) if x[0] > 0 else torch.cat([x, none])
        return Body(self.plain + (pi @ self.changes).view_as(self.plain), self.data.robot.n)

    def carrying(self, x: Float[Tensor, "4"]) -> PositionData:
        """The motions with a load of mass and first moments x about the point, in those rows; what
        was made before has this load, too."""
        self.carried[self.rows] = self._body(x).rows
        return replace(self.data, body=replace(self.data.body, rows=self.carried))

    def stronger(self, servos: Servos, x: Tensor, there: Tensor) -> Servos:
        """Servos for another load: where their gain is free, torques change as gravity's do, since
        it is mostly these two beside each other that motions tell."""
        before, after = (self._body(y).bias.square().mean(0) for y in (x, there))
        joint = servos.joint.clone()
        ratio = (after / before.clamp(min=1e-12)).sqrt().clamp(1 / FAR, FAR)
        ratio = torch.where(self.scales, ratio, 1.0)
        joint[:, [INDEX[name] for name in TORQUES]] *= ratio[:, None]
        return replace(servos, joint=joint)


@dataclass(frozen=True, eq=False)
class _Place:
    """Servos that were fitted beside a load.

    Attributes:
        x: (4,) mass and first moments of the load about its point [kg; kg m].
        servos: one set.
        losses: (n,) that they leave [rad^2].
        away: of the load from what is expected, in squares [1].
    """

    x: Float[Tensor, "4"]
    servos: Servos
    losses: Float[Tensor, " n"]
    away: float

    @property
    def mass(self) -> float:
        """Of the load [kg]."""
        return float(self.x[0])


class _Beside:
    """Fits of servos and of a load's first moments beside its mass."""

    def __init__(self, motions: Motions, model: ServoModel):
        self.motions, self.data, self.windows = motions, motions.data, motions.windows
        self.model = model
        self.load = _Load(motions.data, motions.windows, model.where_free("kp"))
        self.names = tuple(name for name in model.free if name not in PROFILE)
        self.mask = torch.stack([model.free[name] for name in self.names], 1)
        self.at = torch.tensor([INDEX[name] for name in self.names])
        self.logs = torch.tensor([PARAMETERS[k].kind == "log" for k in self.at.tolist()])
        self.together = TOGETHER_S / self.data.tracks.dt
        self.noise = self.together * float(self.data.slight.square().mean())
        masses = self.data.robot.require_parameters("a load").mass
        self.arm = float(masses.sum())
        self.link = max(float(masses[self.data.link]), 0.05 * self.arm)

    def place(self, x: Float[Tensor, "4"], servos: Servos) -> _Place:
        """Servos beside a load."""
        losses = Motions(self.load.carrying(x), self.windows).losses(servos).sum(0)
        return _Place(x, servos, losses, float((x / self.spread(x)).square().sum()))

    def spread(self, x: Float[Tensor, "4"]) -> Float[Tensor, "4"]:
        """What is expected: no load heavier than the arm, with its centre about the point."""
        far = ABOUT * float(self.load.point.norm().clamp(min=1e-3))
        return x.new_tensor([self.arm, *[(float(x[0]) or self.link) * far] * 3])

    def cost(self, place: _Place) -> float:
        """What a search lowers [rad^2]."""
        return float(place.losses.sum()) + self.noise * place.away

    def equations(self, place: _Place, which: slice) -> tuple[Tensor, ...]:
        """Normal equations of every joint's servo and of some of the load's Q numbers: (n, P, P)
        gram, (n, P, 1) pull and (n, P, Q) cross of the servos, and (Q, Q) gram and (Q,) pull of the
        load where the servos give way: what they can do in its place is no sign of it."""
        x, servos, load, windows = place.x, place.servos, self.load, self.windows
        s = sensitivities(load.carrying(x), servos, self.names, windows)
        w = weights(s.residual, windows)
        slopes, spread = [], self.spread(x)
        for unit in torch.eye(4, dtype=x.dtype)[which] * 0.02 * spread:
            there = x + unit
            error = errors_of_one(load.carrying(there), load.stronger(servos, x, there), windows)
            slopes.append((error - s.residual) / unit.sum())
        a, b, r = (
            (column * w.sqrt()[..., None]).flatten(0, 1).transpose(0, 1)
            for column in (s.slope, torch.stack(slopes, -1), s.residual[..., None])
        )
        a = a * self.mask[:, None]
        expected = prior_precision(self.names, mean_square(s.residual, w, windows), self.together)
        gram = a.mT @ a + torch.diag_embed(torch.where(self.mask, expected, 1.0))
        alone = b - a @ torch.linalg.solve(gram, a.mT @ b)
        prior = (self.noise / spread.square())[which]
        of_load = (alone.mT @ b).sum(0) + prior.diag()
        return gram, a.mT @ r, a.mT @ b, of_load, (alone.mT @ r).sum(0)[:, 0] + prior * x[which]

    def promised(self, none: _Place) -> float:
        """By how much a load lowers all joints' loss, as far as slopes tell [rad^2]."""
        *_, gram, pull = self.equations(none, slice(0, 4))
        return float(pull @ torch.linalg.solve(gram, pull))

    def fitted(self, place: _Place) -> _Place:
        """Servos and first moments as they are best beside the mass."""
        for _ in range(ROUNDS):
            gram, pull, cross, of_load, towards = self.equations(place, slice(1, 4))
            step = -torch.linalg.solve(of_load, towards)
            answered = -torch.linalg.solve(gram, pull + cross @ step[:, None])[..., 0]
            # No further than logarithms may go.
            longest = float(torch.where(self.logs & self.mask, answered, 0.0).abs().amax())
            reach = min(1.0, LONGEST / max(longest, 1e-9))
            before = place
            for share in SHARES:
                tried, there = searched(before.servos), before.x.clone()
                tried[:, self.at] += share * reach * answered
                there[1:] += share * reach * step
                servos = self.load.stronger(moved(before.servos, tried), before.x, there)
                place = min(before, self.place(there, servos), key=self.cost)
                if place is not before:
                    break
            if self.cost(place) > (1 - HARDLY) * self.cost(before):
                break
        return place

    def of_mass(self, place: _Place, mass: float) -> _Place:
        """The same load but heavier or lighter, with servos fitted beside it."""
        x = place.x * (mass / place.mass)
        return self.fitted(self.place(x, self.load.stronger(place.servos, place.x, x)))

    def begun(self, mass: float) -> _Place:
        """A load at the point, with servos fitted beside it."""
        none = torch.zeros(4, dtype=torch.float64)
        x = torch.cat([none.new_tensor([mass]), none[1:]])
        carried, servos = self.load.carrying(x), self.load.stronger(self.model.servos, none, x)
        model = replace(self.model, servos=servos).fitted(Motions(carried, self.windows), 4)
        return self.fitted(self.place(x, model.servos))


class _Profile:
    """Places beside one mass after the other, as far to both sides as they are likely."""

    def __init__(self, beside: _Beside, begun: _Place, most: float):
        windows, self.floor = beside.windows, beside.motions.slight
        error = errors_of_one(beside.load.carrying(begun.x), begun.servos, windows)
        alike = alike_rows(error, windows)
        self.samples = samples_of(beside.motions, self.floor, begun.losses, alike)
        self.places, before = [begun], math.inf
        # Servos that stick settle in many places: from the likeliest all others are fitted again.
        while before - self._misfit(centre := self.best) > NEARER:
            before = self._misfit(centre)
            for way in (STEP, 1 / STEP):
                self._walk(beside, centre, way, most)
        # The top of the parabola through the likeliest and those beside it.
        k = min(max(self.places.index(self.best), 1), len(self.places) - 2)
        if k > 0:
            three = self.places[k - 1 : k + 2]
            x, y = [math.log(p.mass) for p in three], [self.unlikely(p) for p in three]
            bend, slope, _ = np.polyfit(x, y, 2)
            top = -slope / (2 * bend) if bend > 0 else x[1]
            if x[0] < top < x[2]:
                self.places.append(beside.of_mass(three[1], math.exp(top)))
                self.places.sort(key=lambda place: place.mass)

    def _walk(self, beside: _Beside, place: _Place, way: float, most: float) -> None:
        """Places from one on, each fitted from that before, until one is too unlikely."""
        while LEAST * beside.link < place.mass * way < most:
            place = beside.of_mass(place, place.mass * way)
            known = [p for p in self.places if abs(math.log(p.mass / place.mass)) < 1e-6]
            place = min(place, *known, key=self._misfit) if known else place
            others = [p for p in self.places if p not in known]
            self.places = sorted([*others, place], key=lambda p: p.mass)
            if self.unlikely(place) > LESS_LIKELY:
                break

    def _misfit(self, place: _Place) -> float:
        logs = (place.losses + self.floor).log()
        return 0.5 * float((self.samples * logs).sum() + place.away)

    @property
    def best(self) -> _Place:
        """The likeliest."""
        return min(self.places, key=self._misfit)

    def unlikely(self, place: _Place) -> float:
        """By how much a place is less likely than the best one [nats]."""
        return self._misfit(place) - self._misfit(self.best)

    def between(self) -> tuple[float, float]:
        """Ends of the 95 % interval of the mass [kg]: along lines of its logarithm from place to
        place, or where the outermost places are."""
        k, ends = self.places.index(self.best), list[float]()
        for way in (self.places[k::-1], self.places[k:]):
            x, y = [math.log(p.mass) for p in way], [self.unlikely(p) for p in way]
            # Beyond the first that is too unlikely nothing counts.
            first = next((i for i, fall in enumerate(y) if fall > LESS_LIKELY), 0)
            two = slice(first - 1, first + 1)
            ends.append(math.exp(np.interp(LESS_LIKELY, y[two], x[two]) if first else x[-1]))
        return ends[0], ends[1]


def with_load(motions: Motions, model: ServoModel) -> Loaded | None:
    """The arm with a load that takes error away beside all servos; None where none does, where its
    mass is not told from none, or where the arm's own masses are not known.

    Args:
        motions: to fit to.
        model: servos, fitted without a load.
    """
    data, windows = motions.data, some_of(motions.windows, MOST_WINDOWS)
    if not data.weighed:
        return None
    beside = _Beside(Motions(data, windows), model)
    none = beside.place(torch.zeros(4, dtype=torch.float64), model.servos)
    if not beside.promised(none) > WORTH * float(none.losses.sum()):
        return None
    begun = min((beside.begun(share * beside.link) for share in MASSES), key=beside.cost)
    found = _Profile(beside, begun, most := BEYOND_ROBOT * beside.arm)
    best, (low, high) = found.best, found.between()
    # Nor is a body that weighs many times the arm a load: something else bends these joints.
    if found.unlikely(none) < LESS_LIKELY or best.mass * STEP > most:
        return None
    # Where the centre is goes with the mass, too.
    between = (p for p in found.places if p is best or low <= p.mass <= high)
    moments = [p.x[1:] / p.mass for p in between]
    com = beside.load.point + best.x[1:] / best.mass
    *_, gram, _ = beside.equations(best, slice(1, 4))
    std = (beside.noise * torch.linalg.inv(gram).diagonal()).sqrt() / best.mass
    spread = (torch.stack(moments) - best.x[1:] / best.mass).abs().amax(0)
    robot = _carrying(data, best.x[0], com)
    body = body_near(robot, data.q, data.dq, data.link).midway(data.tracks.last)
    heavy = Motions(replace(data, robot=robot, body=body), motions.windows)
    carrying = replace(model, servos=best.servos).fitted(heavy, 2, plane=True)
    return Loaded(heavy, carrying, best.mass, (low, high), com, std.hypot(spread / HALF_95))


def _carrying(data: PositionData, mass: Tensor, com: Tensor) -> Robot:
    """The robot with a load."""
    pi = data.robot.require_parameters("a load").pi.clone()
    pi[data.link] += _ball(mass, com).to(pi)
    return data.robot.with_parameters(InertialParameters(pi))


def _ball(mass: Float[Tensor, ""], com: Float[Tensor, "3"]) -> Float[Tensor, "10"]:
    """Inertial parameters of a small ball."""
    none = torch.zeros(1, 6, dtype=torch.float64)
    return InertialParameters.from_com(mass[None], com[None], none).pi[0]
