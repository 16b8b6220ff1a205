"""A case with a background: an arm as it is without faults, effects on top of it, a motion as
people record it, and what its logger writes."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import reduce
from typing import Any

import numpy as np
from scipy.signal import butter, sosfilt

from torchid_bench.withheld.plant.along import (
    STEP,
    Path,
    paths_of,
    rigid_along,
    together,
    torque_along,
)
from torchid_bench.withheld.plant.arms import Arm, arm_named, urdf
from torchid_bench.withheld.plant.background import (
    Background,
    drawn_background,
    imperfect,
    scaled,
    small_things,
)
from torchid_bench.withheld.plant.bodies import Array
from torchid_bench.withheld.plant.catalogue import (
    KINDS,
    drawn_effect,
    effect_record,
    kind_named,
)
from torchid_bench.withheld.plant.draw import EXCLUSIVE, BackgroundSpec
from torchid_bench.withheld.plant.logger import FINEST, Logger, logged
from torchid_bench.withheld.plant.model import plant_of
from torchid_bench.withheld.plant.plan import EffectSpec, Plan, Scene, Signals
from torchid_bench.withheld.plant.recorded import STYLES, Recorded, recorded
from torchid_bench.withheld.plant.scene import friction_known, nominal_of, scene_along
from torchid_bench.withheld.plant.sensing import with_held_torque
from torchid_bench.withheld.plant.settings import DRAWS
from torchid_bench.withheld.plant.simulate import scale_of, with_effect

STANDARD = 0.05
"""Size of a cause: its RMS, of the RMS torque of the joint that feels it most."""

FELT = 0.01
"""Share of a joint's torque from which on it feels an effect: the least that is worth a name."""

_SHARP = 1e-5  # presliding of friction that only has a direction [rad]
_COARSE = 4  # each so many instants tell how large an effect is
_WARM = 1500.0, 3000.0  # seconds for which an arm had moved before its log: it is warm, not done
_FASTER = 0.05  # rad/s: a joint that never is so fast does not move
_ACTS = 0.01  # of the largest torque of what comes and goes, from which on it is there

Rng = np.random.Generator


@dataclass(frozen=True)
class Session:
    """Motions of an arm that were recorded together.

    Attributes:
        scene: of them.
        warm: for how long the arm had moved before [s].
        paths: of its motors.
        loads: torque (T, n) that the gears of the arm without effects transmit, one a path [N m].
    """

    scene: Scene
    warm: float
    paths: tuple[Path, ...] = ()
    loads: tuple[Array, ...] = ()

    def of(self, plan: Plan, lengths: Array) -> "Session":
        """The same of an arm whose dry friction bends by so much (n, m) before it slides."""
        paths = tuple(paths_of(self.scene, lengths))
        return replace(self, paths=paths, loads=tuple(rigid_along(plan, path) for path in paths))


@dataclass(frozen=True)
class Files:
    """What is written of a case: the nominal model, columns of the logs and of the earlier log, the
    key."""

    urdf: str
    logs: tuple[dict[str, Array], ...]
    earlier: dict[str, Array] | None
    key: dict[str, Any]


