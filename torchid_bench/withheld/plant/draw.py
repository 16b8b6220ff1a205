"""What a case is, drawn from a seed and its number alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from torchid.errors import TorchidError
from torchid_bench.withheld.plant.arms import ARMS, ROBOTS, Arm, arm_named
from torchid_bench.withheld.plant.catalogue import (
    FOREIGN,
    KINDS,
    LIBRARY,
    OUTSIDE,
    REDRAWN,
    Kind,
    drawn_effect,
    kind_named,
)
from torchid_bench.withheld.plant.logger import Logger
from torchid_bench.withheld.plant.motion import MotionPlan
from torchid_bench.withheld.plant.plan import EffectSpec
from torchid_bench.withheld.plant.servo_catalogue import SERVO_KINDS
from torchid_bench.withheld.plant.settings import DRAWS

Item = TypeVar("Item")
Rng = np.random.Generator


@dataclass(frozen=True)
class Mix:
    """What the cases of a set are.

    Attributes:
        block: kinds of so many cases in a row, in an order of their own.
        effects: that its arms can have.
        foreign: those that the diagnosis cannot name.
        servos: whether servos move the arms, and the logs have no torque.
        trees: whether its robots branch.
    """

    block: tuple[str, ...]
    effects: Mapping[str, Kind]
    foreign: tuple[str, ...]
    servos: bool = False
    trees: bool = False

    @property
    def library(self) -> tuple[str, ...]:
        """Effects that the diagnosis can name."""
        return tuple(name for name, kind in self.effects.items() if kind.family != OUTSIDE)


def _block(**cases: int) -> tuple[str, ...]:
    return tuple(kind for kind, count in cases.items() for _ in range(count))


# Of several tips none is `the` one that a payload is on: what a hand carries is its link's.
_ON_TREES = {name: kind for name, kind in KINDS.items() if name != "payload"}

_DYNAMIC = ("backlash", "joint_elasticity", "flexible_base", "filter_lag")
"""What bends gives way too little on slow motions; velocities are differences there in any case."""

_REAL = _block(none=4, single=12, several=4, outside=4)
_SERVOS_FOREIGN = tuple(name for name, kind in SERVO_KINDS.items() if kind.family == OUTSIDE)

MIXES = {
    # Of every sort, for development.
    "mixed": Mix(
        _block(none=4, parameters=1, single=7, several=3, outside=2, poor=1, severity=2),
        KINDS,
        FOREIGN,
    ),
    # What a release is judged by: other effects outside the library, and of the cases without an
    # effect half have noise that is coloured or grows with speed.
    "release": Mix(_block(none=4, single=8, outside=4, several=3), KINDS, REDRAWN),
    # With a background, on motions as people record them.
    "background": Mix(
        _REAL,
        {name: kind for name, kind in KINDS.items() if name not in _DYNAMIC},
        tuple(name for name in REDRAWN if name not in _DYNAMIC),
    ),
    # Of commands and positions; with a background, on such motions.
    "position": Mix(
        _block(none=5, single=9, several=2, outside=4), SERVO_KINDS, _SERVOS_FOREIGN, servos=True
    ),
    "position_background": Mix(_REAL, SERVO_KINDS, _SERVOS_FOREIGN, servos=True),
    # Robots that branch, their base held: causes of the library, and none.
    "tree": Mix(_block(none=5, single=15), _ON_TREES, (), trees=True),
    "tree_position": Mix(
        _block(none=5, single=15),
        # Nothing is on `the` tip, and feet on the ground are another matter.
        {name: kind for name, kind in SERVO_KINDS.items() if kind.place != "arm"},
        (),
        servos=True,
        trees=True,
    ),
}

EXCLUSIVE = (
    "stribeck_friction", "asymmetric_friction", "thermal_friction_drift", "uneven_friction",
    "uneven_damping", "gear_coupling", "joint_elasticity", "backlash",
)  # fmt: skip
"""Effects that take the place of a joint's known friction or drive: one of them a joint."""

POOR = ("slow", "small", "few")
"""Motions that tell little."""

COLLINEAR = (
    ("viscous_friction", "power_law_friction"), ("viscous_friction", "coulomb_friction"),
    ("coulomb_friction", "load_dependent_friction"), ("coulomb_friction", "presliding_hysteresis"),
    ("torque_offset", "joint_spring"), ("torque_gain", "time_delay"),
    ("rotor_inertia", "viscous_friction"), ("torque_offset", "cogging"),
)  # fmt: skip
"""Pairs that look alike on one joint."""

