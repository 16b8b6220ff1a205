"""Which effects a format knows: attributes of its joints, and what is left beside them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from torchid.effects.base import Effect, JointEffect
from torchid.effects.friction_laws import PowerLawFriction
from torchid.effects.registry import KINDS, Valued, nominal_effects
from torchid.robot.model import Robot

Target = Literal["mjcf", "urdf"]
"""Files of simulators."""

SAID: dict[Target, frozenset[str]] = {
    "mjcf": frozenset(
        {"damping", "quadratic", "cubic", "friction", "armature", "stiffness", "offset"}
    ),
    "urdf": frozenset({"damping", "friction"}),
}
"""Fields of `JointDynamics` that a format has."""
CURVES = {2.0: "quadratic", 3.0: "cubic"}
"""Powers of the speed that the damping of an MJCF has beside the first (MuJoCo 3.11 and later)."""


@dataclass(frozen=True)
class JointDynamics:
    """Attributes of one joint.

    Attributes:
        damping: viscous friction Fv [N m s/rad; N s/m].
        quadratic, cubic: of the damper's torque damping dq + quadratic |dq| dq + cubic dq^3
            [N m s^2/rad^2, N m s^3/rad^3; N s^2/m^2, N s^3/m^3].
        friction: Coulomb friction Fc [N m; N]; `frictionloss` in MJCF.
        armature: rotor inertia Ia [kg m^2; kg].
        stiffness: of a straight spring, k [N m/rad; N/m].
        offset: torque of that spring at q = 0, c0 = -k springref [N m; N].
    """

    damping: float = 0.0
    quadratic: float = 0.0
    cubic: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    offset: float = 0.0

    @property
    def rest(self) -> float:
        """Position at which the spring is at rest, `springref` [rad; m]."""
        return -self.offset / self.stiffness if self.stiffness else 0.0

    @property
    def resists(self) -> bool:
        """Whether the damper drives the joint at no speed."""
        least = min(self.damping, self.cubic)
        return least >= 0 and self.quadratic >= -2 * math.sqrt(self.damping * self.cubic)


def attributes_in(to: Target, effect: Effect, values: Sequence[float]) -> dict[str, float] | None:
    """What an effect adds to its joint's fields in a format; None where it has no field there."""
    added = effect.attributes(values)
    if isinstance(effect, PowerLawFriction) and effect.a in CURVES:
        added = {CURVES[effect.a]: values[0]}
    return added if added is not None and SAID[to].issuperset(added) else None


def kinds_in(to: Target) -> dict[Callable[[int], JointEffect], tuple[str, ...]]:
    """Effects, by their joint, that a format has fields for, and a field for each coefficient."""
    ones: dict[Callable[[int], JointEffect], Effect] = {
        kind: kind.exemplar(0)
        for kind in KINDS.values()
        if issubclass(kind, JointEffect) and kind is not PowerLawFriction
    }
    ones |= {partial(PowerLawFriction, a=a): PowerLawFriction(0, a) for a in CURVES}
    fields = {kind: attributes_in(to, e, [1.0] * len(e.coefficients)) for kind, e in ones.items()}
    return {kind: tuple(added) for kind, added in fields.items() if added is not None}


def dynamics_of_links(robot: Robot, joints: Sequence[JointDynamics]) -> tuple[JointDynamics, ...]:
    """Attributes of the joints that move the L links, from those of the n coordinates: a joint that
    follows another has none, as they are part of that one's."""
    return tuple(
        JointDynamics() if drive in robot.mimics else joints[drive.coordinate]
        for drive in robot.drives
    )


def split(robot: Robot, to: Target) -> tuple[tuple[JointDynamics, ...], tuple[Valued, ...]]:
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
