"""Single faults a log may have, as moves from one hypothesis to the next."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from torchid.doctor.hypothesis import Hypothesis, Judge, minimum
from torchid.doctor.repair import (
    MOTION,
    PLACES,
    TORQUE,
    Reorder,
    Repair,
    Scale,
    Shift,
    ShiftTorque,
    of_signals,
)
from torchid.dynamics.regressor import regressor
from torchid.robot.model import JointType, Robot

LAGS = (-0.2, -0.1, -0.05, -0.025, 0.025, 0.05, 0.1, 0.2)
"""How late torque may be [s]; what lies between is found afterwards."""
GAINS = tuple(math.log(10.0) * x for x in (-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0))
"""Logarithms of the factors tried first."""
DEGREE = math.pi / 180.0
BADLY = 0.2
"""Share of a torque's spread that bodies leave, from which on the positions themselves are doubted:
their scale in all joints, and the zero of each."""
ZEROS = (math.pi / 2, -math.pi / 2, math.pi)
"""Zeros that conventions differ by [rad]."""
SCALES = tuple(0.25 * k for k in range(-14, 15))
"""Logarithms of the factors tried first for the positions of all joints."""
_TURNS = (2.0 * math.pi, DEGREE, 1.0 / DEGREE)
_NEAR_UNIT = 0.05
LEAST_GAIN = 1.5
"""A joint's torque that is off by less is within what a gear or a drive gain may be."""


@dataclass(frozen=True)
class Move:
    """A fault and the hypothesis that has it mended.

    Attributes:
        kind: torque sign, position sign, joint sign, torque order, position order, joint order,
            gravity, position unit, zero, gain, lag.
        joints: from 0, those whose columns change.
        after: the hypothesis.
        repairs: the same as changes of the log; none for gravity, which is the robot's.
    """

    kind: str
    joints: tuple[int, ...]
    after: Hypothesis
    repairs: tuple[Repair, ...] = ()

    @property
    def name(self) -> str:
        """By which it can be chosen: `torque sign 2`, `joint order 2,1,3`, `gravity +z`."""
        if self.kind == "gravity":
            axis = int(np.argmax(np.abs(self.after.gravity)))
            return f"gravity {'-' if self.after.gravity[axis] < 0 else '+'}{'xyz'[axis]}"
        if self.kind == "zero":
            angle = next(x for r in self.repairs if isinstance(r, Shift) for x in r.offsets if x)
            return f"zero {self.joints[0] + 1} {math.degrees(angle):+.0f} deg"
        order = next((r.order for r in self.repairs if isinstance(r, Reorder)), self.joints)
        return " ".join(filter(None, (self.kind, ",".join(str(k + 1) for k in order))))

    @property
    def signals(self) -> int:
        """How many of the log's signals change sign, scale or order."""
        return sum(len(r.signals) for r in self.repairs if isinstance(r, Scale | Shift | Reorder))


def all_moves(judge: Judge, now: Hypothesis) -> Iterator[Move]:
    """All moves from a hypothesis, with repairs of the signals that the log has."""
    for move in _moves(judge, now):
        yield _of_its_signals(judge, move)


def joint_sign(judge: Judge, now: Hypothesis, joints: Sequence[int]) -> Move:
    """The axes of some joints turned around: positions and torques negated."""
    return _of_its_signals(judge, _scaled("joint sign", joints, now, q=-1.0, tau=-1.0))


def _of_its_signals(judge: Judge, move: Move) -> Move:
    repairs = (of_signals(r, judge.samples.signals) for r in move.repairs)
    return replace(move, repairs=tuple(repairs))


