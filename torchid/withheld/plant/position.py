"""Cases of commands and positions: arms whose servos log no torque, drawn from a seed and a number.

Every arm has plain servos: a gain, viscous and dry friction, a rotor's inertia, encoders in counts,
and a bus that holds each command until the next and is late by less than a sample. What a case has
beside that is its effects.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from torchid.errors import TorchidError
from torchid.withheld.plant.arms import ARMS, Arm, arm_named, urdf
from torchid.withheld.plant.bodies import Array, Box
from torchid.withheld.plant.case import SimulatedCase
from torchid.withheld.plant.draw import in_turn, turn_of
from torchid.withheld.plant.model import Drive, Plant, Spring, plant_of
from torchid.withheld.plant.scene import nominal_of
from torchid.withheld.plant.servo import Moved, Servos, moved

Rng = np.random.Generator
BLOCK = (*["none"] * 5, *["single"] * 9, *["several"] * 2, *["outside"] * 4)
"""Kinds of twenty cases in a row."""
OUTSIDE = "outside"
SEEN = 2.0
"""Least change of a joint's positions that an effect makes, over what its encoder rounds to [1]: a
smaller one is drawn larger."""
LARGER, TRIES = 1.6, 6
FELT = 0.1
"""Share of the largest change of a joint's positions from which on a joint feels an effect."""


@dataclass(frozen=True)
class Scene:
    """An arm with plain servos, and how it moves without any effect.

    Attributes:
        arm, plant, servos: of it.
        inertia: (n,) of joints with their rotors, in the middle [kg m^2].
        commands: (T, n) of each motion [rad].
        base: where they lead.
    """

    arm: Arm
    plant: Plant
    servos: Servos
    inertia: Array
    commands: list[Array]
    base: list[Moved]

    def shown(self, values: Callable[[Moved], Array]) -> Array:
        """Something of all motions, one after the other."""
        return np.concatenate([values(m) for m in self.base])

    @property
    def torque(self) -> Array:
        """(n,) 99.9 % of the servos' torques [N m]."""
        return np.asarray(np.quantile(np.abs(self.shown(lambda m: m.torque)), 0.999, axis=0))

    @property
    def kp(self) -> Array:
        """(n,) gains [N m/rad]."""
        return self.servos.of("kp", self.arm.n)

    def rates(self, order: int) -> Array:
        """(n,) 99.5 % of the speeds [rad/s] (1) or accelerations [rad/s^2] (2) of the motions."""
        size = np.abs(self.shown(lambda m: np.diff(m.q, order, axis=0)))
        return np.asarray(np.quantile(size, 0.995, axis=0)) * self.servos.rate_hz**order


Change = dict[str, float] | Plant
"""Of an effect: numbers of the joint's servo, or another plant."""
Make = Callable[[Scene, int, float, float], Change]
"""From a scene, a joint, a size of about 1 and a number between 0 and 1 that says which variant."""


@dataclass(frozen=True)
class Kind:
    """An effect that can be planted.

    Attributes:
        family: of the diagnosis, or `outside`.
        make: what it changes.
        place: `joint`; `bus`, one joint or all; `loaded`, a joint that bears gravity; `arm`.
        akin: names and families that an honest answer may give it as well.
    """

    family: str
    make: Make
    place: str = "joint"
    akin: tuple[str, ...] = ()


def _numbers(**of: Callable[[Scene, int, float, float], float]) -> Make:
    return lambda scene, j, s, x: {name: value(scene, j, s, x) for name, value in of.items()}


def _way(x: float) -> float:
    return 1.0 if x > 0.5 else -1.0


def _stop(scene: Scene, j: int, s: float, x: float) -> Plant:
    """An end that one side of the motions reaches."""
    q = scene.shown(lambda m: m.q[:, j])
    middle, reach = np.median(q), min(0.18 * s, 0.7)
    low, high = q.min() - 1.0, q.max() + 1.0
    if x > 0.5:
        high = q.max() - reach * (q.max() - middle)
    else:
        low = q.min() + reach * (middle - q.min())
    return replace(scene.plant, stops={j: (float(low), float(high))})


def _floor(scene: Scene, j: int, s: float, x: float) -> Plant:
    """A plane that the tool reaches for a small part of the time."""
    height = scene.shown(lambda m: m.tool)
    return replace(scene.plant, floor=float(np.quantile(height, min(0.02 * s * (1 + x), 0.2))))


