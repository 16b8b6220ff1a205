"""The true arm under its controllers, step by step.

MuJoCo's semi-implicit steps are a leapfrog: positions belong to instants t_k, velocities to
t_k - step/2, and the torque of step k to t_k. So the logged torque, the second difference of the
logged position and the velocity between two steps belong together to second order. Damping and the
controllers' velocity gain are implicit (implicitfast): what they do in step k is what they say at
the step's new velocity, and that is the torque that is recorded.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from torchid.errors import TorchidError
from torchid.withheld.plant.bodies import Array
from torchid.withheld.plant.model import compiled, mujoco
from torchid.withheld.plant.motion import SETTLE, Sum
from torchid.withheld.plant.plan import Act, Live, Plan, Scene, Signals
from torchid.withheld.plant.scene import Nominal

_FEED = 0.004  # seconds between two instants of the feed-forward
_ASTRAY = 1.0  # rad from the reference at which a simulation is no longer one of this arm
_STICKS = 0.05  # rad/s over which the feed-forward's friction comes in


@dataclass(frozen=True)
class Trace:
    """One simulated trajectory.

    Attributes:
        truth: what ideal sensors on the motors read.
        friction: (T, n) torque of MuJoCo's dry friction against the motion [N m].
        resistance: (T, n) the same, with what laws add [N m].
    """

    truth: Signals
    friction: Array
    resistance: Array


def simulated(scene: Scene, plan: Plan, nominal: Nominal, step: float) -> list[Trace]:
    """Every trajectory of a case.

    Args:
        scene: motions and controllers.
        plan: the true arm.
        nominal: the model that the controllers' feed-forward is from.
        step: [s].

    Raises:
        TorchidError: the simulation diverged.
    """
    return [_trajectory(scene, plan, nominal, step, number) for number in range(len(scene.order))]


def _trajectory(scene: Scene, plan: Plan, nominal: Nominal, step: float, number: int) -> Trace:
    shape = scene.shapes[scene.order[number]]
    count = round(shape.seconds / step) + 1
    settle = round(SETTLE / step)
    own = (np.arange(count + settle) - settle) * step
    command = commands(shape, own, scene, nominal)
    late = round(scene.arm.bus / step)
    if late:
        # Motors have the command of so long ago; before the first they hold it.
        command = np.concatenate([np.repeat(command[:1], late, axis=0), command[:-late]])
    if plan.offset is not None:
        # The controller sees q - offset and drives that to the reference.
        command = command + scene.kp * plan.offset
    model, motors = compiled(plan.plant, scene.kp, scene.kd, step)
    data = mujoco().MjData(model)
    offset = 0.0 if plan.offset is None else plan.offset
    data.qpos[motors] = shape.middle + offset
    live = Live(
        data.qpos, data.qvel, data.qfrc_applied, model.dof_frictionloss, model.dof_damping,
        motors, command, scene.kp, scene.kd, own + scene.starts[number], step,
    )  # fmt: skip
    acts = [law(live) for law in plan.laws]
    push = None if plan.push is None else plan.push(own, number)
    q, dq, friction, added = _run(model, data, live, acts, push)
    error = q[:-1] - offset - shape.state(own)[0]
    if not np.isfinite(dq).all() or np.abs(error).max() > _ASTRAY:
        raise TorchidError("a withheld case could not be simulated: the arm diverged.")
    tau = command - scene.kp * q[:-1] - scene.kd * dq[1:]
    truth = live.t, q[:-1] - offset, (dq[1:] + dq[:-1]) / 2, np.diff(dq, axis=0) / step, tau
    return Trace(
        Signals(*(x[settle:] for x in truth)), friction[settle:], (friction + added)[settle:]
    )


def _run(
    model: Any, data: Any, live: Live, acts: Sequence[Act], push: Array | None
) -> tuple[Array, Array, Array, Array]:
    """Positions and velocities (T + 1, n), and torque of dry friction and of laws (T, n) against
    the motion, of the motors."""
    motors = live.motors
    count, n = live.command.shape
    q, dq = np.empty((count + 1, n)), np.empty((count + 1, n))
    friction, added = np.empty((count, n)), np.zeros((count, n))
    every = len(motors) == len(live.q)
    where = slice(None) if every else motors
    position, velocity, dry = live.q, live.dq, data.qfrc_constraint
    control, applied = data.ctrl, live.applied
    tool = data.xfrc_applied[-1, :3]
    command, forward = live.command, mujoco().mj_step
    for k in range(count):
        q[k], dq[k] = position[where], velocity[where]
        control[:] = command[k]
        if acts:
            applied[:] = 0.0
            for act in acts:
                act(k)
            added[k] = applied[where]
        if push is not None:
            tool[:] = push[k]
        forward(model, data)
        friction[k] = dry[where]
    q[count], dq[count] = position[where], velocity[where]
    return q, dq, -friction, -added


def commands(shape: Sum, t: Array, scene: Scene, nominal: Nominal) -> Array:
    """kp q + kd dq + feed-forward along the reference (T, n)."""
    q, dq, _ = shape.state(t)
    coarse = np.arange(t[0], t[-1] + _FEED, _FEED)
    state = shape.state(coarse)
    speed = np.tanh(state[1] / _STICKS)
    feed = nominal.rigid(*state) + nominal.damping * state[1] + nominal.friction * speed
    fine = np.stack([np.interp(t, coarse, column) for column in feed.T], 1)
    return scene.kp * q + scene.kd * dq + fine
