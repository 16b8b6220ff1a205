"""Gears that give way, between motors that are states and joints that a simulator steps.

    I th'' = tau - f        f = k dz(th - q) + D (th' - q')

th is the motor's angle, which the encoder reads, I its inertia (the joint's armature), q the link's
and dz(..) what of the twist lies beyond the play, within which D is the bearing's drag. Written at
the end of a step of length h, with G = D + h k, the motor's new speed can be eliminated:

    f = a - b q',    a = (I push + G (I th' + h tau)) / (I + h G),    b = G I / (I + h G)

with push = k dz at the beginning. A simulator that meets joint damping implicitly (MuJoCo's Euler
and implicit integrators) takes a as a force and b as damping, and both masses are stepped by
backward Euler together: stable however stiff the gear is. Whether the flanks touch at the end of a
step is predicted from the speeds at its beginning.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import torch

from torchid.effects.backlash import Backlash
from torchid.effects.gear import Gear
from torchid.effects.phase import JointElasticity
from torchid.effects.registry import Valued
from torchid.typing import Float, Tensor

QUIET = 1.0
"""Damping, relative to the critical one, of a gear whose link is said not to ring."""


class Law(NamedTuple):
    """Torque on the links at the end of a step, `force` - `damping` q' (B, J), and what the motors
    need for theirs."""

    force: Float[Tensor, "B J"]
    damping: Float[Tensor, "B J"]
    push: Float[Tensor, "B J"]
    stiff: Float[Tensor, "B J"]
    torque: Float[Tensor, "B J"]


@dataclass(eq=False)
class Gears:
    """The gears of J joints in B simulations.

    Attributes:
        joints: from 0.
        effects: per joint its elasticity and its play, those that it has.
        inertia: (J,) of the motors [kg m^2; kg].
        stiffness, damping, play, drag: (B, J) once started.
        angle, rate: (B, J) of the motors [rad, rad/s; m, m/s].
    """

    joints: list[int]
    effects: list[dict[type, Valued]]
    inertia: Float[Tensor, " J"]
    stiffness: Float[Tensor, "B J"] = field(init=False)
    damping: Float[Tensor, "B J"] = field(init=False)
    play: Float[Tensor, "B J"] = field(init=False)
    drag: Float[Tensor, "B J"] = field(init=False)
    angle: Float[Tensor, "B J"] = field(init=False)
    rate: Float[Tensor, "B J"] = field(init=False)

    @staticmethod
    def of(pairs: Sequence[Valued], armature: Float[Tensor, " n"]) -> "Gears | None":
        """The gears among effects; None without any."""
        own: dict[int, dict[type, Valued]] = {}
        for effect, values in pairs:
            if isinstance(effect, JointElasticity | Backlash) and values[0] > 0:
                own.setdefault(effect.joint, {})[type(effect)] = (effect, values)
        joints = sorted(own)
        return Gears(joints, [own[j] for j in joints], armature[joints]) if joints else None

    def start(
        self,
        q: Float[Tensor, "B n"],
        dq: Float[Tensor, "B n"],
        load: Float[Tensor, "B n"],
        mass: Float[Tensor, "B n n"],
    ) -> None:
        """Motors as far ahead of their links as these ask for.

        Args:
            q, dq: of the links.
            load: torque that keeps them on their way.
            mass: matrix there, by which gears that are known by their resonance ring.
        """
        self.play = torch.zeros(len(q), len(self.joints), dtype=torch.float64)
        self.stiffness, self.damping, self.drag = (torch.zeros_like(self.play) for _ in range(3))
        for k, (j, own) in enumerate(zip(self.joints, self.effects, strict=True)):
            link = mass[:, j, j]
            if Backlash in own:
                effect, values = own[Backlash]
                assert isinstance(effect, Backlash)
                unit = Gear.ringing(1.0, effect.contact, effect.ratio, drag=effect.drag)
                self.play[:, k] = values[0]
                self.stiffness[:, k] = link * float(unit.stiffness[0])
                self.damping[:, k] = link * float(unit.damping[0])
                self.drag[:, k] = link * float(unit.drag[0])
            if JointElasticity in own:
                effect, values = own[JointElasticity]
                assert isinstance(effect, JointElasticity)
                self.stiffness[:, k] = 1 / values[0]
                # The two masses swing against each other.
                i = self.inertia[k]
                swinging = link * i / (link + i) if i > 0 else link
                critical = 2 * (swinging / values[0]).sqrt()
                self.damping[:, k] = effect.damping if effect.damping > 0 else QUIET * critical
        carried = load[:, self.joints]
        self.angle = q[:, self.joints] + carried / self.stiffness + carried.sign() * self.play / 2
        self.rate = dq[:, self.joints].clone()

    def law(
        self,
        q: Float[Tensor, "B n"],
        dq: Float[Tensor, "B n"],
        torque: Float[Tensor, "B n"],
        h: float,
    ) -> Law:
        """What acts on the links during a step.

        Args:
            q, dq: of the links at its beginning.
            torque: of the motors.
            h: its length [s].
        """
        twist, tau = self.angle - q[:, self.joints], torque[:, self.joints]
        # On which flank, if on any, the gear is when the step ends.
        then = twist + h * (self.rate - dq[:, self.joints])
        touching = then.abs() >= self.play / 2
        push = self.stiffness * (twist - then.sign() * self.play / 2)
        # A flank pushes and does not pull.
        pull = push + self.damping * (self.rate - dq[:, self.joints])
        touching &= (self.play == 0) | (pull * then.sign() >= 0)
        k, push = self.stiffness * touching, push * touching
        stiff = torch.where(touching, self.damping, self.drag) + h * k
        i = self.inertia
        force = (i * push + stiff * (i * self.rate + h * tau)) / (i + h * stiff)
        return Law(force, stiff * i / (i + h * stiff), push, stiff, tau)

    def advance(self, law: Law, dq: Float[Tensor, "B n"], h: float) -> None:
        """The motors after a step at whose end the links move with dq."""
        i, links = self.inertia, dq[:, self.joints]
        moved = i * self.rate + h * (law.torque - law.push + law.stiff * links)
        self.rate = moved / (i + h * law.stiff)
        self.angle = self.angle + h * self.rate
