"""Faults that torque tells: what each is called, and the moves from one hypothesis to the next that
would mend it."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from torchid.doctor.hypothesis import Hypothesis, Judge, factors_of, minimum
from torchid.doctor.repair import MOTION, PLACES, TORQUE, Map, MappedColumns, Repair, ShiftTorque
from torchid.dynamics.regressor import regressor
from torchid.robot.model import JointType, Robot
from torchid.statistics.criteria import EXPLAINED, LEAST_GAIN, TOLD

LAGS = (-0.2, -0.1, -0.05, -0.025, 0.025, 0.05, 0.1, 0.2)
"""How late torque may be [s]; what lies between is found afterwards."""
TENTH = -math.log(10.0)
GAINS = tuple(-TENTH * x for x in (-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0))
"""Logarithms of the factors tried first."""
DEGREE = math.pi / 180.0
ZEROS = (math.pi / 2, -math.pi / 2, math.pi)
"""Zeros that conventions differ by [rad]."""
SCALES = tuple(0.25 * k for k in range(-14, 15))
"""Logarithms of the factors tried first for the positions of all joints."""
_TURNS = (2.0 * math.pi, DEGREE, 1.0 / DEGREE)


@dataclass(frozen=True)
class Move:
    """A fault as the change of a hypothesis that mends it.

    Attributes:
        kind: of `FAULTS`.
        joints: from 0, those whose columns change.
        before: the hypothesis without it.
        q, tau, gravity, late: what changes.
        signals: that the log has.
    """

    kind: str
    joints: tuple[int, ...]
    before: Hypothesis
    q: Map | None = None
    tau: Map | None = None
    gravity: tuple[float, ...] | None = None
    late: float = 0.0
    signals: tuple[str, ...] = ()

    @cached_property
    def after(self) -> Hypothesis:
        """The hypothesis with it mended."""
        before = self.before
        return Hypothesis(
            before.q.then(self.q) if self.q else before.q,
            before.tau.then(self.tau) if self.tau else before.tau,
            self.gravity or before.gravity,
            before.late + self.late,
        )

    @cached_property
    def columns(self) -> tuple[MappedColumns, ...]:
        """Columns of the log that change."""
        moved = PLACES if self.q and self.q.shifts_only else MOTION
        every = (moved, self.q), (TORQUE, self.tau)
        return tuple(
            MappedColumns(tuple(s for s in names if s in self.signals), change)
            for names, change in every
            if change
        )

    @property
    def repairs(self) -> tuple[Repair, ...]:
        """The fault's mending as changes of the log; none for gravity, which is the robot's."""
        return (*self.columns, *([ShiftTorque(self.late)] if self.late else []))

    @property
    def name(self) -> str:
        """By which it can be chosen: `torque sign 2`, `joint order 2,1,3`, `gravity +z`."""
        if self.gravity:
            axis = int(np.argmax(np.abs(self.gravity)))
            return f"gravity {'-' if self.gravity[axis] < 0 else '+'}{'xyz'[axis]}"
        if self.kind == "zero":
            angle = sum(c.map.offsets[self.joints[0]] for c in self.columns)
            return f"zero {self.joints[0] + 1} {math.degrees(angle):+.0f} deg"
        if self.kind == "coupling":
            return f"coupling {', '.join(sorted(self._sums))}"
        order = self.columns[0].map.order if "order" in self.kind else self.joints
        return " ".join(filter(None, (self.kind, ",".join(str(k + 1) for k in order))))

    @property
    def _sums(self) -> Iterator[str]:
        """`q3-q2` of positions, `tau2+tau3` of torques."""
        for name, change in (("q", self.q), ("tau", self.tau)):
            for k, j, c in change.coupled if change else ():
                yield f"{name}{k + 1}{'-' if c < 0 else '+'}{name}{j + 1}"

    @property
    def changes(self) -> int:
        """How many of the log's signals change sign, scale or order."""
        return sum(len(c.signals) for c in self.columns)


@dataclass(frozen=True)
class TorqueFault:
    """A kind of fault that torque tells.

    Attributes:
        check: that says it; None where an estimate with an interval does.
        words: what it is called, before the joints that have it.
        moves: what would mend it, from a hypothesis.
        modelled: whether nominal parameters bear it out, or not.
        hides: whether a log is asked if it would show.
    """

    check: str | None
    words: str
    moves: Callable[[Judge, Hypothesis], Iterable[Move]]
    modelled: bool = False
    hides: bool = False


def all_moves(judge: Judge, now: Hypothesis) -> Iterator[Move]:
    """All moves from a hypothesis, with the signals that the log has."""
    for fault in FAULTS.values():
        for move in fault.moves(judge, now):
            yield replace(move, signals=tuple(judge.samples.log.signals))


def joint_sign(judge: Judge, now: Hypothesis, joints: Sequence[int]) -> Move:
    """The axes of some joints turned around: positions and torques negated."""
    move = _scaled("joint sign", now, joints, q=-1.0, tau=-1.0)
    return replace(move, signals=tuple(judge.samples.log.signals))


