"""Every effect that can be planted: its family, its place, its variants and its range of sizes, as
catalogue.yaml has them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchid.errors import TorchidError
from torchid.json_data import picked
from torchid.yaml_data import parsed_yaml
from torchid_bench.withheld.plant import friction, mechanics, sensing
from torchid_bench.withheld.plant.arms import Arm
from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.friction import Planted
from torchid_bench.withheld.plant.plan import EffectSpec, Parameters, Scene

Rng = np.random.Generator
Plant = Callable[..., Planted]
"""From a scene, a plan, an effect and its scale."""
Size = Callable[[Scene, EffectSpec], float]
Draws = Callable[[Rng, int, tuple[int, ...]], dict[str, float]]
"""From a generator, the number of joints and the joints."""

OUTSIDE = "outside"


def _uniform(ranges: Mapping[str, tuple[float, float]]) -> Draws:
    """Draws of numbers from ranges."""
    return lambda rng, n, joints: {
        name: float(rng.uniform(*between)) for name, between in ranges.items()
    }


def _constant(value: float) -> Size:
    return lambda scene, effect: value


_ONE, _EVER, _SAME = _constant(1.0), _constant(np.inf), _uniform({})


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


_DRAWS: dict[str, Draws] = {"links": _link_draws, "source": _source_draws}

_COLUMNS: dict[str, Callable[[Scene, EffectSpec, int], float]] = {
    "power": lambda s, e, j: s.moving_rms[j] ** e.draws["exponent"] * 1.2,
    "second": lambda s, e, j: s.moving_rms[e.joints[1]],
    "source": lambda s, e, j: s.torque[int(e.draws["source"])],
    "travel": lambda s, e, j: 0.3 * (s.travel[j, 1] - s.travel[j, 0]),
    "creep": lambda s, e, j: s.moving_rms[j] * e.draws["seconds"],
}
"""RMS of the torque that a unit makes at joint j, where it is no multiple of what a scene has."""


def _soft(scene: Scene, effect: EffectSpec) -> float:
    """Compliance at the lowest resonance allowed."""
    heavy = float(scene.inertia[effect.joints[0], 1])
    return 1 / ((2 * np.pi * mechanics.LOWEST_HZ) ** 2 * heavy)


def _soft_base(scene: Scene, effect: EffectSpec) -> float:
    return 1 / ((2 * np.pi * mechanics.LOWEST_BASE_HZ) ** 2 * mechanics.arm_inertia(scene))


_SIZES: dict[str, Size] = {
    "soft": _soft,
    "half_soft": lambda scene, effect: 0.5 * _soft(scene, effect),
    "soft_base": _soft_base,
    "half_soft_base": lambda scene, effect: 0.5 * _soft_base(scene, effect),
}


def _column(given: float | str | list[Any]) -> Size:
    """Scale from the RMS of the torque that a unit makes at the effect's own joint."""
    factor, signal = given if isinstance(given, list) else (given, None)

    def rms(scene: Scene, effect: EffectSpec, joint: int) -> float:
        if isinstance(factor, str):
            return _COLUMNS[factor](scene, effect, joint)
        return factor if signal is None else factor * getattr(scene, signal)[joint]

    return lambda scene, effect: scene.unit(
        effect.joints[0], float(rms(scene, effect, effect.joints[0]))
    )


def _kind(plant: str, **given: Any) -> Kind:
    """An effect of catalogue.yaml."""
    if "column" in given:
        given["usual"] = _column(given.pop("column"))
    for size in {"usual", "largest"} & given.keys():
        if not callable(own := given[size]):
            given[size] = _SIZES[own] if isinstance(own, str) else _constant(own)
    draws = given.pop("draws", {})
    module, name = plant.split(".")
    places = {"friction": friction, "mechanics": mechanics, "sensing": sensing}
    return Kind(
        plant=getattr(places[module], name),
        draws=_DRAWS[draws] if isinstance(draws, str) else _uniform(draws),
        **given,
    )


def read_catalogue(file: str) -> dict[str, dict[str, Any]]:
    """What a catalogue beside this file says of each effect, as fields of a Kind."""
    parsed = parsed_yaml(Path(__file__).with_name(file).read_text(encoding="utf-8"))
    return {name: {**own, "akin": tuple(own.get("akin", ()))} for name, own in parsed.items()}


def effect_record(
    kinds: Mapping[str, Kind], effect: EffectSpec, felt: Array, parameters: Parameters, size: float
) -> dict[str, Any]:
    """What a key says of an effect; `felt` (n,) is whether each joint feels it."""
    return {
        "name": effect.name,
        **picked(kinds[effect.name], "family acceptable=akin"),
        "joints": [j + 1 for j in effect.joints],
        "felt_by": (np.flatnonzero(felt) + 1).tolist(),
        "parameters": parameters,
        "size": size,
    }


KINDS: dict[str, Kind] = {
    name: _kind(**own) for name, own in read_catalogue("catalogue.yaml").items()
}

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
