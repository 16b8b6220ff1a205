"""What may stand between a command and a position beside what adds torque to the rigid body: the
command on its way, and the servo itself.

Causes that add torque are effects like all others (`torchid.effects.registry`); `servo` of their
class says which numbers of a servo they are in logs of commands and positions.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ServoEffect:
    """One cause of a position error under a servo.

    Attributes:
        name, family: as in the answer.
        parameters: of `torchid.simulation.servo.PARAMETERS` that it needs, the one that gives its
            size first.
        meaning, remedy: one sentence each.
        gloss: what its name says, in a few plain words; empty where it is everybody's.
        equation: in the names of the parameters; u is the command, x the set-point, e = x - q.
        experiment: the motion in which it shows itself.
        twin: a cause that is not looked for, because no log of commands and positions separates it
            from this one.
        twin_below: whether that is so only where the first parameter is below its neutral value.
    """

    name: str
    family: str
    parameters: tuple[str, ...]
    meaning: str
    remedy: str
    equation: str = ""
    experiment: str = ""
    twin: str = ""
    twin_below: bool = False
    gloss: str = ""


_EVERY = (
    ServoEffect(
        "command_delay", "command", ("delay",),
        "The command takes effect late; positions that are read late look the same.",
        "Hold commands back by as much.",
        "x(t) = u(t - delay)", "send steps and fast reversals", twin="late_positions",
    ),
    ServoEffect(
        "set_point_profile", "command", ("acceleration",),
        "The servo follows a set-point of limited acceleration, not the command.",
        "Put the profile before the position controller.",
        "|ddx| <= acceleration", "send steps of several sizes",
        gloss="the servo limits its own acceleration",
    ),
    ServoEffect(
        "set_point_speed", "command", ("speed",),
        "The set-point's speed is limited.", "Limit the command's rate.",
        "|dx| <= speed", "send large steps", gloss="the servo limits its own speed",
    ),
    ServoEffect(
        "command_filter", "command", ("lag",),
        "The command passes a filter of first order.", "Filter the command.",
        "lag dx/dt = u - x", "send steps and a chirp",
    ),
    ServoEffect(
        "command_gain", "command", ("scale",),
        "The command is multiplied by a factor; below 1, a spring on the joint does the same: "
        "kp (u - q) - k q = (kp + k) (g u - q), g = kp / (kp + k).", "Scale the command.",
        "x = scale u", "hold postures over the whole range", twin="joint_spring", twin_below=True,
    ),
    ServoEffect(
        "proportional_gain", "servo", ("kp",),
        "The torque that a position error makes is another than in the file.",
        "Set the actuator's kp.",
        "kp e", "hold loaded postures over the whole range",
    ),
    ServoEffect(
        "gravity_compensation", "servo", (),
        "Something takes gravity out of what the servos feel, and in the file nothing does, or the "
        "other way round.",
        "Set gravcomp of the bodies in the MJCF to 1, or to 0 where it is 1.",
        "torque + g(q)", "hold loaded postures over the whole range",
    ),
    ServoEffect(
        "derivative_gain", "servo", ("kd",),
        "The servo answers to the rate of the error, the command's included.",
        "Feed the command's rate to the controller, not only the joint's.",
        "kd (dx - dq)", "send ramps of several speeds",
    ),
    ServoEffect(
        "integral_action", "servo", ("integral",),
        "The servo's torque grows as long as a position error lasts.",
        "Sum the position error up in the controller.",
        "integral * sum of e", "hold loaded postures for seconds",
    ),
    ServoEffect(
        "saturation", "servo", ("clip",),
        "The servo's torque is limited.", "Clip the actuator's force.",
        "|torque| <= clip", "send large steps against gravity",
    ),
    ServoEffect(
        "dead_zone", "servo", ("dead_zone",),
        "Small position errors make no torque.", "Put a dead zone on the position error.",
        "no torque while |e| < dead_zone", "send steps of a few encoder counts",
    ),
    ServoEffect(
        "motor_dependent_friction", "friction", ("motor_share",),
        "Friction grows with the motor's torque.", "Use friction per motor torque.",
        "motor_share |motor torque| sgn(dq)", "move slowly up and down under load",
    ),
)  # fmt: skip
SERVO_KINDS = {effect.name: effect for effect in _EVERY}
"""By name."""