def of_background(
    spec: BackgroundSpec,
    *,
    only: Sequence[int] | None = None,
    ideal: bool = False,
    quiet: bool = False,
) -> Files:
    """Simulate a case.

    Args:
        spec: what it is.
        only: effects that are there, by their numbers; all if None. What is drawn of the others, of
            the background and of noise stays as it is.
        ideal: whether sensors have no noise, counts, jitter and lost rows.
        quiet: whether it is the arm that its file describes, without effects, seen by the same
            sensors.
    """

    # Each thing that is drawn has random numbers of its own.
    def numbers(what: int) -> Rng:
        return np.random.default_rng([spec.seed, spec.number, what])

    arm = arm_named(spec.arm)
    known = friction_known(arm, *numbers(2).uniform(*DRAWS.friction, (2, arm.n)))
    healthy = Plan(imperfect(numbers(3), plant_of(arm, *known)), *known)
    rng = numbers(4)
    styles = rng.permutation(list(STYLES)).tolist()
    count = int(rng.integers(1, 4))
    asked = _session(rng, arm, known, [str(rng.choice(styles[:3])) for _ in range(count)])
    before = _session(rng, arm, known, styles[3:])
    # The background is that of the asked motions.
    small = drawn_background(numbers(5), asked.scene)
    bent = asked.of(healthy, small.lengths)
    small = scaled(
        small, healthy, asked.scene, bent.paths, bent.loads, asked.warm,
        spec.background * STANDARD,
    )  # fmt: skip
    if quiet:
        none = dict.fromkeys(("scale", "cable", "gain", "late"), np.zeros(arm.n))
        small = replace(small, presliding=np.full(arm.n, _SHARP), **none)
        healthy, only = Plan(plant_of(arm, *known), *known), ()
    asked = asked.of(healthy, small.lengths)
    # The effects, each of standard size on the arm without the others.
    effects = _placed(numbers(6), spec, arm, asked)
    plan, records = healthy, list[dict[str, Any]]()
    coarse = [path.every(_COARSE) for path in asked.paths]
    for k, effect in enumerate(effects):
        if only is not None and k not in only:
            continue
        size = _sizes(asked.scene, healthy, effect, coarse)
        kind = kind_named(effect.name)
        usual, largest = kind.usual(asked.scene, effect), kind.largest(asked.scene, effect)
        one = scale_of(size, usual, largest, STANDARD, effect.name)
        plan, own = with_effect(asked.scene, plan, effect, one.scale)
        records.append(effect_record(KINDS, effect, one.size > FELT, own, float(one.size.max())))
    logger = _logger(numbers(7), ideal=ideal)
    lost = 0.0 if ideal else float(numbers(8).uniform(0.0, 3e-3))
    write = _writing(spec, logger, lost, small, healthy, ideal=ideal)
    key = {
        "kind": spec.kind, "arm": spec.arm, "rate_hz": logger.rate_hz,
        "colour_hz": logger.colour_hz, "level": None, "effects": records,
        "share": spec.background, "earlier": spec.earlier,
        "background": {name: x.tolist() for name, x in asdict(small).items()},
        "noise_std": asked.scene.noise.tolist(), "torque": asked.scene.torque.tolist(),
    }  # fmt: skip
    earlier = None
    if spec.earlier:
        # Of an arm whose friction is what the file knows of it.
        wet, dry = _known_beside(plan, healthy)
        plant = replace(
            healthy.plant,
            damping=healthy.plant.damping + wet,
            friction=healthy.plant.friction + dry,
        )
        described = replace(healthy, plant=plant)
        earlier = write(before.of(healthy, small.lengths), described, 1)[0]
    model = urdf(arm, plan.known_damping, plan.known_friction)
    return Files(model, tuple(write(asked, plan, 0)), earlier, key)


def _session(rng: Rng, arm: Arm, known: tuple[Array, Array], styles: Sequence[str]) -> Session:
    nominal = nominal_of(arm, *known)
    seconds = rng.uniform(35.0, 55.0) / len(styles) ** 0.5
    centre = rng.uniform(-0.4, 0.4, arm.n)
    motions = tuple(recorded(rng, arm, nominal, style, seconds, centre) for style in styles)
    ends = np.cumsum([m.seconds + rng.uniform(*DRAWS.pauses) for m in motions])
    starts = (0.0, *ends[:-1].tolist())
    share = float(rng.uniform(*DRAWS.noise))
    scene = scene_along(nominal, motions, tuple(range(len(styles))), starts, arm, share)
    return Session(scene, float(rng.uniform(*_WARM)))


def _placed(rng: Rng, spec: BackgroundSpec, arm: Arm, session: Session) -> list[EffectSpec]:
    """The effects at joints that move, each at its own where they exclude each other."""
    still = tuple(np.flatnonzero(session.scene.speed < _FASTER).tolist())
    out, taken = list[EffectSpec](), list[int]()
    for effect in spec.effects:
        avoid = (*still, *(taken if effect.name in EXCLUSIVE else ()))
        drawn = drawn_effect(rng, effect.name, arm, avoid=tuple(avoid))
        if "begin" in drawn.draws:
            drawn = replace(drawn, draws={**drawn.draws, **_while_it_moves(rng, session)})
        out.append(drawn)
        taken += drawn.joints
    return out


def _while_it_moves(rng: Rng, session: Session) -> dict[str, float]:
    """Trajectory and beginning, as a share of it, of what happens in the middle of a step."""
    number = int(rng.integers(len(session.scene.order)))
    motion = session.scene.shapes[session.scene.order[number]]
    assert isinstance(motion, Recorded)
    k = int(rng.integers(len(motion.begins)))
    begin = motion.begins[k] + rng.uniform(0.2, 0.5) * motion.lasts[k]
    return {"trajectory": float(number), "begin": float(begin / motion.seconds)}


