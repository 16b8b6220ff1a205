"""What a servo is said to be: values from its maker's tables or its user, beside what is found.

Nominal only: a maker's torque is that of a new servo at its supply's voltage, without friction.
What is found depends on it in one way: servos of one name are units of one type.
"""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import torch

from torchid.effects.servo import INDEX, NAMES, PARAMETERS
from torchid.errors import TorchidError
from torchid.position.model import ServoArm
from torchid.position.record import NominalRecord
from torchid.results.words import unit_behind
from torchid.robot.model import Robot
from torchid.robot.yaml_values import parsed_yaml
from torchid.simulation.servo import Servos

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

UNKNOWN = "unknown"
FITTED = "earlier fit"
ACTUATOR = "actuator"
"""Of an MJCF."""
KEY = "servo"
"""In a robot's yaml."""
_TURN = 2 * math.pi
_DUTY = 885 / (4096 / _TURN)
"""Full duty of a Dynamixel of the X series, in rad times its P gain [rad]: 885 steps of duty for
positions in 4096 counts a turn."""


@dataclass(frozen=True)
class NominalServo:
    """A servo as it is said to be; what is missing is unknown.

    Attributes:
        name: of the preset; `servo` without one.
        values: by name of `torchid.effects.servo.PARAMETERS`, in their units.
        counts: of its encoder in one turn.
        units: how much of a parameter one step of its register is, by the parameter's name.
        gain_unit: kp that one step of the register of the proportional gain makes [N m/rad].
    """

    name: str = KEY
    values: "Mapping[str, float]" = field(default_factory=dict)
    counts: float | None = None
    units: "Mapping[str, float]" = field(default_factory=dict)
    gain_unit: float | None = None

    def record(self, joint: int) -> NominalRecord:
        """Of a joint, as the JSON has it."""
        return NominalRecord(
            joint=joint, servo=self.name, values=dict(self.values), register_units=dict(self.units),
            counts=math.nan if self.counts is None else self.counts,
        )  # fmt: skip


def _dynamixel(name: str, stall: float) -> NominalServo:
    """A Dynamixel with the X series' control table (e-Manual): the duty is P/128 steps a count of
    error, one step of the profile's acceleration is 214.577 rev/min^2, of its velocity 0.229 rpm.

    Args:
        name: of the model.
        stall: torque at the recommended voltage [N m].
    """
    profile = {"acceleration": 214.577 * _TURN / 3600, "speed": 0.229 * _TURN / 60}
    return NominalServo(name, {"clip": stall}, 4096, profile, stall / 128 / _DUTY)


PRESETS = {
    servo.name: servo
    for servo in (
        # Feetech's table of the STS series: 100 counts/s^2 a step, dead zone in counts. Torque and
        # what a step of P makes differ with the version, and are not told here.
        NominalServo(
            "STS3215", counts=4096,
            units={"acceleration": 100 * _TURN / 4096, "dead_zone": _TURN / 4096},
        ),
        _dynamixel("XL330-M288", 0.52),  # 5 V
        _dynamixel("XL430-W250", 1.5),  # 12 V
        _dynamixel("XM430-W350", 4.1),  # 12 V
        _dynamixel("MX-64", 6.0),  # 12 V, firmware of protocol 2.0
    )
}  # fmt: skip
PRESETS |= {"XL330": PRESETS["XL330-M288"], "XL430": PRESETS["XL430-W250"]}
PRESETS |= {"XM430": PRESETS["XM430-W350"]}
PRESETS = MappingProxyType(PRESETS)  # type: ignore[assignment]


def read_servos(text: str, n: int) -> tuple[NominalServo, ...]:
    """Servos from a text: `STS3215`, `XL330 gain=400`, `kp=12 clip=unknown`, for all joints, or one
    a joint with commas between.

    Joints with one preset are taken for units of one type; `type=left kp=12` names a type without a
    preset. `gain` is the register of the proportional gain; other names are those of
    `torchid.effects.servo.PARAMETERS`, in their units, and `counts` a turn.

    Args:
        text: as above.
        n: joints.

    Raises:
        TorchidError: a preset or name that there is not, no number, or another count than n.

    >>> servo, _ = read_servos("XL330-M288 gain=400 clip=unknown", 2)
    >>> round(servo.values["kp"], 2), "clip" in servo.values
    (1.2, False)
    """
    parts = text.split(",")
    if len(parts) not in (1, n):
        raise TorchidError(
            "`servo=...` has another number of servos than the robot has joints.",
            got=len(parts),
            expected=f"1, or {n} with commas between",
        )
    found = [_servo(part) for part in parts]
    return tuple(found * n if len(found) == 1 else found)


