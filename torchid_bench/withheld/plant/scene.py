"""From a case's description to what effects must know of its motion."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from torchid_bench.withheld.plant.arms import Arm
from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.model import compiled, mujoco, plant_of
from torchid_bench.withheld.plant.motion import MotionPlan, Sum, sums
from torchid_bench.withheld.plant.plan import Moving, Scene

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


_GRID = 0.02  # seconds
HEADROOM = 0.85  # share of the effort limit that the nominal motion may need
_FLOOR = 2e-3  # of the largest joint's torque: a joint's noise is as if it carried that much


def scene_of(
    arm: Arm,
    nominal: Nominal,
    motion: MotionPlan,
    noise_share: float,
    bandwidth: float,
    damping: float,
) -> Scene:
    """The scene of a case.

    Args:
        arm: as described.
        nominal: its model.
        motion: of the trajectories.
        noise_share: of each joint's torque RMS.
        bandwidth: of the controllers [Hz].
        damping: ratio of the controllers.
    """
    shapes = _shapes(arm, nominal, motion)
    return scene_along(
        nominal, shapes, motion.shapes, _starts(motion), arm, noise_share, bandwidth, damping
    )


def scene_along(
    nominal: Nominal,
    shapes: tuple[Moving, ...],
    order: tuple[int, ...],
    starts: tuple[float, ...],
    arm: Arm,
    noise_share: float,
    bandwidth: float = 5.0,
    damping: float = 0.8,
) -> Scene:
    """The scene of motions, in the order and at the times at which they are driven."""
    states = [shape.state(np.arange(0, shape.seconds, _GRID)) for shape in shapes]
    all_states = [states[k] for k in order]
    q, dq, ddq = (np.concatenate(x) for x in zip(*all_states, strict=True))
    rigid = nominal.rigid(q, dq, ddq)
    torque = rigid + nominal.damping * dq + nominal.friction * np.sign(dq)
    strength = np.sqrt((torque**2).mean(0))
    mass = nominal.inertia(q[::10])
    # The controllers move rotors and links, a gear has the link alone behind it.
    typical = np.diagonal(mass, axis1=1, axis2=2).mean(0)
    mass = mass - np.diag([joint.rotor for joint in arm.joints])
    inertia = np.diagonal(mass, axis1=1, axis2=2)
    omega = 2 * np.pi * bandwidth
    return Scene(
        arm=arm,
        shapes=shapes,
        order=order,
        starts=starts,
        noise=noise_share * np.maximum(strength, _FLOOR * strength.max()),
        torque=strength,
        peak=np.abs(torque).max(0),
        speed=np.quantile(np.abs(dq), 0.99, axis=0),
        moving_rms=np.sqrt((dq**2).mean(0)),
        brisk_rms=np.sqrt((ddq**2).mean(0)),
        travel=np.stack([q.min(0), q.max(0)], 1),
        inertia=np.stack([inertia.min(0), inertia.max(0)], 1),
        free_inertia=1 / np.diagonal(np.linalg.inv(mass), axis1=1, axis2=2).max(0),
        load=np.sqrt((rigid**2).mean(0)),
        kp=omega**2 * typical,
        kd=2 * damping * omega * typical,
    )


def _shapes(arm: Arm, nominal: Nominal, motion: MotionPlan) -> tuple[Sum, ...]:
    """Motions, made smaller where they would need more torque than the joints have."""

    def bears(shape: Sum) -> bool:
        q, dq, ddq = shape.state(np.arange(0, shape.seconds, 0.05))
        torque = nominal.rigid(q, dq, ddq) + nominal.damping * dq
        return bool((np.abs(torque) + nominal.friction < arm.available(dq) * HEADROOM).all())

    def within(shape: Sum) -> Sum:
        smaller = (shape.scaled(0.85**k) for k in range(6))
        return next((s for s in smaller if bears(s)), shape.scaled(0.85**6))

    return tuple(within(shape) for shape in sums(arm, motion))


def _starts(motion: MotionPlan) -> tuple[float, ...]:
    """When each trajectory begins [s]."""
    clock, out = 0.0, []
    for number, pause in zip(motion.shapes, motion.pauses, strict=True):
        clock += pause
        out.append(clock)
        clock += motion.seconds[number]
    return tuple(out)


def moved_otherwise(scene: Scene, nominal: Nominal, motion: MotionPlan) -> Scene:
    """The scene's arm, noise and controllers on another motion."""
    shapes = _shapes(scene.arm, nominal, motion)
    return replace(scene, shapes=shapes, order=motion.shapes, starts=_starts(motion))


def friction_known(arm: Arm, viscous: Array, coulomb: Array) -> tuple[Array, Array]:
    """Known friction (n,), from shares of the joints' limits."""
    effort = np.array([joint.effort for joint in arm.joints])
    speed = np.array([joint.velocity for joint in arm.joints])
    return viscous * effort / speed, coulomb * effort
