"""Every effect that can be planted: its family, its place, its variants and its range of sizes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from torchid.errors import TorchidError
from torchid.withheld.plant import friction, mechanics, sensing
from torchid.withheld.plant.arms import Arm
from torchid.withheld.plant.friction import Planted
from torchid.withheld.plant.plan import EffectSpec, Scene

Rng = np.random.Generator
Plant = Callable[..., Planted]
"""From a scene, a plan, an effect and its scale."""
Size = Callable[[Scene, EffectSpec], float]
Draws = Callable[[Rng, int, tuple[int, ...]], dict[str, float]]
"""From a generator, the number of joints and the joints."""

OUTSIDE = "outside"


def _uniform(**ranges: tuple[float, float]) -> Draws:
    """Draws of numbers from ranges."""
    return lambda rng, n, joints: {
        name: float(rng.uniform(*between)) for name, between in ranges.items()
    }


def _fixed(value: float) -> Size:
    return lambda scene, effect: value


_EVER = _fixed(np.inf)
_ONE = _fixed(1.0)
_SAME = _uniform()


@dataclass(frozen=True)
class Kind:
    """An effect that can be planted.

    Attributes:
        family: the diagnosis', or `outside`.
        plant: adds it to a plan at a scale.
        usual: scale at which its size is about 5 standard deviations of the noise.
        largest: scale beyond which it would be no arm any more.
        draws: numbers of a variant, from a generator, the number of joints and the joints.
        place: `joint`, `pair` of neighbours, `arm`; of servos also `bus`, one joint or all; `all`;
            `loaded`, a joint that bears gravity.
        first: first joint (from 0) where it can be.
        sensing: whether it changes what is measured, not how the arm moves.
        akin: names and families that an honest answer may give it as well: friction that changes
            along the turn is friction.
    """

    family: str
    plant: Plant
    usual: Size = _ONE
    largest: Size = _EVER
    draws: Draws = _SAME
    place: str = "joint"
    first: int = 0
    sensing: bool = False
    akin: tuple[str, ...] = ()


def _signed(**ranges: tuple[float, float]) -> Draws:
    """Draws of numbers from ranges, and of a direction, 1 or -1."""
    return _uniform(direction=(-1.0, 1.0), **ranges)


def _column(rms: Callable[[Scene, EffectSpec, int], float]) -> Size:
    """Scale from the RMS of the torque that a unit makes at the effect's own joint."""
    return lambda scene, effect: scene.unit(
        effect.joints[0], float(rms(scene, effect, effect.joints[0]))
    )


def _link_draws(rng: Rng, n: int, joints: tuple[int, ...]) -> dict[str, float]:
    out: dict[str, float] = {}
    for joint in joints:
        out[f"mass_{joint}"] = float(rng.normal(0, 0.3))
        out |= {f"shift_{a}_{joint}": float(rng.normal(0, 0.25)) for a in "xyz"}
        out |= {f"stretch_{k}_{joint}": float(rng.normal(0, 0.12)) for k in range(6)}
    return out


def _source_draws(rng: Rng, n: int, joints: tuple[int, ...]) -> dict[str, float]:
    others = [j for j in range(n) if j != joints[0]]
    return {"source": float(rng.choice(others)), "direction": float(rng.uniform(-1, 1))}


def _soft(scene: Scene, effect: EffectSpec) -> float:
    """Compliance at the lowest resonance allowed."""
    heavy = float(scene.inertia[effect.joints[0], 1])
    return 1 / ((2 * np.pi * mechanics.LOWEST_HZ) ** 2 * heavy)


def _soft_base(scene: Scene, effect: EffectSpec) -> float:
    return 1 / ((2 * np.pi * mechanics.LOWEST_BASE_HZ) ** 2 * mechanics.arm_inertia(scene))


def _half(size: Size) -> Size:
    return lambda scene, effect: 0.5 * size(scene, effect)


_GRAVITY = _fixed(0.05)

