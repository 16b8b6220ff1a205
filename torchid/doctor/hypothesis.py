"""What a log may mean: which column is which joint, of which sign and size, under which gravity."""

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from torchid.doctor.cone import OWN, Columns, Fit, Normal, Unknowns, Weights, cone, fit, shares
from torchid.doctor.repair import Map
from torchid.doctor.samples import BLOCKS, LOOPS, MOVING, Samples, direction_of
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.regressor import regressor
from torchid.robot.model import Robot
from torchid.statistics.jackknife import from_left_out

FEWEST = 5
"""Rows that a joint must have in a block of time to be judged there."""


Rows = np.ndarray | slice
"""Of a block of time."""


@dataclass(frozen=True)
class Hypothesis:
    """What the joints of the robot are of a log.

    Attributes:
        q, tau: of the log's columns of motion and of torque.
        gravity: (3,) in the base frame [m/s^2].
        late: by how much the torque is late [s].
    """

    q: Map
    tau: Map
    gravity: tuple[float, ...]
    late: float = 0.0

    @property
    def moved(self) -> tuple[Map, tuple[float, ...]]:
        """What the rigid body's columns depend on."""
        return self.q, self.gravity

    @classmethod
    def literal(cls, robot: Robot) -> "Hypothesis":
        """The log and the robot's gravity at their word."""
        return cls(Map.of(robot.n), Map.of(robot.n), tuple(robot.gravity.tolist()))

    def scaled(self, joints: Sequence[int], *, q: float = 1.0, tau: float = 1.0) -> "Hypothesis":
        """With the factors of some joints multiplied."""
        n = len(self.q.order)
        return replace(
            self,
            q=self.q.then(factors_of(joints, n, q)),
            tau=self.tau.then(factors_of(joints, n, tau)),
        )


def factors_of(joints: Sequence[int], n: int, factor: float) -> Map:
    """Some of n joints times a factor."""
    return Map.of(n, factors=[factor if k in joints else 1.0 for k in range(n)])


@dataclass(frozen=True)
class Score:
    """How well bodies explain the torque under a hypothesis.

    Attributes:
        hypothesis: which.
        fit: on all rows.
        errors: (n,) in sample, as shares of the torque's spread.
    """

    hypothesis: Hypothesis
    fit: Fit
    errors: np.ndarray

    @property
    def loss(self) -> float:
        """Mean logarithm of the errors times n: minus the log-likelihood of a row."""
        return float(np.log(self.errors).sum())


