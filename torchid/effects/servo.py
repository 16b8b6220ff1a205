"""What may stand between a command and a position beside what adds torque to the rigid body: the
command on its way, and the servo itself.

All that is asked of a number of a servo, and of an effect of one, stands here; its physics is
stepped in `torchid.simulation.servo_kernel`. Causes that add torque are effects like all others
(`torchid.effects.registry`); `servo` of their class says which numbers of a servo they are in logs
of commands and positions.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch

from torchid.typing import Float, Tensor

Kind = Literal["log", "positive", "real"]


class ServoMotion(NamedTuple):
    """What sizes to try are taken from: commands, positions [rad] and speeds [rad/s] (T, n), and
    gains (n,) of servos [N m/rad]."""

    u: Float[Tensor, "T n"]
    q: Float[Tensor, "T n"]
    dq: Float[Tensor, "T n"]
    kp: Float[Tensor, " n"]


@dataclass(frozen=True)
class ServoParameter:
    """One number of a joint's servo.

    Attributes:
        name, unit, meaning: of the parameter; units of a revolute joint.
        neutral: value without effect.
        start: where a search begins.
        kind: `log` is searched on a logarithmic scale, `positive` stays at or above zero.
        words: a noun, and what a smaller and a larger value is called.
        prior: standard deviation of the searched coordinate that is expected before any motion is
            seen; of a logarithm, or of torques beside those of a small servo.
        step: of the searched coordinate, for its differences; None: 0.02 of a logarithm, else
            0.005.
        of_type: whether servos of one type have the same, and not the arm or its calibration.
        usual: size that servos have, of torques as a share of kp; None of what acts only beyond a
            limit: a log that does not come there says nothing of it.
        sizes: (V, n) values to try of what has no slope where it does not act; else None.
        shape: whether it acts only beside another number, maybe of several effects.
    """

    name: str
    unit: str
    meaning: str
    neutral: float
    start: float
    kind: Kind = "log"
    words: tuple[str, str, str] = ("", "", "")
    prior: float = 1.0
    step: float | None = None
    of_type: bool = True
    usual: float | None = None
    sizes: Callable[[ServoMotion], Float[Tensor, "V n"]] | None = None
    shape: bool = False

    @property
    def difference(self) -> float:
        """Step of the searched coordinate."""
        return self.step or (0.02 if self.kind == "log" else 5e-3)


_INF = float("inf")
_STOP_INSIDE = (0.0, 0.004, 0.01)
_FAR, _AT_STOP = 0.9, (0.1, 0.5)


def _shares(*shares: float) -> Tensor:
    return torch.tensor(shares, dtype=torch.float64)[:, None]


def _while_held(q: Float[Tensor, "T n"], u: Float[Tensor, "T n"]) -> Float[Tensor, "V n"]:
    """Positions of joints while their commands are farthest beyond them: of a soft stop a little
    more than where it begins."""
    beyond = u - q
    far = beyond >= beyond.quantile(_FAR, 0)
    return q.masked_fill(~far, torch.nan).nanquantile(torch.tensor(_AT_STOP, dtype=q.dtype), 0)


# End stops about where the joints came to their lowest and highest positions, or are while their
# commands are far beyond.
def _lower_stops(m: ServoMotion) -> Float[Tensor, "V n"]:
    return torch.cat([m.q.amin(0) + _shares(*_STOP_INSIDE), -_while_held(-m.q, -m.u)])


def _upper_stops(m: ServoMotion) -> Float[Tensor, "V n"]:
    return torch.cat([m.q.amax(0) - _shares(*_STOP_INSIDE), _while_held(m.q, m.u)])


def _clips(m: ServoMotion) -> Float[Tensor, "V n"]:
    """Limits that are tried first: shares of the torque that the largest position errors would
    make, which of stiff servos is many times their limit."""
    return _shares(0.04, 0.1, 0.2, 0.4, 0.6, 0.8) * (m.u - m.q).abs().quantile(0.999, 0) * m.kp


def _supplies(m: ServoMotion) -> Float[Tensor, "V n"]:
    total = ((m.u - m.q).abs() * m.kp).sum(1).quantile(0.99)
    return _shares(1.0, 3.0, 10.0) * total.expand(len(m.kp))


def _speeds(m: ServoMotion) -> Float[Tensor, "V n"]:
    return _shares(0.4, 0.55, 0.7, 0.85, 1.0) * m.dq.abs().quantile(0.9999, 0).clamp(min=0.1)


def _integrals(m: ServoMotion) -> Float[Tensor, "V n"]:
    return _shares(0.1, 0.5, 2.0) * m.kp  # kp per second


def _dead_zones(m: ServoMotion) -> Float[Tensor, "V n"]:
    return _shares(0.0015, 0.004).expand(-1, len(m.kp))


def _scales(m: ServoMotion) -> Float[Tensor, "V n"]:
    return _shares(0.9, 0.97, 1.03, 1.1).expand(-1, len(m.kp))


PARAMETERS = (
    ServoParameter(
        "kp", "N m/rad", "torque a position error makes", 0.0, 15.0,
        words=("gain", "lower", "higher"), prior=0.5,
    ),
    ServoParameter(
        "kd", "N m s/rad", "torque a rate of the position error makes", 0.0, 0.3,
        words=("derivative gain", "lower", "higher"), usual=0.03,
    ),
    ServoParameter(
        "integral", "N m/(rad s)", "torque a lasting error adds a second", 0.0, 15.0,
        words=("integral gain", "lower", "higher"), usual=0.5, sizes=_integrals,
    ),
    ServoParameter(
        "damping", "N m s/rad", "viscous friction and back-EMF", 0.0, 0.6,
        words=("viscous friction", "less", "more"),
    ),
    ServoParameter(
        "armature", "kg m^2", "inertia of the rotor, reflected", 0.0, 0.03,
        words=("rotor inertia", "smaller", "larger"), prior=0.5,
    ),
    ServoParameter(
        "delay", "s", "from the command's stamp to its effect", 0.0, 0.02, "positive",
        words=("delay", "shorter", "longer"), prior=0.02, step=1e-3,
    ),
    ServoParameter(
        "offset", "N m", "constant torque", 0.0, 0.0, "real",
        words=("torque offset", "lower", "higher"), prior=0.2, of_type=False,
    ),
    ServoParameter(
        "coulomb", "N m", "dry friction in motion", 0.0, 0.08, "positive",
        words=("dry friction", "less", "more"), prior=0.3,
    ),
    ServoParameter(
        "stiction", "N m", "more dry friction at rest", 0.0, 0.05, "positive",
        words=("extra friction at rest", "less", "more"), prior=0.1, usual=0.01,
    ),
    ServoParameter(
        "stribeck_speed", "rad/s", "where stiction fades", 1.0, 0.08,
        words=("speed at which stiction fades", "lower", "higher"), shape=True,
    ),
    ServoParameter(
        "motor_share", "1", "friction per motor torque", 0.0, 0.1, "positive",
        words=("friction share of the motor torque", "smaller", "larger"), prior=0.3, usual=0.1,
    ),
    ServoParameter(
        "load_share", "1", "friction per external torque", 0.0, 0.1, "positive",
        words=("friction share of the external torque", "smaller", "larger"), prior=0.3,
        of_type=False, usual=0.1,
    ),
    ServoParameter(
        "acceleration", "rad/s^2", "limit of the set-point", _INF, 40.0,
        words=("acceleration limit", "lower", "higher"),
    ),
    ServoParameter(
        "speed", "rad/s", "limit of the set-point", _INF, 3.0,
        words=("speed limit", "lower", "higher"), sizes=_speeds,
    ),
    ServoParameter(
        "lag", "s", "time constant of a filter on the set-point", 0.0, 0.05, "positive",
        words=("command filter's time constant", "shorter", "longer"), prior=0.05, step=1e-3,
        usual=0.02,
    ),
    ServoParameter(
        "clip", "N m", "largest servo torque", _INF, 5.0,
        words=("torque limit", "lower", "higher"), sizes=_clips,
    ),
    ServoParameter(
        "dead_zone", "rad", "position error without torque", 0.0, 0.003, "positive",
        words=("dead zone", "narrower", "wider"), prior=0.003, step=5e-4, usual=0.005,
        sizes=_dead_zones,
    ),
    ServoParameter(
        "stop_low", "rad", "end stop", -_INF, -3.0, "real",
        words=("lower end stop", "lower", "higher"), prior=0.05, of_type=False, sizes=_lower_stops,
    ),
    ServoParameter(
        "stop_high", "rad", "end stop", _INF, 3.0, "real",
        words=("upper end stop", "lower", "higher"), prior=0.05, of_type=False, sizes=_upper_stops,
    ),
    ServoParameter(
        "scale", "1", "factor on the command", 1.0, 1.0, "real",
        words=("command factor", "smaller", "larger"), prior=0.05, step=2e-3, of_type=False,
        usual=0.05, sizes=_scales,
    ),
    ServoParameter(
        "stiction_share", "1", "more friction at rest per torque through the gear", 0.0, 0.1,
        "positive", words=("extra friction share at rest", "smaller", "larger"), prior=0.3,
        usual=0.1,
    ),
    ServoParameter(
        "supply", "N m", "sum of all torques over the share of its voltage that they take", _INF,
        50.0, words=("stiffness of the supply", "lower", "higher"), of_type=False,
        sizes=_supplies,
    ),
    ServoParameter("stribeck_exponent", "1", "of the speed that stiction fades with", 1.0, 1.0),
    ServoParameter(
        "damping_share", "1", "of the damping, within the clip", 0.0, 0.0, "real", of_type=False
    ),
)  # fmt: skip
NAMES = tuple(p.name for p in PARAMETERS)
INDEX = {name: k for k, name in enumerate(NAMES)}
PLANE = ("x", "y", "z", "height", "stiffness")
"""Point of the last link but the jaw [m, link frame], height of the plane [m], stiffness [N/m]."""
TORQUES = tuple(p.name for p in PARAMETERS if p.unit.startswith("N m") or p.name == "armature")
"""What is multiplied by one factor when all torques are."""
PER_KP = {"N m": "rad", "N m s/rad": "s", "N m/(rad s)": "1/s", "kg m^2": "s^2", "N m/rad": "1"}
"""Units of torques as shares of kp."""


def as_share(name: str) -> str:
    """What the share of kp is called that is known where a torque itself is not: `kd/kp`."""
    return f"{name}/kp"


@dataclass(frozen=True)
class ServoEffect:
    """One cause of a position error under a servo.

    Attributes:
        name, family: as in the answer.
        parameters: of `PARAMETERS` that it needs, the one that gives its
            size first.
        meaning, remedy: one sentence each.
        gloss: what its name says, in a few plain words; empty where it is everybody's.
        equation: in the names of the parameters; u is the command, x the set-point, e = x - q.
        experiment: the motion in which it shows itself.
        twin: a cause that is not looked for, because no log of commands and positions separates it
            from this one.
        twin_below: whether that is so only where the first parameter is below its neutral value.
        shared: whether it is of all joints, or of none.
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
    shared: bool = False

    @staticmethod
    def logs() -> tuple[str, ...]:
        """Which logs can show it."""
        return ("positions",)

    @property
    def has_sizes(self) -> bool:
        """Whether it has no slope where it does not act, and sizes of it are tried."""
        return bool(self.parameters) and PARAMETERS[INDEX[self.parameters[0]]].sizes is not None


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
        "supply_sag", "servo", ("supply",),
        "All servos share a supply, whose voltage falls with the sum of their torques.",
        "Multiply torques and their limits by the share of the voltage that is left.",
        "f clip(kp e), f = 1 - sum of |torques| / supply = 1 / (1 + sum of |clip(kp e)| / supply)",
        "hold loaded postures with one joint, then with all at once",
        gloss="the voltage falls under load", shared=True,
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