KINDS: dict[str, Kind] = {
    "viscous_friction": Kind(
        "speed", friction.viscous, _column(lambda s, e, j: s.moving_rms[j]), _EVER, _uniform()
    ),
    "power_law_friction": Kind(
        "speed",
        friction.power_law,
        _column(lambda s, e, j: s.moving_rms[j] ** e.draws["exponent"] * 1.2),
        _EVER,
        _uniform(exponent=(1.6, 2.5)),
    ),
    "gear_coupling": Kind(
        "speed",
        mechanics.coupling,
        _column(lambda s, e, j: s.moving_rms[e.joints[1]]),
        _EVER,
        _uniform(ratio=(-1.0, 1.0), coulomb=(0.0, 0.5)),
        place="pair",
    ),
    "coulomb_friction": Kind(
        "sign", friction.coulomb, _column(lambda s, e, j: 1.0), _EVER,
        _uniform(deflection=(5e-5, 4e-4)),
    ),
    "stribeck_friction": Kind(
        "sign", friction.stribeck, _column(lambda s, e, j: 0.35), _EVER,
        _uniform(speed=(0.06, 0.22), decay=(1.2, 2.0), deflection=(5e-5, 3e-4)),
    ),
    "load_dependent_friction": Kind(
        "sign", friction.load_dependent, _column(lambda s, e, j: s.load[j]), _fixed(0.8),
        _uniform(deflection=(5e-4, 2e-3)),
    ),
    "torque_offset": Kind(
        "constant", friction.offset, _column(lambda s, e, j: 1.0), _EVER, _signed()
    ),
    "asymmetric_friction": Kind(
        "constant", friction.asymmetric, _column(lambda s, e, j: 1.2), _EVER,
        _signed(viscous=(0.0, 0.6), deflection=(5e-5, 3e-4)),
    ),
    "base_tilt": Kind(
        "gravity", mechanics.tilt, _GRAVITY, _fixed(0.3), _uniform(heading=(0.0, 2 * np.pi)),
        place="arm",
    ),
    "torque_gain": Kind(
        "gravity", sensing.gain, _column(lambda s, e, j: s.torque[j]), _fixed(0.8), _signed(),
        sensing=True,
    ),
    "torque_crosstalk": Kind(
        "gravity", sensing.crosstalk, _column(lambda s, e, j: s.torque[int(e.draws["source"])]),
        _fixed(0.8), _source_draws, sensing=True,
    ),
    "encoder_offset": Kind(
        "gravity", sensing.encoder_offset, _GRAVITY, _fixed(0.3), _signed(), first=1
    ),
    "kinematic_error": Kind(
        "gravity", mechanics.kinematics, _ONE, _fixed(5.0),
        _uniform(**{f"{w}{a}": (-1.0, 1.0) for w in ("shift", "turn") for a in "xyz"}),
        place="joint", first=1,
    ),
    "joint_spring": Kind(
        "gravity", friction.spring,
        _column(lambda s, e, j: 0.3 * (s.travel[j, 1] - s.travel[j, 0])), _EVER,
        _uniform(rest=(0.0, 1.0), counterbalance=(0.0, 1.0)),
    ),
    "rotor_inertia": Kind(
        "inertia", mechanics.armature, _column(lambda s, e, j: s.brisk_rms[j]), _EVER, _uniform()
    ),
    "payload": Kind(
        "inertia", mechanics.payload, _ONE, _fixed(12.0),
        _uniform(
            x=(-0.04, 0.04), y=(-0.04, 0.04), z=(0.0, 0.06),
            width=(0.04, 0.15), depth=(0.04, 0.15), height=(0.04, 0.15),
        ),
        place="arm",
    ),
    "link_inertia": Kind(
        "inertia", mechanics.link_inertia, _fixed(0.5), _fixed(2.5), _link_draws,
        first=1,  # of the first link only the moment about its axis is felt
    ),
    "time_delay": Kind(
        "phase", sensing.delay, _fixed(0.01), _fixed(0.06), _uniform(), sensing=True
    ),
    "filter_lag": Kind(
        "phase", sensing.velocity_lag, _fixed(0.01), _fixed(0.06), _uniform(), place="arm",
        sensing=True,
    ),
    "joint_elasticity": Kind(
        "phase", mechanics.elastic, _half(_soft), _soft, _uniform(damping=(0.03, 0.08))
    ),
    "backlash": Kind(
        "hysteresis", mechanics.backlash, _fixed(3e-3), _fixed(0.02), _uniform(damping=(0.04, 0.1))
    ),
    "presliding_hysteresis": Kind(
        "hysteresis", friction.presliding, _column(lambda s, e, j: 0.8), _EVER,
        _uniform(length=(0.02, 0.15)),
    ),
    "cogging": Kind(
        "periodic", friction.cogging, _column(lambda s, e, j: 0.7), _EVER,
        _uniform(frequency=(2.0, 8.0), phase=(0.0, 2 * np.pi), second=(0.0, 0.3)),
    ),
    "thermal_friction_drift": Kind(
        "time", friction.thermal, _column(lambda s, e, j: 0.6), _EVER,
        _uniform(direction=(-3.0, 1.0), time=(15.0, 40.0), coulomb=(0.3, 0.9)),
    ),
    "saturation": Kind(
        "transient", sensing.saturation, _fixed(0.2), _fixed(0.7), _uniform(), sensing=True
    ),
    "contact": Kind(
        "transient", sensing.contact, _fixed(30.0), _fixed(400.0),
        _uniform(
            x=(-1.0, 1.0), y=(-1.0, 1.0), z=(-1.0, 1.0), trajectory=(0.0, 3.99),
            begin=(0.2, 0.7), seconds=(0.5, 2.0),
        ),
        place="arm",
    ),
    "dropped_samples": Kind(
        "transient", sensing.dropped, _fixed(0.08), _fixed(0.4),
        _uniform(rate=(0.4, 1.5), seed=(0.0, 2.0**31)), sensing=True,
    ),
    "uneven_friction": Kind(
        OUTSIDE, friction.uneven_friction, _column(lambda s, e, j: 0.7), _EVER,
        _uniform(periods=(1.0, 3.0), phase=(0.0, 2 * np.pi)),
        akin=("sign",),
    ),
    "uneven_damping": Kind(
        OUTSIDE, friction.uneven_damping, _column(lambda s, e, j: 0.7 * s.moving_rms[j]), _EVER,
        _uniform(periods=(1.0, 3.0), phase=(0.0, 2 * np.pi)),
        akin=("speed",),
    ),
    "motor_ripple": Kind(
        OUTSIDE, friction.motor_ripple, _column(lambda s, e, j: 0.7 * s.torque[j]), _fixed(0.5),
        _uniform(frequency=(2.0, 8.0), phase=(0.0, 2 * np.pi)), first=1,
        akin=("periodic",),
    ),
    "flexible_base": Kind(
        OUTSIDE, mechanics.flexible_base, _half(_soft_base), _soft_base,
        _uniform(damping=(0.03, 0.1)), place="arm",
        akin=("phase",),
    ),
    "fluid_drag": Kind(
        OUTSIDE, mechanics.fluid, _fixed(50.0), _fixed(1200.0), _uniform(), place="arm",
        akin=("speed",),
    ),
    "random_load": Kind(
        OUTSIDE, friction.random_load, _column(lambda s, e, j: 1.0), _EVER,
        _uniform(seed=(0.0, 2.0**31)),
        akin=("gravity", "periodic", "constant"),
    ),
    "random_resistance": Kind(
        OUTSIDE, friction.random_resistance, _column(lambda s, e, j: 1.0), _EVER,
        _uniform(seed=(0.0, 2.0**31)),
        akin=("speed", "sign", "gravity", "periodic", "constant"),
    ),
    "creep": Kind(
        OUTSIDE, friction.creep,
        _column(lambda s, e, j: s.moving_rms[j] * e.draws["seconds"]), _EVER,
        _uniform(seconds=(0.1, 1.0)),
        akin=("hysteresis", "phase"),
    ),
    "bursts": Kind(
        OUTSIDE, friction.bursts, _column(lambda s, e, j: 0.4), _EVER,
        _uniform(rate=(0.4, 1.2), seed=(0.0, 2.0**31)),
        akin=("transient",),
    ),
}  # fmt: skip