def _servo(text: str) -> NominalServo:
    words = text.split()
    servo = NominalServo()
    if words and "=" not in words[0]:
        known = {name.lower(): preset for name, preset in PRESETS.items()}
        if words[0].lower() not in known:
            raise TorchidError(
                "there is no such servo.",
                got=words[0],
                available=list(PRESETS),
                hint='say what it is: `servo="kp=12 clip=2.9 counts=4096"`',
            )
        servo = known[words.pop(0).lower()]
    values, counts = dict(servo.values), servo.counts
    for word in words:
        name, _, given = word.partition("=")
        value = None if given == UNKNOWN or name == "type" else _number(word, given)
        if name == "type":
            servo = replace(servo, name=given)
        elif name == "counts":
            counts = value
        elif name == "gain":
            if value is not None and servo.gain_unit is None:
                raise TorchidError(
                    f"what a step of the gain makes is not known of {servo.name}.",
                    got=word,
                    expected="kp=.. [N m/rad]",
                )
            values.pop("kp", None)
            if value is not None and servo.gain_unit is not None:
                values["kp"] = value * servo.gain_unit
        elif name not in NAMES:
            raise TorchidError(
                "a servo has no such value.", got=word, available=["type", "gain", "counts", *NAMES]
            )
        elif value is None:
            values.pop(name, None)
        else:
            values[name] = value
    return NominalServo(servo.name, values, counts, servo.units, servo.gain_unit)


def _number(word: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise TorchidError(
            "a servo's value is not a number.", got=word, expected=f"NAME=NUMBER or NAME={UNKNOWN}"
        )
    return value


def nominal_servos(robot: Robot, text: str | None) -> tuple[NominalServo, ...]:
    """The servos of an arm as a text says them, or else the key `servo` of the robot's yaml, a
    text, or a list of one a joint; or else those of an earlier fit that the yaml holds; or those
    of an MJCF's actuators. Empty where none says any.

    Raises:
        TorchidError: as `read_servos`.
    """
    if text is not None:
        return read_servos(text, robot.n)
    path = Path(robot.source)
    if path.suffix.lower() == ".xml" and path.is_file():
        from torchid.robot.mjcf import mjcf_servos

        values = mjcf_servos(path, robot.joint_names)
        return tuple(NominalServo(ACTUATOR, v) for v in values) if any(values) else ()
    if path.suffix.lower() not in (".yaml", ".yml") or not path.is_file():
        return ()
    given = parsed_yaml(path).get(KEY)
    if given is None:
        fitted = ServoArm.of_file(path)
        if fitted is None:
            return ()
        rows = [fitted.servos.joint[j].tolist() for j in range(robot.n)]
        return tuple(
            NominalServo(
                FITTED, {p.name: v for p, v in zip(PARAMETERS, row, strict=True) if v != p.neutral}
            )
            for row in rows
        )
    listed = given if isinstance(given, list) else [given]
    return read_servos(",".join(map(str, listed)), robot.n)


def servos_as_given(robot: Robot, servos: "Sequence[NominalServo]") -> ServoArm | None:
    """The arm that its own file describes: servos of an earlier fit, with how well they are known,
    or those of an MJCF's actuators; None where no file says them of all joints."""
    names = {servo.name for servo in servos if servo.values}
    if not servos or not all(servo.values for servo in servos) or not names <= {FITTED, ACTUATOR}:
        return None
    if names == {FITTED}:
        return ServoArm.of_file(robot.source)
    out = Servos.neutral(robot.n)
    for j, servo in enumerate(servos):
        for name, value in servo.values.items():
            out.joint[j, INDEX[name]] = value
    return ServoArm(robot, out, torch.ones(robot.n, dtype=torch.float64))


def types_of(servos: "Sequence[NominalServo]") -> tuple[str, ...]:
    """Which servos are units of one type: those of one name, but for what no user has named."""
    own = (KEY, FITTED, ACTUATOR)
    return tuple("" if servo.name in own else servo.name for servo in servos)


def sheets_of(servos: "Sequence[NominalServo]") -> tuple["Mapping[str, float]", ...]:
    """What makers or users say of servos; what a robot's file has is compared instead."""
    return tuple({} if servo.name in (FITTED, ACTUATOR) else servo.values for servo in servos)


def unit_of(name: str) -> str:
    """The unit of a servo's value, for people."""
    return unit_behind(PARAMETERS[INDEX[name]].unit)
