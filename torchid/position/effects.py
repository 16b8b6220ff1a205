"""What may stand between a command and a position beside a plain servo, by name."""

from dataclasses import dataclass

from torchid.simulation.servo import INDEX, PARAMETERS

CORE = ("kp", "damping", "armature", "delay", "offset", "coulomb")
"""What every fit has: a gain, viscous and dry friction, an inertia, a delay and an offset."""


@dataclass(frozen=True)
class PositionEffect:
    """One cause of a position error.

    Attributes:
        name, family: as in the answer.
        parameters: of `torchid.simulation.servo.PARAMETERS` that it needs, the one that tells its
            size first.
        meaning: one sentence.
        remedy: what a simulator needs for it.
        twin: a cause that is not looked for, because no log of commands and positions tells it from
            this one.
        twin_below: whether that is so only where the first parameter is below its neutral value.
    """

    name: str
    family: str
    parameters: tuple[str, ...]
    meaning: str
    remedy: str
    twin: str = ""
    twin_below: bool = False

    def neutral(self) -> dict[str, float]:
        """Values of its parameters without effect."""
        return {name: PARAMETERS[INDEX[name]].neutral for name in self.parameters}


EFFECTS = (
    PositionEffect(
        "command_delay", "command", ("delay",),
        "the command takes effect late; positions that are read late look the same",
        "hold commands back by as much", twin="late_positions",
    ),
    PositionEffect(
        "set_point_profile", "command", ("acceleration",),
        "the servo follows a set-point of limited acceleration, not the command",
        "put the profile before the position controller",
    ),
    PositionEffect(
        "set_point_speed", "command", ("speed",),
        "the set-point's speed is limited", "limit the command's rate",
    ),
    PositionEffect(
        "command_filter", "command", ("lag",),
        "the command passes a filter of first order", "filter the command",
    ),
    PositionEffect(
        "command_gain", "command", ("scale",),
        "the command is multiplied by a factor; below 1, a spring on the joint does the same: "
        "kp (u - q) - k q = (kp + k) (g u - q), g = kp / (kp + k)", "scale the command",
        twin="joint_spring", twin_below=True,
    ),
    PositionEffect(
        "derivative_gain", "servo", ("kd",),
        "the servo answers to the rate of the error, the command's included",
        "feed the command's rate to the controller, not only the joint's",
    ),
    PositionEffect(
        "integral_action", "servo", ("integral",),
        "the servo's torque grows as long as a position error lasts",
        "sum the position error up in the controller",
    ),
    PositionEffect(
        "saturation", "servo", ("clip",),
        "the servo's torque is limited", "clip the actuator's force",
    ),
    PositionEffect(
        "dead_zone", "servo", ("dead_zone",),
        "small position errors make no torque", "put a dead zone on the position error",
    ),
    PositionEffect(
        "torque_offset", "servo", ("offset",),
        "a constant torque, or a zero off by as much over kp", "add the torque, or the zero",
    ),
    PositionEffect(
        "stribeck_friction", "friction", ("stiction", "stribeck_speed"),
        "the joint sticks harder than it slides", "stiction that holds, and fades with speed",
    ),
    PositionEffect(
        "load_dependent_friction", "friction", ("load_share",),
        "friction grows with the load", "friction per external torque",
    ),
    PositionEffect(
        "motor_dependent_friction", "friction", ("motor_share",),
        "friction grows with the motor's torque", "friction per motor torque",
    ),
    PositionEffect(
        "end_stop", "world", ("stop_low", "stop_high"),
        "the joint meets a stop", "a joint limit at that position",
    ),
    PositionEffect(
        "plane_contact", "world", (),
        "a point of the arm touches a plane", "a floor at that height",
    ),
)  # fmt: skip
PAYLOAD = PositionEffect(
    "payload", "inertia", (),
    "the arm carries a body that its model does not have", "add the body to the last link",
)  # fmt: skip
"""Beside `EFFECTS`: not a servo's, but the robot's."""
BY_NAME = {effect.name: effect for effect in EFFECTS}
KEPT = ("command_delay", "torque_offset")
"""What is part of every model, named or not."""
