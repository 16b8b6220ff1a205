"""Backlash of a gear: the link flies from one flank to the other."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchid.effects.base import Coefficient, Columns, Effect, Example, ModelEffect, Motion
from torchid.effects.gear import Driven, Gear, joint_load, link_lags
from torchid.effects.variation import (
    OneJointEffect,
    link_lag_torque,
    needed,
    rigid_torque,
    secant_at,
)
from torchid.robot.model import Robot

STEP = 1.5
"""Ratio of plays that are tried, one to the next."""

IMPACTS = ((40.0, 0.5, 0.0), (20.0, 0.1, 0.1))
"""Contact [Hz], damping and drag [1] that a search begins with: a stiff flank that takes up the
impact, and a soft one on which the link bounces and swings in a bearing that brakes it."""

CONTACTS = tuple((10.0 * 1.2 ** np.arange(12)).tolist())
"""Contacts that are compared where impacts can be heard [Hz]."""

ROTORS = (0.0, 0.15, 0.3)
"""Rotors that are compared there [1]."""

FACTORS = {"at": STEP, "contact": 3.0, "ratio": 9.0, "drag": 9.0, "rotor": 2.0}
"""By which shapes are varied at first."""

WIDTHS = tuple((2e-4 * STEP ** np.arange(13)).tolist())
"""Plays that a search begins with [rad or m]: when a link lands depends on how far it flew, so that
the columns of plays that differ by more than a half have little in common."""


@dataclass(frozen=True)
class Backlash(OneJointEffect):
    """The gear has play, and the encoder is on the motor.

    Where the gear's torque changes sign the link leaves one flank, flies, and lands on the other:
    two masses with a stiff, damped gear beyond the play (see `gear`). The motor's motion drives the
    link, and the column is the secant of the model's torque in the play.

    Attributes:
        at: width of the play the secant is taken at [rad or m].
        contact: resonance of the link on its gear, at the mean of its inertia [Hz].
        ratio: damping of that, relative to the critical one.
        drag: damping of the flight between the flanks, relative to the same.
        rotor: inertia of the motor that the model has in its links, so that the flying link is
            lighter by it, relative to the least inertia that the joint moves.
    """

    at: float = 1e-3
    contact: float = IMPACTS[0][0]
    ratio: float = IMPACTS[0][1]
    drag: float = IMPACTS[0][2]
    rotor: float = 0.0

    name = "backlash"
    family = "hysteresis"
    branch = "transmission"
    needs = frozenset({"robot", "t"})
    jumps = True
    costly = True
    coefficients = (Coefficient("width", "rad", True, "angle between the flanks", 0.05),)
    meaning = "Gear teeth lose contact and cross the play when the torque reverses."
    equation = (
        "tau(q - d e_j, ..) - tau(q, ..), M_jj d'' + k dz(d) + D d' = tau_j(q, ..), dz what of d "
        "is beyond width/2, where alone k and D act"
    )
    signature = "pulses where the joint's torque, not its speed, changes sign"
    experiment = "bias the joint with a gravity load so that its torque does not change sign"
    remedy = (
        "Preload or adjust the gear; in the simulator, a joint of range `width` between motor and "
        "link."
    )
    source = (
        "Nordin and Gutman 2002, Controlling mechanical systems with backlash: a survey, "
        "Automatica 38(10), section 2"
    )
    example = Example((2e-3,), "time")

    @classmethod
    def starts(cls, robot: Robot) -> list[Effect]:
        """Plays of every other width on every joint, with each kind of impact."""
        places = itertools.product(range(robot.n), WIDTHS[::2], IMPACTS)
        return [cls(joint, width, *impact) for joint, width, impact in places]

    def between(self) -> "list[Backlash]":
        """The play of the next width; none where its own is none of `WIDTHS`."""
        return [replace(self, at=b) for a, b in itertools.pairwise(WIDTHS) if a == self.at]

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """Secant of the torque of all joints over the width of the play (T, n, 1)."""
        return next(self.columns_along([self], [motion], robot))[0]

    @classmethod
    def columns_along(
        cls, effects: Sequence[ModelEffect], motions: Sequence[Motion], robot: Robot | None = None
    ) -> Iterator[list[Columns]]:
        """Columns of several plays along several motions, the links of all of them side by side."""
        arm = needed(robot, cls.name)
        plays = [e for e in effects if isinstance(e, cls)]
        links, rotors, places = [], [], []
        rigid = [rigid_torque(arm, *m.state) for m in motions]
        for joint in dict.fromkeys(e.joint for e in plays):
            own = [e for e in plays if e.joint == joint]
            places.append((joint, [secant_at(e.at, 1e-7) for e in own]))
            contact, ratio, drag = zip(*((e.contact, e.ratio, e.drag) for e in own), strict=True)
            for motion, torque in zip(motions, rigid, strict=True):
                load, inertia = joint_load(arm, motion.state, joint, torque)
                inertia = inertia[:, joint, None]
                # Gradients leave the gear as it is, which its resonance with the body says.
                size = float(inertia.detach().abs().mean())
                gear = Gear.ringing(size, contact, ratio, places[-1][1], drag)
                # The motor has a part of the inertia, which does not fly; most often nothing.
                shares = [e.rotor for e in own]
                shares = shares if any(shares) else [0.0]
                rotor = float(inertia.detach().abs().min()) * inertia.new_tensor(shares)
                there = motion.ddq[:, joint, None].double() * rotor
                t = motion.require("t", cls.name)
                links.append(Driven(load[:, None] - there, inertia - rotor, t, gear))
                rotors.append(rotor)
        lags = zip(rotors, link_lags(links), strict=True)
        for joint, widths in places:
            changes = []
            for motion, torque, (rotor, lag) in zip(motions, rigid, lags, strict=False):
                change = link_lag_torque(arm, motion, joint, torque, *(x.T for x in lag))
                change[..., joint] += (rotor * lag.acceleration).T
                changes.append(change)
            for at, *torques in zip(widths, *changes, strict=True):
                pairs = zip(motions, torques, strict=True)
                yield [(x / at).to(motion.q).unsqueeze(-1) for motion, x in pairs]

    def around(self, level: int, interval: float) -> "list[Backlash]":
        """Plays, contacts and dampings a little larger and smaller: within the steps of `WIDTHS` at
        0, a third of that at 1, ..."""
        return [
            replace(self, **{name: getattr(self, name) * factor ** (sign * 3.0 ** -(level + 1))})
            for name, factor in FACTORS.items()
            if getattr(self, name) > 0
            for sign in (-2, -1, 1, 2)
        ]

    def sharp(self) -> "list[Backlash]":
        """Contacts from soft to stiff, with rotors, and dampings of both kinds of impact."""
        kinds = [(ratio, drag) for _, ratio, drag in IMPACTS]
        kinds.append((kinds[1][0] / 2, kinds[1][1] / 2))
        return [
            replace(self, contact=contact, ratio=ratio, drag=drag, rotor=rotor)
            for contact, (ratio, drag), rotor in itertools.product(CONTACTS, kinds, ROTORS)
        ]

    @property
    def ranges(self) -> tuple[tuple[float, float], ...]:
        """Plays for which the column at `at` is the nearest of those that are tried."""
        return ((self.at / STEP, self.at * STEP),)

    def unsure(self, values: Sequence[float]) -> list[float]:
        """The columns' width and the coefficient are two estimates of one play."""
        return [abs(values[0] - self.at)]

    def measured(
        self, motion: Motion, values: Sequence[float], robot: Robot | None = None
    ) -> Motion:
        """The torque of the link that flies, the motion being the motor's."""
        torque = motion.require("torque", self.name)
        own = replace(self, at=values[0]) if values[0] > 0 else self
        return motion._replace(torque=torque + own.all_torques(motion, values, robot).to(torque))
