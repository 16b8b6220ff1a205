"""Torque with a state, computed beside MuJoCo at every step.

Each function is a law: what it is called with but for the running simulation makes it, and started
with a trajectory it returns what to do before step k. Laws work on single numbers, for speed. `dof`
is the motor's, for what resists in gear and motor.
"""

from collections.abc import Callable, Sequence
from functools import wraps
from math import copysign, exp, sin
from typing import Concatenate, ParamSpec

import numpy as np

from torchid_bench.withheld.plant.plan import Act, Law, Live

Limit = Callable[[float, int], float]
"""Friction that bristles carry when they slide [N m], of speed and step."""

P = ParamSpec("P")


def _law(start: Callable[Concatenate[Live, P], Act]) -> Callable[P, Law]:
    """What makes a law of its own numbers."""

    @wraps(start)
    def made(*args: P.args, **kwargs: P.kwargs) -> Law:
        return lambda live: start(live, *args, **kwargs)

    return made


@_law
def bristles(live: Live, joint: int, limit: Limit, deflection: float) -> Act:
    """LuGre friction: bristles of stiffness sigma0 that slide at a limit g(dq).

    dz/dt = dq - sigma0 |dq| z / g(dq), torque sigma0 z (Canudas de Wit et al. 1995, sigma1 = 0);
    exact over a step at constant speed, so stiff bristles need no smaller steps.

    Args:
        joint: from 0.
        limit: g.
        deflection: at which bristles with the limit at speed 0 slide [rad].
    """
    dof = int(live.motors[joint])
    dq, applied, step = live.dq, live.applied, live.step
    stiffness = max(limit(0.0, 0), 1e-9) / deflection
    z = 0.0

    def act(k: int) -> None:
        nonlocal z
        speed = float(dq[dof])
        g = max(limit(speed, k), 1e-9)
        slides = copysign(g / stiffness, speed)
        z = slides + (z - slides) * exp(-stiffness * abs(speed) * step / g)
        applied[dof] -= stiffness * z

    return act


@_law
def slip_elements(live: Live, joint: int, torque: float, lengths: tuple[float, ...]) -> Act:
    """Maxwell-slip hysteresis: springs in parallel, each with a slider (Al-Bender et al. 2005).

    Args:
        joint: from 0.
        torque: of all elements when they slide [N m].
        lengths: displacement at which each begins to slide [rad].
    """
    share = torque / len(lengths)
    dof = int(live.motors[joint])
    dq, applied, step = live.dq, live.applied, live.step
    stiffness = [share / length for length in lengths]
    forces = [0.0 for _ in lengths]

    def act(k: int) -> None:
        move = float(dq[dof]) * step
        for i, c in enumerate(stiffness):
            forces[i] = min(max(forces[i] + c * move, -share), share)
        applied[dof] -= sum(forces)

    return act


@_law
def resisting(live: Live, joint: int, torque: Callable[[float, float], float]) -> Act:
    """Torque against the motor's motion that is a function of its position and speed [N m]."""
    dof = int(live.motors[joint])
    q, dq, applied = live.q, live.dq, live.applied

    def act(k: int) -> None:
        applied[dof] -= torque(float(q[dof]), float(dq[dof]))

    return act


def _bent(z: float, speed: float, step: float, deflection: float) -> float:
    """How far bristles are bent after a step, 1 or -1 where they slide."""
    slides = copysign(1.0, speed)
    return slides + (z - slides) * exp(-abs(speed) * step / deflection)


def _motor(live: Live, joint: int) -> Callable[[int], float]:
    """Torque of a joint's motor at step k [N m]."""
    dof, q, dq = int(live.motors[joint]), live.q, live.dq
    kp, kd = float(live.kp[joint]), float(live.kd[joint])
    command = np.ascontiguousarray(live.command[:, joint])
    return lambda k: float(command[k]) - kp * float(q[dof]) - kd * float(dq[dof])


