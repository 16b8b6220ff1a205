"""Effects of friction and of torque at the joints, the last ones of them outside of
torchid's library: how each is planted at a scale.

Every function takes (scene, plan, effect, s) and returns the plan with the effect, and its
parameters in physical units. s is the coefficient that decides the effect's size.
"""

from dataclasses import replace
from math import exp
from typing import Any

import numpy as np

from torchid_bench.withheld.plant.laws import (
    bristles,
    bursting,
    creeping,
    loaded_bristles,
    one_sided_bristles,
    resisting,
    rippling_motor,
    slip_elements,
    varying,
    waves,
)
from torchid_bench.withheld.plant.model import Spring
from torchid_bench.withheld.plant.plan import EffectSpec, Law, Parameters, Plan, Scene, sign

Planted = tuple[Plan, Parameters]


def with_law(plan: Plan, law: Law) -> Plan:
    """The plan with one law more."""
    return replace(plan, laws=(*plan.laws, law))


def with_plant(plan: Plan, **changes: Any) -> Plan:
    """The plan with another arm."""
    return replace(plan, plant=replace(plan.plant, **changes))


def viscous(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """MuJoCo's damping."""
    damping = plan.plant.damping.copy()
    damping[effect.joints[0]] += s
    return with_plant(plan, damping=damping), {"Fv": s}


def power_law(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Torque s |dq|^a."""
    a = effect.draws["exponent"]

    def torque(_: float, dq: float) -> float:
        return s * abs(dq) ** a * sign(dq)

    return with_law(plan, resisting(effect.joints[0], torque)), {"factor": s, "a": a}


def coulomb(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """LuGre with stiff bristles and a constant limit."""
    joint = effect.joints[0]
    deflection = _deflection(scene, effect, s)
    law = bristles(joint, lambda dq, k: s, deflection)
    return with_law(plan, law), {"Fc": s, "deflection": deflection}


def stribeck(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """LuGre whose limit falls with speed from s to nothing, beside the known dry friction."""
    joint, d = effect.joints[0], effect.draws["decay"]
    vs = effect.draws["speed"] * float(scene.speed[joint])
    deflection = _deflection(scene, effect, s)

    def limit(dq: float, k: int) -> float:
        return s * exp(-(abs(dq / vs) ** d))

    law = bristles(joint, limit, deflection)
    parameters = {"excess": s, "speed": vs, "decay": d, "deflection": deflection}
    return with_law(plan, law), parameters


def load_dependent(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Bristles that slide at a share of the transmitted torque."""
    deflection = effect.draws["deflection"]
    law = loaded_bristles(effect.joints[0], s, deflection)
    return with_law(plan, law), {"mu": s, "deflection": deflection}


def offset(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A constant torque on the joint, as of a cable; the motor holds against it."""
    value = sign(effect.draws["direction"]) * s
    return with_law(plan, resisting(effect.joints[0], lambda q, dq: value)), {"F0": value}


def asymmetric(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Bristles that resist more one way than they help the other, and damping likewise.

    Friction must resist both ways, so the known friction is more than the difference.
    """
    joint, direction = effect.joints[0], sign(effect.draws["direction"])
    share = effect.draws["viscous"]
    dry, wet = s * direction, share * s / float(scene.speed[joint]) * direction
    plan = knowing(plan, joint, damping=1.3 * abs(wet), friction=1.3 * abs(dry))
    deflection = _deflection(scene, effect, s)
    plan = with_law(plan, one_sided_bristles(joint, dry, deflection))
    plan = with_law(plan, resisting(joint, lambda q, dq: wet * abs(dq)))
    return plan, {"dF": dry, "dFv": wet, "deflection": deflection}


def spring(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """MuJoCo's spring, or a counterbalance whose lever turns with the joint."""
    joint = effect.joints[0]
    low, high = scene.travel[joint]
    rest = float(low + (high - low) * effect.draws["rest"])
    if effect.draws["counterbalance"] > 0.5:
        law = resisting(joint, lambda q, dq: s * float(np.sin(q - rest)))
        return with_law(plan, law), {"amplitude": s, "rest": rest}
    springs = (*plan.plant.springs, Spring(joint, s, rest))
    return with_plant(plan, springs=springs), {"stiffness": s, "rest": rest}


def presliding(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Maxwell-slip elements of several lengths."""
    length = effect.draws["length"]
    lengths = tuple(length * x for x in (0.3, 0.8, 1.4, 2.2))
    law = slip_elements(effect.joints[0], s, lengths)
    return with_law(plan, law), {"torque": s, "lengths": list(lengths)}


def cogging(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A ripple along the position, with a weaker second harmonic."""
    joint, phase = effect.joints[0], effect.draws["phase"]
    k = wave_number(scene, joint, effect.draws["frequency"])
    second = effect.draws["second"]

    def torque(q: float, dq: float) -> float:
        return s * float(np.sin(k * q + phase) + second * np.sin(2 * k * q + 2.0 * phase))

    plan = with_law(plan, resisting(joint, torque))
    return plan, {"amplitude": s, "wave_number": k, "phase": phase, "second_harmonic": second}


def thermal(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """The known friction falls as the gear warms up, or rises, with two time constants.

    What falls must have been there, so the known (cold) friction is more than what goes.
    """
    joint, T = effect.joints[0], effect.draws["time"]
    direction = sign(effect.draws["direction"])
    dry = direction * s * effect.draws["coulomb"]
    wet = direction * s * (1 - effect.draws["coulomb"]) / float(scene.moving_rms[joint] + 1e-9)
    if direction < 0:
        plan = knowing(plan, joint, damping=1.2 * abs(wet), friction=1.2 * abs(dry))

    def warmth(_: float, t: float) -> float:
        return 1 - 0.75 * exp(-t / T) - 0.25 * exp(-t / (4 * T))

    plan = with_law(replacing(plan, joint), varying(joint, wet, dry, warmth))
    return plan, {"viscous": wet, "coulomb": dry, "times": [T, 4 * T]}


def wave_number(scene: Scene, joint: int, hertz: float) -> float:
    """Waves a turn of a ripple that is so many Hz at the joint's fast speed: an integer, 3 at
    least."""
    return float(max(3, round(2 * np.pi * hertz / max(float(scene.speed[joint]), 1e-3))))


def knowing(plan: Plan, joint: int, damping: float = 0.0, friction: float = 0.0) -> Plan:
    """The plan with at least so much friction that is known, and there."""
    more = np.zeros((2, plan.plant.n))
    more[0, joint] = max(0.0, damping - plan.known_damping[joint])
    more[1, joint] = max(0.0, friction - plan.known_friction[joint])
    there = plan.plant.damping + more[0], plan.plant.friction + more[1]
    return replace(
        with_plant(plan, damping=there[0], friction=there[1]),
        known_damping=plan.known_damping + more[0],
        known_friction=plan.known_friction + more[1],
    )


def replacing(plan: Plan, joint: int) -> Plan:
    """The plan, with the joint's dry friction no longer as the nominal model has it."""
    return replace(plan, replaced=(*plan.replaced, joint))


def _deflection(scene: Scene, effect: EffectSpec, torque: float) -> float:
    """Deflection of stiff bristles [rad]: as drawn, but not stiffer than a step can follow."""
    softest = torque * (5e-4) ** 2 / (0.3 * float(scene.inertia[effect.joints[0], 0]))
    return max(effect.draws["deflection"], softest)


def uneven_friction(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Dry friction Fc + s sin(k q + phase), as of a bent shaft; Fc is known and more than s."""
    joint = effect.joints[0]
    return _uneven(replacing(knowing(plan, joint, friction=1.1 * s), joint), effect, 0.0, s)


def uneven_damping(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Viscous friction Fv + s sin(k q + phase); Fv is known and more than s."""
    return _uneven(knowing(plan, effect.joints[0], damping=1.1 * s), effect, s, 0.0)


def _uneven(plan: Plan, effect: EffectSpec, damping: float, friction: float) -> Planted:
    k, phase = effect.draws["periods"], effect.draws["phase"]
    law = varying(effect.joints[0], damping, friction, lambda q, _: float(np.sin(k * q + phase)))
    parameters = {"amplitude": damping + friction, "wave_number": k, "phase": phase}
    return with_law(plan, law), parameters


def motor_ripple(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """The motor's torque constant ripples with its angle, below 20 Hz."""
    joint, phase = effect.joints[0], effect.draws["phase"]
    k = wave_number(scene, joint, effect.draws["frequency"])
    law = rippling_motor(joint, s, k, phase)
    return with_law(plan, law), {"share": s, "wave_number": k, "phase": phase}


def random_load(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A smooth random function of the joint's position and a neighbour's, as of cables."""
    return _random(scene, plan, effect, s, with_neighbour=True)


def random_resistance(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A smooth random function of the joint's position and speed."""
    return _random(scene, plan, effect, s, with_neighbour=False)


def _random(
    scene: Scene, plan: Plan, effect: EffectSpec, s: float, *, with_neighbour: bool
) -> Planted:
    """Five plane waves (Rahimi and Recht 2007): a draw of a Gaussian process."""
    joint = effect.joints[0]
    rng = np.random.default_rng(int(effect.draws["seed"]))
    widths = (1.5, 1.5) if with_neighbour else (1.0, 2.0)
    numbers = (rng.standard_normal((5, 2)) * widths).tolist()
    wave = [(0.63, k, m, float(rng.uniform(0, 2 * np.pi))) for k, m in numbers]
    other = (joint + 1 if joint + 1 < scene.n else joint - 1) if with_neighbour else None
    unit = 1.0 if with_neighbour else float(scene.speed[joint])
    law = waves(joint, s, wave, other, unit)
    return with_law(plan, law), {"torque": s, "seed": effect.draws["seed"]}


def creep(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A spring whose far end follows slowly."""
    seconds = effect.draws["seconds"]
    law = creeping(effect.joints[0], s, seconds)
    return with_law(plan, law), {"stiffness": s, "seconds": seconds}


def bursts(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Torque that comes and goes at random."""
    rate, seed = effect.draws["rate"], int(effect.draws["seed"])
    return with_law(plan, bursting(effect.joints[0], s, rate, seed)), {"torque": s, "rate": rate}
