"""The scene of an arm of servos: its drives, its motions, and effects that its log shows."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from torchid_bench.withheld.plant.arms import Arm, arm_named
from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.draw import ServoSpec
from torchid_bench.withheld.plant.model import plant_of
from torchid_bench.withheld.plant.plan import EffectSpec, Plan
from torchid_bench.withheld.plant.scene import nominal_of
from torchid_bench.withheld.plant.servo import Moved, Servos, moved
from torchid_bench.withheld.plant.servo_catalogue import SERVO_KINDS, ServoScene
from torchid_bench.withheld.plant.settings import DRAWS

Rng = np.random.Generator

SEEN = 2.0
"""Least change of a joint's positions that an effect makes, over what its encoder rounds to [1]: a
smaller one is drawn larger."""

LARGER, TRIES = 1.6, 6
"""By how much it is drawn larger [1], and how many sizes are tried."""

NEAR, SCALES = 1.4, (0.02, 5.0)
"""How near to a wanted size an effect is drawn [1], and between which scales."""


def servo_scene(spec: ServoSpec, rng: Rng) -> ServoScene:
    """The robot with plain servos, and motions that excite them."""
    plan, inertia = servo_plan(spec, rng)
    assert plan.servos is not None
    arm = arm_named(spec.arm)
    commands = motions(arm, spec.rate_hz, rng)
    return ServoScene(arm, plan, inertia, commands, moved(plan.plant, plan.servos, commands))


def servo_plan(spec: ServoSpec, rng: Rng) -> tuple[Plan, Array]:
    """The robot with plain servos, and inertias (n,) of its joints with their rotors [kg m^2]:
    gains as small servos' are beside their loads, or, of quasi-direct drives, as their rotors,
    which are known, make them as fast."""
    arm = arm_named(spec.arm)
    n, zero = arm.n, np.zeros(arm.n)
    kp = np.array([joint.effort for joint in arm.joints]) * rng.uniform(*DRAWS.servo_gain, n)
    plant = plant_of(arm, zero, zero)
    # What the joints bear, the arm bent a little; rotors behind large gears make servos slow: their
    # own frequencies tell their inertias.
    middle, half = ranges(arm)
    bent = np.minimum(middle + 0.6, middle + half)
    own = nominal_of(arm, zero, zero).inertia(bent[None])[0].diagonal()
    fast = rng.uniform(*DRAWS.servo_own, n)
    armature = np.maximum(kp / fast**2 - own, DRAWS.servo_rotor * own)
    rotors = np.array([joint.rotor for joint in arm.joints])
    if rotors.any():
        armature, kp = rotors, (own + rotors) * fast**2
    damping = 2 * rng.uniform(*DRAWS.servo_damping, n) * np.sqrt(kp * (own + armature))
    servos = Servos(
        {
            "kp": kp,
            "coulomb": kp * rng.uniform(*DRAWS.servo_dry, n),
            "delay": np.full(n, rng.uniform(*DRAWS.servo_late) / spec.rate_hz),
        },
        count=2 * np.pi / spec.counts,
        rate_hz=spec.rate_hz,
        seed=int(rng.integers(2**31)),
    )
    plant = replace(plant, damping=damping, armature=armature)
    return Plan(plant, zero, zero, servos=servos), own + armature


def ranges(arm: Arm) -> tuple[Array, Array]:
    """Middle and half (n,) of the joints' ranges [rad]."""
    lower, upper = (np.array([getattr(j, end) for j in arm.joints]) for end in ("lower", "upper"))
    return (lower + upper) / 2, (upper - lower) / 2


def motions(arm: Arm, rate_hz: float, rng: Rng) -> list[Array]:
    """Commands (T, n) of seven motions: slow sweeps with holds, steps of several sizes, sums of
    sines and chirps, about a pose that changes from one to the next."""
    n, out = arm.n, []
    middle, limit = ranges(arm)
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
    return [middle + u for u in out]


def placed_effect(scene: ServoScene, name: str, rng: Rng, taken: tuple[int, ...]) -> EffectSpec:
    """An effect at joints that no other has, and its variant."""
    place, n = SERVO_KINDS[name].place, scene.arm.n
    draws, everywhere = {"variant": float(rng.uniform())}, rng.random() < 0.5
    if place in ("arm", "all") or (place == "bus" and everywhere):
        return EffectSpec(name, (), draws)
    free = [j for j in range(n) if j not in taken]
    if place == "loaded":
        # Gravity must make a torque that varies.
        load = scene.shown(lambda m: m.load).std(0) / scene.of("kp")
        free = [j for j in free if load[j] >= 0.3 * load.max()] or [int(load.argmax())]
    return EffectSpec(name, (int(rng.choice(free)),), draws)


def led_motions(scene: ServoScene, plan: Plan) -> list[Moved]:
    """Where the scene's commands lead an arm."""
    assert plan.servos is not None
    return moved(plan.plant, plan.servos, scene.commands)


def standard_effect(scene: ServoScene, effect: EffectSpec, standard: float) -> tuple[float, Array]:
    """The scale at which an effect alone changes the positions of some joint by about so much, RMS
    [rad], or as near to it as drives bear, and the RMS (n,) of the change."""
    tried = list[tuple[float, Array]]()
    (low, high), scale = SCALES, 1.0
    for _ in range(TRIES):
        _, rms = _changed(scene, effect, scale, lambda m: m.logged)
        tried.append((scale, rms))
        off = standard / max(float(rms.max()), 1e-9)
        low, high = (max(low, scale), high) if off > 1 else (low, min(high, scale))
        if max(off, 1 / off) < NEAR or low >= high:
            break
        wanted = scale * min(max(off, 0.25), 4.0)
        # Of what acts beyond a threshold alone a proportion leads nowhere.
        scale = wanted if low < wanted < high else min((low * high) ** 0.5, 4 * scale)
    return min(tried, key=lambda one: abs(np.log(max(one[1].max(), 1e-9) / standard)))


def visible_effect(scene: ServoScene, effect: EffectSpec) -> tuple[float, Array, list[Moved]]:
    """The scale from which on encoders show an effect alone, the RMS (n,) of what it changes in
    the positions [rad], and how the arm moves."""
    scale = 1.0
    for _ in range(TRIES):
        there, rms = _changed(scene, effect, scale, lambda m: m.q)
        if rms.max() > SEEN * scene.servos.count:
            break
        scale *= LARGER
    return scale, rms, there


def _changed(
    scene: ServoScene, effect: EffectSpec, scale: float, of: Callable[[Moved], Array]
) -> tuple[list[Moved], Array]:
    """How the arm moves with an effect alone, and the RMS (n,) of what it changes [rad]."""
    plan, _ = SERVO_KINDS[effect.name].plant(scene, scene.plan, effect, scale)
    there = led_motions(scene, plan)
    change = np.concatenate([of(a) - of(b) for a, b in zip(there, scene.base, strict=True)])
    return there, np.sqrt((change**2).mean(0))