def _scaled(
    kind: str, now: Hypothesis, joints: Sequence[int], q: float = 1.0, tau: float = 1.0
) -> Move:
    n = len(now.q.order)
    positions, torques = (None if x == 1.0 else factors_of(joints, n, x) for x in (q, tau))
    return Move(kind, tuple(joints), now, positions, torques)


def _signs(judge: Judge, now: Hypothesis, kind: str, q: float, tau: float) -> Iterator[Move]:
    """Moves that turn the sign of each joint by itself, and of all of them."""
    live = judge.live(now)
    for joints in [[k] for k in live] + [list(range(judge.robot.n))] * (len(live) > 1):
        yield _scaled(kind, now, joints, q=q, tau=tau)


def _orders(judge: Judge, now: Hypothesis, kind: str, q: bool, tau: bool) -> Iterator[Move]:
    """Two joints exchanged, all of them reversed or one on; of torque also as it fits best."""
    n, live = judge.robot.n, judge.live(now)
    orders = []
    for i, j in itertools.combinations(live, 2):
        exchanged = {i: j, j: i}
        orders.append(tuple(exchanged.get(k, k) for k in range(n)))
    if len(live) == n > 2:
        orders += [tuple(reversed(range(n)))] * (n > 3)
        orders += [tuple(np.roll(range(n), shift).tolist()) for shift in (1, -1)]
        orders += [] if q else [_assigned(judge, now)]
    for order in orders:
        change = Map.of(n, order=order)
        joints = tuple(k for k, j in enumerate(order) if k != j)
        if joints:
            yield Move(kind, joints, now, change if q else None, change if tau else None)


def _assigned(judge: Judge, now: Hypothesis) -> tuple[int, ...]:
    """The order of the torque columns that single joints' rows, each by itself, explain best."""
    a = judge.columns(now).rows
    tau, moving, n = judge.torque(now), judge.moving(now), judge.robot.n
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
    return tuple(linear_sum_assignment(np.log(np.maximum(errors, 1e-3)))[1].tolist())


def _gravities(judge: Judge, now: Hypothesis) -> Iterator[Move]:
    """Along each axis of the base."""
    size = float(np.linalg.norm(now.gravity))
    for axis, sign in itertools.product(range(3), (1.0, -1.0)):
        other = np.zeros(3)
        other[axis] = sign * size
        if size and np.array(now.gravity) @ other < 0.99 * size**2:
            yield Move("gravity", (), now, gravity=tuple(other.tolist()))


def _gains(judge: Judge, now: Hypothesis) -> Iterator[Move]:
    """Each joint's torque at the size at which the joints' torques fit together best; none of a
    torque that bodies explain at no size."""
    live = judge.live(now)
    if len(live) < 2:
        return
    weights = judge.score(now).fit.weights
    for k in live:

        def loss(log_factor: float, k: int = k) -> float:
            return judge.score(now.scaled((k,), tau=math.exp(log_factor)), weights).loss

        if min(GAINS, key=loss) == 0.0:
            continue
        best = minimum(loss, GAINS, step=0.3)
        there = judge.score(now.scaled((k,), tau=math.exp(best)), weights)
        if abs(best) > math.log(LEAST_GAIN) and there.errors[k] < TOLD:
            yield _scaled("gain", now, (k,), tau=math.exp(best))


def _lags(judge: Judge, now: Hypothesis) -> Iterator[Move]:
    for late in LAGS if now.late == 0.0 else ():
        if abs(late) < judge.samples.reach:
            yield Move("lag", (), now, late=late)


def _turning(judge: Judge) -> list[int]:
    return [k for k, kind in enumerate(judge.robot.joint_types) if kind is JointType.REVOLUTE]


def _badly(judge: Judge, now: Hypothesis) -> bool:
    """Whether bodies explain the torque so badly that the positions themselves are doubted: their
    scale in all joints, and the zero of each."""
    return judge.score(now).errors[judge.live(now)].max(initial=0.0) > EXPLAINED


def _units(judge: Judge, now: Hypothesis) -> Iterator[Move]:
    """Positions of all joints in degrees, or at the scale at which the torque is explained best:
    turns, or those of motors before their gears."""
    turning = _turning(judge)
    if not turning:
        return
    yield _scaled("position unit", now, turning, q=DEGREE)
    if not _badly(judge, now):
        return
    weights = judge.score(now).fit.weights

    def loss(log_factor: float) -> float:
        return judge.score(now.scaled(turning, q=math.exp(log_factor)), weights).loss

    def bound(log_factor: float) -> float:
        return judge.lower_bound(now.scaled(turning, q=math.exp(log_factor)))

    judge.expect(now.scaled(turning, q=math.exp(x)) for x in SCALES)
    best = minimum(loss, SCALES, 0.05, bound)
    if abs(best) > math.log(LEAST_GAIN):
        # 0.05: logarithm of the factor by which a unit may be missed
        named = (x for x in _TURNS if abs(math.log(x) - best) < 0.05)
        yield _scaled("position unit", now, turning, q=next(named, math.exp(best)))


