"""Numbers that cases are drawn with. A sealed set is drawn with the defaults: who changes one draws
other cases from the same seed."""

from dataclasses import dataclass

import numpy as np

Range = tuple[float, float]
"""Least and most of what is drawn evenly."""


@dataclass(frozen=True)
class DrawSettings:
    """How cases are drawn, of arms whose controllers are told torques and of arms of servos.

    Attributes:
        level: size of an effect, in standard deviations of the torque noise.
        levels: of the sweep over sizes.
        alike: share of cases of several effects that are a pair that looks alike on one joint.
        pairs: share of pairs among the others; the rest are three effects.
        tries: draws of joints until effects that exclude each other are apart.
        repeated: share of logs with a trajectory that is repeated.
        speeds: shares of the velocity limit that the motions may use.
        seconds, pauses: length of a trajectory, and rest before the next [s].
        tree_seconds, tree_speeds: the same of robots that branch, length and shares of speed.
        slow, small: by how much a poor motion is slower, or smaller, than usual.
        known: share of arms with friction that is known.
        friction: known friction, of effort / speed and of effort.
        noise: of torque, as a share of each joint's torque RMS.
        bandwidth_hz, damping: of the controllers; damping as a ratio.
        rates_hz, bits, jitters: of the logger; jitter in sampling intervals.
        coloured, colour_hz: share of logs with coloured torque noise, and its corner [Hz].
        grows: of noise that grows with speed, by how much, as a share.
        velocities, velocity_noise: share of logs with velocities of their own; their noise [rad/s].
        servo_rates_hz, counts: of servos' logs, and of an encoder in one turn.
        servo_gain: over the joint's effort limit [1/rad].
        servo_own: its own frequency with its rotor [rad/s].
        servo_rotor: least inertia of a rotor, of the link's.
        servo_damping: ratio.
        servo_dry: dry friction, as radians of position error.
        servo_late: of a command, in samples.
    """

    level: float = 5.0
    levels: tuple[float, ...] = tuple(float(x) for x in np.logspace(-1, 1, 9).round(4))
    alike: float = 0.35
    pairs: float = 0.7
    tries: int = 100
    repeated: float = 0.8
    speeds: tuple[float, ...] = (0.85, 0.55, 0.3, 0.7)
    seconds: Range = (12.0, 15.0)
    pauses: Range = (2.0, 6.0)
    tree_seconds: float = 10.0
    tree_speeds: tuple[float, ...] = (0.85, 0.7, 0.55, 0.45, 0.3)
    slow: Range = (0.06, 0.12)
    small: Range = (0.03, 0.08)
    known: float = 0.7
    friction: Range = (0.003, 0.02)
    noise: Range = (0.005, 0.02)
    bandwidth_hz: Range = (3.0, 8.0)
    damping: Range = (0.6, 1.0)
    rates_hz: tuple[int, ...] = (250, 500, 1000)
    bits: tuple[int, int] = (17, 20)
    jitters: tuple[float, ...] = (0.0, 0.01, 0.03)
    coloured: float = 0.5
    colour_hz: float = 5.0
    grows: Range = (1.0, 4.0)
    velocities: float = 0.35
    velocity_noise: Range = (1e-4, 1e-3)
    servo_rates_hz: tuple[int, ...] = (30, 50, 100)
    counts: tuple[int, ...] = (4096, 4096, 16384)
    servo_gain: Range = (5.0, 10.0)
    servo_own: Range = (15.0, 35.0)
    servo_rotor: float = 0.2
    servo_damping: Range = (0.5, 1.1)
    servo_dry: Range = (0.002, 0.006)
    servo_late: Range = (0.0, 0.4)


DRAWS = DrawSettings()
"""Of all sealed sets."""
