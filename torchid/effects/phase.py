"""Effects seen as phase: torque or motion that is measured late, and joints that give way."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from torch import Tensor

from torchid.effects.base import Coefficient, Columns, Example, ModelEffect, Motion
from torchid.effects.gear import Gear, joint_load, link_lag
from torchid.effects.instants import derivative, interval, shifted
from torchid.effects.variation import (
    OneJointEffect,
    link_lag_torque,
    needed,
    on_joint,
    rigid_torque,
    secant_at,
    with_joint,
)
from torchid.log.filtering import low_passed
from torchid.robot.model import Robot
from torchid.typing import Float

LOSSES = tuple((5e-4 * 2.0 ** np.arange(7)).tolist())
"""Damping over stiffness of gears that are tried where a link may swing [s]: at 10 Hz a damping
ratio of 1.6 % to 1."""

SOFTER = tuple((0.25 * 1.2 ** np.arange(11)).tolist())
"""Compliances that are tried there, relative to the one that a quasi-static fit finds: near the
resonance it takes the swing for more deflection."""


@dataclass(frozen=True)
class TimeDelay(OneJointEffect):
    """A joint's torque is measured late: at t it reads what it was at t - d.

    The column is -d tau/dt, the first term in d; or the secant [tau(t - at) - tau(t)] / at, exact
    for a delay of `at`.

    Attributes:
        at: delay the secant is taken at [s]; 0 for the derivative.
    """

    at: float = 0.0

    name = "time_delay"
    family = "phase"
    branch = "sensing"
    of_sensor = True
    needs = frozenset({"torque", "t"})
    logs_late = "torque"
    coefficients = (Coefficient("delay", "s", True, "by which the torque is late", 0.1),)
    meaning = "The torque is filtered or stamped later than the position."
    equation = "tau_j(t - delay) - tau_j(t)"
    signature = "a phase that grows with frequency"
    experiment = "repeat the motion at half the speed"
    beyond = "stamp both signals with one clock"
    remedy = "Shift the torque's stamps back by the delay, or filter both alike."
    source = (
        "Taylor series of tau(t - d); Swevers, Verdonck and De Schutter 2007, Dynamic model "
        "identification for industrial robots, IEEE Control Systems Magazine 27(5)"
    )
    example = Example((0.01,), "time")
    shared = True
    smooth = True
    linearised = True

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """-d tau/dt of the joint's own torque (T, n, 1), or its secant."""
        torque, t = motion.require("torque", self.name), motion.require("t", self.name)
        own = torque[:, self.joint, None]
        late = (shifted(own, t, -self.at) - own) / self.at if self.at > 0 else -derivative(own, t)
        return on_joint(late[:, 0], self.joint, torque.shape[1])

    def measured(
        self, motion: Motion, values: Sequence[float], robot: Robot | None = None
    ) -> Motion:
        """The joint's torque, late."""
        torque, t = motion.require("torque", self.name), motion.require("t", self.name)
        late = torque.clone()
        late[:, self.joint] = shifted(torque[:, self.joint, None], t, -values[0])[:, 0]
        return motion._replace(torque=late)


@dataclass(frozen=True)
class FilterLag(ModelEffect):
    """Velocity is measured late on all joints, and acceleration is differentiated from it.

    At t the log has dq(t - d) and ddq(t - d) with q(t). The column is the secant of the model's
    torque over the advance: [tau(q, dq(t + at), ddq(t + at)) - tau(q, dq, ddq)] / at.

    Attributes:
        at: lag the secant is taken at [s].
    """

    at: float = 1e-3

    name = "filter_lag"
    family = "phase"
    branch = "sensing"
    of_sensor = True
    needs = frozenset({"robot", "t", "velocity"})
    logs_late = "velocity"
    coefficients = (
        Coefficient("lag", "s", True, "by which velocity and acceleration are late", 0.1),
    )
    gloss = "dq is late"
    meaning = "The controller's velocity filter delays dq and what follows from it."
    equation = "tau(q, dq(t + lag), ddq(t + lag)) - tau(q, dq, ddq)"
    signature = "a phase of velocity and acceleration alone, on all joints; moves with the cut-off"
    experiment = "repeat the diagnosis at two cut-offs, and the motion at two speeds"
    beyond = "record the unfiltered signals"
    remedy = "Differentiate q with a zero-phase filter, or advance dq by the lag."
    source = (
        "group delay of a causal low-pass; Gautier 1997, Dynamic identification of robots with "
        "power model, ICRA, on zero-phase filtering of dq and ddq"
    )
    example = Example((0.01,), "time")
    smooth = True
    linearised = True

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """Secant of the torque over the advance of velocity and acceleration (T, n, 1)."""
        arm, t = needed(robot, self.name), motion.require("t", self.name)
        at = secant_at(self.at, 1e-6)
        q, dq, ddq = motion.state
        early = rigid_torque(arm, q, shifted(dq.double(), t, at), shifted(ddq.double(), t, at))
        return ((early - rigid_torque(arm, q, dq, ddq)) / at).to(q).unsqueeze(-1)

    def measured(
        self, motion: Motion, values: Sequence[float], robot: Robot | None = None
    ) -> Motion:
        """Velocity and acceleration, late."""
        t = motion.require("t", self.name)
        late = (shifted(x, t, -values[0]) for x in (motion.dq, motion.ddq))
        return motion._replace(**dict(zip(("dq", "ddq"), late, strict=True)))


