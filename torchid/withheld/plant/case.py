"""Cases of the benchmark: drawn from a seed and a number, and simulated."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from torchid.withheld.plant.arms import arm_named, urdf
from torchid.withheld.plant.catalogue import kind_named
from torchid.withheld.plant.draw import CaseSpec, draw_case
from torchid.withheld.plant.logger import logged
from torchid.withheld.plant.model import plant_of
from torchid.withheld.plant.nominal import nominal_of, rms
from torchid.withheld.plant.plan import Plan, Scene
from torchid.withheld.plant.scene import friction_known, moved_otherwise, scene_of
from torchid.withheld.plant.simulate import simulated
from torchid.withheld.plant.sizes import Sized, gaps, planted, readings, size_of, sized

__all__ = ["CaseSpec", "SimulatedCase", "draw_case", "simulate_case"]

FINE = 2.5e-4
"""Step of the simulation that is logged [s]."""

_FINEST = 48
"""Bits of an encoder that rounds nothing."""


@dataclass(frozen=True)
class SimulatedCase:
    """A case.

    Attributes:
        urdf: the nominal model.
        columns: of the log: t, q1.., dq1.. where the logger has velocities, tau1.., traj (T,).
        key: what was planted; without an id.
    """

    urdf: str
    columns: dict[str, np.ndarray]
    key: dict[str, Any]


def simulate_case(spec: CaseSpec, *, ideal: bool = False, fresh: bool = False) -> SimulatedCase:
    """Simulate a case.

    Args:
        spec: what it is.
        ideal: whether its log is that of sensors without noise, counts and jitter; everything else
            stays as it is.
        fresh: whether the same arm, with the same effects, moves along other trajectories of the
            same kind.

    Raises:
        TorchidError: an unknown arm or effect, or a simulation that diverged.
        MissingExtraError: MuJoCo is not installed.
    """
    scene, base = _scene(spec)
    nominal = nominal_of(scene.arm, base.known_damping, base.known_friction)
    found = [sized(scene, base, nominal, effect, spec.level or 5.0) for effect in spec.effects]
    if spec.poor:
        scene = moved_otherwise(scene, nominal, spec.poor)
    if fresh:
        scene = moved_otherwise(scene, nominal, (spec.poor or spec.motion).another())
    plan, parameters = _all(scene, base, spec, found)
    nominal = replace(nominal, damping=plan.known_damping, friction=plan.known_friction)
    traces = simulated(scene, plan, nominal, FINE)
    left = gaps(plan, nominal, traces)
    sizes = [one.size for one in found]
    if len(sizes) == 1:
        sizes = [rms(left) / scene.noise]
    elif spec.poor:
        sizes = [_alone(scene, base, spec, k, one) for k, one in enumerate(found)]
    effects = [_effect_key(spec, k, parameters[k], sizes[k]) for k in range(len(spec.effects))]
    logger, noise = spec.logger, scene.noise
    if ideal:
        logger = replace(logger, encoder_bits=_FINEST, velocity_noise=0.0, jitter=0.0)
        noise = 0.0 * noise
    columns = logged(logger, plan, readings(plan, traces), noise)
    key = _key(spec, scene, plan, effects, rms(left))
    return SimulatedCase(urdf(scene.arm, plan.known_damping, plan.known_friction), columns, key)


def _scene(spec: CaseSpec) -> tuple[Scene, Plan]:
    """The scene, and the arm without effects."""
    arm = arm_named(spec.arm)
    damping, friction = friction_known(arm, np.array(spec.viscous), np.array(spec.coulomb))
    scene = scene_of(
        arm,
        nominal_of(arm, damping, friction),
        spec.motion,
        spec.noise_share,
        spec.bandwidth_hz,
        spec.damping_ratio,
    )
    return scene, Plan(plant_of(arm, damping, friction), damping, friction)


def _all(
    scene: Scene, base: Plan, spec: CaseSpec, found: Sequence[Sized]
) -> tuple[Plan, list[dict[str, Any]]]:
    """The plan with every effect at its scale, and their parameters."""
    plan, parameters = base, []
    for effect, one in zip(spec.effects, found, strict=True):
        plan, own = planted(scene, plan, effect, one.scale)
        parameters.append(own)
    return plan, parameters


def _alone(scene: Scene, base: Plan, spec: CaseSpec, k: int, one: Sized) -> np.ndarray:
    """Size (n,) of one effect of several on the case's motion."""
    plan, _ = planted(scene, base, spec.effects[k], one.scale)
    nominal = nominal_of(scene.arm, plan.known_damping, plan.known_friction)
    return size_of(scene, plan, nominal, simulated(scene, plan, nominal, FINE * 2))


def _effect_key(
    spec: CaseSpec, k: int, parameters: dict[str, Any], size: np.ndarray
) -> dict[str, Any]:
    effect = spec.effects[k]
    return {
        "name": effect.name,
        "family": kind_named(effect.name).family,
        "acceptable": list(kind_named(effect.name).akin),
        "joints": [j + 1 for j in effect.joints],
        "felt_by": [j + 1 for j in np.flatnonzero(size > 1.0).tolist()],
        "parameters": parameters,
        "size": float(size.max()),
    }


def _key(
    spec: CaseSpec, scene: Scene, plan: Plan, effects: list[dict[str, Any]], gap: np.ndarray
) -> dict[str, Any]:
    return {
        "kind": spec.kind,
        "arm": spec.arm,
        "rate_hz": spec.logger.rate_hz,
        "colour_hz": spec.logger.colour_hz,
        "repeats": len(set(spec.motion.shapes)) < len(spec.motion.shapes),
        "level": spec.level,
        "effects": effects,
        "background": {
            "viscous": plan.known_damping.tolist(),
            "coulomb": plan.known_friction.tolist(),
        },
        "noise_std": scene.noise.tolist(),
        "controller": {
            "kp": scene.kp.tolist(),
            "kd": scene.kd.tolist(),
            "bandwidth_hz": spec.bandwidth_hz,
            "damping_ratio": spec.damping_ratio,
        },
        "encoder_bits": spec.logger.encoder_bits,
        "jitter": spec.logger.jitter,
        "own_velocity": spec.logger.own_velocity or plan.own_velocity,
        "excitation": spec.excitation,
        "true_gap_rms": gap.tolist(),
    }