def _moves(judge: Judge, now: Hypothesis) -> Iterator[Move]:
    live = judge.live(now)
    everyone = tuple(range(len(now.q_order)))
    for joints in [(k,) for k in live] + [everyone] * (len(live) > 1):
        yield _scaled("torque sign", joints, now, tau=-1.0)
        yield _scaled("position sign", joints, now, q=-1.0)
        yield _scaled("joint sign", joints, now, q=-1.0, tau=-1.0)
    yield from _orders(now, live)
    if len(live) == judge.robot.n:
        yield from _assigned(judge, now)
    yield from _gravities(now)
    yield from _gains(judge, now, live)
    for late in LAGS if now.late == 0.0 else ():
        if abs(late) < judge.samples.reach:
            yield Move("lag", (), replace(now, late=late), (ShiftTorque(late),))
    turning = [k for k, kind in enumerate(judge.robot.joint_types) if kind is JointType.REVOLUTE]
    if turning:
        yield _scaled("position unit", turning, now, q=DEGREE)
    base = judge.score(now)
    if base.errors[live].max(initial=0.0) > BADLY:
        yield from _units(judge, now, turning, base.fit.weights)
        for k, angle in itertools.product(sorted({*live} & {*turning}), ZEROS):
            offsets = tuple(angle * (j == k) for j in range(judge.robot.n))
            yield Move("zero", (k,), now.shifted(k, angle), (Shift(PLACES, offsets),))


def _units(
    judge: Judge, now: Hypothesis, turning: Sequence[int], weights: np.ndarray
) -> Iterator[Move]:
    """Positions of all joints at the scale at which the torque is explained best: turns, or those
    of motors before their gears."""
    if not turning:
        return

    def loss(log_factor: float) -> float:
        return judge.score(now.scaled(turning, q=math.exp(log_factor)), weights).loss

    judge.expect(now.scaled(turning, q=math.exp(x)) for x in SCALES)
    best = minimum(loss, SCALES, step=0.05)
    if abs(best) > math.log(LEAST_GAIN):
        named = (x for x in _TURNS if abs(math.log(x) - best) < _NEAR_UNIT)
        yield _scaled("position unit", turning, now, q=next(named, math.exp(best)))


def _scaled(
    kind: str,
    joints: Sequence[int],
    now: Hypothesis,
    *,
    q: float | None = None,
    tau: float | None = None,
) -> Move:
    repairs = [
        Scale(signals, tuple(f if k in joints else 1.0 for k in range(len(now.q_order))))
        for signals, f in ((MOTION, q), (TORQUE, tau))
        if f is not None
    ]
    return Move(kind, tuple(joints), now.scaled(joints, q=q, tau=tau), tuple(repairs))


def _orders(now: Hypothesis, live: Sequence[int]) -> Iterator[Move]:
    n = len(now.q_order)
    orders: list[tuple[int, ...]] = []
    for i, j in itertools.combinations(live, 2):
        exchanged = {i: j, j: i}
        orders.append(tuple(exchanged.get(k, k) for k in range(n)))
    if n > 3 and len(live) == n:
        orders.append(tuple(reversed(range(n))))
    if n > 2 and len(live) == n:
        orders += [tuple(np.roll(range(n), shift).tolist()) for shift in (1, -1)]
    for order in orders:
        yield _order(now, order, q=False, tau=True)
        yield _order(now, order, q=True, tau=False)
        yield _order(now, order, q=True, tau=True)


def _order(now: Hypothesis, order: tuple[int, ...], *, q: bool, tau: bool) -> Move:
    kind = "joint order" if q and tau else ("position order" if q else "torque order")
    joints = tuple(k for k, j in enumerate(order) if k != j)
    repairs = [Reorder(s, order) for s, moved in ((MOTION, q), (TORQUE, tau)) if moved]
    return Move(kind, joints, now.reordered(order, q=q, tau=tau), tuple(repairs))


def _assigned(judge: Judge, now: Hypothesis) -> Iterator[Move]:
    """The order of the torque columns that single joints' rows, each by itself, explain best."""
    a, _ = judge.columns(now)
    tau = judge.torque(now)
    moving = judge.moving(now)
    n = judge.robot.n
    if n < 3:
        return
    scale = np.where(tau.std(0) > 0, tau.std(0), 1.0)
    errors = np.ones((n, n))
    for i in range(n):
        rows = moving[:, i]
        if rows.sum() < 2 * a.shape[-1]:
            continue
        u, s, _ = np.linalg.svd(a[i, rows], full_matrices=False)
        basis = u[:, s > 1e-8 * max(s[0], 1e-300)]
        left = tau[rows] - basis @ (basis.T @ tau[rows])
        errors[i] = left.std(0) / scale
    _, order = linear_sum_assignment(np.log(np.maximum(errors, 1e-3)))
    found = tuple(int(j) for j in order)
    if found != tuple(range(n)):
        yield _order(now, found, q=False, tau=True)