def _drive(scene: Scene, j: int, stiff: float, play: float = 0.0) -> Plant:
    """The rotor before a spring of so many times the servo's gain, with or without play, and the
    link behind it; the encoder is the rotor's."""
    stiffness = stiff * float(scene.kp[j])
    damping = 0.4 * float(np.sqrt(stiffness * (scene.inertia - scene.plant.armature)[j]))
    return replace(scene.plant, drives=(Drive(j, 0.0, stiffness, damping, play),))


def _payload(scene: Scene, j: int, s: float, x: float) -> Plant:
    body = Box(1.0, (0.06, 0.06, 0.06), scene.arm.tool).inertial()
    last = scene.plant.links[-1].body.mass
    factor = 0.4 * s * (1 + x) * last / body.mass
    heavy = replace(body, mass=body.mass * factor, inertia=body.inertia * factor)
    return replace(scene.plant, payload=heavy)


def _cable(scene: Scene, j: int, s: float, x: float) -> Plant:
    q = scene.shown(lambda m: m.q[:, j])
    rest = float(q.min() if x > 0.5 else q.max())
    return replace(scene.plant, springs=(Spring(j, 0.05 * s * float(scene.kp[j]), rest),))


def _effort(share: float) -> Callable[[Scene, int, float, float], float]:
    """A torque that makes so many radians of position error."""
    return lambda scene, j, s, x: share * s * (0.7 + 0.6 * x) * float(scene.kp[j])


def _damping(scene: Scene, j: int) -> float:
    return float(scene.plant.damping[j])


KINDS: dict[str, Kind] = {
    "command_delay": Kind(
        "command",
        _numbers(delay=lambda c, j, s, x: 1 / c.servos.rate_hz + s * (0.02 + 0.03 * x)),
        "bus",
    ),
    "set_point_profile": Kind(
        "command",
        _numbers(acceleration=lambda c, j, s, x: (0.3 + 0.4 * x) / s * float(c.rates(2)[j])),
        "bus",
    ),
    "set_point_speed": Kind(
        "command",
        _numbers(speed=lambda c, j, s, x: (0.3 + 0.3 * x) / s * float(c.rates(1)[j])),
        "bus",
    ),
    "command_gain": Kind(
        "command",
        _numbers(scale=lambda c, j, s, x: 1 + s * _way(x) * (0.04 + 0.08 * abs(2 * x - 1))),
    ),
    "derivative_gain": Kind(
        "servo", _numbers(kd=lambda c, j, s, x: s * (0.4 + 0.6 * x) * _damping(c, j))
    ),
    "saturation": Kind(
        "servo",
        _numbers(clip=lambda c, j, s, x: (0.4 + 0.3 * x) / s * float(c.torque[j])),
    ),
    "dead_zone": Kind("servo", _numbers(dead_zone=lambda c, j, s, x: s * (0.004 + 0.008 * x))),
    "torque_offset": Kind(
        "servo",
        _numbers(offset=lambda c, j, s, x: _way(x) * 0.012 * s * (1 + x) * float(c.kp[j])),
    ),
    "stribeck_friction": Kind(
        "friction",
        _numbers(stiction=_effort(0.008), stribeck_speed=lambda c, j, s, x: 0.02 + 0.06 * x),
    ),
    "load_dependent_friction": Kind(
        "friction", _numbers(load_share=lambda c, j, s, x: s * (0.2 + 0.2 * x)), "loaded"
    ),
    "motor_dependent_friction": Kind(
        "friction", _numbers(motor_share=lambda c, j, s, x: s * (0.15 + 0.2 * x)), "loaded"
    ),
    "end_stop": Kind("world", _stop),
    "plane_contact": Kind("world", _floor, "arm"),
    "payload": Kind("inertia", _payload, "arm"),
    "integral_action": Kind(
        "servo", _numbers(integral=lambda c, j, s, x: s * (0.5 + x) * float(c.kp[j])), "loaded"
    ),
    "command_filter": Kind(
        "command", _numbers(lag=lambda c, j, s, x: s * (0.05 + 0.05 * x)), "bus"
    ),
    # Outside of what the diagnosis has.
    "backlash": Kind(
        OUTSIDE, lambda c, j, s, x: _drive(c, j, 20.0, s * (0.02 + 0.03 * x)), "loaded",
        ("dead_zone",),
    ),
    "elasticity": Kind(OUTSIDE, lambda c, j, s, x: _drive(c, j, (2 + 2 * x) / s), "loaded"),
    "supply_sag": Kind(
        OUTSIDE,
        _numbers(sag=lambda c, j, s, x: s * (0.2 + 0.3 * x) / c.torque.sum()),
        "all",
        ("saturation",),
    ),
    "fading_gain": Kind(OUTSIDE, _numbers(fade=lambda c, j, s, x: min(s * (0.2 + 0.2 * x), 0.7))),
    "warming_friction": Kind(
        OUTSIDE,
        _numbers(
            coulomb=lambda c, j, s, x: (1 + s) * float(c.servos.of("coulomb", c.arm.n)[j]),
            heating=lambda c, j, s, x: 0.5 + 0.4 * x,
        ),
        akin=("friction",),
    ),
    "nonlinear_gain": Kind(
        OUTSIDE, _numbers(hardening=lambda c, j, s, x: s * (4.0 + 8.0 * x)), akin=("dead_zone",)
    ),
    "cable": Kind(OUTSIDE, _cable, akin=("torque_offset",)),
    "dropped_commands": Kind(
        OUTSIDE, _numbers(dropped=lambda c, j, s, x: min(s * (0.2 + 0.2 * x), 0.8)), "all",
        ("command",),
    ),
    "late_positions": Kind(
        OUTSIDE, _numbers(late=lambda c, j, s, x: s * (0.02 + 0.04 * x)), "bus", ("command",)
    ),
    "cogging": Kind(
        OUTSIDE, _numbers(cogging=_effort(0.01), teeth=lambda c, j, s, x: round(8 + 16 * x))
    ),
}  # fmt: skip

