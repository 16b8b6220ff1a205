"""Servos, which of their parameters are free, and what they leave of a log."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.effects.servo import INDEX, NAMES, PARAMETERS, ServoEffect
from torchid.position.data import PositionData, Usual
from torchid.position.effects import EFFECTS, KEPT
from torchid.position.fit import errors, errors_of_one, fit, huber, loss
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import Windows
from torchid.statistics.criteria import MOST_MOTIONS
from torchid.typing import Bool, Float

MATTERS = 0.02
"""Share of the largest gain of a motion from which another's counts [1]."""


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions of an arm, and the windows of them that are looked at."""

    data: PositionData
    windows: Windows

    def losses(self, servos: Servos) -> Float[Tensor, "W n"]:
        """Huber's losses of windows and joints [rad^2], as many times as each window stands for."""
        return huber(errors_of_one(self.data, servos, self.windows)) * self.windows.weight[:, None]

    def losses_of_sets(self, sets: Servos) -> Float[Tensor, "n P"]:
        """The same of P sets of servos, of all windows together."""
        return loss(errors(self.data, sets, self.windows), self.windows)

    @property
    def every(self) -> Bool[Tensor, " n"]:
        """All joints."""
        return torch.ones(self.data.robot.n, dtype=torch.bool)

    @property
    def slight(self) -> Float[Tensor, " n"]:
        """Losses that call for no cause [rad^2]."""
        return self.data.slight**2 * self.windows.rows

    def each(self, losses: Float[Tensor, "W n"]) -> Float[Tensor, "m n"]:
        """Sums over the windows of every motion."""
        motion = self.windows.motion
        out = torch.zeros(int(motion.max()) + 1, losses.shape[1], dtype=losses.dtype)
        return out.index_add_(0, motion, losses)


@dataclass(frozen=True, eq=False)
class ServoModel:
    """Servos, and which of their parameters were searched on which joints.

    Attributes:
        servos: one set.
        free: parameters with the joints (n,) on which they are free.
        plane: whether there is a plane.
    """

    servos: Servos
    free: Mapping[str, Bool[Tensor, " n"]]
    plane: bool = False

    def where_free(self, name: str) -> Bool[Tensor, " n"]:
        """(n,) joints on which a parameter is free."""
        return self.free.get(name, torch.zeros(self.servos.n, dtype=torch.bool))

    def where(self, effect: ServoEffect) -> Bool[Tensor, " n"]:
        """(n,) joints on which an effect is part of the model."""
        if not effect.parameters:
            return torch.full((self.servos.n,), self.plane)
        own = [name for name in effect.parameters if not PARAMETERS[INDEX[name]].shape]
        return torch.stack([self.where_free(name) for name in own]).any(0)

    @property
    def causes(self) -> int:
        """Effects beside plain servos, joint by joint; a plane is one."""
        named = (e for e in EFFECTS if e not in KEPT)
        return sum(int(self.where(e).sum()) if e.parameters else int(self.plane) for e in named)

    def at(self, joint: Float[Tensor, "n K"]) -> "ServoModel":
        """It with other values."""
        return replace(self, servos=replace(self.servos, joint=joint))

    def freed(self, names: Sequence[str], joints: Bool[Tensor, " n"]) -> "ServoModel":
        """It with parameters free on more joints."""
        more = {name: self.where_free(name) | joints for name in names}
        return replace(self, free={**self.free, **more})

    def joined(
        self, other: "ServoModel", joints: Bool[Tensor, " n"], names: Sequence[str] = NAMES
    ) -> "ServoModel":
        """It with another's servos on some joints, of which those parameters are free that are so
        there; or some parameters alone."""
        values = torch.where(joints[:, None], other.servos.joint, self.servos.joint)
        free = {
            name: torch.where(joints, other.where_free(name), self.where_free(name))
            for name in {**self.free, **other.free}
            if name in names
        }
        if names != NAMES:
            kept = [k for name, k in INDEX.items() if name not in names]
            values[:, kept] = self.servos.joint[:, kept]
        return replace(self.at(values), free={**self.free, **free})

    def beyond(self, effect: ServoEffect, usual: Usual) -> Bool[Tensor, " n"]:
        """(n,) joints on which a number that every servo has is larger than is usual."""
        return self.servos.of(effect.parameters[0]).abs() > usual[effect.parameters[0]]

    def without(
        self, effect: ServoEffect, joints: Bool[Tensor, " n"], usual: Usual
    ) -> "ServoModel":
        """It without an effect on some joints; of what every servo has without what is not
        usual."""
        if not effect.parameters:
            plane = self.servos.plane.clone()
            plane[4] = 0.0
            return ServoModel(replace(self.servos, plane=plane), self.free)
        # A shape stays where another effect has it.
        gone = dict.fromkeys(effect.parameters, joints)
        for other in EFFECTS:
            for name in {*other.parameters} & {*gone} if other != effect else ():
                gone[name] = gone[name] & ~self.where(other)
        values = self.servos.joint.clone()
        for name, on in gone.items():
            k = INDEX[name]
            most, there = usual.get(name), values[:, k]
            less = PARAMETERS[k].neutral if most is None else there.clamp(-most, most)
            values[:, k] = torch.where(on, less, there)
        free = {name: on & ~gone.get(name, ~on) for name, on in self.free.items()}
        free = {name: on for name, on in free.items() if bool(on.any())}
        return replace(self.at(values), free=free)

    def fitted(
        self,
        motions: Motions,
        iterations: int,
        *,
        joints: Bool[Tensor, " n"] | None = None,
        plane: bool = False,
    ) -> "ServoModel":
        """It fitted to motions, on some joints alone if asked; the plane's numbers too if
        asked (`fit.fit`)."""
        free = self.free
        if joints is not None:
            free = {name: on & joints for name, on in free.items()}
        servos = fit(
            motions.data, self.servos, free, motions.windows,
            plane=plane and self.plane, iterations=iterations,
        )  # fmt: skip
        return replace(self, servos=servos)

    def losses(self, motions: Motions) -> Float[Tensor, " n"]:
        """(n,) losses [rad^2]."""
        return motions.losses(self.servos).sum(0)


def mostly_better(gain: Float[Tensor, "m n"]) -> Bool[Tensor, " n"]:
    """(n,) whether most motions gain of those that it matters to."""
    matters = gain.abs() > MATTERS * gain.abs().amax(0)
    better = ((gain > 0) & matters).sum(0)
    return (better > MOST_MOTIONS * matters.sum(0)) & (gain.sum(0) > 0)


def better_in_sum(gain: Float[Tensor, "m n"]) -> Bool[Tensor, " n"]:
    """(n,) whether motions gain more than others lose: what acts at the ends of the travel alone
    matters to few motions, by how much and not to how many counts."""
    return gain.clamp(min=0).sum(0) > MOST_MOTIONS * gain.abs().sum(0)
