"""What a case is, drawn from a seed and its number alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from torchid.errors import TorchidError
from torchid.withheld.plant.arms import ARMS, arm_named
from torchid.withheld.plant.catalogue import (
    FOREIGN,
    KINDS,
    LIBRARY,
    REDRAWN,
    drawn_effect,
    kind_named,
)
from torchid.withheld.plant.logger import Logger
from torchid.withheld.plant.motion import MotionPlan
from torchid.withheld.plant.plan import EffectSpec

Item = TypeVar("Item")

BLOCK = (
    *["none"] * 4,
    "parameters",
    *["single"] * 7,
    *["several"] * 3,
    *["outside"] * 2,
    "poor",
    *["severity"] * 2,
)
"""Kinds of twenty cases in a row, in an order of their own."""

CASE_KINDS = tuple(dict.fromkeys(BLOCK))

RELEASE = (*["none"] * 4, *["single"] * 8, *["outside"] * 4, *["several"] * 3)
"""Kinds of nineteen cases in a row of a release, whose effects outside the library are others, and
half of whose cases without an effect have noise that is coloured or grows with speed."""

MIXES = {"mixed": BLOCK, "release": RELEASE}

LEVEL = 5.0
"""Size of an effect, in standard deviations of the torque noise."""

LEVELS = tuple(float(x) for x in np.logspace(-1, 1, 9).round(4))
"""Of the severity sweep."""

EXCLUSIVE = (
    "stribeck_friction",
    "asymmetric_friction",
    "thermal_friction_drift",
    "uneven_friction",
    "uneven_damping",
    "gear_coupling",
    "joint_elasticity",
    "backlash",
)
"""Effects that take the place of a joint's known friction or drive: one of them a joint."""

_DRAWS = 100

POOR = ("slow", "small", "few")

COLLINEAR = (
    ("viscous_friction", "power_law_friction"),
    ("viscous_friction", "coulomb_friction"),
    ("coulomb_friction", "load_dependent_friction"),
    ("coulomb_friction", "presliding_hysteresis"),
    ("torque_offset", "joint_spring"),
    ("torque_gain", "time_delay"),
    ("rotor_inertia", "viscous_friction"),
    ("torque_offset", "cogging"),
)
"""Pairs that look alike on one joint."""

_SEVERAL = tuple(name for name in LIBRARY if name not in ("filter_lag", "link_inertia"))


@dataclass(frozen=True)
class CaseSpec:
    """A case before it is simulated.

    Attributes:
        seed, number: what it was drawn from.
        kind: none, parameters, single, several, outside, poor or severity.
        arm: 3r, 6r or 7r.
        effects: to plant.
        level: wanted size of each, in standard deviations of the noise; None without effects.
        motion: of the trajectories; a poor case's effects have their size on these.
        poor: the motion of a poor case; None for others.
        excitation: `rich`, or what is poor about the motion.
        viscous, coulomb: (n,) known friction, as shares of effort / speed and of effort.
        noise_share: torque noise, as a share of each joint's torque RMS.
        bandwidth_hz, damping_ratio: of the controllers.
        logger: of the log.
    """

    seed: int
    number: int
    kind: str
    arm: str
    effects: tuple[EffectSpec, ...]
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
) -> CaseSpec:
    """A case from a seed and its number; what is given is not drawn.

    Args:
        seed: of the set.
        number: of the case, from 0.
        mix: of the set: `mixed`, or `release`.
        kind: of the case.
        effects: names of the effects to plant.
        level: their size, in standard deviations of the noise.
        arm: 3r, 6r or 7r.

    Raises:
        TorchidError: an unknown kind, effect or arm.
    """
    if kind is None and effects is not None:
        kind = ("none", "single")[len(effects)] if len(effects) < 2 else "several"
    if mix not in MIXES:
        raise TorchidError(f"unknown mix of cases '{mix}'.", available=list(MIXES))
    block, foreign = MIXES[mix], FOREIGN if mix == "mixed" else REDRAWN
    kind = kind or in_turn(seed, number, block, 101)
    if kind not in CASE_KINDS:
        raise TorchidError(f"unknown kind of case '{kind}'.", available=list(CASE_KINDS))
    rng = np.random.default_rng([seed, number, 1])
    name = arm or str(rng.choice(list(ARMS)))
    n = arm_named(name).n
    turn = turn_of(seed, number, kind, block)
    rng = np.random.default_rng([seed, number, 2])
    planted = _effects(rng, seed, turn, kind, n, effects, foreign)
    wanted = level or LEVEL if planted else None
    if planted and not level and kind == "severity":
        wanted = in_turn(seed, turn, LEVELS, 102)
    motion = _motion(np.random.default_rng([seed, number, 3]), n)
    poor, excitation = None, "rich"
    if kind == "poor":
        # A motion that tells little: slow, small, or of one or two joints.
        rng = np.random.default_rng([seed, number, 4])
        what = str(rng.choice(POOR))
        levels, reach, moving = motion.levels, 1.0, motion.moving
        if what == "slow":
            factor = float(rng.uniform(0.06, 0.12))
            levels = tuple(level * factor for level in levels)
        elif what == "small":
            reach = float(rng.uniform(0.03, 0.08))
        else:
            count = int(rng.integers(1, 3))
            moving = tuple(sorted(int(j) for j in rng.choice(n, count, replace=False)))
        poor, excitation = replace(motion, levels=levels, moving=moving, reach=reach), what
    quiet = np.random.default_rng([seed, number, 5])
    # In a release several effects stand on friction that is known.
    knows = quiet.random() < 0.7 or (mix == "release" and kind == "several")
    viscous, coulomb = (quiet.uniform(0.003, 0.02, n) * knows for _ in range(2))
    rng = np.random.default_rng([seed, number, 6])
    logger = Logger(
        rate_hz=int(rng.choice([250, 500, 1000])),
        encoder_bits=int(rng.integers(17, 21)),
        colour_hz=5.0 if rng.random() < 0.5 else None,
        jitter=float(rng.choice([0.0, 0.01, 0.03])),
        own_velocity=bool(rng.random() < 0.35),
        velocity_noise=float(rng.uniform(1e-4, 1e-3)),
        clock=float(rng.uniform(0, 1000).__round__(3)),
        seed=int(rng.integers(2**31)),
    )
    if mix == "release" and kind == "none":
        # White, white, coloured, growing with speed, in turn.
        noise = turn % 4
        grows = float(rng.uniform(1.0, 4.0)) if noise == 3 else 0.0
        logger = replace(logger, colour_hz=5.0 if noise == 2 else None, grows=grows)
    return CaseSpec(
        seed, number, kind, name, planted, wanted, motion, poor, excitation,
        tuple(viscous.tolist()), tuple(coulomb.tolist()),
        noise_share=float(quiet.uniform(0.005, 0.02)),
        bandwidth_hz=float(quiet.uniform(3.0, 8.0)),
        damping_ratio=float(quiet.uniform(0.6, 1.0)),
        logger=logger,
    )  # fmt: skip


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


