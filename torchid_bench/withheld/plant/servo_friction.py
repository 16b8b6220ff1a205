"""Dry friction of servos' gears as it was published of seven of them, on a joint of any torque.

Its bound is (Duclusaud, Passault, Padois, Ly 2025, `Extended Friction Models for the Physics
Simulation of Servo Actuators`)

    F = F0 + |k_e T_e - k_m T_m| + s (F1 + |c_e T_e - c_m T_m| + Q),   s = exp(-|dq / v|^a),

of the torques of the motor and from outside, T_m and T_e, which add up where they oppose each
other. Q is there where they do: the smaller one's square, times its own coefficient. The laws are
M1: F0; M2: with F1; M3: F0 and k_e = k_m; M4: with F1 and c_e = c_m; M5: with shares of both; M6:
with Q.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from torchid.yaml_data import parsed_yaml
from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.waves import pull_of

_LEAST = 0.2  # of the constant part
_NUMBERS = {
    "base": (0.0, 1), "stribeck": (0.0, 1), "viscous": (0.0, 1), "speed": (1.0, 0),
    "alpha": (1.0, 0), "motor": (0.0, 0), "external": (0.0, 0), "motor_stribeck": (0.0, 0),
    "external_stribeck": (0.0, 0), "motor_quad": (0.0, -1), "external_quad": (0.0, -1),
}  # fmt: skip
"""Neutral value of each number of a gear, and its power of the torque."""
LAWS = ("m1", "m2", "m3", "m4", "m5", "m6")


@dataclass(frozen=True)
class GearFriction:
    """Dry friction of gears.

    Attributes:
        numbers: (n,) by name: base, stribeck: F0, F1 [N m]; motor, external, motor_stribeck,
            external_stribeck: k_m, k_e, c_m, c_e [1]; motor_quad, external_quad: coefficients of Q
            [1/(N m)]; speed, alpha: v [rad/s], a [1]; and viscous friction besides [N m s/rad].
    """

    numbers: Mapping[str, Array]

    def bound(self, dq: Array, motor: Array, external: Array) -> Array:
        """Dry friction (.., n) at speeds [rad/s] and torques (.., n) [N m]."""
        p, driven, drawn = self.numbers, np.abs(motor), np.abs(external)
        square = np.where(
            drawn < driven, p["external_quad"] * drawn**2, p["motor_quad"] * driven**2
        )
        fading = p["stribeck"] + square * (motor * external < 0)
        fading += np.abs(p["external_stribeck"] * external - p["motor_stribeck"] * motor)
        fading *= np.exp(-((np.abs(dq) / p["speed"]) ** p["alpha"]))
        out: Array = p["base"] + np.abs(p["external"] * external - p["motor"] * motor) + fading
        return out


@dataclass(frozen=True)
class Beyond:
    """What servos have beyond plain ones; arrays are (n,).

    Attributes:
        gears: whose friction is theirs.
        plain: the part of it that is a plain servo's [N m].
        share: how much of the rest is there [1].
        waves: (n, 5, 3) of a joint's cable, see `drawn_waves`.
        level: their mean along the motions, where cables do not pull [1].
        cable: its torque [N m].
    """

    gears: GearFriction
    plain: Array
    share: Array
    waves: Array
    level: Array
    cable: Array

    def dry(self, dry: Array, dq: Array, motor: Array, external: Array) -> Array:
        """A bound of dry friction with it, of which something is left however little it is."""
        more = self.gears.bound(dq, motor, external) - self.plain
        return np.maximum(dry + self.share * more, _LEAST * self.plain)

    def pull(self, q: Array) -> Array:
        """Of the cables [N m]."""
        return self.cable * (pull_of(self.waves, q) - self.level)


@cache
def published() -> dict[str, dict[str, dict[str, float]]]:
    """Numbers of each servo's laws, as servo_friction.yaml has them, with those of its supply."""
    parsed = parsed_yaml(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
    return {
        servo: {law: {**given["supply"], **given[law]} for law in LAWS if law in given}
        for servo, given in parsed.items()
    }


def torque_of(servo: str, law: str) -> float:
    """Torque at standstill, as the law's fit has it [N m]."""
    own = published()[servo][law]
    return own["kt"] * (own["amps"] if "amps" in own else own["volts"] / own["R"])


def gears(laws: Sequence[tuple[str, str]], effort: Array) -> GearFriction:
    """Gears of joints, each of a servo and a law, scaled to their torques (n,) [N m]."""
    ratio = effort / np.array([torque_of(*law) for law in laws])
    numbers = {}
    for name, (neutral, grows) in _NUMBERS.items():
        both = name.replace("motor", "load").replace("external", "load")
        own = (published()[servo][law] for servo, law in laws)
        numbers[name] = np.array([x.get(name, x.get(both, neutral)) for x in own]) * ratio**grows
    return GearFriction(numbers)
