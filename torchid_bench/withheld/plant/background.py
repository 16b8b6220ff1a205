"""What every real arm has besides its faults: small things of papers and of makers.

Friction that grows with the load and falls with speed and temperature (Bittencourt et al. 2010;
Wolf and Iskandar 2018), carried by Maxwell-slip elements that bend before they slide (Al-Bender et
al. 2005), a little more of it one way than the other; a drive whose torque ripples and has a gain;
links that weigh 3 to 10 % more or less than described; cables that pull as two joints stand;
channels that are late. There is so much of it that what a fit of all usual laws leaves on a joint
has the size that is asked for.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.polynomial import polyfit

from torchid_bench.withheld.plant.along import STEP, Path, slipping, together
from torchid_bench.withheld.plant.bodies import Array, deformed
from torchid_bench.withheld.plant.model import Plant
from torchid_bench.withheld.plant.plan import Plan, Scene
from torchid_bench.withheld.plant.waves import drawn_waves, pull_of

Rng = np.random.Generator

ELEMENTS = np.array([0.3, 0.8, 1.4, 2.2])
"""Displacements at which the elements of dry friction slide, of the drawn one [1]."""

NAMES = (
    "coulomb_friction", "viscous_friction", "power_law_friction", "load_dependent_friction",
    "stribeck_friction", "asymmetric_friction", "thermal_friction_drift", "presliding_hysteresis",
    "load_hysteresis", "motor_ripple", "torque_gain", "time_delay", "filter_lag", "link_inertia",
    "all_base", "payload",
)  # fmt: skip
"""Of effects that the small things are, on every joint: who names one of them names what is there,
however small."""

_EVERY = 10  # rows of a fit are so many instants apart: what is below the band, and no more
_STIFFEST = 3e-4  # presliding of a joint [rad]
_MOST = 1.0  # of what papers say of friction and ripple; what is left of the size is a cable's
_LEAST = 0.2  # share of dry friction that is left whatever changes it
_CREEP = 0.01  # rad/s below which a direction is none, in the laws that are fitted


@dataclass(frozen=True)
class Background:
    """The small things of an arm; arrays are (n,).

    Attributes:
        presliding: displacement at which dry friction slides [rad].
        load: dry friction per torque that the gear transmits, at standstill [1].
        excess: more of it at standstill, as a share; fades over `speed` [rad/s].
        bend: exponent of viscous friction, 1 where it is in proportion [1].
        usual: speed at which it is what is known of it [rad/s].
        uneven: dry friction forwards over its mean, less 1 [1].
        warming: share of dry friction that goes as the gear warms up, in `seconds` [s].
        ripple: share of the torque, along the position `wave` times a turn, with a phase [rad].
        gain: of the torque's reading, less 1.
        late: of the torque channel [s].
        waves: (n, 5, 3) of a joint's cable: numbers along its position and its neighbour's, phase
            [rad].
        level: (2, n) torque and stiffness of the cables, which are a weight's and a spring's.
        scale: of friction and ripple, as found by `scaled` [1].
        cable: torque of the cable, as found there [N m].
    """

    presliding: Array
    load: Array
    excess: Array
    speed: Array
    bend: Array
    usual: Array
    uneven: Array
    warming: Array
    seconds: Array
    ripple: Array
    wave: Array
    phase: Array
    gain: Array
    late: Array
    waves: Array
    level: Array
    scale: Array
    cable: Array

    @property
    def lengths(self) -> Array:
        """(n, m) displacements at which the elements of dry friction slide [rad]."""
        return self.presliding[:, None] * ELEMENTS


def drawn_background(rng: Rng, scene: Scene) -> Background:
    """Small things as papers and makers have them; their scale is yet to be found."""
    n = scene.n
    waves = np.maximum(3, np.round(2 * np.pi * rng.uniform(2.0, 8.0, n) / scene.speed.clip(0.1)))
    return Background(
        presliding=np.exp(rng.uniform(np.log(3e-4), np.log(3e-3), n)),
        load=rng.uniform(0.01, 0.04, n),
        excess=rng.uniform(0.1, 0.5, n),
        speed=rng.uniform(0.03, 0.15, n) * scene.speed.clip(0.1),
        bend=rng.uniform(0.6, 0.95, n),
        usual=0.5 * scene.speed.clip(0.1),
        uneven=rng.uniform(-0.06, 0.06, n),
        warming=rng.uniform(0.05, 0.2, n),
        seconds=rng.uniform(300, 1200, n),
        ripple=rng.uniform(0.003, 0.01, n),
        wave=waves,
        phase=rng.uniform(0, 2 * np.pi, n),
        gain=rng.uniform(-0.02, 0.02, n),
        late=rng.uniform(1e-3, 2e-3) + rng.uniform(0, 2e-3, n),
        waves=drawn_waves(rng, n),
        level=np.zeros((2, n)),
        scale=np.ones(n),
        cable=np.zeros(n),
    )


def imperfect(rng: Rng, plant: Plant) -> Plant:
    """The arm with links that weigh 3 to 10 % more or less than described, and are as far from it
    in shape."""
    links = []
    for link in plant.links:
        size, ways = rng.uniform(0.03, 0.1, 5), rng.choice([-1.0, 1.0], 5)
        reach = np.sqrt(np.trace(link.body.inertia) / link.body.mass)
        off = size * ways
        body = deformed(link.body, 1 + off[0], 0.5 * reach * off[1:4], 0.5 * off[4] * np.eye(3))
        links.append(replace(link, body=body))
    return replace(plant, links=tuple(links))


def small_things(b: Background, plan: Plan, path: Path, load: Array, warm: float) -> Array:
    """Torque (T, n) that the small things add to the arm's own [N m].

    Args:
        b: small things.
        plan: the arm, with the friction that is known.
        path: of its motors.
        load: (T, n) torque that its gears transmit [N m].
        warm: for how long the arm had moved before the log's clock began [s].
    """
    speed, age = np.abs(path.dq), (warm + path.start + path.t)[:, None]
    known, wet = plan.plant.friction, plan.plant.damping
    falling = np.exp(-((speed / b.speed) ** 2))
    limit = known * (b.excess * falling - b.warming * (1 - np.exp(-age / b.seconds)))
    limit += b.load * np.abs(load) * (0.6 + 0.4 * falling)
    limit = np.maximum(b.scale * limit, (_LEAST - 1) * known)
    viscous = wet * np.sign(path.dq) * (speed**b.bend * b.usual ** (1 - b.bend) - speed)
    ripple = b.ripple * load * np.sin(b.wave * path.q + b.phase)
    uneven = known * b.uneven * np.abs(path.bent)
    rest = b.scale * (uneven + viscous + ripple)
    return limit * path.bent + rest + b.cable * _pull(b, path.q)


def _pull(b: Background, q: Array) -> Array:
    """Of cables (T, n), without their mean and slope along the asked motions."""
    return pull_of(b.waves, q) - b.level[0] - b.level[1] * q


def scaled(
    b: Background,
    plan: Plan,
    scene: Scene,
    paths: Sequence[Path],
    loads: Sequence[Array],
    warm: float,
    size: float,
) -> Background:
    """As much of the small things that a fit of all usual laws leaves `size` of each joint's torque
    while it moves, presliding of known friction included.

    Args:
        b: as drawn.
        plan, scene: the arm without effects, and its motions.
        paths: of the motors.
        loads: torque that the gears transmit (T, n) [N m], one a path.
        warm: for how long the arm had moved before [s].
        size: RMS that is left, of each joint's RMS torque [1].
    """
    moving = np.abs(np.concatenate([p.dq[::_EVERY] for p in paths])) > 2 * _CREEP
    q = np.concatenate([p.q[::_EVERY] for p in paths])
    pairs = zip(q.T, pull_of(b.waves, q).T, strict=True)
    # Of a joint that stands the mean alone.
    slopes = [polyfit(x, y, [0, 1] if np.ptp(x) > 1e-6 else [0]) for x, y in pairs]
    b = replace(b, level=np.stack([np.resize([*c, 0.0], 2) for c in slopes], 1))
    pull = together([_pull(b, p.q) for p in paths], STEP, _EVERY)
    goal = size * scene.torque * np.sqrt(moving.sum(0))
    for stiffer in (True, True, False):
        bent = together([p.bent - _sign(p.dq) for p in paths], STEP, _EVERY)
        parts = [small_things(b, plan, p, x, warm) for p, x in zip(paths, loads, strict=True)]
        signals = np.stack([plan.plant.friction * bent, together(parts, STEP, _EVERY), pull], 2)
        left = [
            left_of(laws[rows], x[rows])
            for laws, x, rows in zip(
                _usual_laws(b, paths, loads), signals.transpose(1, 0, 2), moving.T, strict=True
            )
        ]
        # A joint whose presliding alone leaves more than that is stiffer.
        soft = np.array([np.linalg.norm(x[:, 0]) for x in left]) > 0.7 * goal
        if not (stiffer and soft.any()):
            break
        b = replace(
            b, presliding=np.where(soft, np.maximum(b.presliding / 3, _STIFFEST), b.presliding)
        )
        paths = [replace(p, bent=slipping(p.q, b.lengths).mean(2)) for p in paths]
    scale = np.array(
        [min(_times(x[:, 0], x[:, 1], g), _MOST) for x, g in zip(left, goal, strict=True)]
    )
    cable = [
        _times(x[:, 0] + s * x[:, 1], x[:, 2], g) for x, s, g in zip(left, scale, goal, strict=True)
    ]
    return replace(b, scale=scale, cable=np.array(cable))


def _sign(dq: Array) -> Array:
    return np.clip(dq / _CREEP, -1.0, 1.0)


def left_of(laws: Array, x: Array) -> Array:
    """What laws (T, K) leave of signals (T, M)."""
    return np.asarray(x - laws @ np.linalg.lstsq(laws, x, rcond=1e-8)[0])


def _times(own: Array, more: Array, goal: float) -> float:
    """x > 0 with |own + x more| = goal; 0 where |own| is more than that already."""
    a, h, c = more @ more, own @ more, own @ own - goal**2
    return max(0.0, float(-h + np.sqrt(max(h * h - a * c, 0.0))) / float(max(a, 1e-300)))


def _usual_laws(b: Background, paths: Sequence[Path], loads: Sequence[Array]) -> Array:
    """Columns (n, T, K) of what is usually fitted to each joint: a constant, gravity and inertia,
    friction of speed, direction, load and time, presliding of one element, a gain, a late torque,
    ripple."""

    def smooth(parts: Iterable[Array]) -> Array:
        return together(list(parts), STEP, _EVERY)

    q, dq, ddq = (smooth(getattr(p, x) for p in paths) for x in ("q", "dq", "ddq"))
    load, rate = smooth(loads), smooth(np.gradient(x, STEP, axis=0) for x in loads)
    signs, slow = (
        smooth(x) for x in zip(*((_sign(p.dq), _slow(b, p)) for p in paths), strict=True)
    )
    age = np.concatenate([(p.start + p.t)[::_EVERY] for p in paths])[:, None]
    slips = [slipping(p.q, b.presliding[:, None] * np.array([0.6, 1.6])) for p in paths]
    columns = [np.ones_like(q), np.sin(q), np.cos(q), ddq, dq, dq * np.abs(dq), signs, slow]
    columns += [smooth(x[..., k] for x in slips) for k in range(2)]
    columns += [age * signs, signs * np.abs(load), load, rate]
    columns += [wave(b.wave * q) * load for wave in (np.sin, np.cos)]
    return np.stack(columns, 2).transpose(1, 0, 2)


def _slow(b: Background, path: Path) -> Array:
    return np.asarray(_sign(path.dq) * np.exp(-((path.dq / b.speed) ** 2)))