def _sizes(
    scene: Scene, healthy: Plan, effect: EffectSpec, paths: Sequence[Path]
) -> Callable[[float], Array]:
    """Its size (n,) at a scale: RMS of what it changes in the gap, of each joint's torque."""
    kind = kind_named(effect.name)
    bare = [rigid_along(healthy, path) for path in paths]
    comes_and_goes = kind.family == "transient" or "transient" in kind.akin

    def size(scale: float) -> Array:
        plan, _ = with_effect(scene, healthy, effect, scale)
        wet, dry = _known_beside(plan, healthy)
        parts = []
        for path, own in zip(paths, bare, strict=True):
            tau = read(plan, path, torque_along(plan, path, (healthy, own))).tau
            tau = with_held_torque(tau, path.t, plan.held, path.number)
            parts.append(tau - own - wet * path.dq - dry * path.bent)
        change = np.abs(together(parts, paths[0].step))
        there = change > (_ACTS * change.max() if comes_and_goes else -1.0)
        mean = (change**2 * there).sum(0) / np.maximum(there.sum(0), 1)
        return np.asarray(np.sqrt(mean) / scene.torque)

    return size


def _known_beside(plan: Plan, healthy: Plan) -> tuple[Array, Array]:
    """Viscous and dry friction (n,) that is known of a plan beside what is of the healthy arm's."""
    return plan.known_damping - healthy.known_damping, plan.known_friction - healthy.known_friction


def read(plan: Plan, path: Path, tau: Array) -> Signals:
    """What the sensors of the effects make of a motion and its torque (T, n)."""
    truth = Signals(path.t + path.start, path.q, path.dq, path.ddq, tau)
    return reduce(lambda x, sensor: sensor(x), plan.sensors, truth)


def _logger(rng: Rng, *, ideal: bool) -> Logger:
    bits = int(rng.integers(14, 19, endpoint=True))
    return Logger(
        rate_hz=int(rng.choice((125, 250, 500))),
        encoder_bits=FINEST if ideal else bits,
        colour_hz=float(rng.uniform(5.0, 30.0)),
        jitter=0.0 if ideal else float(rng.choice((0.0, 0.02, 0.05))),
        own_velocity=True,
        velocity_noise=0.0,
        clock=float(rng.uniform(0, 1000).__round__(3)),
        seed=int(rng.integers(2**31)),
    )


def _writing(
    spec: BackgroundSpec,
    logger: Logger,
    lost: float,
    small: Background,
    healthy: Plan,
    *,
    ideal: bool,
) -> Callable[[Session, Plan, int], list[dict[str, Array]]]:
    """What the logger writes of a session of a plan: a table a motion."""
    tick = 2 * np.pi / 2**logger.encoder_bits
    corner = float(np.random.default_rng([spec.seed, spec.number, 9]).uniform(20.0, 60.0))
    filtering = butter(2, corner, fs=1 / STEP, output="sos")

    def write(session: Session, plan: Plan, number: int) -> list[dict[str, Array]]:
        out, noise = [], 0.0 if ideal else 1.0
        for path, load in zip(session.paths, session.loads, strict=True):
            tau = torque_along(plan, path, (healthy, load))
            tau = tau + small_things(small, healthy, path, load, session.warm)
            seen = read(plan, path, tau)
            t = seen.t
            late = [np.interp(t - s, t, x) for s, x in zip(small.late, seen.tau.T, strict=True)]
            # The drive's speed: a filtered difference of what the encoder counts.
            counts = np.round(seen.q / tick) * tick
            if ideal:
                speed = np.gradient(counts, STEP, axis=0)
            else:
                steps = np.diff(counts, axis=0, prepend=counts[:1])
                speed = sosfilt(filtering, steps / STEP, axis=0)
            seen = replace(seen, dq=speed, tau=np.stack(late, 1) * (1 + small.gain))
            own = replace(logger, seed=logger.seed + 10 * path.number + number)
            held = replace(plan, held=tuple(
                replace(h, windows=(h.windows[path.number],)) for h in plan.held
            ))  # fmt: skip
            columns = logged(own, held, [seen], noise * session.scene.noise)
            rows = np.random.default_rng([own.seed, 1]).random(len(columns["t"])) >= lost
            out.append({name: x[rows] for name, x in columns.items() if name != "traj"})
        return out

    return write
