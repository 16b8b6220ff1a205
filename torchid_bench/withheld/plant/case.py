"""Cases of the benchmark: drawn from a seed and a number, and simulated."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from torchid.json_data import picked
from torchid_bench.withheld.plant.arms import arm_named, urdf
from torchid_bench.withheld.plant.background_case import FELT, of_background
from torchid_bench.withheld.plant.catalogue import KINDS, effect_record
from torchid_bench.withheld.plant.draw import (
    BackgroundSpec,
    CaseSpec,
    ServoSpec,
    TorqueSpec,
    draw_case,
)
from torchid_bench.withheld.plant.logger import FINEST, logged
from torchid_bench.withheld.plant.model import plant_of
from torchid_bench.withheld.plant.plan import Plan, Scene
from torchid_bench.withheld.plant.scene import (
    friction_known,
    moved_otherwise,
    nominal_of,
    rms,
    scene_of,
)
from torchid_bench.withheld.plant.servo_background import STANDARD, surroundings
from torchid_bench.withheld.plant.servo_catalogue import SERVO_KINDS
from torchid_bench.withheld.plant.servo_scene import (
    led_motions,
    placed_effect,
    servo_scene,
    standard_effect,
    visible_effect,
)
from torchid_bench.withheld.plant.settings import DRAWS
from torchid_bench.withheld.plant.simulate import (
    gaps,
    readings,
    simulated,
    size_of,
    sized,
    with_effect,
)

__all__ = ["CaseSpec", "SimulatedCase", "draw_case", "simulate_case"]

FINE = 2.5e-4
"""Step of the simulation that is logged [s]."""

MOVED = 0.1
"""Share of the largest change of a joint's positions from which on a joint feels an effect."""


@dataclass(frozen=True)
class SimulatedCase:
    """A case.

    Attributes:
        urdf: the nominal model.
        columns: of the log: t, q1.., dq1.. where the logger has velocities, tau1.., traj (T,); of
            servos t, u1.., q1.., traj.
        key: what was planted; without an id.
        rotors: (n,) inertia that the maker's data tell of each rotor [kg m^2]; empty if none.
        more: columns of further files of the log.
        earlier: of an earlier log; None without one.
    """

    urdf: str
    columns: dict[str, np.ndarray]
    key: dict[str, Any]
    rotors: tuple[float, ...] = ()
    more: tuple[dict[str, np.ndarray], ...] = ()
    earlier: dict[str, np.ndarray] | None = None


def simulate_case(spec: CaseSpec, *, ideal: bool = False) -> SimulatedCase:
    """Simulate a case.

    Args:
        spec: what it is.
        ideal: whether its log is that of sensors without noise, counts and jitter; everything else
            stays as it is.

    Raises:
        TorchidError: an unknown arm or effect, or a simulation that diverged.
        MissingExtraError: MuJoCo is not installed.
    """
    if isinstance(spec, BackgroundSpec):
        files = of_background(spec, ideal=ideal)
        first, *more = files.logs
        return SimulatedCase(files.urdf, first, files.key, (), tuple(more), files.earlier)
    if isinstance(spec, ServoSpec):
        return _of_servos(spec)
    assert isinstance(spec, TorqueSpec)
    return _of_torques(spec, ideal=ideal)


def _of_servos(spec: ServoSpec) -> SimulatedCase:
    # Effects are placed and sized one after the other, each alone on the arm as plain servos are.
    rng = np.random.default_rng([spec.seed, spec.number, 2 if spec.background is None else 6])
    around = None if spec.background is None else surroundings(spec)
    scene = servo_scene(spec, rng) if around is None else around.scene
    plan, moved, taken = scene.plan, scene.base, tuple[int, ...]()
    if around is not None:
        plan, moved, taken = around.plan, around.moved, around.still
    count, effects = scene.servos.count, list[dict[str, Any]]()
    for one in spec.effects:
        effect = placed_effect(scene, one.name, rng, taken)
        taken += effect.joints
        if around is None:
            scale, rms, moved = visible_effect(scene, effect)
        else:
            scale, rms = standard_effect(scene, effect, STANDARD)
        plan, own = SERVO_KINDS[effect.name].plant(scene, plan, effect, scale)
        felt = rms > max(MOVED * rms.max(), count / 2)
        # Of the largest change, over what an encoder rounds to.
        size = float(rms.max() / (count / np.sqrt(12)))
        effects.append(effect_record(SERVO_KINDS, effect, felt, own, size))
        if around is not None:
            effects[-1]["over_background"] = float(rms.max() / around.left[rms.argmax()])
    if len(effects) > 1 or (effects and around is not None):
        moved = led_motions(scene, plan)
    # What the bus carries: commands, and positions in counts.
    files = [
        {
            "t": np.arange(len(u)) / spec.rate_hz,
            **{f"u{j + 1}": x for j, x in enumerate(u.T)},
            **{f"q{j + 1}": x for j, x in enumerate(m.logged.T)},
        }
        for u, m in zip(scene.commands, moved, strict=True)
    ]
    values = {name: scene.of(name).tolist() for name in scene.servos.values}
    key = {
        **picked(spec, "kind arm rate_hz"),
        "level": None,
        "effects": effects,
        "background": {**values, **picked(scene.plan.plant, "damping armature")},
        "counts": spec.counts,
    }
    model = urdf(scene.arm, np.zeros(scene.arm.n), np.zeros(scene.arm.n))
    if around is None:
        rows = [len(u) for u in scene.commands]
        columns = {name: np.concatenate([f[name] for f in files]) for name in files[0]}
        return SimulatedCase(model, {**columns, "traj": np.repeat(np.arange(len(rows)), rows)}, key)
    key["background"] |= around.key
    key |= {"share": spec.background, "earlier": False, "left": around.left.tolist()}
    return SimulatedCase(model, files[0], key, more=tuple(files[1:]))