class Judge:
    """Fits hypotheses about one log; keeps what several of them share.

    Args:
        robot: whose bodies are fitted.
        samples: of the log.
        springs: whether a joint may have a spring, too: what looks like a joint's gravity.
        loops: whether dry friction may build up over a distance, too, after each reversal: what
            looks like a delay of the torque.
    """

    def __init__(
        self, robot: Robot, samples: Samples, *, springs: bool = False, loops: bool = False
    ):
        self.robot = robot
        self.samples = samples
        self.springs = springs
        self.loops = loops
        self.cone = cone(robot, OWN + springs + loops * len(LOOPS))
        self._used: Unknowns = ()
        self._scores: dict[tuple, Score] = {}
        self._columns: dict[tuple, Columns] = {}
        self._expected: dict[tuple, Hypothesis] = {}
        self._rigid: dict[tuple, torch.Tensor] = {}
        self._torques: dict[float, np.ndarray] = {}
        ends = np.searchsorted(samples.block.numpy(), np.arange(BLOCKS + 1)).tolist()
        self.members = [slice(*pair) for pair in itertools.pairwise(ends)]

    @cached_property
    def looped(self) -> "Judge":
        """One beside which lags are judged: with loops over position of each joint's own."""
        return Judge(self.robot, self.samples, springs=self.springs, loops=True)

    def score(self, hypothesis: Hypothesis, weights: Weights = None) -> Score:
        """The fit on all rows; with given weights of a fit that was made, three times faster."""
        key = hypothesis, None if weights is None else tuple(weights.tolist())
        if key not in self._scores:
            normal = self.normal(hypothesis)
            fitted = self.fit(normal, weights)
            self._scores[key] = Score(hypothesis, fitted, shares(fitted.variance, normal.spread))
        return self._scores[key]

    def lower_bound(self, hypothesis: Hypothesis) -> float:
        """A loss that no bodies go below, in a tenth of the time of their fit: what each joint by
        itself leaves, whose parameters may be anything."""
        normal = self.normal(hypothesis)
        variance = self.columns(hypothesis).least(normal)
        return float(np.log(shares(variance, normal.spread)).sum())

    def fit(self, normal: Normal, weights: Weights = None) -> Fit:
        """The best bodies for some rows, sought from those that the last rows had."""
        fitted = fit(normal, self.cone, weights, self._used)
        self._used = fitted.used
        return fitted

    def held_out(self, hypothesis: Hypothesis) -> np.ndarray:
        """(B, n) errors of each block under the fit to the others, as shares of the spread; NaN
        where a joint does not move."""
        normal, rows = self.normal(hypothesis, self.members), []
        for b in range(BLOCKS):
            fitted = self.fit(normal.without(b))
            error = shares(normal.mean_square(fitted.x)[b], normal.spread)
            rows.append(np.where(normal.count[b] >= FEWEST, error, np.nan))
        return np.stack(rows)

    def normal(self, hypothesis: Hypothesis, members: Sequence[Rows] | None = None) -> Normal:
        """Normal equations of the rows under a hypothesis, in blocks that have all of them; None:
        in one, whose products are kept."""
        columns = self.columns(hypothesis)
        a = columns.rows
        gram = columns.gram[None] if members is None else _products(a, members)
        members = [slice(None)] if members is None else members
        moving = self.moving(hypothesis)
        tau = self.torque(hypothesis) * moving
        cross = [(tau[m].T[:, None] @ a[:, m])[:, 0] for m in members]
        square = [(tau[m] ** 2).sum(0) for m in members]
        counts = np.stack([moving[m].sum(0) for m in members])
        rows = np.maximum(counts.sum(0), 1)
        spread = (tau**2).sum(0) / rows - (tau.sum(0) / rows) ** 2
        dead = (spread < 1e-12 * max(1e-300, spread.max())) | (rows < FEWEST * BLOCKS)
        spread[dead] = 0.0
        return Normal(gram, np.stack(cross), np.stack(square), counts, spread)

    def torque(self, hypothesis: Hypothesis) -> np.ndarray:
        """(T, n) torque of the robot's joints."""
        late = hypothesis.late
        if late not in self._torques:
            self._torques[late] = self.samples.torque(late).numpy()
        return hypothesis.tau.of_columns(torch.from_numpy(self._torques[late])).numpy()

    def live(self, hypothesis: Hypothesis) -> list[int]:
        """Joints, from 0, that move enough to be judged and have a torque that varies."""
        return np.flatnonzero(self.normal(hypothesis).spread > 0).tolist()

    def moving(self, hypothesis: Hypothesis) -> np.ndarray:
        """(T, n) whether each joint of the robot moves."""
        moving = self.samples.moving[:, list(hypothesis.q.order)].numpy()
        coupled = [k for k, _, _ in hypothesis.q.coupled]
        if coupled:
            moving[:, coupled] = self.motion(hypothesis)[:, coupled, 3].abs().numpy() > MOVING
        return moving

    def columns(self, hypothesis: Hypothesis) -> Columns:
        """Columns of the joints' rows under a hypothesis, kept for the last few."""
        key = hypothesis.moved
        if key not in self._columns:
            if len(self._columns) > 6:
                del self._columns[next(iter(self._columns))]
            rigid, own = (f(hypothesis).numpy() for f in (self._regressor, self.own))
            count, n, links = rigid.shape
            each = own.shape[-1]
            a = np.zeros((n, count, links + each * n))
            for i in range(n):
                a[i, :, :links] = rigid[:, i]
                a[i, :, links + each * i : links + each * (i + 1)] = own[:, i]
            a *= self.moving(hypothesis).T[..., None]
            self._columns[key] = Columns(a)
        return self._columns[key]

    def expect(self, hypotheses: Iterable[Hypothesis]) -> None:
        """These are scored next: their regressors are evaluated together."""
        self._expected, self._rigid = {h.moved: h for h in hypotheses}, {}

    def _regressor(self, hypothesis: Hypothesis) -> torch.Tensor:
        """(T, n, 10 n) regressor, and those of hypotheses under the same gravity that follow."""
        if hypothesis.moved not in self._rigid:
            gravity, count = hypothesis.gravity, len(self.samples.motion)
            some = {hypothesis.moved: hypothesis}
            some |= {k: h for k, h in self._expected.items() if h.gravity == gravity}
            # 4000: rows whose regressors are evaluated at a time: of fewer the calls take longer
            # than the work
            some = dict(itertools.islice(some.items(), max(1, 4000 // count)))
            self._expected = {k: h for k, h in self._expected.items() if k not in some}
            robot = replace(self.robot, gravity=torch.tensor(gravity, dtype=torch.float64))
            motion = torch.cat([self.motion(h) for h in some.values()])
            parts = regressor(robot, *motion[..., :3].unbind(-1)).split(count)
            self._rigid |= zip(some, parts, strict=True)
        return self._rigid.pop(hypothesis.moved)

    def own(self, hypothesis: Hypothesis) -> torch.Tensor:
        """(T, n, OWN) what is each joint's own: dq, direction of motion, ddq, one; with springs q
        before the last, with loops those over position."""
        q, dq, ddq, sign, *loops = self.motion(hypothesis).unbind(-1)
        some = [q] * self.springs + loops * self.loops
        return torch.stack([dq, sign, ddq, *some, torch.ones_like(dq)], -1)

    def nominal(self, hypothesis: Hypothesis, gravity: torch.Tensor | None = None) -> torch.Tensor:
        """(T, n) torque of the robot's own parameters, under the hypothesis's gravity or this."""
        if gravity is None:
            gravity = torch.tensor(hypothesis.gravity, dtype=torch.float64)
        q, dq, ddq = self.motion(hypothesis)[..., :3].unbind(-1)
        return inverse_dynamics(replace(self.robot, gravity=gravity), q, dq, ddq)

    def motion(self, hypothesis: Hypothesis) -> torch.Tensor:
        """(T, n, 4 + K) q, dq, ddq, direction and loops of the robot's joints."""
        columns, q = self.samples.motion, hypothesis.q
        places = q.of_columns(columns[..., 0], places=True)
        rates = (q.of_columns(columns[..., k]) for k in (1, 2))
        sign = torch.tensor(q.factors, dtype=torch.float64).sign()
        dry = columns[:, list(q.order), 3:] * sign[:, None]
        motion = torch.cat([torch.stack([places, *rates], -1), dry], -1)
        for k, _, _ in q.coupled:
            motion[:, k, 3] = direction_of(motion[:, k, 1], dim=0)
        return motion


def _products(a: np.ndarray, members: Sequence[Rows]) -> np.ndarray:
    """(B, n, P, P) products of the columns (n, T, P), a block of rows apart."""
    out = np.empty((len(members), len(a), *2 * a.shape[-1:]))
    for own, m in zip(out, members, strict=True):
        x = a[:, m]
        np.matmul(x.transpose(0, 2, 1), x, out=own)
    return out


Family = Callable[[float], Hypothesis]


@dataclass(frozen=True)
class Profile:
    """A number and what is known of it.

    Attributes:
        value: where the loss is lowest.
        low, high: 95 %, from leaving out one block of time after the other; infinite where they
            were not asked.
        gain: by how much the loss is lower than at the starting value.
        own: (n, 3) value, low and high that each joint's torque has by itself, within two steps;
            NaN of one that tells nothing; None where no interval was asked.
    """

    value: float
    low: float
    high: float
    gain: float
    own: np.ndarray | None = None


def profile(
    judge: Judge,
    family: Family,
    grid: Sequence[float],
    start: float,
    step: float,
    least: float = -math.inf,
) -> Profile:
    """Minimise the loss over one number: on a grid, then by parabolas, then by the jackknife.

    Args:
        judge: of the log.
        family: the hypothesis for each value.
        grid: first values tried; `start` is one more.
        start: the value that would be fine.
        step: distance of the values that a parabola goes through.
        least: gain up to which no interval is asked, and none is worked out.
    """

    def loss(x: float) -> float:
        return judge.score(family(x)).loss

    best = minimum(loss, (*grid, start), step)
    gain = loss(start) - loss(best)
    if gain <= least:
        return Profile(best, -math.inf, math.inf, gain)
    values = (best - step, best, best + step)
    normals = [judge.normal(family(x), judge.members) for x in values]
    weights = judge.fit(normals[1]).weights
    errors = [[judge.score(family(x)).errors for x in values]]
    for b in range(BLOCKS):
        others = [normal.without(b) for normal in normals]
        errors.append([shares(judge.fit(x, weights).variance, x.spread) for x in others])
    # Of all joints together, then of each one: as it is, and a block left out.
    logs = np.log(np.array(errors)).transpose(0, 2, 1)
    logs = np.concatenate([logs.sum(1, keepdims=True), logs], 1)
    each = torch.tensor([[_vertex(values, x.tolist()) for x in own] for own in logs]).double()
    each[0, 0] = best
    ends = from_left_out(each[1:]).interval(each[0])
    low, high = ends[0].tolist()
    own = torch.cat([each[0, 1:, None], ends[1:]], 1).numpy()
    own[logs[0, 1:] @ [1, -2, 1] <= 0] = np.nan
    return Profile(best, low, high, gain, own)


def minimum(
    loss: Callable[[float], float],
    grid: Sequence[float],
    step: float,
    bound: Callable[[float], float] = lambda x: -np.inf,
) -> float:
    """The lowest point of a grid, refined by three parabolas through points `step` apart; `bound`
    is what the loss does not go below."""
    bounds, at = {x: bound(x) for x in grid}, dict[float, float]()
    for x in sorted(grid, key=lambda x: bounds[x]):
        if bounds[x] < min(at.values(), default=np.inf):
            at[x] = loss(x)
    best = min(at, key=lambda x: at[x])
    for _ in range(3):
        values = (best - step, best, best + step)
        at |= {x: loss(x) for x in values if x not in at}
        best = _vertex(values, [at[x] for x in values])
    at[best] = loss(best)
    return min(at, key=lambda x: at[x])


def lowest(values: Sequence[float], losses: Sequence[float]) -> float:
    """The lowest point of the parabola around the lowest of some values, as far apart as others."""
    k = min(max(int(np.argmin(losses)), 1), len(values) - 2)
    return _vertex(values[k - 1 : k + 2], losses[k - 1 : k + 2])


def _vertex(values: Sequence[float], losses: Sequence[float]) -> float:
    """The lowest point of the parabola through three points, at most two steps away."""
    a, b, c = losses
    step = values[2] - values[1]
    curve = a - 2 * b + c
    if curve <= 0:
        return values[int(np.argmin(losses))]
    return float(values[1] + np.clip(0.5 * (a - c) / curve, -2.0, 2.0) * step)
