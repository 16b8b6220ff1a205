"""The nominal model: what the arm's maker knows, and the gap that is left."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from torchid.withheld.plant.arms import Arm
from torchid.withheld.plant.bodies import Array
from torchid.withheld.plant.engine import mujoco
from torchid.withheld.plant.model import compiled, plant_of

BAND = 20.0
"""Hz below which gaps are measured."""

_CREEP = 0.01  # rad/s over which the sign of a reversal comes in, where friction is not known


@dataclass(frozen=True)
class Nominal:
    """The described arm's torque, by MuJoCo's inverse dynamics.

    Attributes:
        model, data: MuJoCo's, without friction.
        damping, friction: (n,) what is known of friction [N m s/rad; N m].
    """

    model: Any
    data: Any
    damping: Array
    friction: Array

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Torque (T, n) of the rigid body [N m]."""
        model, data = self.model, self.data
        position, velocity, acceleration = data.qpos, data.qvel, data.qacc
        inverse, force = mujoco().mj_inverse, data.qfrc_inverse
        out = np.empty_like(q)
        for k in range(len(q)):
            position[:], velocity[:], acceleration[:] = q[k], dq[k], ddq[k]
            inverse(model, data)
            out[k] = force
        return out

    def inertia(self, q: Array) -> Array:
        """Mass matrices (T, n, n) [kg m^2]."""
        module, n = mujoco(), q.shape[1]
        full, out = np.empty((n, n)), np.empty((len(q), n, n))
        for k in range(len(q)):
            self.data.qpos[:] = q[k]
            module.mj_forward(self.model, self.data)
            module.mj_fullM(self.model, self.data, full)
            out[k] = full
        return out


def nominal_of(arm: Arm, damping: Array, friction: Array) -> Nominal:
    """The nominal model of an arm with what is known of its friction."""
    zeros = np.zeros(arm.n)
    model, _ = compiled(plant_of(arm, zeros, zeros), zeros, zeros, 1e-3)
    return Nominal(model, mujoco().MjData(model), damping, friction)


def dry(speed: Array) -> Array:
    """Direction of motion, from -1 to 1 within a creeping speed."""
    return np.clip(speed / _CREEP, -1.0, 1.0)


def low_passed(x: Array, step: float) -> Array:
    """Signals (T, n) below the band, without phase."""
    sections = butter(4, BAND, fs=1 / step, output="sos")
    return np.asarray(sosfiltfilt(sections, x, axis=0))


def rms(parts: Sequence[Array]) -> Array:
    """Root mean square (n,) of signals (T, n) over all parts."""
    together = np.concatenate(parts)
    return np.sqrt((together**2).mean(0))