_SEVERAL = tuple(name for name in LIBRARY if name not in ("filter_lag", "link_inertia"))


@dataclass(frozen=True)
class CaseSpec:
    """A case before it is simulated.

    Attributes:
        seed, number: what it was drawn from.
        kind: none, parameters, single, several, outside, poor or severity.
        arm: 3r, 6r or 7r, or a robot that branches.
        effects: to plant; servos' get their joints once the loads are known.
    """

    seed: int
    number: int
    kind: str
    arm: str
    effects: tuple[EffectSpec, ...]


@dataclass(frozen=True)
class ServoSpec(CaseSpec):
    """A case of an arm of servos.

    Attributes:
        rate_hz: of the log.
        counts: of an encoder in one turn.
        background: what plain servos leave, of a cause of standard size; None of plain servos.
    """

    rate_hz: float
    counts: int
    background: float | None = None


@dataclass(frozen=True)
class BackgroundSpec(CaseSpec):
    """A case of an arm with a background; its effects get their joints once its motion is known.

    Attributes:
        background: what a fit of all usual laws leaves, of a cause of standard size.
        earlier: whether there is an earlier log of other motion, without the effects.
    """

    background: float
    earlier: bool


@dataclass(frozen=True)
class TorqueSpec(CaseSpec):
    """A case of an arm whose controllers are told torques.

    Attributes:
        level: wanted size of each effect, in standard deviations of the noise; None without any.
        motion: of the trajectories; a poor case's effects have their size on these.
        poor: the motion of a poor case; None for others.
        excitation: `rich`, or what is poor about the motion.
        viscous, coulomb: (n,) known friction, as shares of effort / speed and of effort.
        noise_share: torque noise, as a share of each joint's torque RMS.
        bandwidth_hz, damping_ratio: of the controllers.
        logger: of the log.
    """

    level: float | None
    motion: MotionPlan
    poor: MotionPlan | None
    excitation: str
    viscous: tuple[float, ...]
    coulomb: tuple[float, ...]
    noise_share: float
    bandwidth_hz: float
    damping_ratio: float
    logger: Logger


def draw_case(
    seed: int,
    number: int,
    *,
    kind: str | None = None,
    effects: Sequence[str] | None = None,
    level: float | None = None,
    arm: str | None = None,
    mix: str = "mixed",
    robots: str = "arms",
    background: float = 0.0,
) -> CaseSpec:
    """A case from a seed and its number; what is given is not drawn.

    Args:
        seed: of the set.
        number: of the case, from 0.
        kind: of the case.
        effects: names of the effects to plant.
        level: their size, in standard deviations of the noise; servos' have the size that shows.
        arm: 3r, 6r or 7r, or a robot that branches.
        mix: of the set: `mixed` or `release`; `position` for arms of servos, `tree` and
            `tree_position` for robots that branch.
        robots: that the arm is drawn from: `arms`, `tree`, or one that branches.
        background: of the mixes `background` and `position_background`, of a cause of standard
            size.

    Raises:
        TorchidError: an unknown mix, kind, effect or arm.
    """
    if mix not in MIXES:
        raise TorchidError(f"unknown mix of cases '{mix}'.", available=list(MIXES))
    own = MIXES[mix]
    # The kind, and how many cases of it came before.
    kinds = [kind_named(name, own.effects) for name in effects or ()]
    if kind is None and effects is not None:
        kind = ("none", "single", "several")[min(len(kinds), 2)]
        kind = "outside" if any(f.family == OUTSIDE for f in kinds) else kind
    kind = kind or in_turn(seed, number, own.block, 101)
    if kind not in own.block:
        raise TorchidError(f"unknown kind of case '{kind}'.", available=sorted(set(own.block)))
    turn = turn_of(seed, number, kind, own.block)
    # None, or one of which each comes once before any comes twice.
    names: Sequence[str]
    if effects is None and kind == "none":
        effects = ()
    elif effects is None and kind in ("single", "outside"):
        names, salt = (own.library, 104) if kind == "single" else (own.foreign, 103)
        effects = (in_turn(seed, turn, names, salt),)
    if mix == "background":
        rng = np.random.default_rng([seed, number, 1])
        if effects is None:
            names = [name for name in own.library if name in _SEVERAL]
            effects = tuple(rng.choice(names, 2, replace=False).tolist())
        placed = tuple(EffectSpec(str(name), (), {}) for name in effects)
        name = arm or str(rng.choice(ROBOTS[robots]))
        return BackgroundSpec(
            seed, number, kind, arm_named(name).name, placed, background, turn % 2 == 0
        )
    if own.servos:
        servos = _servo_case(seed, number, kind, effects, arm, ROBOTS[robots])
        return replace(servos, background=background) if mix == "position_background" else servos
    return _torque_case(
        seed, number, kind, effects, arm, turn=turn, level=level, release=mix == "release",
        robots=ROBOTS[robots],
    )  # fmt: skip