LIBRARY = tuple(name for name, kind in KINDS.items() if kind.family != OUTSIDE)
FOREIGN = tuple(name for name, kind in KINDS.items() if kind.family == OUTSIDE)


@dataclass(frozen=True)
class Planting:
    """An effect to plant: its name, its joints from 0 (empty for the arm), and its variant."""

    name: str
    joints: tuple[int, ...]
    variant: float


@dataclass(frozen=True)
class PositionSpec:
    """A case before it is simulated.

    Attributes:
        seed, number: what it was drawn from.
        kind: none, single, several or outside.
        arm: 3r, 6r or 7r.
        effects: names to plant; their joints are drawn where the loads are known.
        rate_hz: of the log.
        counts: of an encoder in one turn.
    """

    seed: int
    number: int
    kind: str
    arm: str
    effects: tuple[str, ...]
    rate_hz: float
    counts: int


def draw_case(
    seed: int,
    number: int,
    *,
    kind: str | None = None,
    effects: Sequence[str] | None = None,
    arm: str | None = None,
) -> PositionSpec:
    """A case from a seed and its number; what is given is not drawn.

    Args:
        seed: of the set.
        number: of the case, from 0.
        kind: of the case.
        effects: names of the effects to plant.
        arm: 3r, 6r or 7r.

    Raises:
        TorchidError: an unknown effect or arm.
    """
    for name in effects or ():
        if name not in KINDS:
            raise TorchidError(f"no servo can have an effect '{name}'.", available=list(KINDS))
    if kind is None and effects is not None:
        inside = all(KINDS[name].family != OUTSIDE for name in effects)
        kind = ("none", "single", "several")[min(len(effects), 2)] if inside else "outside"
    kind = kind or in_turn(seed, number, BLOCK, 101)
    rng, turn = np.random.default_rng([seed, number, 1]), turn_of(seed, number, kind, BLOCK)
    if effects is None:
        effects = {
            "none": lambda: (),
            "single": lambda: (in_turn(seed, turn, LIBRARY, 104),),
            "several": lambda: tuple(map(str, rng.choice(LIBRARY, 2, replace=False))),
            "outside": lambda: (in_turn(seed, turn, FOREIGN, 103),),
        }[kind]()
    name = arm or str(rng.choice(list(ARMS)))
    return PositionSpec(
        seed, number, kind, arm_named(name).name, tuple(effects),
        rate_hz=float(rng.choice([30, 50, 100])), counts=int(rng.choice([4096, 4096, 16384])),
    )  # fmt: skip


