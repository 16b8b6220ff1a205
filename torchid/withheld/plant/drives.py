"""Effects between motor and link, and of the base: how each is planted at a scale."""

from dataclasses import replace

import numpy as np

from torchid.withheld.plant.friction import Planted, replacing
from torchid.withheld.plant.model import BaseMount, Coupling, Drive
from torchid.withheld.plant.plan import EffectSpec, Plan, Scene, sign

_ROTOR = 0.3  # of the least inertia that the link has while the other joints are free
_STIFF_HZ = 18.0  # of the gear with play: link against a held motor
LOWEST_HZ = 6.0
"""Lowest resonance of an elastic joint, link against a held motor."""
LOWEST_BASE_HZ = 4.5
"""Lowest resonance of a flexible base under the arm stretched upwards; bent, it is higher."""


def elastic(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A motor with a mass of its own before a gear of compliance s; the log has the motor."""
    joint, stiffness = effect.joints[0], 1 / s
    light, heavy = scene.inertia[joint]
    damping = 2 * effect.draws["damping"] * float(np.sqrt(stiffness * light))
    drive = Drive(joint, _ROTOR * float(scene.free_inertia[joint]), stiffness, damping)
    parameters = {
        "compliance": s,
        "gear_damping": damping,
        "rotor": drive.rotor,
        "lowest_resonance_hz": float(np.sqrt(stiffness / heavy)) / (2 * np.pi),
    }
    return _with_drive(plan, drive), parameters


def backlash(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A motor and a link that touch, when they do, through a stiff spring."""
    joint = effect.joints[0]
    light = float(scene.inertia[joint, 0])
    stiffness = (2 * np.pi * _STIFF_HZ) ** 2 * float(scene.inertia[joint, 1])
    damping = 2 * effect.draws["damping"] * float(np.sqrt(stiffness * light))
    drive = Drive(
        joint, _ROTOR * float(scene.free_inertia[joint]), float(stiffness), damping, play=s
    )
    parameters = {"width": s, "stiffness": float(stiffness), "gear_damping": damping}
    return _with_drive(plan, drive), parameters


def coupling(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A motor that turns with two joints, with friction of its own.

    What that friction does to each joint alone is known, as any test of one joint would show it;
    the nominal model lacks what one joint's motion does to the other.
    """
    joint, source = effect.joints
    ratio = sign(effect.draws["ratio"])
    dry = s * float(scene.moving_rms[source]) * effect.draws["coulomb"]
    known = np.zeros((2, plan.plant.n))
    known[0, [joint, source]] = s, s * ratio**2
    known[1, joint] = dry
    couplings = (*plan.plant.couplings, Coupling(joint, source, ratio, s, dry))
    plan = replace(
        plan,
        plant=replace(plan.plant, couplings=couplings),
        known_damping=plan.known_damping + known[0],
        known_friction=plan.known_friction + known[1],
    )
    return replacing(replacing(plan, joint), source), {"Fvm": s, "Fcm": dry, "ratio": ratio}


def flexible_base(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A base on a spring of compliance s and dampers."""
    inertia = 0.3
    stiffness = 1 / s
    damping = 2 * effect.draws["damping"] * float(np.sqrt(stiffness * arm_inertia(scene)))
    mount = BaseMount(stiffness, damping, inertia)
    plan = replace(plan, plant=replace(plan.plant, mount=mount))
    return plan, {"compliance": s, "damping": damping, "inertia": inertia}


def arm_inertia(scene: Scene) -> float:
    """About a horizontal axis through the base, of the arm stretched upwards [kg m^2]."""
    height, total = 0.0, 0.3
    for joint in scene.arm.joints:
        height += float(np.linalg.norm(joint.xyz))
        total += joint.inertial().mass * height**2
    return total


def fluid(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """The arm moves in a fluid of density s: MuJoCo's drag of the links' inertia boxes."""
    return replace(plan, plant=replace(plan.plant, fluid=s)), {"density": s}


def _with_drive(plan: Plan, drive: Drive) -> Plan:
    return replace(plan, plant=replace(plan.plant, drives=(*plan.plant.drives, drive)))
