"""Effects that torchid's library does not have: how each is planted at a scale."""

from torchid.withheld.plant.friction import (
    Planted,
    knowing,
    replacing,
    wave_number,
    with_law,
)
from torchid.withheld.plant.laws import rippling_motor, varying
from torchid.withheld.plant.plan import EffectSpec, Plan, Scene


def uneven_friction(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Dry friction Fc + s sin(k q + phase), as of a bent shaft; Fc is known and more than s."""
    joint, k, phase = effect.joints[0], effect.draws["periods"], effect.draws["phase"]
    plan = replacing(knowing(plan, joint, friction=1.1 * s), joint)
    law = varying(joint, 0.0, s, k, phase)
    return with_law(plan, law), {"amplitude": s, "wave_number": k, "phase": phase}


def uneven_damping(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Viscous friction Fv + s sin(k q + phase); Fv is known and more than s."""
    joint, k, phase = effect.joints[0], effect.draws["periods"], effect.draws["phase"]
    plan = knowing(plan, joint, damping=1.1 * s)
    law = varying(joint, s, 0.0, k, phase)
    return with_law(plan, law), {"amplitude": s, "wave_number": k, "phase": phase}


def motor_ripple(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """The motor's torque constant ripples with its angle, below 20 Hz."""
    joint, phase = effect.joints[0], effect.draws["phase"]
    k = wave_number(scene, joint, effect.draws["frequency"])
    law = rippling_motor(joint, s, k, phase)
    return with_law(plan, law), {"share": s, "wave_number": k, "phase": phase}