def simulate_case(spec: PositionSpec) -> SimulatedCase:
    """Simulate a case.

    Raises:
        TorchidError: a simulation that diverged.
        MissingExtraError: MuJoCo is not installed.
    """
    rng = np.random.default_rng([spec.seed, spec.number, 2])
    scene = _scene(spec, rng)
    n = scene.arm.n
    plant, servos, effects = scene.plant, scene.servos, []
    taken: set[int] = set()
    found = scene.base
    for name in spec.effects:
        planting = _placed(scene, name, rng, taken)
        taken |= set(planting.joints)
        plant, servos, entry, found = _sized(scene, plant, servos, planting)
        effects.append(entry)
    if len(effects) > 1:
        found = moved(plant, servos, scene.commands)
    rows = [len(u) for u in scene.commands]
    columns = {
        "t": np.concatenate([np.arange(k) / spec.rate_hz for k in rows]),
        **{f"u{j + 1}": np.concatenate([u[:, j] for u in scene.commands]) for j in range(n)},
        **{f"q{j + 1}": np.concatenate([m.logged[:, j] for m in found]) for j in range(n)},
        "traj": np.repeat(np.arange(len(rows)), rows),
    }
    zero = np.zeros(n)
    background = {k: np.broadcast_to(v, n).tolist() for k, v in scene.servos.values.items()}
    key = {
        "kind": spec.kind,
        "arm": spec.arm,
        "rate_hz": spec.rate_hz,
        "level": None,
        "effects": effects,
        "background": {
            **background,
            "damping": scene.plant.damping.tolist(),
            "armature": scene.plant.armature.tolist(),
        },
        "counts": spec.counts,
    }
    return SimulatedCase(urdf(scene.arm, zero, zero), columns, key)


def _scene(spec: PositionSpec, rng: Rng) -> Scene:
    """The arm with plain servos, gains as small servos' are beside their loads."""
    arm = arm_named(spec.arm)
    n = arm.n
    kp = np.array([joint.effort for joint in arm.joints]) * rng.uniform(5.0, 10.0, n)
    plant = plant_of(arm, np.zeros(n), np.zeros(n))
    # What the joints bear, the arm bent a little; rotors behind large gears make servos slow: their
    # own frequencies [rad/s] tell their inertias.
    own = nominal_of(arm, np.zeros(n), np.zeros(n)).inertia(np.full((1, n), 0.6))[0].diagonal()
    fast = rng.uniform(15.0, 35.0, n)
    armature = np.maximum(kp / fast**2 - own, 0.2 * own)
    damping = 2 * rng.uniform(0.5, 1.1, n) * np.sqrt(kp * (own + armature))
    plant = replace(plant, damping=damping, armature=armature)
    servos = Servos(
        {
            "kp": kp,
            "coulomb": kp * rng.uniform(0.002, 0.006, n),
            "delay": np.full(n, rng.uniform(0, 0.4) / spec.rate_hz),
        },
        count=2 * np.pi / spec.counts,
        rate_hz=spec.rate_hz,
        seed=int(rng.integers(2**31)),
    )
    commands = motions(arm, spec.rate_hz, rng)
    return Scene(arm, plant, servos, own + armature, commands, moved(plant, servos, commands))