def _effects(
    rng: np.random.Generator,
    seed: int,
    turn: int,
    kind: str,
    n: int,
    wanted: Sequence[str] | None,
    foreign: Sequence[str],
) -> tuple[EffectSpec, ...]:
    if wanted is not None:
        for name in wanted:
            kind_named(name)
        found = _apart(rng, wanted, n)
        if found is None:
            raise TorchidError(
                "these effects cannot be on one arm: each needs joints of its own.",
                got=list(wanted),
                hint="an arm with more joints",
            )
        return found
    if kind == "none":
        return ()
    if kind == "parameters":
        links = tuple(range(n))
        return (EffectSpec("link_inertia", links, KINDS["link_inertia"].draws(rng, n, links)),)
    if kind == "several":
        # A pair that looks alike, on one joint; or two or three, each on its own.
        if rng.random() < 0.35:
            first, second = COLLINEAR[int(rng.integers(len(COLLINEAR)))]
            one = drawn_effect(rng, first, n)
            others = tuple(j for j in range(n) if j not in one.joints)
            return one, drawn_effect(rng, second, n, avoid=others)
        count = 2 if rng.random() < 0.7 else 3
        while True:
            names = [str(x) for x in rng.choice(_SEVERAL, count, replace=False)]
            found = _apart(rng, names, n)
            if found is not None:
                return found
    if kind == "outside":
        return (drawn_effect(rng, in_turn(seed, turn, foreign, 103), n),)
    if kind == "single":
        return (drawn_effect(rng, in_turn(seed, turn, LIBRARY, 104), n),)
    return (drawn_effect(rng, str(rng.choice(LIBRARY)), n),)


def _apart(rng: np.random.Generator, names: Sequence[str], n: int) -> tuple[EffectSpec, ...] | None:
    """Effects on joints of their own, where there are enough; None where there are too few for
    effects that exclude each other."""
    for _ in range(_DRAWS):
        out: list[EffectSpec] = []
        for name in names:
            taken = tuple(j for effect in out for j in effect.joints)
            out.append(drawn_effect(rng, name, n, avoid=taken))
        alone = [j for effect in out if effect.name in EXCLUSIVE for j in effect.joints]
        if len(set(alone)) == len(alone):
            return tuple(out)
    return None


def _motion(rng: np.random.Generator, n: int) -> MotionPlan:
    """Four trajectories of 12 to 15 s at three or four levels of speed; mostly one is repeated."""
    repeats = rng.random() < 0.8
    count = 3 if repeats else 4
    levels = rng.permutation([0.85, 0.55, 0.3, 0.7][:count]) * rng.uniform(0.85, 1.1)
    shapes = list(range(count))
    if repeats:
        shapes.append(int(np.argmax(levels)) if rng.random() < 0.5 else int(rng.integers(count)))
    return MotionPlan(
        seed=int(rng.integers(2**31)),
        shapes=tuple(shapes),
        levels=tuple(levels.tolist()),
        seconds=tuple(rng.uniform(12.0, 15.0, count).round(2).tolist()),
        pauses=(0.0, *rng.uniform(2.0, 6.0, 3).round(2).tolist()),
        moving=tuple(range(n)),
    )