LIBRARY = tuple(name for name, kind in KINDS.items() if kind.family != OUTSIDE)
"""Those that torchid has, by torchid's names."""

FOREIGN = ("uneven_friction", "uneven_damping", "motor_ripple", "flexible_base", "fluid_drag")
"""Those that it had not when the benchmark was made: the mixed sets'."""

REDRAWN = ("random_load", "random_resistance", "creep", "bursts", "flexible_base", "fluid_drag")
"""Those that it has not, most of them random physics: the release sets'."""


def kind_named(name: str, kinds: Mapping[str, Kind] = KINDS) -> Kind:
    """An effect by name.

    Raises:
        TorchidError: there is none of that name.
    """
    if name not in kinds:
        raise TorchidError(f"the withheld plant has no effect '{name}'.", available=list(kinds))
    return kinds[name]


def drawn_effect(rng: Rng, name: str, arm: Arm, avoid: tuple[int, ...] = ()) -> EffectSpec:
    """A variant of an effect at a place.

    Args:
        rng: generator.
        name: of the effect.
        arm: that has it.
        avoid: joints to keep clear of, where others are left.
    """
    kind, n = kind_named(name), arm.n
    joints: tuple[int, ...] = ()
    if kind.place != "arm":
        free = [j for j in range(kind.first, n) if j not in avoid] or list(range(kind.first, n))
        joint = int(rng.choice(free))
        joints = (joint,)
        if kind.place == "pair":
            joints = (joint, int(rng.choice(arm.neighbours(joint))))
    return EffectSpec(name, joints, kind.draws(rng, n, joints))