@dataclass(frozen=True)
class JointElasticity(OneJointEffect):
    """The joint's transmission is a spring: the link lags the motor, whose encoder is logged, by
    the torque times the compliance. Quasi-static: the motor's own motion is as measured, and the
    link follows without ringing.

        q_link = q_motor - c tau,    likewise for velocity and acceleration

    The column is the secant [tau(q - at tau_j e_j, ...) - tau(q, ...)] / at. The torque in it is
    the model's, corrected once for the deflection it causes, so that with `at` at the true
    compliance what is left is of third order in it. The correction differentiates twice more than
    the column, so beyond the joint's resonance it would be noise: it is low-passed.

    Where the gear's damping is known, the link swings instead (see `gear`).

    Attributes:
        at: compliance the secant is taken at [rad/(N m) or m/N].
        band: cut-off of the correction [Hz]; well above that of the rows.
        damping: of the gear [N m s/rad or N s/m]; 0 for a link that does not ring.
    """

    at: float = 1e-5
    band: float = 20.0
    damping: float = 0.0

    name = "joint_elasticity"
    family = "phase"
    branch = "transmission"
    elastic = True
    needs = frozenset({"robot", "torque", "t"})
    coefficients = (
        Coefficient("compliance", "rad/(N m)", True, "deflection per torque, 1/K", 0.2),
    )
    meaning = "Gears and torque sensors twist under load, so the link lags the motor."
    equation = (
        "tau(q - compliance tau_j e_j, ..) - tau(q, ..), likewise dq and ddq with the derivatives "
        "of tau_j"
    )
    signature = "gravity-shaped like an offset that follows the load, and strong at high frequency"
    experiment = "excite the joint with a chirp, or measure on the link's side"
    beyond = "measure on the link's side, or excite the joint with a chirp"
    remedy = (
        "Give the joint a spring of stiffness 1/compliance between motor and link in the "
        "simulator, or measure the link's position."
    )
    source = (
        "Spong 1987, Modeling and control of elastic joint robots, J. Dyn. Sys. Meas. Control "
        "109(4)"
    )
    example = Example((1e-4,), "time")
    smooth = True
    linearised = True

    @classmethod
    def columns_of(
        cls, effects: Sequence[ModelEffect], motion: Motion, robot: Robot | None = None
    ) -> Iterator[Columns]:
        """Columns of several elastic joints; links that swing on one joint side by side."""
        arm, t = needed(robot, cls.name), motion.require("t", cls.name)
        rigid = rigid_torque(arm, *motion.state)
        elastic = [e for e in effects if isinstance(e, cls)]
        found: dict[JointElasticity, Columns] = {}
        for joint in dict.fromkeys(e.joint for e in elastic if e.damping > 0):
            own = [e for e in elastic if e.joint == joint and e.damping > 0]
            at = np.array([secant_at(e.at, 1e-10) for e in own])
            load, column = joint_load(arm, motion.state, joint, rigid)
            gear = Gear(1 / at, np.array([e.damping for e in own]), 0 * at, 0 * at)
            lags = link_lag(load[:, None], column[:, joint, None], t, gear)
            change = link_lag_torque(arm, motion, joint, rigid, *(x.T for x in lags))
            for e, a, torque in zip(own, at.tolist(), change, strict=True):
                found[e] = (torque / a).to(motion.q).unsqueeze(-1)
        for e in elastic:
            yield found[e] if e in found else e._deflected(motion, arm, rigid)

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """Secant of the torque of all joints over the joint's compliance (T, n, 1)."""
        return next(self.columns_of([self], motion, robot))

    def _deflected(self, motion: Motion, arm: Robot, rigid: Float[Tensor, "T n"]) -> Columns:
        """Columns of a link that does not ring."""
        t = motion.require("t", self.name)
        at = secant_at(self.at, 1e-10)
        load = motion.require("torque", self.name)[:, self.joint].double()
        # Twice: the deflection changes the torque that causes it.
        change = self._change(arm, motion, rigid, at * load)[:, self.joint]
        # Two instants are needed for a rate to filter at.
        load = load + (low_passed(change, 1 / interval(t), self.band) if len(t) > 1 else change)
        return (self._change(arm, motion, rigid, at * load) / at).to(motion.q).unsqueeze(-1)

    def sharp(self) -> "list[JointElasticity]":
        """Links that swing, of several compliances and dampings."""
        tried = itertools.product(SOFTER, LOSSES)
        return [replace(self, at=self.at * c, damping=d / (self.at * c)) for c, d in tried]

    def around(self, level: int, interval: float) -> "list[JointElasticity]":
        """Neighbours of a link that swings: compliances and dampings a little larger and smaller,
        by a tenth and a third at level 0, a third of that at 1, ..."""
        if self.damping == 0:
            return []
        fine = 3.0**-level
        steps = [
            (1.1 ** (a * fine), 1.4 ** (b * fine))
            for a, b in itertools.product((-1, 0, 1), repeat=2)
            if a or b
        ]
        return [replace(self, at=self.at * c, damping=self.damping * d) for c, d in steps]

    def _change(
        self, robot: Robot, motion: Motion, rigid: Float[Tensor, "T n"], lag: Float[Tensor, " T"]
    ) -> Float[Tensor, "T n"]:
        """Change of the torque by a deflection."""
        t = motion.require("t", self.name)
        rate = derivative(lag, t)
        return link_lag_torque(robot, motion, self.joint, rigid, lag, rate, derivative(rate, t))

    def measured(
        self, motion: Motion, values: Sequence[float], robot: Robot | None = None
    ) -> Motion:
        """The motor's motion in place of the link's."""
        load = motion.require("torque", self.name)[:, self.joint]
        t = motion.require("t", self.name)
        ahead = values[0] * load
        rate = derivative(ahead, t)
        return motion._replace(
            q=with_joint(motion.q, self.joint, ahead),
            dq=with_joint(motion.dq, self.joint, rate),
            ddq=with_joint(motion.ddq, self.joint, derivative(rate, t)),
        )
