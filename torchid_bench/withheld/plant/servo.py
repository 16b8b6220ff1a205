"""An arm that position servos move in MuJoCo: what its bus carries, what its servos make of it, and
what the joints do.

A servo's own step is MuJoCo's. It holds the last command that came, reads its encoder in counts,
and its torque is an actuator's; damping is MuJoCo's implicit one, dry friction its constraint, of a
bound that is set anew in each step and so stiff that a joint at rest stays there.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from torchid.errors import TorchidError
from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.model import Plant, compiled, mujoco
from torchid_bench.withheld.plant.servo_friction import Beyond

STEP = 2e-3
"""Longest step [s]."""
SETTLE = 2.0
"""At the first command before a motion is logged [s]."""
_ASTRAY = 3.0  # rad from the set-point at which a simulation is no longer one of a servo
_RIGID = 0.9999  # impedance of dry friction: what is left to 1 creeps
_RATE_FILTER = 0.01  # of a set-point's rate [s]

NEUTRAL = MappingProxyType(
    {
        "kp": 0.0, "kd": 0.0, "integral": 0.0, "hardening": 0.0, "dead_zone": 0.0, "clip": np.inf,
        "sag": 0.0, "fade": 0.0, "offset": 0.0, "delay": 0.0, "lag": 0.0, "late": 0.0,
        "dropped": 0.0, "scale": 1.0, "acceleration": np.inf, "speed": np.inf, "coulomb": 0.0,
        "stiction": 0.0, "stribeck_speed": 1.0, "load_share": 0.0, "motor_share": 0.0,
        "stiction_share": 0.0, "cogging": 0.0, "teeth": 1.0, "heating": 0.0, "jitter": 0.0,
    }
)  # fmt: skip
"""Every number of a servo, with its value without effect: kp [N m/rad], kd [N m s/rad] on the rate
of the set-point less the joint's, integral [N m/(rad s)], hardening of kp [1/rad], dead_zone [rad],
clip [N m], sag of the supply per torque of all servos [1/(N m)], fade of kp over the session [1],
offset [N m], delay, lag of a first-order filter, late position readings [s], share of commands that
are dropped, scale of the command, limits of the set-point's acceleration [rad/s^2] and speed
[rad/s], coulomb, stiction [N m] that fades with stribeck_speed [rad/s], friction per external and
per motor torque, friction that fades per torque of the gear, cogging [N m] with teeth a turn,
heating: how much friction falls [1], jitter of the times at which commands come [samples]."""


@dataclass(frozen=True)
class Servos:
    """Servos of an arm and of its log.

    Attributes:
        values: by name of `NEUTRAL`, (n,) each.
        count: step of the encoders [rad].
        rate_hz: of the log and of the commands.
        seed: of commands that are dropped, and of jitter.
        beyond: friction and cables beyond a plain servo's; None of plain servos.
    """

    values: Mapping[str, Array] = field(default_factory=dict)
    count: float = 2 * np.pi / 4096
    rate_hz: float = 50.0
    seed: int = 0
    beyond: Beyond | None = None

    def of(self, name: str, n: int) -> Array:
        """(n,) one number of every joint."""
        return np.broadcast_to(self.values.get(name, NEUTRAL[name]), n).astype(float)

    def has(self, name: str) -> bool:
        """Whether some joint has the effect."""
        return name in self.values and bool(np.any(self.values[name] != NEUTRAL[name]))


@dataclass(frozen=True)
class Moved:
    """Where an arm went, in the rows of its log.

    Attributes:
        q: (T, n) [rad].
        logged: (T, n) what its encoders said [rad].
        torque, load: (T, n) of servos, and of gravity and motion [N m].
        tool: (T,) height of the tool point [m].
    """

    q: Array
    logged: Array
    torque: Array
    load: Array
    tool: Array


def moved(plant: Plant, servos: Servos, commands: list[Array]) -> list[Moved]:
    """Where the commands of several motions move an arm, which settles at the first of each.

    Args:
        plant: with kp and friction in `servos`, not here.
        servos: of its joints.
        commands: (T, n) of each motion, one a row of the log.

    Raises:
        TorchidError: the simulation diverged.
    """
    ends = np.cumsum([0, *(len(u) for u in commands)])
    ages = ends / ends[-1]
    return [
        _motion(plant, servos, u, number, (ages[number], ages[number + 1]))
        for number, u in enumerate(commands)
    ]


def _motion(
    plant: Plant, servos: Servos, u: Array, number: int, ages: tuple[float, float]
) -> Moved:
    """One motion, from one share of the session to another."""
    # A gear between two masses is faster than a servo.
    n, every = plant.n, round((2 if plant.drives else 1) / servos.rate_hz / STEP)
    step = 1 / servos.rate_hz / every
    settle = round(SETTLE * servos.rate_hz)
    given = np.concatenate([np.repeat(u[:1], settle, 0), u])
    x, dx = set_points(servos, given, every, np.random.default_rng([servos.seed, number]))
    model, motors = compiled(plant, np.zeros(n), np.zeros(n), step)
    p = {name: servos.of(name, n) for name in NEUTRAL}
    # The derivative's part on the joint's own rate is implicit, as damping is.
    model.dof_damping[motors] += p["kd"]
    model.dof_solimp[:, :2] = _RIGID
    model.dof_frictionloss[motors] = p["coulomb"]
    beyond, varying = (
        servos.beyond,
        ("stiction", "load_share", "motor_share", "stiction_share", "heating"),
    )
    dry_changes = beyond is not None or any(map(servos.has, varying))
    data, forward = mujoco().MjData(model), mujoco().mj_step
    data.qpos[motors] = given[0]
    bias, tool = data.qfrc_bias, model.body("tool").id
    age = np.interp(np.arange(len(x)), (settle * every, len(x)), ages)[:, None]
    gain, sagging = p["kp"] * (1 - p["fade"] * age), servos.has("sag")
    odd = any(map(servos.has, ("dead_zone", "hardening", "integral")))
    pushed = p["kd"] * dx
    q_of, torque_of, load_of = (np.empty((len(x), n)) for _ in range(3))
    height = np.empty(len(x))
    summed, sag = np.zeros(n), 1.0
    for k, goal in enumerate(x):
        q, dq, load = data.qpos[motors], data.qvel[motors], bias[motors]
        # The servo.
        e = goal - np.rint(q / servos.count) * servos.count
        if odd:
            e -= np.clip(e, -p["dead_zone"], p["dead_zone"])
            summed = np.clip(summed + p["integral"] * e * step, -0.2 * p["kp"], 0.2 * p["kp"])
            e = e * (1 + p["hardening"] * np.abs(e))
        torque = gain[k] * e + pushed[k] + summed
        if sagging:
            # The supply follows within some steps, so that sag and torque settle on each other.
            sag += 0.1 * (1 / (1 + float(p["sag"] @ np.abs(torque))) - sag)
            torque = torque * sag
        torque = np.minimum(np.maximum(torque, -p["clip"]), p["clip"])
        q_of[k], torque_of[k], load_of[k], height[k] = q, torque, load, data.xpos[tool, 2]
        data.ctrl[:] = torque + p["offset"] + p["cogging"] * np.sin(p["teeth"] * q)
        if dry_changes:
            motor = torque - p["kd"] * dq
            fades = p["stiction"] + p["stiction_share"] * np.abs(load + motor)
            dry = p["coulomb"] + fades * np.exp(-np.abs(dq) / p["stribeck_speed"])
            dry += np.abs(p["load_share"] * load + p["motor_share"] * motor)
            if beyond is not None:
                dry = beyond.dry(dry, dq, motor, -load)
                data.ctrl[:] += beyond.pull(q)
            model.dof_frictionloss[motors] = dry * (1 - p["heating"] * age[k])
        forward(model, data)
    if not np.isfinite(q_of).all() or np.abs(q_of - x).max() > _ASTRAY:
        raise TorchidError("a withheld case could not be simulated: the arm diverged.")
    rows = np.arange(settle, len(given)) * every
    read = q_of[rows[:, None] - np.round(p["late"] / step).astype(int), np.arange(n)]
    logged = np.round(read / servos.count) * servos.count
    return Moved(q_of[rows], logged, torque_of[rows], load_of[rows], height[rows])


def set_points(
    servos: Servos, u: Array, every: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """What servos are to follow in every step (T every, n), and its filtered rate.

    Args:
        servos: with delays, limits, scales.
        u: (T, n) commands.
        every: steps a row.
        rng: of commands that are dropped; those of all joints are sent as one.
    """
    n, step = u.shape[1], 1 / servos.rate_hz / every
    p = {name: servos.of(name, n) for name in NEUTRAL}
    # A command that was dropped leaves the one before.
    kept = rng.random(len(u))[:, None] >= p["dropped"]
    kept[0] = True
    last = np.maximum.accumulate(np.where(kept, np.arange(len(u))[:, None], 0), axis=0)
    sent = np.take_along_axis(u, last, 0) * p["scale"]
    # Held until the next one, and late.
    come = every * (np.arange(len(u)) + p["jitter"].max() * rng.random(len(u)))
    come[0] = 0.0
    held = sent[np.searchsorted(come, np.arange(len(u) * every), "right") - 1]
    late = np.round(p["delay"] / step).astype(int)
    rows = np.maximum(np.arange(len(held))[:, None] - late, 0)
    x = np.take_along_axis(held, rows, 0)
    if servos.has("acceleration") or servos.has("speed"):
        x = _limited(x, p["acceleration"], p["speed"], step)
    if servos.has("lag"):
        x = _filtered(x, p["lag"], step)
    rate = np.gradient(_filtered(x, np.full(n, _RATE_FILTER), step), step, axis=0)
    return x, rate


def _filtered(x: Array, lag: Array, step: float) -> Array:
    """First-order filters of time constants (n,) [s]; none of 0."""
    keep = np.exp(-step / np.maximum(lag, 1e-9))
    out, y = np.empty_like(x), x[0]
    for k, goal in enumerate(x):
        y = goal + keep * (y - goal)
        out[k] = y
    return out


def _limited(x: Array, acceleration: Array, speed: Array, step: float) -> Array:
    """A set-point that goes to each goal at the speed from which it can still brake, and changes
    its speed no faster than it may."""
    out, at, v = np.empty_like(x), x[0].copy(), np.zeros(x.shape[1])
    a, most = np.minimum(acceleration, 1e4), np.minimum(speed, 1e3)
    for k, goal in enumerate(x):
        left = goal - at
        # In whole steps: the braking that begins in the next one must still do.
        brakes = a * step * (np.sqrt(0.25 + 2 * np.abs(left) / (a * step**2)) - 0.5)
        wanted = np.sign(left) * np.minimum(np.minimum(brakes, most), np.abs(left) / step)
        v = v + np.clip(wanted - v, -a * step, a * step)
        at = at + v * step
        out[k] = at
    return out