def motions(arm: Arm, rate_hz: float, rng: Rng) -> list[Array]:
    """Commands (T, n) of seven motions: slow sweeps with holds, steps of several sizes, sums of
    sines and chirps, about a pose that changes from one to the next."""
    n, out = arm.n, []
    limit = np.array([joint.upper for joint in arm.joints])
    pose = rng.uniform(-0.35, 0.35, n) * limit
    for what in ("sweep", "steps", "sines", "chirp", "sweep", "steps", "sines"):
        seconds = rng.uniform(14.0, 18.0)
        t = np.arange(round(seconds * rate_hz))[:, None] / rate_hz
        rise = np.clip(t / 1.0, 0, 1) ** 2 * (3 - 2 * np.clip(t / 1.0, 0, 1))
        if what == "sweep":
            # There and back; every third of the time the arm stands.
            moving = np.cumsum((t % 4.5 < 3.0) / rate_hz, axis=0)
            wave = 1 - np.cos(2 * np.pi * rng.uniform(0.06, 0.18, n) * moving)
            u = rng.uniform(0.25, 0.5, n) * wave
        elif what == "steps":
            held = np.floor(t[:, 0] / rng.uniform(1.2, 2.0)).astype(int)
            u = rng.uniform(-1, 1, (held[-1] + 1, n)) * rng.choice([0.05, 0.15, 0.3], (1, n))
            u = u[held]
        elif what == "sines":
            u = np.zeros((len(t), n))
            for _ in range(3):
                u += rng.uniform(0.05, 0.2, n) * np.sin(
                    2 * np.pi * rng.uniform(0.1, 0.9, n) * t + rng.uniform(0, 2 * np.pi, n)
                )
            u = rise * u
        else:
            last = rng.uniform(2.0, 3.5)
            u = rise * 0.08 * np.sin(2 * np.pi * (0.2 * t + (last - 0.2) * t**2 / (2 * seconds)))
            u = u * rng.choice([-1.0, 1.0], n)
        out.append(np.clip(pose + u, -0.95 * limit, 0.95 * limit))
        pose = np.clip(out[-1][-1] * 0.5, -0.5 * limit, 0.5 * limit)
    return out


def _placed(scene: Scene, name: str, rng: Rng, taken: set[int]) -> Planting:
    """An effect at joints that no other has."""
    kind, n = KINDS[name], scene.arm.n
    variant, everywhere = float(rng.uniform()), rng.random() < 0.5
    if kind.place in ("arm", "all") or (kind.place == "bus" and everywhere):
        return Planting(name, (), variant)
    free = [j for j in range(n) if j not in taken]
    if kind.place == "loaded":
        # Gravity must make a torque that varies.
        load = scene.shown(lambda m: m.load).std(0) / scene.kp
        free = [j for j in free if load[j] >= 0.3 * load.max()] or [int(load.argmax())]
    return Planting(name, (int(rng.choice(free)),), variant)


def _sized(
    scene: Scene, plant: Plant, servos: Servos, planting: Planting
) -> tuple[Plant, Servos, dict[str, Any], list[Moved]]:
    """The arm with an effect too, which is made larger until its encoders show it, and how the arm
    moves with that effect alone."""
    size = 1.0
    for _ in range(TRIES):
        alone = _with(scene, scene.plant, scene.servos, planting, size)
        found = moved(alone[0], alone[1], scene.commands)
        change = np.concatenate([a.q - b.q for a, b in zip(found, scene.base, strict=True)])
        rms = np.sqrt((change**2).mean(0))
        if rms.max() > SEEN * scene.servos.count:
            break
        size *= LARGER
    kind = KINDS[planting.name]
    plant, servos, numbers = _with(scene, plant, servos, planting, size)
    felt = np.flatnonzero(rms > max(FELT * rms.max(), scene.servos.count / 2))
    entry = {
        "name": planting.name,
        "family": kind.family,
        "acceptable": kind.akin,
        "joints": [j + 1 for j in planting.joints],
        "felt_by": (felt + 1).tolist(),
        "parameters": numbers,
        # Of the largest change of a joint's positions, over what its encoder rounds to.
        "size": float(rms.max() / (scene.servos.count / np.sqrt(12))),
    }
    return plant, servos, entry, found


def _with(
    scene: Scene, plant: Plant, servos: Servos, planting: Planting, size: float
) -> tuple[Plant, Servos, dict[str, float]]:
    """An arm with an effect, and the effect's numbers at its first joint."""
    n = scene.arm.n
    values: Mapping[str, Array] = servos.values
    joints = planting.joints or range(n)
    changed: dict[str, Array] = {}
    for j in joints:
        made = KINDS[planting.name].make(scene, j, size, planting.variant)
        if isinstance(made, Plant):
            new = {
                name: value
                for name, value in vars(made).items()
                if value is not getattr(scene.plant, name)
            }
            numbers = {"size": size, "variant": planting.variant}
            if "payload" in new:
                numbers = {"mass": float(new["payload"].mass)}
            return replace(plant, **new), servos, numbers
        for name, value in made.items():
            changed.setdefault(name, servos.of(name, n).copy())[j] = value
    numbers = {name: float(value[joints[0]]) for name, value in changed.items()}
    return plant, replace(servos, values={**values, **changed}), numbers
