"""What every arm of servos has besides its faults: gears whose friction is that of published ones
and not a plain servo's, links that weigh 3 to 10 % more or less than described, a supply that sags
a little, commands that come by a fraction of a sample too late, cables that pull as two joints
stand. What the best plain servo leaves of all that has, on each joint, the size that is asked for:
a share of the gears' friction is there that makes it so, and cables pull only where all of it is
less."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from torchid.json_data import picked
from torchid_bench.withheld.plant.arms import Arm, arm_named
from torchid_bench.withheld.plant.background import imperfect, left_of
from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.draw import ServoSpec
from torchid_bench.withheld.plant.plan import Plan
from torchid_bench.withheld.plant.recorded import STYLES, Recorded, recorded
from torchid_bench.withheld.plant.scene import Nominal, nominal_of
from torchid_bench.withheld.plant.servo import Moved, Servos, moved
from torchid_bench.withheld.plant.servo_catalogue import ServoScene
from torchid_bench.withheld.plant.servo_friction import Beyond, gears, published
from torchid_bench.withheld.plant.servo_scene import servo_plan
from torchid_bench.withheld.plant.waves import drawn_waves, pull_of

STANDARD = 0.01
"""A cause of standard size changes the positions of the joint that it moves most by so much, RMS
[rad]: about the median of what is planted with a size of 1."""

NAMES = (
    "stribeck_friction", "load_dependent_friction", "motor_dependent_friction", "torque_offset",
    "command_delay", "payload", "supply_sag",
)  # fmt: skip
"""Of effects that the small things are: gear friction, masses, sag and jitter among them."""

_CREEP = 0.02  # rad/s below which a joint stands
_MOVES = 0.05  # rad/s: a joint that never is so fast does not move
_LEAST = 1e-3  # of a cause: masses, sag and jitter are there in any case
_SECONDS = 36.0, 44.0  # of all motions together

Rng = np.random.Generator


@dataclass(frozen=True)
class Surroundings:
    """An arm of servos without faults.

    Attributes:
        scene: as plain servos are, and how they move.
        plan: with the small things.
        moved: where that leads.
        left: (n,) RMS of the positions that the best plain servo leaves of the small things [rad].
        still: joints (from 0) that do not move.
        key: what a key says of it.
    """

    scene: ServoScene
    plan: Plan
    moved: list[Moved]
    left: Array
    still: tuple[int, ...]
    key: dict[str, Any]


def surroundings(spec: ServoSpec) -> Surroundings:
    """The arm of a case, which is the same whatever is planted."""

    def numbers(what: int) -> Rng:
        return np.random.default_rng([spec.seed, spec.number, what])

    arm = arm_named(spec.arm)
    zero = np.zeros(arm.n)
    nominal = nominal_of(arm, zero, zero)
    motions = _motions(numbers(4), arm, nominal)
    states = [m.state(np.arange(0.0, m.seconds, 1 / spec.rate_hz)) for m in motions]
    # A gear a joint, and the plain part of its friction along the motions.
    rng = numbers(3)
    servos_of = rng.choice(list(published()), arm.n).tolist()
    laws = [(servo, str(rng.choice(list(published()[servo])))) for servo in servos_of]
    gear = gears(laws, np.array([j.effort for j in arm.joints]))
    q, dq, ddq = (np.concatenate(x) for x in zip(*states, strict=True))
    load, moves = nominal.rigid(q, dq, ddq), np.abs(dq) > _CREEP
    dry = gear.numbers["base"] + gear.numbers["stribeck"]
    bound = gear.bound(dq, load + np.sign(dq) * dry, -load)
    plain = (bound * moves).sum(0) / np.maximum(moves.sum(0), 1)
    # Plain servos of that friction.
    plan, inertia = servo_plan(spec, numbers(2))
    assert plan.servos is not None
    servos = replace(plan.servos, values={**plan.servos.values, "coulomb": plain})
    plant = replace(plan.plant, damping=plan.plant.damping + gear.numbers["viscous"])
    plan, commands = replace(plan, plant=plant, servos=servos), [u for u, _, _ in states]
    scene = ServoScene(arm, plan, inertia, commands, moved(plant, servos, commands))
    # The small things.
    rng = numbers(5)
    sag, jitter = rng.uniform(0.005, 0.03) / scene.torque.sum(), rng.uniform(0.05, 0.4)
    small = {"sag": np.full(arm.n, sag), "jitter": np.full(arm.n, jitter)}
    waves = drawn_waves(rng, arm.n)
    beyond = Beyond(gear, plain, zero, waves, pull_of(waves, q).mean(0), zero)
    servos = replace(servos, values={**servos.values, **small})
    plan = replace(plan, plant=imperfect(rng, plant))
    goal = max(spec.background or 0.0, _LEAST) * STANDARD
    made, there, left = _scaled(scene, plan, servos, beyond, goal)
    speed = np.quantile(np.abs(dq), 0.99, axis=0)
    still = tuple(np.flatnonzero(speed < _MOVES).tolist())
    key = {"laws": [" ".join(law) for law in laws], "sag": sag, "jitter": jitter}
    assert made.servos is not None
    key |= picked(made.servos.beyond, "share waves level cable")
    return Surroundings(scene, made, there, left, still, key)


def _motions(rng: Rng, arm: Arm, nominal: Nominal) -> list[Recorded]:
    """One to three motions as people record them."""
    count = int(rng.integers(1, 4))
    centre, seconds = rng.uniform(-0.4, 0.4, arm.n), rng.uniform(*_SECONDS) / count
    styles = rng.choice(list(STYLES), count)
    return [recorded(rng, arm, nominal, str(style), seconds, centre) for style in styles]


def _scaled(
    scene: ServoScene, plan: Plan, servos: Servos, beyond: Beyond, goal: float
) -> tuple[Plan, list[Moved], Array]:
    """With as much of the gears' friction that plain servos leave the RMS `goal` [rad], and where
    that leads; cables pull where all of it leaves less. Third, (n,) what is left [rad]."""
    usual, n = _usual(scene), scene.arm.n

    def left(share: Array, cable: Array) -> tuple[Plan, list[Moved], Array]:
        """The third is (n, T) of the goal."""
        of = replace(servos, beyond=replace(beyond, share=share, cable=cable))
        there = moved(plan.plant, of, scene.commands)
        apart = np.concatenate([a.q - b.q for a, b in zip(there, scene.base, strict=True)])
        rest = [left_of(own, x[:, None])[:, 0] for own, x in zip(usual, apart.T, strict=True)]
        return replace(plan, servos=of), there, np.array(rest) / goal

    whole = left(np.ones(n), np.zeros(n))[2]
    size = np.sqrt((whole**2).mean(1))
    # A first guess, and how far along it the goal is.
    share = 1 / np.maximum(size, 1)
    cable = 1.5 * np.sqrt(np.maximum(1 - size**2, 0)) * goal * scene.of("kp")
    far = np.array([*map(_how_far, whole, left(share, cable)[2] - whole)])
    made, there, rest = left((1 + far * (share - 1)).clip(0, 1), far * cable)
    return made, there, goal * np.sqrt((rest**2).mean(1))


def _how_far(x: Array, d: Array) -> float:
    """How many steps d (T,) lead from x (T,) to where the mean square is 1, or as near as it gets;
    three at most."""
    a, h, c = d @ d, x @ d, x @ x - len(x)
    way = np.sqrt(max(h * h - a * c, 0.0)) * -np.sign(c)
    return float(np.clip((way - h) / max(a, 1e-300), 0.0, 3.0))


def _usual(scene: ServoScene) -> list[Array]:
    """Columns (T, K) of each joint's positions that numbers of a plain servo change: an offset, a
    gain, viscous and dry friction, inertia; a delay is as viscous friction."""
    columns = []
    for one in scene.base:
        dq = np.gradient(one.q, axis=0) * scene.servos.rate_hz
        ddq = np.gradient(dq, axis=0) * scene.servos.rate_hz
        # A joint that stands keeps the side from which it came.
        last = np.where(np.abs(dq) > _CREEP, np.arange(len(dq))[:, None], 0)
        side = np.sign(np.take_along_axis(dq, np.maximum.accumulate(last, axis=0), 0))
        columns.append(np.stack([np.ones_like(dq), one.torque, dq, side, ddq], 2))
    return list(np.concatenate(columns).transpose(1, 0, 2))
