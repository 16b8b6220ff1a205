"""Effects between motor and link, of the base, and of bodies and frames that are not as described:
how each is planted at a scale."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from torchid_bench.withheld.plant.bodies import Inertial, combined, deformed
from torchid_bench.withheld.plant.friction import Planted, replacing, with_plant
from torchid_bench.withheld.plant.model import BaseMount, Coupling, Drive
from torchid_bench.withheld.plant.plan import EffectSpec, Plan, Scene, sign

_ROTOR = 0.3  # of the least inertia that the link has while the other joints are free
_STIFF_HZ = 18.0  # of the gear with play: link against a held motor
LOWEST_HZ = 6.0
"""Lowest resonance of an elastic joint, link against a held motor."""
LOWEST_BASE_HZ = 4.5
"""Lowest resonance of a flexible base under the arm stretched upwards; bent, it is higher."""


def elastic(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A motor with a mass of its own before a gear of compliance s; the log has the motor."""
    drive = _drive(scene, effect, 1 / s)
    heavy = scene.inertia[drive.joint, 1]
    parameters = {
        "compliance": s,
        "gear_damping": drive.damping,
        "rotor": drive.rotor,
        "lowest_resonance_hz": float(np.sqrt(drive.stiffness / heavy)) / (2 * np.pi),
    }
    return with_plant(plan, drives=(*plan.plant.drives, drive)), parameters


def backlash(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A motor and a link that touch, when they do, through a stiff spring."""
    stiffness = (2 * np.pi * _STIFF_HZ) ** 2 * float(scene.inertia[effect.joints[0], 1])
    drive = _drive(scene, effect, stiffness, play=s)
    parameters = {"width": s, "stiffness": stiffness, "gear_damping": drive.damping}
    return with_plant(plan, drives=(*plan.plant.drives, drive)), parameters


def _drive(scene: Scene, effect: EffectSpec, stiffness: float, play: float = 0.0) -> Drive:
    """A motor whose gear is damped by the drawn share of what is critical for the lightest link."""
    joint = effect.joints[0]
    damping = 2 * effect.draws["damping"] * float(np.sqrt(stiffness * scene.inertia[joint, 0]))
    rotor = _ROTOR * float(scene.free_inertia[joint])
    return Drive(joint, rotor, stiffness, damping, play)


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
        with_plant(plan, couplings=couplings),
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
    return with_plant(plan, mount=mount), {"compliance": s, "damping": damping, "inertia": inertia}


def arm_inertia(scene: Scene) -> float:
    """About a horizontal axis through the base, of the arm stretched upwards [kg m^2]."""
    heights: list[float] = []
    total = 0.3
    for joint, above in zip(scene.arm.joints, scene.arm.parents, strict=True):
        below = heights[above] if above >= 0 else 0.0
        heights.append(below + float(np.linalg.norm(joint.xyz)))
        total += joint.inertial().mass * heights[-1] ** 2
    return total


def fluid(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """The arm moves in a fluid of density s: MuJoCo's drag of the links' inertia boxes."""
    return with_plant(plan, fluid=s), {"density": s}


def armature(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """MuJoCo's armature."""
    values = plan.plant.armature.copy()
    values[effect.joints[0]] += s
    return with_plant(plan, armature=values), {"Ia": s}


def payload(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A box of mass s, welded to the last link near the tool."""
    draws = effect.draws
    at = np.array([draws["x"], draws["y"], draws["z"]])
    sizes = np.array([draws["width"], draws["depth"], draws["height"]])
    squares = sizes**2
    inertia = np.diag(squares.sum() - squares) * s / 12
    box = Inertial(s, plan.plant.tool + at, inertia)
    old = plan.plant.payload
    load = box if old is None else combined([old, box])
    parameters = {"m": s, "centre": (plan.plant.tool + at).tolist(), "sizes": sizes.tolist()}
    return with_plant(plan, payload=load), parameters


def link_inertia(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Links that are heavier, moved and stretched; s = 1 is as far as they are drawn."""
    links = list(plan.plant.links)
    parameters = {}
    for joint in effect.joints:
        body = links[joint].body
        # Mass factor, shift [m] and stretch of a link at a scale.
        draws = effect.draws
        factor = float(np.exp(s * draws[f"mass_{joint}"]))
        reach = np.sqrt(np.trace(body.inertia) / body.mass)  # size of the body
        shift = s * reach * np.array([draws[f"shift_{a}_{joint}"] for a in "xyz"])
        stretch = np.zeros((3, 3))
        for entry, value in zip(
            ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)),
            (draws[f"stretch_{k}_{joint}"] for k in range(6)),
            strict=True,
        ):
            stretch[entry] = stretch[entry[::-1]] = s * value
        links[joint] = replace(links[joint], body=deformed(body, factor, shift, stretch))
        parameters[f"link{joint + 1}"] = {
            "mass_factor": factor, "shift": shift.tolist(), "stretch": stretch.tolist()
        }  # fmt: skip
    return with_plant(plan, links=tuple(links)), {"scale": s, **parameters}


def tilt(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Gravity turned by s about a horizontal axis."""
    heading = effect.draws["heading"]
    turn = s * np.array([np.cos(heading), np.sin(heading), 0.0])
    gravity = Rotation.from_rotvec(turn).apply(plan.plant.gravity)
    plan = with_plant(plan, gravity=gravity)
    return plan, {"tilt_x": float(turn[0]), "tilt_y": float(turn[1])}


def kinematics(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """A joint's frame displaced and turned across its axis; s = 1 is 10 mm and 0.03 rad."""
    joint = effect.joints[0]
    link = plan.plant.links[joint]
    shift, turn = (
        s * size * np.array([effect.draws[f"{word}{a}"] for a in "xyz"])
        for word, size in (("shift", 0.01), ("turn", 0.03))
    )
    turn = turn - link.axis * (turn @ link.axis)
    moved = replace(
        link,
        position=link.position + link.rotation.apply(shift),
        rotation=link.rotation * Rotation.from_rotvec(turn),
    )
    links = tuple(moved if k == joint else old for k, old in enumerate(plan.plant.links))
    parameters = {"shift": shift.tolist(), "turn": turn.tolist()}
    return with_plant(plan, links=links), parameters