@_law
def loaded_bristles(live: Live, joint: int, share: float, deflection: float) -> Act:
    """Bristles whose limit is a share of the torque that the gear transmits just now."""
    dof, motor_at = int(live.motors[joint]), _motor(live, joint)
    dq, applied, step = live.dq, live.applied, live.step
    z, torque = 0.0, 0.0

    def act(k: int) -> None:
        nonlocal z, torque
        z = _bent(z, float(dq[dof]), step, deflection)
        torque = share * abs(motor_at(k) - torque) * z
        applied[dof] -= torque

    return act


@_law
def one_sided_bristles(live: Live, joint: int, torque: float, deflection: float) -> Act:
    """A torque [N m] the same way whichever way the bristles are bent, |z| of its full size."""
    dof = int(live.motors[joint])
    dq, applied, step = live.dq, live.applied, live.step
    z = 0.0

    def act(k: int) -> None:
        nonlocal z
        z = _bent(z, float(dq[dof]), step, deflection)
        applied[dof] -= torque * abs(z)

    return act


@_law
def rippling_motor(live: Live, joint: int, share: float, k: float, phase: float) -> Act:
    """A motor whose torque constant ripples with its angle: u share sin(k q + phase) is lost."""
    dof, motor_at = int(live.motors[joint]), _motor(live, joint)
    q, applied = live.q, live.applied

    def act(step: int) -> None:
        applied[dof] -= motor_at(step) * share * np.sin(k * float(q[dof]) + phase)

    return act


@_law
def varying(
    live: Live, joint: int, damping: float, friction: float, wave: Callable[[float, float], float]
) -> Act:
    """MuJoCo's own damping and dry friction, changed by so much times a function of the joint's
    position [rad] and of time [s]."""
    dof = int(live.motors[joint])
    fields, q, t = (live.damping, live.friction), live.q, live.t
    mean = float(fields[0][dof]), float(fields[1][dof])

    def act(step: int) -> None:
        now = wave(float(q[dof]), float(t[step]))
        fields[0][dof] = mean[0] + damping * now
        fields[1][dof] = mean[1] + friction * now

    return act


Wave = tuple[float, float, float, float]
"""Amplitude, wave numbers along two coordinates, and phase."""


@_law
def waves(
    live: Live, joint: int, torque: float, terms: Sequence[Wave], other: int | None, unit: float
) -> Act:
    """A torque [N m] against the motor's motion that is a sum of plane waves: over its position and
    another motor's [rad], or over its position and its speed in units of `unit` [rad/s]."""
    dof, q, dq, applied = int(live.motors[joint]), live.q, live.dq, live.applied
    second, at = (dq, dof) if other is None else (q, int(live.motors[other]))

    def act(step: int) -> None:
        x, y = float(q[dof]), float(second[at]) / unit
        applied[dof] -= torque * sum(a * sin(k * x + m * y + c) for a, k, m, c in terms)

    return act


@_law
def creeping(live: Live, joint: int, stiffness: float, seconds: float) -> Act:
    """A spring to where the motor was some time ago, as of rubber: its far end follows slowly."""
    dof, q, applied = int(live.motors[joint]), live.q, live.applied
    keep = exp(-live.step / seconds)
    end = float(q[dof])

    def act(step: int) -> None:
        nonlocal end
        end = float(q[dof]) + (end - float(q[dof])) * keep
        applied[dof] -= stiffness * (float(q[dof]) - end)

    return act


@_law
def bursting(live: Live, joint: int, torque: float, rate: float, seed: int) -> Act:
    """Half sines of torque [N m] at random instants, of random length and sign, so many a
    second."""
    dof, applied, t = int(live.motors[joint]), live.applied, live.t
    rng = np.random.default_rng([seed, abs(round(1000 * float(t[0])))])
    total = np.zeros(len(t))
    for _ in range(max(2, round(rate * float(t[-1] - t[0])))):
        begin, length = rng.uniform(t[0], t[-1]), rng.uniform(0.15, 0.8)
        phase = np.clip((t - begin) / length, 0, 1) * np.pi
        total += torque * rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5) * np.sin(phase)

    def act(step: int) -> None:
        applied[dof] -= total[step]

    return act
