"""The causes that a search over commands and positions looks for, by name."""

from torchid.effects.registry import KINDS
from torchid.effects.servo import SERVO_KINDS, ServoEffect

CORE = ("kp", "damping", "armature", "delay", "offset", "coulomb")
"""What every fit has: a gain, viscous and dry friction, an inertia, a delay and an offset."""

_FAMILIES = {
    "torque_offset": "servo",
    "viscous_friction": "friction",
    "coulomb_friction": "friction",
    "rotor_inertia": "inertia",
    "stribeck_friction": "friction",
    "load_dependent_friction": "friction",
    "end_stop": "world",
    "plane_contact": "world",
    "payload": "inertia",
}
"""Families, in this answer, of the effects that add torque."""

_OFFSET = (
    "A constant torque pulls at the joint: gravity that the model lacks, or a wrong zero.",
    "Set the joint's zero anew, and the load that the arm carries.",
)
"""Meaning and remedy of a torque offset where no torque is measured."""

_ORDER = (
    "command_delay", "set_point_profile", "set_point_speed", "command_filter", "command_gain",
    "derivative_gain", "integral_action", "saturation", "dead_zone", "torque_offset",
    "stribeck_friction", "load_dependent_friction", "motor_dependent_friction", "end_stop",
    "plane_contact",
)  # fmt: skip


def _effect(name: str) -> ServoEffect:
    """A cause as it shows itself under a servo."""
    if name not in _FAMILIES:
        return SERVO_KINDS[name]
    kind = KINDS[name]
    meaning, remedy = _OFFSET if name == "torque_offset" else (kind.meaning, kind.remedy)
    return ServoEffect(
        name,
        _FAMILIES[name],
        kind.servo,
        meaning,
        remedy,
        kind.equation,
        kind.experiment,
        gloss=kind.gloss,
    )


EFFECTS = tuple(map(_effect, _ORDER))
PAYLOAD, GRAVITY = _effect("payload"), _effect("gravity_compensation")
"""Beside `EFFECTS`: not a servo's, but the robot's."""
GAINS = tuple(
    map(_effect, ("proportional_gain", "viscous_friction", "coulomb_friction", "rotor_inertia"))
)
"""Numbers that every servo has: causes where a file has others."""
BY_NAME = {effect.name: effect for effect in (*EFFECTS, *GAINS)}
KEPT = ("command_delay", "torque_offset")
"""What is part of every model, named or not."""


def experiment_of(name: str) -> str:
    """The motion in which an effect of a servo, or of the robot, shows itself."""
    return next(e for e in (*BY_NAME.values(), PAYLOAD, GRAVITY) if e.name == name).experiment
