"""Which effects a format knows: joint attributes of URDF and MJCF, and what is left beside them."""

from dataclasses import dataclass, replace

from torchid.effects.registry import Valued, nominal_effects
from torchid.robot.model import Robot


@dataclass(frozen=True)
class JointDynamics:
    """Attributes of one joint.

    Attributes:
        damping: viscous friction Fv [N m s/rad; N s/m].
        friction: Coulomb friction Fc [N m; N]; `frictionloss` in MJCF.
        armature: rotor inertia Ia [kg m^2; kg]; MJCF only.
        stiffness: of a straight spring, k [N m/rad; N/m]; MJCF only.
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


def split(robot: Robot, *, mjcf: bool) -> tuple[tuple[JointDynamics, ...], tuple[Valued, ...]]:
    """Attributes of the n joints, and the effects that are not among them."""
    joints = [JointDynamics() for _ in range(robot.n)]
    rest: list[Valued] = []
    for effect, values in nominal_effects(robot):
        added = effect.attributes(values, mjcf)
        if added is None:
            rest.append((effect, values))
            continue
        (j,) = effect.joints
        own = joints[j]
        joints[j] = replace(own, **{key: getattr(own, key) + v for key, v in added.items()})
    return tuple(joints), tuple(rest)
