"""Which effects a format knows: attributes of its joints, and what is left beside them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from torchid.effects.base import Effect, JointEffect
from torchid.effects.registry import KINDS, Valued, nominal_effects
from torchid.robot.model import Robot

Target = Literal["mjcf", "urdf"]
"""Files of simulators."""
Fields = Target | Literal["usd"]
"""Formats with fields of joints."""

SAID: dict[Fields, frozenset[str]] = {
    "mjcf": frozenset({"damping", "friction", "armature", "stiffness", "offset"}),
    "urdf": frozenset({"damping", "friction"}),
    "usd": frozenset({"damping", "friction", "armature"}),
}
"""Fields of `JointDynamics` that a format has."""


@dataclass(frozen=True)
class JointDynamics:
    """Attributes of one joint.

    Attributes:
        damping: viscous friction Fv [N m s/rad; N s/m].
        friction: Coulomb friction Fc [N m; N]; `frictionloss` in MJCF.
        armature: rotor inertia Ia [kg m^2; kg].
        stiffness: of a straight spring, k [N m/rad; N/m].
        offset: torque of that spring at q = 0, c0 = -k springref [N m; N].
    """

    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    offset: float = 0.0

    @property
    def rest(self) -> float:
        """Position at which the spring is at rest, `springref` [rad; m]."""
        return -self.offset / self.stiffness if self.stiffness else 0.0


def attributes_in(to: Fields, effect: Effect, values: Sequence[float]) -> dict[str, float] | None:
    """What an effect adds to its joint's fields in a format; None where it has no field there."""
    added = effect.attributes(values)
    return added if added is not None and SAID[to].issuperset(added) else None


def kinds_in(to: Target) -> dict[type[JointEffect], tuple[str, ...]]:
    """Effects that a format's joints have fields for, and a field for each coefficient."""
    ones = {
        kind: attributes_in(to, kind.exemplar(0), [1.0] * len(kind.coefficients))
        for kind in KINDS.values()
        if issubclass(kind, JointEffect)
    }
    return {kind: tuple(added) for kind, added in ones.items() if added is not None}


def dynamics_of_links(robot: Robot, joints: Sequence[JointDynamics]) -> tuple[JointDynamics, ...]:
    """Attributes of the joints that move the L links, from those of the n coordinates: a joint that
    follows another has none, as they are part of that one's."""
    return tuple(
        JointDynamics() if drive in robot.mimics else joints[drive.coordinate]
        for drive in robot.drives
    )


def split(robot: Robot, to: Fields) -> tuple[tuple[JointDynamics, ...], tuple[Valued, ...]]:
    """Attributes of the n joints, and the effects that are not among them."""
    joints = [JointDynamics() for _ in range(robot.n)]
    rest: list[Valued] = []
    for effect, values in nominal_effects(robot):
        added = attributes_in(to, effect, values)
        if added is None:
            rest.append((effect, values))
            continue
        (j,) = effect.joints
        own = joints[j]
        joints[j] = replace(own, **{key: getattr(own, key) + v for key, v in added.items()})
    return tuple(joints), tuple(rest)
