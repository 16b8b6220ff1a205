"""The true arm under its controllers, step by step.

MuJoCo's semi-implicit steps are a leapfrog: positions belong to instants t_k, velocities to
t_k - step/2, and the torque of step k to t_k. So the logged torque, the second difference of the
logged position and the velocity between two steps belong together to second order. Damping and the
controllers' velocity gain are implicit (implicitfast): what they do in step k is what they say at
the step's new velocity, and that is the torque that is recorded.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from torchid.errors import TorchidError
from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.catalogue import kind_named
from torchid_bench.withheld.plant.model import compiled, mujoco
from torchid_bench.withheld.plant.motion import SETTLE
from torchid_bench.withheld.plant.plan import (
    Act,
    EffectSpec,
    Live,
    Moving,
    Parameters,
    Plan,
    Scene,
    Signals,
)
from torchid_bench.withheld.plant.scene import Nominal, dry, low_passed, rms
from torchid_bench.withheld.plant.sensing import with_held_torque

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
    data.qpos[motors] = shape.state(own[:1])[0][0] + offset
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


def commands(shape: Moving, t: Array, scene: Scene, nominal: Nominal) -> Array:
    """kp q + kd dq + feed-forward along the reference (T, n)."""
    q, dq, _ = shape.state(t)
    coarse = np.arange(t[0], t[-1] + _FEED, _FEED)
    state = shape.state(coarse)
    speed = np.tanh(state[1] / _STICKS)
    feed = nominal.rigid(*state) + nominal.damping * state[1] + nominal.friction * speed
    fine = np.stack([np.interp(t, coarse, column) for column in feed.T], 1)
    return scene.kp * q + scene.kd * dq + fine


COARSE = 5e-4
"""Step of the simulations that find a scale [s]."""

_GRID = 0.004  # seconds between the instants of a gap
_CLOSE = 0.12  # a scale is found when the size is that close to the wanted one, as a share
_TRIES = 6  # simulations that look for a scale


@dataclass(frozen=True)
class Sized:
    """An effect at the scale that was found.

    Attributes:
        scale: of the effect.
        size: (n,) RMS of what it changes in the gap, in standard deviations of the noise.
    """

    scale: float
    size: Array


def readings(plan: Plan, traces: Sequence[Trace]) -> list[Signals]:
    """What sensors without noise read, but for held torques, one a trajectory."""
    return [reduce(lambda x, sensor: sensor(x), plan.sensors, trace.truth) for trace in traces]


def gaps(plan: Plan, nominal: Nominal, traces: Sequence[Trace]) -> list[Array]:
    """Noise-free torque minus the nominal model's along the measured motion, below 20 Hz (T, n).

    Where the arm has the very dry friction that the nominal model knows, its actual torque is taken
    out; where an effect replaces it, Fc sign(dq), and at rest, where the sign says nothing, what
    resists, up to Fc.
    """
    out = []
    pairs = zip(traces, readings(plan, traces), strict=True)
    for number, (trace, reading) in enumerate(pairs):
        fine = float(reading.t[1] - reading.t[0])
        every = max(1, round(_GRID / fine))
        tau = with_held_torque(reading.tau, reading.t, plan.held, number)
        # One row of so many, of triangular means, which hold back what would be folded.
        tau, q, dq, ddq, friction, resistance = (
            uniform_filter1d(uniform_filter1d(x, every, axis=0), every, axis=0)[::every]
            for x in (tau, reading.q, reading.dq, reading.ddq, trace.friction, trace.resistance)
        )
        known = friction.copy()
        for joint in plan.replaced:
            direction, limit = dry(dq[:, joint]), plan.known_friction[joint]
            sticks = np.clip(resistance[:, joint], -limit, limit)
            known[:, joint] = limit * direction + (1 - np.abs(direction)) * sticks
        gap = tau - nominal.rigid(q, dq, ddq) - plan.known_damping * dq - known
        out.append(low_passed(gap, fine * every))
    return out


def size_of(scene: Scene, plan: Plan, nominal: Nominal, traces: Sequence[Trace]) -> Array:
    """RMS (n,) of the gap below 20 Hz, in standard deviations of the noise."""
    return rms(gaps(plan, nominal, traces)) / scene.noise


def with_effect(
    scene: Scene, plan: Plan, effect: EffectSpec, scale: float
) -> tuple[Plan, Parameters]:
    """The plan with an effect at a scale."""
    return kind_named(effect.name).plant(scene, plan, effect, scale)


def sized(scene: Scene, base: Plan, nominal: Nominal, effect: EffectSpec, level: float) -> Sized:
    """The scale at which an effect alone has a wanted size, or the largest that it may have.

    Size grows about in proportion to the scale; where it does not, the last two tries say how.

    Args:
        scene, base, nominal: the arm without effects.
        effect: to plant.
        level: wanted size, the largest of all joints.

    Raises:
        TorchidError: the arm bears the effect at no size that was tried.
    """
    kind = kind_named(effect.name)
    still: list[Trace] = []

    def measured(scale: float) -> Array:
        plan, _ = with_effect(scene, base, effect, scale)
        if kind.sensing:
            still[:] = still or simulated(scene, base, nominal, COARSE)
        traces = still if kind.sensing else simulated(scene, plan, nominal, COARSE)
        return size_of(scene, plan, nominal, traces)

    usual = kind.usual(scene, effect) * level / 5.0
    return scale_of(measured, usual, kind.largest(scene, effect), level, effect.name)


def scale_of(
    measured: Callable[[float], Array], usual: float, largest: float, level: float, name: str
) -> Sized:
    """The scale at which an effect has a wanted size, or the largest that it may have.

    Args:
        measured: (n,) its size at a scale; an error where the arm does not bear it.
        usual, largest: scales to begin with, and at most.
        level: wanted size, the largest of all joints.
        name: of the effect.

    Raises:
        TorchidError: the arm bears the effect at no size that was tried.
    """
    scale = min(largest, usual)
    tried: list[Sized] = []
    for _ in range(_TRIES):
        try:
            size = measured(scale)
        except TorchidError:
            # More than the controllers bear.
            largest = scale = 0.5 * scale
            continue
        tried.append(Sized(scale, size))
        if abs(size.max() / level - 1) < _CLOSE:
            break
        following = _next(tried, level, largest)
        if abs(following / scale - 1) < 0.01:
            break
        scale = following
    if not tried:
        raise TorchidError(f"{name} is more than the arm bears at any size.")
    return min(tried, key=lambda s: abs(np.log(s.size.max() / level)))


def _next(tried: Sequence[Sized], level: float, largest: float) -> float:
    """The next scale to try."""
    scales = [s.scale for s in tried[-2:]]
    sizes = [max(float(s.size.max()), 1e-6) for s in tried[-2:]]
    slope = 1.0
    if len(tried) > 1:
        rise = np.log(sizes[1] / sizes[0]) / np.log(scales[1] / scales[0])
        slope = float(np.clip(rise, 0.4, 3.0))
    step = float(np.clip((level / sizes[-1]) ** (1 / slope), 0.02, 30.0))
    return min(largest, scales[-1] * step)
