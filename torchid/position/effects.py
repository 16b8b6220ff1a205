"""The causes that a search over commands and positions looks for, by name."""

from torchid.effects.registry import KINDS
from torchid.effects.servo import SERVO_KINDS, ServoEffect

CORE = ("kp", "damping", "armature", "delay", "offset", "coulomb")
"""What every fit has: a gain, viscous and dry friction, an inertia, a delay and an offset."""
KEPT_NUMBERS = ("delay", "offset")
"""Of them those that are causes beyond what is usual even where no file has others."""

_FAMILIES = {"speed": "friction", "sign": "friction", "constant": "servo", "transient": "world"}
"""Families, in this answer, of effects that add torque."""

_OFFSET = (
    "A constant torque pulls at the joint: gravity that the model lacks, or a wrong zero.",
    "Set the joint's zero anew, and the load that the arm carries.",
)
"""Meaning and remedy of a torque offset where no torque is measured."""


def _effect(name: str) -> ServoEffect:
    """A cause as it shows itself under a servo."""
    if name in SERVO_KINDS:
        return SERVO_KINDS[name]
    kind = KINDS[name]
    meaning, remedy = _OFFSET if name == "torque_offset" else (kind.meaning, kind.remedy)
    return ServoEffect(
        name,
        _FAMILIES.get(kind.family, kind.family),
        kind.servo,
        meaning,
        remedy,
        kind.equation,
        kind.experiment,
        gloss=kind.gloss,
    )


PAYLOAD, GRAVITY = _effect("payload"), _effect("gravity_compensation")
"""Not a servo's, but the robot's."""
_SERVOS = [
    _effect(name) for name in (*SERVO_KINDS, *(k for k, kind in KINDS.items() if kind.servo))
]
GAINS = tuple(e for e in _SERVOS if e.parameters and {*e.parameters} <= {*CORE} - {*KEPT_NUMBERS})
"""Numbers that every servo has: causes where a file has others."""
EFFECTS = (*(e for e in _SERVOS if e not in GAINS and e != GRAVITY), _effect("plane_contact"))
"""What plain servos may lack."""
BY_NAME = {effect.name: effect for effect in (*EFFECTS, *GAINS)}
KEPT = tuple(e for e in EFFECTS if {*e.parameters} & {*KEPT_NUMBERS})
"""Effects that are part of every model, named or not."""


def experiment_of(name: str) -> str:
    """The motion in which an effect of a servo, or of the robot, shows itself."""
    return next(e for e in (*BY_NAME.values(), PAYLOAD, GRAVITY) if e.name == name).experiment