def _gravities(now: Hypothesis) -> Iterator[Move]:
    size = float(np.linalg.norm(now.gravity))
    if size == 0.0:
        return
    down = np.array(now.gravity) / size
    for axis in range(3):
        for sign in (1.0, -1.0):
            other = np.zeros(3)
            other[axis] = sign
            if down @ other < 0.99:
                yield Move("gravity", (), replace(now, gravity=tuple((size * other).tolist())))


def _gains(judge: Judge, now: Hypothesis, live: Sequence[int]) -> Iterator[Move]:
    """Each joint's torque at the size at which the joints' torques fit together best."""
    if len(live) < 2:
        return
    weights = judge.score(now).fit.weights
    for k in live:

        def loss(log_factor: float, k: int = k) -> float:
            return judge.score(now.scaled((k,), tau=math.exp(log_factor)), weights).loss

        if min(GAINS, key=loss) == 0.0:
            continue
        best = minimum(loss, GAINS, step=0.3)
        if abs(best) > math.log(LEAST_GAIN):
            yield _scaled("gain", (k,), now, tau=math.exp(best))


Group = frozenset[int]
"""Joints, from 0, whose axes are turned around together."""
MOST = 8
"""Joints up to which every pattern is tried; of more, those of one, two and all of them."""
_ROWS = 24
_SAME = 1e-8


@lru_cache(maxsize=8)
def invisible_groups(robot: Robot, gravity: tuple[float, ...]) -> tuple[Group, ...]:
    """Groups of axes that mirrored bodies explain, by the geometry alone, smallest first.

    Args:
        robot: its kinematics.
        gravity: (3,) in the base frame [m/s^2].
    """
    robot = replace(robot, gravity=torch.tensor(gravity, dtype=torch.float64))
    n = robot.n
    generator = torch.Generator().manual_seed(0)
    motion = torch.randn(3, _ROWS, n, generator=generator, dtype=torch.float64)
    bodies = torch.randn(10 * n, generator=generator, dtype=torch.float64)
    tau = regressor(robot, *motion) @ bodies
    sizes = range(1, n + 1) if n <= MOST else (1, 2, n)
    tried = [frozenset(g) for size in sizes for g in itertools.combinations(range(n), size)]
    return tuple(g for g in tried if _explains(robot, motion, tau, g))


def _explains(robot: Robot, motion: torch.Tensor, tau: torch.Tensor, group: Group) -> bool:
    """Whether some bodies make the torques of these axes turned around."""
    sign = torch.ones(robot.n, dtype=torch.float64)
    sign[list(group)] = -1.0
    matrix = regressor(robot, *(x * sign for x in motion)).flatten(0, 1).numpy()
    target = (tau * sign).flatten().numpy()
    size = np.linalg.norm(matrix, axis=0)
    matrix = matrix / np.where(size > 0, size, 1.0)
    left = target - matrix @ np.linalg.lstsq(matrix, target, rcond=1e-11)[0]
    return bool(np.linalg.norm(left) < _SAME * np.linalg.norm(target))


def least_groups(groups: tuple[Group, ...]) -> list[Group]:
    """Those that hold no other one."""
    return [g for g in groups if not any(other < g for other in groups)]


def alternatives(turned: Group, groups: tuple[Group, ...]) -> list[Group]:
    """All groups that explain a log as well as this one, smallest first; axes that may point either
    way by themselves are left as they are."""
    alone = frozenset().union(*(g for g in groups if len(g) == 1))
    found = {turned - alone, *((turned ^ g) - alone for g in groups)}
    return sorted(found, key=lambda g: (len(g), sorted(g)))