def _servo_case(
    seed: int,
    number: int,
    kind: str,
    effects: Sequence[str] | None,
    arm: str | None,
    robots: Sequence[str],
) -> ServoSpec:
    rng = np.random.default_rng([seed, number, 1])
    if effects is None:
        effects = rng.choice(MIXES["position"].library, 2, replace=False).tolist()
    name = arm or str(rng.choice(list(robots)))
    return ServoSpec(
        seed, number, kind, arm_named(name).name,
        tuple(EffectSpec(str(effect), (), {}) for effect in effects),
        rate_hz=float(rng.choice(DRAWS.servo_rates_hz)), counts=int(rng.choice(DRAWS.counts)),
    )  # fmt: skip


def _torque_case(
    seed: int,
    number: int,
    kind: str,
    effects: Sequence[str] | None,
    arm: str | None,
    *,
    turn: int,
    level: float | None,
    release: bool,
    robots: Sequence[str],
) -> TorqueSpec:
    # Arm, effects, motion, friction and logger each have random numbers of their own.
    def numbers(what: int) -> Rng:
        return np.random.default_rng([seed, number, what])

    name = arm or str(numbers(1).choice(list(robots)))
    own = arm_named(name)
    n = own.n
    planted = _effects(numbers(2), kind, own, effects)
    wanted = level or DRAWS.level if planted else None
    if planted and not level and kind == "severity":
        wanted = in_turn(seed, turn, DRAWS.levels, 102)
    motion = _motion(numbers(3), n, branches=name not in ARMS)
    poor, excitation = _poor(numbers(4), motion, n) if kind == "poor" else (None, "rich")
    quiet = numbers(5)
    # In a release several effects stand on friction that is known.
    knows = quiet.random() < DRAWS.known or (release and kind == "several")
    viscous, coulomb = (quiet.uniform(*DRAWS.friction, n) * knows for _ in range(2))
    rng = numbers(6)
    logger = Logger(
        rate_hz=int(rng.choice(DRAWS.rates_hz)),
        encoder_bits=int(rng.integers(*DRAWS.bits, endpoint=True)),
        colour_hz=DRAWS.colour_hz if rng.random() < DRAWS.coloured else None,
        jitter=float(rng.choice(DRAWS.jitters)),
        own_velocity=bool(rng.random() < DRAWS.velocities),
        velocity_noise=float(rng.uniform(*DRAWS.velocity_noise)),
        clock=float(rng.uniform(0, 1000).__round__(3)),
        seed=int(rng.integers(2**31)),
    )
    if release and kind == "none":
        # White, white, coloured, growing with speed, in turn.
        noise = turn % 4
        grows = float(rng.uniform(*DRAWS.grows)) if noise == 3 else 0.0
        logger = replace(logger, colour_hz=DRAWS.colour_hz if noise == 2 else None, grows=grows)
    return TorqueSpec(
        seed, number, kind, name, planted, wanted, motion, poor, excitation,
        tuple(viscous.tolist()), tuple(coulomb.tolist()),
        noise_share=float(quiet.uniform(*DRAWS.noise)),
        bandwidth_hz=float(quiet.uniform(*DRAWS.bandwidth_hz)),
        damping_ratio=float(quiet.uniform(*DRAWS.damping)),
        logger=logger,
    )  # fmt: skip