def _of_torques(spec: TorqueSpec, *, ideal: bool) -> SimulatedCase:
    # The scene, and the arm without effects.
    arm = arm_named(spec.arm)
    known = friction_known(arm, np.array(spec.viscous), np.array(spec.coulomb))
    nominal, base = nominal_of(arm, *known), Plan(plant_of(arm, *known), *known)
    controllers = spec.bandwidth_hz, spec.damping_ratio
    scene = scene_of(arm, nominal, spec.motion, spec.noise_share, *controllers)
    logs = [
        sized(scene, base, nominal, effect, spec.level or DRAWS.level) for effect in spec.effects
    ]
    if spec.poor:
        scene = moved_otherwise(scene, nominal, spec.poor)
    plan, parameters = base, []
    for effect, one in zip(spec.effects, logs, strict=True):
        plan, own = with_effect(scene, plan, effect, one.scale)
        parameters.append(own)
    nominal = replace(nominal, damping=plan.known_damping, friction=plan.known_friction)
    traces = simulated(scene, plan, nominal, FINE)
    left = gaps(plan, nominal, traces)
    sizes = [one.size for one in logs]
    if len(sizes) == 1:
        sizes = [rms(left) / scene.noise]
    elif spec.poor:
        # Of each effect alone on the case's motion.
        for k, (effect, one) in enumerate(zip(spec.effects, logs, strict=True)):
            alone, _ = with_effect(scene, base, effect, one.scale)
            own_nominal = nominal_of(arm, alone.known_damping, alone.known_friction)
            moved = simulated(scene, alone, own_nominal, FINE * 2)
            sizes[k] = size_of(scene, alone, own_nominal, moved)
    noise_std, torque = scene.noise, scene.torque
    effects = [
        effect_record(KINDS, effect, size * noise_std > FELT * torque, own, float(size.max()))
        for effect, own, size in zip(spec.effects, parameters, sizes, strict=True)
    ]
    logger, noise = spec.logger, scene.noise
    if ideal:
        logger = replace(logger, encoder_bits=FINEST, velocity_noise=0.0, jitter=0.0)
        noise = 0.0 * noise
    columns = logged(logger, plan, readings(plan, traces), noise)
    key = _key(spec, scene, plan, effects, rms(left))
    model = urdf(scene.arm, plan.known_damping, plan.known_friction)
    return SimulatedCase(model, columns, key, tuple(j.rotor for j in arm.joints))


def _key(
    spec: TorqueSpec, scene: Scene, plan: Plan, effects: list[dict[str, Any]], gap: np.ndarray
) -> dict[str, Any]:
    return {
        **picked(spec, "kind arm rate_hz=logger.rate_hz colour_hz=logger.colour_hz"),
        "noise_grows": spec.logger.grows,
        "repeats": len(set(spec.motion.shapes)) < len(spec.motion.shapes),
        "level": spec.level,
        "effects": effects,
        "background": picked(plan, "viscous=known_damping coulomb=known_friction"),
        "noise_std": scene.noise.tolist(),
        "controller": {**picked(scene, "kp kd"), **picked(spec, "bandwidth_hz damping_ratio")},
        **picked(spec.logger, "encoder_bits jitter"),
        "own_velocity": spec.logger.own_velocity or plan.own_velocity,
        "excitation": spec.excitation,
        "true_gap_rms": gap.tolist(),
    }