def _zeros(judge: Judge, now: Hypothesis) -> Iterator[Move]:
    joints = sorted({*judge.live(now)} & {*_turning(judge)}) if _badly(judge, now) else []
    for k, angle in itertools.product(joints, ZEROS):
        offsets = [angle * (j == k) for j in range(judge.robot.n)]
        yield Move("zero", (k,), now, Map.of(judge.robot.n, offsets=offsets))


def _couplings(judge: Judge, now: Hypothesis) -> Iterator[Move]:
    """Positions that are sums or differences of two parallel axes' (a parallelogram, a belt, an
    angle to the ground), torques that are, or both as one power has it."""
    n, live = judge.robot.n, judge.live(now)
    for j, k in parallel_pairs(judge.robot) if _badly(judge, now) else ():
        for sign in (1.0, -1.0) if {j, k} <= set(live) else ():
            angle = replace(Map.of(n), coupled=((k, j, -sign),))
            torque = replace(Map.of(n), coupled=((j, k, sign),))
            yield Move("coupling", (k,), now, q=angle)
            yield Move("coupling", (j,), now, tau=torque)
            yield Move("coupling", (j, k), now, q=angle, tau=torque)


def _sign(kind: str, check: str, words: str, q: float, tau: float) -> TorqueFault:
    moves = partial(_signs, kind=kind, q=q, tau=tau)
    return TorqueFault(check, f"{words} the wrong sign in", moves, modelled=True, hides=True)


def _order(kind: str, words: str, *, q: bool, tau: bool) -> TorqueFault:
    moves = partial(_orders, kind=kind, q=q, tau=tau)
    return TorqueFault("joint order", words, moves, modelled=True, hides=True)


FAULTS = {
    "torque sign": _sign("torque sign", "torque sign", "torque has", 1.0, -1.0),
    "position sign": _sign("position sign", "position sign", "position has", -1.0, 1.0),
    "joint sign": _sign("joint sign", "position sign", "position and torque have", -1.0, -1.0),
    "joint order": _order("joint order", "joints numbered otherwise:", q=True, tau=True),
    "torque order": _order("torque order", "torque columns exchanged among", q=False, tau=True),
    "position order": _order(
        "position order", "position columns exchanged among", q=True, tau=False
    ),
    "gravity": TorqueFault(None, "another direction of gravity", _gravities),
    "gain": TorqueFault(
        "gain of a joint", "torque of another size in", _gains, modelled=True, hides=True
    ),
    "lag": TorqueFault(None, "torque late or early", _lags),
    "position unit": TorqueFault(
        "position unit, by torque", "positions in another unit, or on the motors' side, in", _units
    ),
    "zero": TorqueFault("zero of positions", "another zero in", _zeros, modelled=True),
    "coupling": TorqueFault(
        "coupling of joints",
        "the column is a sum or difference of two joints' in",
        _couplings,
        modelled=True,
    ),
}
"""By what their moves call themselves."""


def parallel_pairs(robot: Robot) -> list[tuple[int, int]]:
    """Pairs of joints, from 0, both ways around, whose axes are parallel in every posture: each
    turns, and so does every joint between them, about one direction."""
    groups: list[set[int]] = []
    for joint in range(robot.n):
        link = robot.own_links[joint]
        parent = robot.parents[link]
        axis = robot.before[link, :3, 2]
        near = next((g for g in groups if any(robot.own_links[k] == parent for k in g)), None)
        turns = robot.joint_types[joint] is JointType.REVOLUTE
        # 1 - 1e-6: cosine of the angle between axes from which they are parallel
        if near and turns and abs(float(axis @ robot.after[parent, 2, :3])) > (1 - 1e-6):
            near.add(joint)
        elif turns:
            groups.append({joint})
    return [pair for g in groups for pair in itertools.permutations(sorted(g), 2)]


Group = frozenset[int]
"""Joints, from 0, whose axes are turned around together."""


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
    # 24: states, more than a robot's torques have unknowns a joint
    motion = torch.randn(3, 24, n, generator=generator, dtype=torch.float64)
    bodies = torch.randn(10 * n, generator=generator, dtype=torch.float64)
    tau = regressor(robot, *motion) @ bodies
    # 8: joints up to which every pattern is tried; of more, those of one, two and all of them
    sizes = range(1, n + 1) if n <= 8 else (1, 2, n)
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
    # 1e-8: rounding
    return bool(np.linalg.norm(left) < 1e-8 * np.linalg.norm(target))


def least_groups(groups: tuple[Group, ...]) -> list[Group]:
    """The groups of joints that hold no other group."""
    return [g for g in groups if not any(other < g for other in groups)]


def alternatives(turned: Group, groups: tuple[Group, ...]) -> list[Group]:
    """All groups that explain a log as well as this one, smallest first; axes that may point either
    way by themselves are left as they are."""
    alone = frozenset().union(*(g for g in groups if len(g) == 1))
    others = {turned - alone, *((turned ^ g) - alone for g in groups)}
    return sorted(others, key=lambda g: (len(g), sorted(g)))
