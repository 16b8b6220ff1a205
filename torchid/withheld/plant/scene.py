"""From a case's description to what effects must know of its motion."""

from dataclasses import replace

import numpy as np

from torchid.withheld.plant.arms import Arm
from torchid.withheld.plant.bodies import Array
from torchid.withheld.plant.motion import MotionPlan, Sum, sums
from torchid.withheld.plant.nominal import Nominal
from torchid.withheld.plant.plan import Scene

_GRID = 0.02  # seconds
_HEADROOM = 0.85  # share of the effort limit that the nominal motion may need
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
    shapes = _within_effort(arm, nominal, sums(arm, motion))
    states = [shape.state(np.arange(0, shape.seconds, _GRID)) for shape in shapes]
    all_states = [states[k] for k in motion.shapes]
    q, dq, ddq = (np.concatenate(x) for x in zip(*all_states, strict=True))
    rigid = nominal.rigid(q, dq, ddq)
    torque = rigid + nominal.damping * dq + nominal.friction * np.sign(dq)
    strength = np.sqrt((torque**2).mean(0))
    mass = nominal.inertia(q[::10])
    inertia = np.diagonal(mass, axis1=1, axis2=2)
    omega = 2 * np.pi * bandwidth
    typical = inertia.mean(0)
    return Scene(
        arm=arm,
        shapes=tuple(shapes),
        order=motion.shapes,
        starts=_starts(motion),
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


def _within_effort(arm: Arm, nominal: Nominal, shapes: list[Sum]) -> list[Sum]:
    """Motions made smaller where they would need more torque than the joints have."""
    effort = np.array([joint.effort for joint in arm.joints]) * _HEADROOM

    def needed(shape: Sum) -> Array:
        q, dq, ddq = shape.state(np.arange(0, shape.seconds, 0.05))
        torque = nominal.rigid(q, dq, ddq) + nominal.damping * dq
        return np.abs(torque).max(0) + nominal.friction

    def within(shape: Sum) -> Sum:
        smaller = (shape.scaled(0.85**k) for k in range(6))
        return next((s for s in smaller if (needed(s) < effort).all()), shape.scaled(0.85**6))

    return [within(shape) for shape in shapes]


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
    shapes = _within_effort(scene.arm, nominal, sums(scene.arm, motion))
    return replace(scene, shapes=tuple(shapes), order=motion.shapes, starts=_starts(motion))


def friction_known(arm: Arm, viscous: Array, coulomb: Array) -> tuple[Array, Array]:
    """Known friction (n,), from shares of the joints' limits."""
    effort = np.array([joint.effort for joint in arm.joints])
    speed = np.array([joint.velocity for joint in arm.joints])
    return viscous * effort / speed, coulomb * effort
