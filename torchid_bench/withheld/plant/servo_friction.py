"""Dry friction of servos' gears as it was published of seven of them, on a joint of any torque.

Its bound is (Duclusaud, Passault, Padois, Ly 2025, `Extended Friction Models for the Physics
Simulation of Servo Actuators`)

    F = F0 + |k_e T_e - k_m T_m| + s (F1 + |c_e T_e - c_m T_m| + Q),   s = exp(-|dq / v|^a),

of the torques of the motor and from outside, T_m and T_e, which add up where they oppose each
other. Q is there where they do: the smaller one's square, times its own coefficient. The laws are
M1: F0; M2: with F1; M3: F0 and k_e = k_m; M4: with F1 and c_e = c_m; M5: with shares of both; M6:
with Q.
"""

from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path

import numpy as np

from torchid.yaml_data import parsed_yaml
from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.waves import pull_of

_LEAST = 0.2  # of the constant part
LAWS = ("m1", "m2", "m3", "m4", "m5", "m6")


@dataclass(frozen=True)
class GearFriction:
    """Dry friction of gears; arrays are (n,).

    Attributes:
        base, stribeck: F0, F1 [N m].
        motor, external, motor_stribeck, external_stribeck: k_m, k_e, c_m, c_e [1].
        motor_quad, external_quad: coefficients of Q [1/(N m)].
        speed, alpha: v [rad/s], a [1].
        viscous: friction besides [N m s/rad].
    """

    base: Array
    stribeck: Array
    motor: Array
    external: Array
    motor_stribeck: Array
    external_stribeck: Array
    motor_quad: Array
    external_quad: Array
    speed: Array
    alpha: Array
    viscous: Array

    def bound(self, dq: Array, motor: Array, external: Array) -> Array:
        """Dry friction (.., n) at speeds [rad/s] and torques (.., n) [N m]."""
        driven, drawn = np.abs(motor), np.abs(external)
        square = np.where(
            drawn < driven, self.external_quad * drawn**2, self.motor_quad * driven**2
        )
        fading = self.stribeck + square * (motor * external < 0)
        fading += np.abs(self.external_stribeck * external - self.motor_stribeck * motor)
        fading *= np.exp(-((np.abs(dq) / self.speed) ** self.alpha))
        out: Array = self.base + np.abs(self.external * external - self.motor * motor) + fading
        return out

    def of_torque(self, ratio: Array) -> "GearFriction":
        """The same gears for so many times the torque."""
        more = {name: getattr(self, name) * ratio for name in ("base", "stribeck", "viscous")}
        less = {name: getattr(self, name) / ratio for name in ("motor_quad", "external_quad")}
        return replace(self, **more, **less)


@dataclass(frozen=True)
class Beyond:
    """What servos have beyond plain ones; arrays are (n,).

    Attributes:
        gears: whose friction is theirs.
        plain: the part of it that is a plain servo's [N m].
        share: how much of the rest is there [1].
        waves: (n, 5, 3) of a joint's cable, see `drawn_waves`.
        cable: its torque [N m].
    """

    gears: GearFriction
    plain: Array
    share: Array
    waves: Array
    cable: Array

    def dry(self, dry: Array, dq: Array, motor: Array, external: Array) -> Array:
        """A bound of dry friction with it, of which something is left however little it is."""
        more = self.gears.bound(dq, motor, external) - self.plain
        return np.maximum(dry + self.share * more, _LEAST * self.plain)

    def pull(self, q: Array) -> Array:
        """Of the cables [N m]."""
        return self.cable * pull_of(self.waves, q)


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


def gears(laws: list[tuple[str, str]], effort: Array) -> GearFriction:
    """Gears of joints, each of a servo and a law, scaled to their torques (n,) [N m]."""
    own = [published()[servo][law] for servo, law in laws]
    columns = {}
    for name in (f.name for f in fields(GearFriction)):
        either = name.replace("motor", "load").replace("external", "load")
        neutral = float(name in ("speed", "alpha"))
        columns[name] = np.array([x.get(name, x.get(either, neutral)) for x in own])
    ratio = effort / np.array([torque_of(*law) for law in laws])
    return GearFriction(**columns).of_torque(ratio)
