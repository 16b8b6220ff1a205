"""Effects of bodies and frames that are not as described: how each is planted at a scale."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from torchid.withheld.plant.bodies import Inertial, combined, deformed
from torchid.withheld.plant.friction import Planted
from torchid.withheld.plant.model import Plant
from torchid.withheld.plant.plan import EffectSpec, Plan, Scene


def armature(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """MuJoCo's armature."""
    values = plan.plant.armature.copy()
    values[effect.joints[0]] += s
    return _with(plan, replace(plan.plant, armature=values)), {"Ia": s}


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
    return _with(plan, replace(plan.plant, payload=load)), parameters


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
    return _with(plan, replace(plan.plant, links=tuple(links))), {"scale": s, **parameters}


def tilt(scene: Scene, plan: Plan, effect: EffectSpec, s: float) -> Planted:
    """Gravity turned by s about a horizontal axis."""
    heading = effect.draws["heading"]
    turn = s * np.array([np.cos(heading), np.sin(heading), 0.0])
    gravity = Rotation.from_rotvec(turn).apply(plan.plant.gravity)
    plan = _with(plan, replace(plan.plant, gravity=gravity))
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
    return _with(plan, replace(plan.plant, links=links)), parameters


def _with(plan: Plan, plant: Plant) -> Plan:
    return replace(plan, plant=plant)