def _poor(rng: Rng, motion: MotionPlan, n: int) -> tuple[MotionPlan, str]:
    """A motion that tells little, and why: slow, small, or of one or two joints."""
    what = str(rng.choice(POOR))
    if what == "slow":
        factor = float(rng.uniform(*DRAWS.slow))
        return replace(motion, levels=tuple(level * factor for level in motion.levels)), what
    if what == "small":
        return replace(motion, reach=float(rng.uniform(*DRAWS.small))), what
    count = int(rng.integers(1, 3))
    moving = sorted(int(j) for j in rng.choice(n, count, replace=False))
    return replace(motion, moving=tuple(moving)), what


def turn_of(seed: int, number: int, kind: str, kinds: Sequence[str]) -> int:
    """How many cases of a kind came before this one."""
    block, place = divmod(number, len(kinds))
    order = np.random.default_rng([seed, block, 101]).permutation(len(kinds))
    before = sum(kinds[k] == kind for k in order[:place])
    return block * kinds.count(kind) + before


def in_turn(seed: int, turn: int, names: Sequence[Item], salt: int) -> Item:
    """One of the items, each once before any comes twice."""
    lap, place = divmod(turn, len(names))
    order = np.random.default_rng([seed, lap, salt]).permutation(len(names))
    return names[int(order[place])]


def _effects(rng: Rng, kind: str, arm: Arm, wanted: Sequence[str] | None) -> tuple[EffectSpec, ...]:
    n = arm.n
    if wanted is not None:
        drawn = _apart(rng, wanted, arm)
        if drawn is None:
            raise TorchidError(
                "these effects cannot be on one arm: each needs joints of its own.",
                got=list(wanted),
                hint="an arm with more joints",
            )
        return drawn
    if kind == "parameters":
        links = tuple(range(n))
        return (EffectSpec("link_inertia", links, KINDS["link_inertia"].draws(rng, n, links)),)
    if kind == "several":
        # A pair that looks alike, on one joint; or two or three, each on its own.
        if rng.random() < DRAWS.alike:
            first, second = COLLINEAR[int(rng.integers(len(COLLINEAR)))]
            beside = drawn_effect(rng, first, arm)
            others = tuple(j for j in range(n) if j not in beside.joints)
            return beside, drawn_effect(rng, second, arm, avoid=others)
        count = 2 if rng.random() < DRAWS.pairs else 3
        while True:
            names = [str(x) for x in rng.choice(_SEVERAL, count, replace=False)]
            drawn = _apart(rng, names, arm)
            if drawn is not None:
                return drawn
    return (drawn_effect(rng, str(rng.choice(LIBRARY)), arm),)


def _apart(
    rng: np.random.Generator, names: Sequence[str], arm: Arm
) -> tuple[EffectSpec, ...] | None:
    """Effects on joints of their own, where there are enough; None where there are too few for
    effects that exclude each other."""
    for _ in range(DRAWS.tries):
        out: list[EffectSpec] = []
        for name in names:
            taken = tuple(j for effect in out for j in effect.joints)
            out.append(drawn_effect(rng, name, arm, avoid=taken))
        alone = [j for effect in out if effect.name in EXCLUSIVE for j in effect.joints]
        if len(set(alone)) == len(alone):
            return tuple(out)
    return None


def _motion(rng: np.random.Generator, n: int, *, branches: bool) -> MotionPlan:
    """Four trajectories of 12 to 15 s at three or four levels of speed, mostly one repeated.

    Of a robot with branches six of 10 s, five motions and the fastest again: what hangs in the air
    is soon brought there, and branches move at the same time.
    """
    repeats = branches or rng.random() < DRAWS.repeated
    speeds = DRAWS.tree_speeds if branches else DRAWS.speeds[: 3 if repeats else 4]
    levels, count = rng.permutation(speeds) * rng.uniform(0.85, 1.1), len(speeds)
    again = [int(np.argmax(levels))] * repeats
    if repeats and not branches:
        again = [int(np.argmax(levels)) if rng.random() < 0.5 else int(rng.integers(count))]
    seed, even = int(rng.integers(2**31)), (DRAWS.tree_seconds,) * count
    return MotionPlan(
        seed=seed,
        shapes=(*range(count), *again),
        levels=tuple(levels.tolist()),
        seconds=even if branches else tuple(rng.uniform(*DRAWS.seconds, count).round(2).tolist()),
        pauses=(0.0, *rng.uniform(*DRAWS.pauses, count if branches else 3).round(2).tolist()),
        moving=tuple(range(n)),
    )
