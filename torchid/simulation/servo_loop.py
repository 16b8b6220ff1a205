"""Arms that position servos move: many windows of logs and many sets of servos in one batch.

Where many sets are fitted, the rigid body is linearised about the measured motion, once for all
samples; what is left to step is a few products of small matrices and arithmetic on (windows,
joints, sets). Where one set is run, the rigid body is evaluated on the way.

A step of length h solves for the mean velocity w of each joint, with the servo and the damping at
w (a theta method) and dry friction as what it is, a bounded force that holds the joint if it can:

    (J / (theta h) + kd + b + kp theta h) w = r - friction,   |friction| <= F, w = 0 if |r| <= F.

No speed is regularised, so that a joint at rest stays where it is for as long as the command does.
Inertial coupling between joints enters with the accelerations of the step before, and the step is
solved again; where one set is run, until they are its own.

Steps follow one another, windows do not: a long one is cut into pieces that begin near what was
measured, and those are stepped again that did not begin where the one before has ended, until all
do (multiple shooting in time; Gander and Vandewalle 2007). Servos soon forget where they began.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor

from torchid.dynamics.forward import gravity_torque, mass_and_bias
from torchid.dynamics.newton_euler import keep_freed_memory
from torchid.effects.registry import nominal_effects
from torchid.effects.spring import JointSpring, stumpff
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import JointType, Robot, link_poses
from torchid.simulation.servo import INDEX, PLANE, Servos
from torchid.typing import Bool, Float, Int

THETA = 0.51
"""Share of a step at which forces are taken [1]: 1/2 is of second order, more is damped."""
STEP = 0.005
"""Longest step, and longest time for which the rigid body is what it is in its middle [s]."""
NEARLY = 0.05
"""Share of a step by which steps may be longer: clocks of logs are not exact [1]."""
SWEEPS = 30
"""Most solutions of a step where one set is run."""
TOGETHER = 3
"""Solutions of a step where many sets are run, of every set and window alike: an answer hangs on
nothing that is run beside it. One alone, with the accelerations of the step before, errs by
milliradians where a joint sets out."""
STOP_STIFFNESS, STOP_SHARE = 200.0, 10.0
"""Of an end stop: so much [N m/rad], and no less than so many times the servo's gain [1]."""
CONTACT_DAMPING = 20.0
"""Of the plane [N s/m]."""
PROFILE = ("scale", "acceleration", "speed", "lag")
_TOGETHER = 4000
_NUMBERS = 64000
FASTEST = (1e6, 1e4)
"""Acceleration [rad/s^2] and speed [rad/s] of set-points that are as good as not limited."""
LONE, MIDDLE = 3.0, 0.5
"""Times the changes before and after it from which a change of a set-point is a jump; and when that
is, in samples, where nothing tells [1]."""
_STRETCH, _EARLY = 200, 25
PIECE_S, MANY = 2.0, 8
"""Length of the pieces of long windows [s], and how many of them a window must have to be cut."""
MEET = 1e-6
"""Between where a piece ends and the next begins: far below what steps err by [rad]."""
_SETTLED = 1e-8
"""Change of positions by an acceleration in a step below which it stays as it is [rad]."""
_BOUNDS = ("coulomb", "clip", "dead_zone", "stop_low", "stop_high")
"""Parameters that every window has its own copy of: `clamp` takes four times as long between bounds
that all windows share."""
_SLIGHT = 1e-6
"""Step of a finite difference [rad]."""


@dataclass(frozen=True, eq=False)
class Body:
    """The rigid body's torque near a motion: M(q) ddq + bias + stiffness (q' - q).

    Attributes:
        q: (T, n) the motion [rad].
        bias: (T, n) torque at zero acceleration [N m].
        stiffness: (T, n, n) derivative of gravity's and the springs' torque [N m/rad].
        inertia: (T, n) diagonal of the mass matrix [kg m^2].
        coupling: (T, n, n) the rest of it.
        dominance: (T, n) sums of the absolute values of the rows of that.
        height: (T, 4) of a homogeneous point of the link that may touch a plane, or None.
        slope: (T, n, 4) its derivative by the joints.
    """

    q: Float[Tensor, "T n"]
    bias: Float[Tensor, "T n"]
    stiffness: Float[Tensor, "T n n"]
    inertia: Float[Tensor, "T n"]
    coupling: Float[Tensor, "T n n"]
    dominance: Float[Tensor, "T n"]
    height: Float[Tensor, "T 4"] | None = None
    slope: Float[Tensor, "T n 4"] | None = None

    @cached_property
    def packed(self) -> Float[Tensor, "F T"]:
        """(2 n n + 4 n, T) all but heights and slopes, matrices by columns: what steps need of
        windows' instants is then one selection."""
        fields = (self.coupling.mT, self.stiffness.mT, self.q, self.bias, self.inertia)
        return torch.cat([x.flatten(1) for x in (*fields, self.dominance)], 1).T.contiguous()

    @cached_property
    def single(self) -> "Body":
        """It in single precision."""
        return self._each(lambda x: x.float())

    def at(self, rows: Int[Tensor, " W"]) -> "Body":
        """It at some of the instants."""
        return self._each(lambda x: x[rows])

    def midway(self, last: Int[Tensor, " m"]) -> "Body":
        """It between each instant and the next one, for steps from one to the other; at the last
        instants of motions as it is there."""
        after = torch.arange(1, len(self.q) + 1)
        after[last] = last
        return self._each(lambda x: (x + x[after]) / 2)

    def _each(self, change: Callable[[Tensor], Tensor]) -> "Body":
        fields = (getattr(self, field.name) for field in dataclasses.fields(self))
        return Body(*(None if x is None else change(x) for x in fields))  # type: ignore[arg-type]


def body_near(
    robot: Robot, q: Float[Tensor, "T n"], dq: Float[Tensor, "T n"], link: int | None
) -> Body:
    """The rigid body linearised about a motion, with the heights of a link's points if asked.

    Raises:
        RobotError: the robot has no inertial parameters.
    """
    # In pieces that stay in the cache.
    pieces = zip(q.split(_TOGETHER), dq.split(_TOGETHER), strict=True)
    bodies = [_with_stiffness(robot, body_at(robot, *piece, link)) for piece in pieces]
    names = [field.name for field in dataclasses.fields(Body)]
    parts = ([getattr(b, name) for b in bodies] for name in names)
    return Body(*(None if x[0] is None else torch.cat(x) for x in parts))  # type: ignore[arg-type]


def body_at(
    robot: Robot, q: Float[Tensor, "T n"], dq: Float[Tensor, "T n"], link: int | None
) -> Body:
    """The rigid body at the instants of a motion: as `body_near`, with zeros for the stiffness.

    Raises:
        RobotError: the robot has no inertial parameters.
    """
    mass, bias = mass_and_bias(robot, q, dq)
    own = mass.diagonal(dim1=1, dim2=2)
    off = mass - torch.diag_embed(own)
    bias = bias + _springs(robot, q) - compensation(robot, q)
    body = q, bias, torch.zeros_like(mass), own, off, off.abs().sum(2)
    if link is None:
        return Body(*body)
    up = upwards(robot).to(q)
    poses = link_poses(robot, q)
    points = poses[:, link, :3]
    # A joint turns points about its axis, or moves them along it (geometric Jacobian).
    # The base is behind the last link, where -1 finds it.
    base = torch.eye(4).to(q).expand(len(q), 1, 4, 4)
    joints = torch.cat([poses, base], 1)[:, list(robot.parents)] @ robot.before.to(q)
    axes, origins = joints[..., :3, 2], joints[..., :3, 3]
    turning = torch.linalg.cross(up.expand_as(axes), axes)
    slope = turning @ points
    slope[..., 3] -= (turning * origins).sum(-1)
    for j, drive in enumerate(robot.drives):
        if drive.joint_type is not JointType.REVOLUTE:
            slope[:, j] = 0.0
            slope[:, j, 3] = axes[:, j] @ up
    slope[:, [k for k in range(robot.n_links) if k not in robot.ancestors(link)]] = 0.0
    if robot.mimics:
        own = slope.new_zeros(len(slope), robot.n, 4)
        follow = torch.tensor([drive.coordinate for drive in robot.drives])
        ratio = slope.new_tensor([drive.ratio for drive in robot.drives])
        slope = own.index_add(1, follow, slope * ratio[:, None])
    return Body(*body, up @ points, slope)


def upwards(robot: Robot) -> Float[Tensor, "3"]:
    """Unit vector against gravity; a robot without gravity has no floor, but z."""
    up = -robot.gravity.double() if bool(robot.gravity.any()) else torch.eye(3).double()[2]
    return up / up.norm()


def _springs(robot: Robot, q: Float[Tensor, "T n"]) -> Float[Tensor, "T n"]:
    """Torque of the springs that the robot's description lists [N m]."""
    out = torch.zeros_like(q)
    for effect, values in nominal_effects(robot):
        if isinstance(effect, JointSpring):
            c, s = stumpff(effect.curvature * q[:, effect.joint] ** 2)
            out[:, effect.joint] += values[0] * q[:, effect.joint] * s + values[1] * c
    return out


def compensation(robot: Robot, q: Float[Tensor, "T n"]) -> Float[Tensor, "T n"]:
    """Torque of the weight that servos do not feel [N m]."""
    if robot.compensated is None:
        return torch.zeros_like(q)
    pi = torch.nn.functional.pad(robot.compensated, (0, PARAMETERS_PER_LINK - 4))
    return gravity_torque(robot, q, InertialParameters(pi))


def _with_stiffness(robot: Robot, body: Body) -> Body:
    def still(q: Float[Tensor, "T n"]) -> Float[Tensor, "T n"]:
        return gravity_torque(robot, q) + _springs(robot, q) - compensation(robot, q)

    at_rest = still(body.q)
    columns = [
        (still(body.q + _SLIGHT * unit) - at_rest) / _SLIGHT
        for unit in torch.eye(robot.n, dtype=body.q.dtype)
    ]
    return dataclasses.replace(body, stiffness=torch.stack(columns, -1))


BodyAt = Callable[[Tensor, Tensor], Body]
"""The rigid body at positions and velocities (W, n)."""

Values = TypeVar("Values", np.ndarray, Tensor)

Shares = tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]
"""Of a step: how far the set-point is from the first knot to the next and from there to the last;
torque per first difference of knots by its rate alone; by all, and the same of the last; and when
it is, in samples from the first knot."""

Jump = tuple[Tensor, Tensor]
"""When set-points jump, in samples from the knot before, and how far: 0 where they go on lines."""

Way = tuple[Tensor, Tensor, Tensor, tuple[Jump, Jump] | None]
"""Of set-points: a knot, and the differences to the two after it; and which of them are jumps, if
any is."""

_Knot = tuple[Tensor, Tensor | None]


@dataclass(frozen=True, eq=False)
class Tracks:
    """Commands of several motions, one after the other.

    Attributes:
        u: (T, n) commanded positions [rad].
        first, last: (m,) first and last row of each motion.
        dt: sampling interval [s].
        jump_at: (T,) when commands that jump between a row and the next do so, in samples; None for
            in the middle, where commands hold until the next one and are late by half a sample.
    """

    u: Float[Tensor, "T n"]
    first: Int[Tensor, " m"]
    last: Int[Tensor, " m"]
    dt: float
    jump_at: Float[Tensor, " T"] | None = None

    @property
    def jumping(self) -> Bool[Tensor, " T"]:
        """Rows (T,) between which and the next one of their motion some command jumps."""
        out = jumps(self.u.T).any(0)
        out[self.last] = False
        return out


@dataclass(frozen=True, eq=False)
class Windows:
    """Stretches of motions that are simulated from their measured start.

    Attributes:
        start: (W,) first row.
        length: (W,) rows.
        motion: (W,) which motion.
        weight: (W,) how many windows each stands for.
    """

    start: Int[Tensor, " W"]
    length: Int[Tensor, " W"]
    motion: Int[Tensor, " W"]
    weight: Float[Tensor, " W"]

    @property
    def rows(self) -> float:
        """Rows that all windows stand for [1]."""
        return float((self.length * self.weight).sum())

    def some(self, rows: Int[Tensor, " V"]) -> "Windows":
        """Some of them."""
        return Windows(self.start[rows], self.length[rows], self.motion[rows], self.weight[rows])

    def on_rows(
        self, values: Float[Tensor, "L W n"], out: Float[Tensor, "T n"]
    ) -> Float[Tensor, "T n"]:
        """`out`, with the windows' values in their rows."""
        ends = zip(self.start.tolist(), self.length.tolist(), strict=True)
        for w, (a, length) in enumerate(ends):
            out[a : a + length] = values[:length, w]
        return out


def windows_of(tracks: Tracks, seconds: float | None) -> Windows:
    """Whole motions, or consecutive windows; a last one shorter than half joins the one before."""
    start, length, motion = [], [], []
    for m, (a, b) in enumerate(zip(tracks.first.tolist(), tracks.last.tolist(), strict=True)):
        rows = b - a + 1
        size = rows if seconds is None else max(2, round(seconds / tracks.dt))
        starts = list(range(0, max(rows - size // 2, 1), size))
        for k in starts:
            start.append(a + k)
            length.append((rows if k == starts[-1] else k + size) - k)
            motion.append(m)
    one = torch.ones(len(start), dtype=torch.float64)
    return Windows(torch.tensor(start), torch.tensor(length), torch.tensor(motion), one)


def set_points(
    profile: Float[Tensor, "S n 4"],
    tracks: Tracks,
    *,
    repeated: bool,
    needed: Bool[Tensor, " T"] | None = None,
) -> Float[Tensor, "n S T"]:
    """Commands through each servo's scale, its profile of limited acceleration and speed, and its
    filter.

    Within a sample the goal stands still, and the set-point goes there as fast as the limits let
    it come to rest: at full acceleration, then at the limit of speed, then at full deceleration.
    A goal that moves on is chased. Where `repeated` commands end the profile, a command that
    equals the one before is the set-point itself.

    Args:
        profile: scale, limit of acceleration and of speed, lag (`PROFILE`) of S sets.
        tracks: m motions.
        repeated: as in `Servos`.
        needed: rows that matter; in others profiles may be left out. None: all.
    """
    scale, a, top, lag = profile.permute(2, 1, 0).unsqueeze(-1)
    slow = (lag[..., 0] > 0).nonzero().tolist()
    if needed is None or slow:  # a filter knows all that was
        needed = torch.ones(len(tracks.u), dtype=torch.bool)
    x = _limited(tracks.u.T[:, None] * scale, a, top, tracks, needed, repeated=repeated)
    if not slow:
        return x
    from scipy.signal import lfilter

    out = x.clone()
    for low, high in zip(tracks.first.tolist(), tracks.last.tolist(), strict=True):
        rate = np.diff(x[..., low : high + 1].numpy(), prepend=x[..., low, None]) / tracks.dt
        for j, s in slow:
            # How far behind the filter is, exactly for goals along straight lines.
            seconds = float(lag[j, s])
            keep = math.exp(-tracks.dt / seconds)
            behind = lfilter([seconds * (1 - keep)], [1, -keep], rate[j, s])
            out[j, s, low : high + 1] -= torch.from_numpy(behind)
    return out


def _limited(
    u: Float[Tensor, "n S T"],
    a: Tensor,
    top: Tensor,
    tracks: Tracks,
    needed: Bool[Tensor, " T"],
    *,
    repeated: bool,
) -> Float[Tensor, "n S T"]:
    """Commands through profiles with limits (n, S, 1) of acceleration and of speed, in stretches
    that hold rows that are needed."""
    bound = (a.isfinite() | top.isfinite())[..., 0]
    if not bool(bound.any()):
        return u
    out = u.clone()
    # Of joints and sets with a profile alone: others follow lines from command to command, which
    # no limit does, however high. Of two limits that which is none is so high that it is none.
    a, top = (x[bound].clamp(max=most) for x, most in zip((a, top), FASTEST, strict=True))
    goal = out[bound]
    # Motions in stretches side by side. Each begins a while before it counts, where all goals have
    # long asked for less than half of what the limits allow, or a repeated command has just ended
    # every profile: there nothing is left of the past.
    begin, count, first = [], [], []
    asked_for = torch.nn.functional.pad(needed.cumsum(0), (1, 0)).tolist()
    for low, high in zip(tracks.first.tolist(), tracks.last.tolist(), strict=True):
        asked = goal[..., low : high + 1].diff(n=2).abs() / tracks.dt**2 > a / 2
        busy = torch.nn.functional.pad(asked.any(0).int(), (2, 0)).cumsum(0)
        row = low
        while row < high:
            end = min(row + _STRETCH, high)
            while end < high and not (
                int(busy[end - low]) == int(busy[max(end - low - _EARLY, 0)])
                or (repeated and bool((goal[..., end - 1] == goal[..., end - 2]).all()))
            ):
                end += 1
            if asked_for[end] > asked_for[row]:
                begin.append(max(low, row - _EARLY))
                first.append(row)
                count.append(end - begin[-1])
            row = end
    if not begin:
        return out
    # Few numbers many times: numpy's calls cost a third of torch's. Time first, so that the numbers
    # of one row lie together.
    order = np.argsort(count)[::-1]
    at, counts, counted = (np.array(x)[order] for x in (begin, count, first))
    goals = goal.T.contiguous().numpy()
    limits, out_of = (a[:, 0].numpy(), top[:, 0].numpy()), goals.copy()
    x, v, before = goals[at], np.zeros_like(goals[at]), goals[at]
    for k in range(int(counts[0])):
        live = int((counts > k).sum())
        at, x, v = at[:live], x[:live], v[:live]
        target = goals[at]
        way, v = profile_step(target - x, v, *limits, tracks.dt)
        x = x + way
        if repeated and k > 0:
            same = target == before[:live]
            x, v = np.where(same, target, x), np.where(same, 0.0, v)
        before, at = target, at + 1
        keep = at > counted[:live]
        out_of[at[keep]] = x[keep]
    out[bound] = torch.from_numpy(out_of).T.contiguous()
    return out


def jumps(points: Float[Tensor, "*D T"]) -> Bool[Tensor, "*D T"]:
    """Whether a set-point jumps between a row and the next, and does not go along a line."""
    change = points.diff().abs()
    near = torch.nn.functional.pad(change, (1, 1))
    lone = change > LONE * torch.maximum(near[..., :-2], near[..., 2:]) + _SLIGHT
    return torch.nn.functional.pad(lone, (0, 1))


def profiles_of(servos: Servos) -> Float[Tensor, "S n 4"]:
    """What makes the set-points of every set of servos."""
    return servos.joint[..., [INDEX[name] for name in PROFILE]].flatten(0, -3)


def profile_step(e: Values, v: Values, a: Values, top: Values, dt: float) -> tuple[Values, Values]:
    """How far the fastest way to rest at a distance e goes within dt, and its velocity then."""
    # Of arrays or of tensors, which call the same functions by other names.
    own: Any = torch if isinstance(e, Tensor) else np
    where, root = own.where, own.sqrt
    least, most = (own.clamp_min, own.clamp_max) if own is torch else (own.maximum, own.minimum)
    # Towards the goal, unless the braking distance is longer than what is left.
    side = where(e - v * abs(v) / (2 * a) >= 0, 1.0, -1.0)
    peak = most(root(least(side * a * e + v * v / 2, 0)), top)
    speed = side * v
    t_up = least((peak - speed) / a, 0)
    # The way while it speeds up and while it brakes; the rest at constant speed.
    up, down = (speed + peak) / 2 * t_up, peak * peak / (2 * a)
    t_even = least((side * e - up - down) / least(peak, 1e-12), 0)
    first = most(t_up, dt)
    second = most(t_even, dt - first)
    third = most(peak / a, dt - first - second)
    way = speed * first + a * first * first / 2
    now = speed + a * first
    way = way + now * second + now * third - a * third * third / 2
    return side * way, side * (now - a * third)


@torch.inference_mode()
def rollout(
    servos: Servos,
    body: Body | BodyAt,
    tracks: Tracks,
    windows: Windows,
    q: Float[Tensor, "W n"],
    dq: Float[Tensor, "W n"],
    *,
    points: Float[Tensor, "n S T"] | None = None,
    owner: Int[Tensor, " ..."] | None = None,
    measured: Float[Tensor, "T n"] | None = None,
    longest_step: float = STEP,
) -> Float[Tensor, "L W n P"]:
    """Positions of arms that start at q, dq and are given the commands of a log.

    Args:
        servos: (P, n, K) for P sets on every window, or (W, 1, n, K) for one set a window.
        body: halfway from each row of the tracks to the next (`Body.midway`); or what gives it at
            positions and velocities, where P is 1.
        tracks: the commands.
        windows: W stretches of them.
        q, dq: state at the first row of each window [rad, rad/s]; the rollout has their precision,
            which is the body's.
        points: set-points, if known.
        owner: (P,) or (W, 1, 1): which row of them each set has (default: 0, 1, ...).
        measured: positions, whose errors until a window begins are what an integrating servo has
            summed by then; without them it begins where the arm would stand still [rad]. Pieces of
            long windows begin near them; without them none is cut.
        longest_step: of the integration [s].

    Returns:
        (L, W, n, P) at the rows of each window; NaN after its last.
    """
    each, sets = servos.joint.ndim == 4, servos.joint.shape[-3]
    if points is None:
        profiles, owner = profiles_of(servos).unique(dim=0, return_inverse=True)
        points = set_points(profiles, tracks, repeated=servos.repeated)
    whose = torch.arange(sets) if owner is None else owner

    def run(some: Windows, of: Tensor, begin: Tensor) -> tuple[Tensor, Tensor]:
        mine, sole = servos, whose
        if each:
            mine = dataclasses.replace(servos, joint=servos.joint[of], plane=servos.plane[of])
            sole = whose.reshape(-1).expand(len(servos.joint))[of]
        given = begin, points, sole, measured, longest_step
        return _side_by_side(mine, body, tracks, some, *given)

    rows = max(2, round(PIECE_S / tracks.dt))
    pieces, of = _pieces(windows, rows)
    sums = bool((servos.of("integral") > 0).any())  # of which nothing is forgotten
    if measured is None or sums or len(of) < MANY * len(windows.start):
        return run(windows, torch.arange(len(q)), _at(q, dq, sets))[0]
    later = (pieces.start > windows.start[of])[:, None]
    q, dq = torch.where(later, measured[pieces.start].to(q), q[of]), dq[of].masked_fill(later, 0.0)
    begin = _at(q, dq, sets)
    out, ends = run(pieces, of, begin)
    near = MEET / tracks.dt ** torch.arange(3).to(q)[:, None, None, None]
    # Of where a joint ends by where it begins: 1 where it did not move, else 0 until it is seen.
    slope = (ends[0] == begin[0]).to(q)
    # Until every piece begins where the one before has ended.
    for _ in range(int(of.bincount().max()) - 1):
        now = _following(begin, ends, slope, of)
        some = ((now - begin).abs() > near).flatten(0, 2).any(0).nonzero().flatten()
        if not len(some):
            break
        again, after = run(pieces.some(some), of[some], now[..., some])
        seen = (after[0] - ends[0][..., some]) / (now - begin)[0][..., some]
        slope[..., some] = seen.clamp(0, 1).where(seen.isfinite(), slope[..., some])
        begin[..., some], ends[..., some], out[: len(again), some] = now[..., some], after, again
    # Each window's rows from its pieces, NaN from its end on.
    count, row = of.bincount(), torch.arange(int(windows.length.max()))[:, None]
    nth = torch.minimum((row - 1).clamp(min=0) // rows, count - 1)
    whole = out[(row - rows * nth).clamp(max=rows), count.cumsum(0) - count + nth]
    return whole.masked_fill_((row >= windows.length)[..., None, None], math.nan)


def _pieces(windows: Windows, rows: int) -> tuple[Windows, Int[Tensor, " V"]]:
    """Windows in pieces of so many rows, of which the first is the last one of the piece before;
    and which window each is of."""
    count = ((windows.length - 2) // rows + 1).clamp(min=1)
    of = torch.arange(len(count)).repeat_interleave(count)
    begun = rows * (torch.arange(len(of)) - (count.cumsum(0) - count)[of])
    length = (windows.length[of] - begun).clamp(max=rows + 1)
    start = windows.start[of] + begun
    return dataclasses.replace(windows.some(of), start=start, length=length), of


def _at(q: Float[Tensor, "W n"], dq: Float[Tensor, "W n"], sets: int) -> Float[Tensor, "3 n P W"]:
    """Positions, velocities and accelerations of so many sets that begin alike."""
    state = torch.stack([q, dq, torch.zeros_like(q)])
    return state.mT[:, :, None].expand(-1, -1, sets, -1).contiguous()


def _following(begin: Tensor, ends: Tensor, slope: Tensor, of: Tensor) -> Float[Tensor, "3 n P V"]:
    """States where pieces begin that follow one another, from where they began and then ended, and
    the slopes (n, P, V) of the positions there over those here."""
    now = begin.clone()
    for k in (1 + (of[1:] == of[:-1]).nonzero().flatten()).tolist():
        now[..., k] = ends[..., k - 1]
        now[0, ..., k] += slope[..., k - 1] * (now[0, ..., k - 1] - begin[0, ..., k - 1])
    return now


def _side_by_side(
    servos: Servos,
    body: Body | BodyAt,
    tracks: Tracks,
    windows: Windows,
    begin: Float[Tensor, "3 n P W"],
    points: Float[Tensor, "n S T"],
    owner: Int[Tensor, " ..."],
    measured: Float[Tensor, "T n"] | None,
    longest_step: float,
) -> tuple[Float[Tensor, "L W n P"], Float[Tensor, "3 n P W"]]:
    """Windows from their states, as of `rollout`, and their states at the end."""
    each = servos.joint.ndim == 4
    # (n, P, W or 1, K), and (5, P, W or 1): windows, of which there are most, are side by side in
    # memory, so that what differs between windows or sets alone is a row or a number.
    joint, plane = servos.joint.to(begin), servos.plane.to(begin)
    table = joint.permute(2, 1, 0, 3) if each else joint.transpose(0, 1)[:, :, None]
    plane = plane.permute(2, 1, 0) if each else plane.T[:, :, None]
    sets = table.shape[1]
    owner = owner.reshape(1, 1, -1) if each and owner.numel() > 1 else owner.reshape(1, -1, 1)
    out = begin.new_full((int(windows.length.max()), *begin.shape[1:]), math.nan)
    ends = torch.empty_like(begin)
    # Long windows first, so that those that have ended can be left out; as many at a time as keep
    # the state in the cache.
    order = windows.length.argsort(descending=True, stable=True)
    known = isinstance(body, Body)
    lone = jumps(points)
    jump_at = None
    if bool(lone.any()):
        at = torch.full_like(points[0, 0], MIDDLE) if tracks.jump_at is None else tracks.jump_at
        jump_at = torch.where(lone, at, math.inf).flatten().to(begin)
    keep_freed_memory()

    def run_of(some: Int[Tensor, " V"]) -> _Run:
        return _Run(
            table[:, :, some] if each else table,
            plane[..., some] if each else plane,
            points,
            owner[..., some] if owner.shape[2] > 1 else owner,
            jump_at,
            tracks.first[windows.motion[some]],
            tracks.dt,
            longest_step,
            # A body that is not known beforehand is evaluated in each part of a sample, and the
            # steps are solved for their own accelerations.
            1 if known else math.ceil(tracks.dt / STEP - NEARLY),
            (TOGETHER, 0.0) if known else (SWEEPS, _SETTLED),
        )

    parts = order.split(max(1, _NUMBERS // (servos.n * sets)))
    for some, *part in zip(parts, *(x.split(len(parts[0]), 3) for x in (out, ends)), strict=True):
        (q, end), run, start = part, run_of(some), windows.start[some]
        state = _State(*begin.index_select(3, some))
        if run.active["integral"]:
            state.i = run.summed(body, run.begin, start, state.q[:, 0].T, measured)
        lengths = windows.length[some].tolist()
        q[0] = state.q
        live = len(some)
        for k in range(1, lengths[0]):
            while lengths[live - 1] <= k:
                live -= 1
            if live < state.q.shape[2]:
                end[..., : state.q.shape[2]] = torch.stack([state.q, state.v, state.a])
                run, state = run_of(some[:live]), state.first_of(live)
            run.sample(state, body, start[:live] + k - 1)
            q[k, ..., :live] = state.q
        end[..., :live] = torch.stack([state.q, state.v, state.a])
    # As they were given.
    back = order.argsort()
    return out.index_select(3, back).permute(0, 3, 1, 2), ends.index_select(3, back)


class _State:
    """Positions, velocities, accelerations and torques of integral action (n, P, W)."""

    def __init__(self, q: Tensor, v: Tensor, a: Tensor, i: Tensor | None = None):
        self.q, self.v, self.a = q, v, a
        self.i = torch.zeros_like(q) if i is None else i

    def soon(self, wait: float) -> tuple[Float[Tensor, "W n"], Float[Tensor, "W n"]]:
        """Positions and velocities of the first set, a little later."""
        v = self.v + self.a * wait
        q = self.q + (self.v + v) * (wait / 2)
        return q[:, 0].T.contiguous(), v[:, 0].T.contiguous()

    def first_of(self, live: int) -> "_State":
        return _State(*(x[..., :live].contiguous() for x in (self.q, self.v, self.a, self.i)))


class _NearBody(NamedTuple):
    """The body through a part of a sample, (n, P, W) or columns of matrices (n, 1, W).

    Attributes:
        load: torque at rest [N m].
        coupling: columns of the mass matrix but its diagonal.
        lacking: what a joint's inertia lacks of its coupling.
        lean, soft, stiff: factors of the velocity at a step's beginning, and of its mean without
            the servo and with it.
    """

    load: Tensor
    coupling: Sequence[Tensor]
    lacking: Tensor
    lean: Tensor
    soft: Tensor
    stiff: Tensor


class _Run:
    """What does not change along a rollout: parameters, set-points, the parts of a sample."""

    def __init__(
        self,
        table: Tensor,
        plane: Tensor,
        points: Tensor,
        owner: Tensor,
        jump_at: Tensor | None,
        begin: Tensor,
        dt: float,
        longest_step: float,
        parts: int,
        sweeps: tuple[int, float],
    ):
        self.table, self.plane, self.points, self.owner = table, plane, points, owner
        self.begin, self.dt, self.longest_step = begin, dt, longest_step
        self.parts, self.sweeps, self.settled = parts, *sweeps
        each = math.ceil(dt / parts / longest_step - NEARLY)
        steps = parts * each
        self.h, self.steps = dt / steps, steps
        self.last: tuple[tuple[Tensor, Tensor], Body] | None = None
        p = {name: table[..., k].contiguous() for name, k in INDEX.items()}
        p |= {name: p[name].expand(-1, -1, len(begin)).contiguous() for name in _BOUNDS}
        self.p = p
        # Rows of the set-points, and how far behind each servo is, in samples.
        behind = p["delay"] / dt
        self.whole = behind.floor().to(torch.int64)
        part = behind - self.whole
        self.rows = (
            torch.arange(points.shape[0])[:, None, None] * points.shape[1] + owner
        ) * points.shape[2]
        self.flat = points.reshape(-1).to(table)
        self.jump_at = jump_at
        self.ahead: tuple[_Knot, _Knot] | None = None
        # Most sets have set-points and delays as another has: theirs are looked up once.
        self.apart: Sequence[Tensor] = (self.whole, self.rows)
        self.alike: Tensor | None = None
        if self.whole.shape[2] == self.rows.shape[2] == 1 < table.shape[1]:
            both = torch.cat([x[..., 0] for x in self.apart])
            both, alike = both.unique(dim=1, return_inverse=True)
            if both.shape[1] < table.shape[1]:
                self.apart, self.alike = both[..., None].chunk(2), alike
        # Within a sample the delayed set-point bends once: shares of its three knots a step.
        shares = []
        for s in range(steps):
            at = 1 - part + (s + THETA) / steps
            near, far = at.clamp(max=1.0), (at - 1).clamp(min=0.0)
            # The torque per difference of knots, of the position and of the rate; that is the mean
            # over the step, so that it changes with the delay without a jump.
            rate = p["kd"] / dt
            later = rate * (s + 1 - part * steps).clamp(0.0, 1.0)
            sooner = rate - later
            first = torch.addcmul(sooner, p["kp"], near)
            last = torch.addcmul(later, p["kp"], far)
            shares.append((near, far, sooner, first, last, at))
        # Those of every part, in which the body stays the same.
        self.shares = [shares[k : k + each] for k in range(0, steps, each)]
        self.rate = p["kd"] / dt
        self.active = {
            name: bool((p[name] != neutral).any())
            for name, neutral in (
                ("dead_zone", 0.0), ("stiction", 0.0), ("motor_share", 0.0), ("integral", 0.0),
                ("load_share", 0.0),
            )
        }  # fmt: skip
        self.clips = bool(p["clip"].isfinite().any())
        self.limits = -p["clip"], p["clip"]
        self.stops = bool(p["stop_low"].isfinite().any() | p["stop_high"].isfinite().any())
        # Of the stops: stiffness, damping, and what they add to the factor of w.
        self.stop = (STOP_SHARE * p["kp"]).clamp(min=STOP_STIFFNESS)
        damping = 2 * (self.stop * (p["armature"] + 1e-3)).sqrt()
        self.hard = self.stop * THETA * self.h + damping
        self.touches = bool((plane[4] > 0).any())
        # Of speeds, in the exponent of what fades with them.
        self.fading = -1 / p["stribeck_speed"]
        # What a step takes from the torque of a servo that goes at its mean velocity.
        inside = p["damping_share"] * p["damping"]
        self.gain, self.outside = (
            p["kp"] * (THETA * self.h) + p["kd"] + inside,
            p["damping"] - inside,
        )
        self.inside = p["kd"] + inside

    def way(self, rows: Tensor) -> Way:
        """Three set-points (n, P, W), or (n, 1, W) of sets that are alike, around the delayed
        instant of a sample, which follows the one that was asked for before."""
        at = rows - self.apart[0] - 1
        if self.ahead is None:
            self.ahead = self._knot(at), self._knot(at + 1)
        (before, at_first), (now, at_last) = self.ahead
        self.ahead = self.ahead[1], self._knot(at + 2)
        first, last = now - before, self.ahead[1][0] - now
        jumping = None
        if at_first is not None and at_last is not None:
            here = at_first.isfinite(), at_last.isfinite()
            if bool((here[0] | here[1]).any()):
                jumping = (at_first, here[0] * first), (at_last + 1, here[1] * last)
        return before, first, last, jumping

    def _knot(self, at: Tensor) -> _Knot:
        """Set-points at rows of the tracks, before a motion its first; and when they jump from
        there to the next, if any does."""
        at = torch.maximum(at, self.begin).add_(self.apart[1])
        both = [None if x is None else x.take(at) for x in (self.flat, self.jump_at)]
        if self.alike is not None and at.shape[1] > 1:
            both = [None if x is None else x.index_select(1, self.alike) for x in both]
        x, jump_at = both
        assert x is not None
        return x, jump_at

    def summed(
        self,
        body: Body | BodyAt,
        first: Tensor,
        rows: Tensor,
        q: Tensor,
        measured: Tensor | None,
    ) -> Tensor:
        """(n, P, W) torque of integral action at rows of motions that began at rows `first`, at
        rest: there the servo bore the load."""
        p, began = self.p, q if measured is None else measured[first]
        at = body.at(first) if isinstance(body, Body) else body(began, torch.zeros_like(began))
        x = self.flat.take(self.rows + first)
        held = at.bias.T[:, None] - p["offset"] - p["kp"] * (x - began.T[:, None])
        held = torch.where(p["integral"] > 0, held, 0.0)
        if measured is None:
            return held

        # Sums over time of the set-points, late as they are, and of what was measured.
        def until(series: Tensor) -> Tensor:
            middle = (series[..., 1:] + series[..., :-1]) / 2
            return torch.nn.functional.pad(middle.cumsum(-1), (1, 0))

        behind = torch.minimum(p["delay"].double() / self.dt, (rows - first).double())
        late = rows - behind
        before = late.floor().to(torch.int64)
        sums = until(self.points).reshape(-1)
        low, high = (sums.take(self.rows + torch.maximum(k, first)) for k in (before, before + 1))
        goals = torch.lerp(low, high, late - before)
        goals = goals - sums.take(self.rows + first) + behind * x
        way = until(measured.T).T
        summed = goals - (way[rows] - way[first]).T[:, None]
        return held + p["integral"] * self.dt * summed.to(held)

    def sample(self, state: _State, body: Body | BodyAt, rows: Tensor) -> None:
        """Step a state from one sample to the next."""
        way = self.way(rows)
        for shares in self.shares:
            wait = len(shares) * self.h / 2
            if isinstance(body, Body):
                self._part(state, body, rows, way, shares, wait)
            else:
                now = self._near(state, body, wait)
                self._part(state, now, torch.arange(len(rows)), way, shares, wait)

    def _near(self, state: _State, body: BodyAt, wait: float) -> Body:
        """The body a little later; that of the last time, where nothing has moved since."""
        soon = state.soon(wait)
        if self.last is None or not all(map(torch.equal, soon, self.last[0])):
            self.last = soon, body(*soon)
        return self.last[1]

    def _part(
        self,
        state: _State,
        body: Body,
        rows: Tensor,
        way: Way,
        shares: list[Shares],
        wait: float,
    ) -> None:
        """Step a state through a part of a sample, `wait` being half of it [s], near rows of the
        body's."""
        p, h, active = self.p, self.h, self.active
        near = self._near_body(state, body, rows, wait)
        arm = self._reach(body, rows) if self.touches else None
        # The same in all steps, unless speed, the servo's torque or a plane make it another.
        same = arm is None and not active["stiction"] and not active["motor_share"]
        resting, dry = p["offset"] - near.load, None
        for share in shares:
            drive, rest, outer, more = self._drive(state, way, share), resting, near.load, None
            touch = None if arm is None else self._contact(state, arm)
            if touch is not None:
                push, more = touch
                rest, outer = rest + push, outer - push
            if self.stops:
                stop, hard = self._stop(state)
                rest, more = rest + stop, hard if more is None else more + hard
            rest = torch.addcmul(rest, near.lean, state.v)
            if dry is None or not same:
                most = self._dry(state, drive, outer)
                dry = -most, most
            w, v, a = self._solved(state, near, rest, drive, dry, more)
            if active["integral"]:
                error = self._error(state, way, share).sub_(w, alpha=THETA * h)
                state.i = torch.addcmul(state.i, p["integral"] * h, error)
                if self.clips:  # what the servo cannot give is not summed
                    state.i = state.i.clamp(*self.limits)
            state.q, state.v, state.a = torch.add(state.q, w, alpha=h), v, a

    def _near_body(self, state: _State, body: Body, rows: Tensor, wait: float) -> _NearBody:
        """What the body is in the middle of a part of a sample, near rows of its own."""
        # Columns of matrices (n, 1, W), and the same of vectors.
        n = len(state.q)
        parts = body.packed.index_select(1, rows)[:, None].split(n)
        coupling, stiffness = parts[:n], parts[n : 2 * n]
        near_q, bias, own, dominance = parts[2 * n :]
        # Where coupling outweighs a joint's own inertia, as much is added on both sides of the
        # equation, here with this step's acceleration, there with the last one's.
        inertia = own + self.p["armature"]
        lacking = (dominance - inertia).clamp_(min=0)
        inertia = inertia + lacking
        # Gravity in the middle of the part.
        ahead = torch.add(state.q, state.v, alpha=wait).sub_(near_q)
        load = _plus_product(bias, stiffness, ahead)
        lean = inertia / (THETA * self.h)
        soft = lean + self.outside
        return _NearBody(load, coupling, lacking, lean, soft, soft + self.gain)

    def _error(self, state: _State, way: Way, share: Shares) -> Tensor:
        """Set-point less position at the instant of a step, but for the dead zone [rad]."""
        (x0, d0, d1, jumping), (near, far, *_) = way, share
        error = torch.addcmul(torch.addcmul(x0, d0, near), d1, far).sub_(state.q)
        if jumping is not None:
            error.add_(self._beyond_lines(jumping, share))
        if self.active["dead_zone"]:
            error = error - error.clamp(-self.p["dead_zone"], self.p["dead_zone"])
        return error

    def _beyond_lines(self, jumping: tuple[Jump, Jump], share: Shares) -> Tensor:
        """How much farther set-points are where they jump: means over the step, which change with
        the delay without a jump [rad]."""
        (at_first, first), (at_last, last) = jumping
        near, far, at = share[0], share[1], share[-1]
        ahead = ((at - at_first) * self.steps + 0.5).clamp_(0.0, 1.0).sub_(near).mul_(first)
        return ahead.addcmul_(((at - at_last) * self.steps + 0.5).clamp_(0.0, 1.0) - far, last)

    def _drive(self, state: _State, way: Way, share: Shares) -> Tensor:
        """The servo's torque of a joint at rest [N m]."""
        (x0, d0, d1, jumping), (_, _, rate, first, last, _) = way, share
        if self.active["dead_zone"]:
            drive = self._error(state, way, share).mul_(self.p["kp"])
            drive = torch.addcmul(drive, rate, d0).addcmul_(self.rate - rate, d1)
        else:
            drive = (x0 - state.q).mul_(self.p["kp"]).addcmul_(first, d0).addcmul_(last, d1)
            if jumping is not None:
                drive.addcmul_(self.p["kp"], self._beyond_lines(jumping, share))
        return drive.add_(state.i) if self.active["integral"] else drive

    def _solved(
        self,
        state: _State,
        near: _NearBody,
        rest: Tensor,
        drive: Tensor,
        dry: tuple[Tensor, Tensor],
        more: Tensor | None,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Mean velocity of a step, and velocity and acceleration at its end: friction holds a joint
        if it can, the servo gives no more than it can, and coupling has the accelerations of the
        solution before.

        Args:
            state: where the step begins.
            near: the body there.
            rest: torque of all else than servo, dry friction and coupling.
            drive: the servo's torque of a joint at rest.
            dry: least and most torque of dry friction.
            more: what contact and stops add to the factor of the velocity.
        """
        soft, stiff = near.soft, near.stiff
        if more is not None:
            soft, stiff = soft + more, stiff + more
        moves, a = torch.empty_like(state.q), state.a
        for left in reversed(range(self.sweeps)):
            free = _plus_product(rest, near.coupling, a, sign=-1).addcmul_(near.lacking, a)
            total = free + drive
            w = (total - total.clamp(*dry)).div_(stiff)
            if self.clips:
                torque = torch.addcmul(drive, self.gain, w, value=-1)
                held = torque.clamp(*self.limits)
                total = free.add_(held)
                slipping = (total - total.clamp(*dry)).div_(soft)
                w = torch.lerp(w, slipping, torch.ne(torque, held, out=held))
            v = torch.sub(w, state.v, alpha=1 - THETA).div_(THETA)
            # What is held is at rest; numbers, as to compute with truth values is slow.
            v.mul_(torch.ne(w, 0, out=moves))
            before, a = a, (v - state.v).div_(self.h)
            # Until the accelerations are those of this step.
            change = self.settled and left and float((a - before).abs().max()) * self.h * self.h
            if change < self.settled:
                break
        return w, v, a

    def _dry(self, state: _State, drive: Tensor, outer: Tensor) -> Tensor:
        """The most that friction can hold now [N m]."""
        p = self.p
        dry = p["coulomb"]
        if self.active["load_share"]:
            dry = torch.addcmul(dry, p["load_share"], outer.abs())
        if self.active["stiction"]:
            dry = torch.addcmul(dry, p["stiction"], state.v.abs().mul_(self.fading).exp_())
        if self.active["motor_share"]:
            motor = torch.addcmul(drive, self.inside, state.v, value=-1).abs_()
            if self.clips:
                motor = torch.minimum(motor, p["clip"])
            dry = torch.addcmul(dry, p["motor_share"], motor)
        return dry

    def _stop(self, state: _State) -> tuple[Tensor, Tensor]:
        """Torque of critically damped end stops, and what they add to the factor of w."""
        beyond = state.q - state.q.clamp(self.p["stop_low"], self.p["stop_high"])
        return -self.stop * beyond, torch.ne(beyond, 0, out=torch.empty_like(beyond)) * self.hard

    def _reach(self, body: Body, rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Height of the point (1, P, W) and its slopes (n, P, W), and where they were taken."""
        assert body.height is not None
        assert body.slope is not None
        x, y, z = (self.plane[k][None] for k in range(3))
        h = body.height[rows].T[:, None, None]
        s = body.slope[rows].permute(2, 1, 0).contiguous()[:, :, None]
        height = h[0] * x + h[1] * y + h[2] * z + h[3]
        slope = s[0] * x + s[1] * y + s[2] * z + s[3]
        return height, slope, body.q[rows].T[:, None]

    def _contact(
        self, state: _State, arm: tuple[Tensor, Tensor, Tensor]
    ) -> tuple[Tensor, Tensor] | None:
        """Torque of the plane on the joints, and what it adds to the factor of w; None where no
        point is in it."""
        height, slope, near = arm
        level, k = (self.plane[PLANE.index(name)][None] for name in ("height", "stiffness"))
        soon = state.q + state.v * (THETA * self.h) - near
        depth = level - height - (slope * soon).sum(0, keepdim=True)
        if float(depth.max()) <= 0:
            return None
        force = k * depth - CONTACT_DAMPING * (slope * state.v).sum(0, keepdim=True)
        # A plane without stiffness is none: it does not damp, either.
        force = torch.where((depth > 0) & (k > 0), force, 0.0).clamp(min=0)
        return slope * force, slope * slope * (CONTACT_DAMPING * (force > 0))


def _plus_product(x: Tensor, columns: Sequence[Tensor], y: Tensor, sign: float = 1) -> Tensor:
    """x + sign M y, (n, P, W), of matrices' columns (n, 1, W): to add them up takes a sixth of the
    time of a batch of products of small matrices."""
    first, *rest = y.unbind()
    out = torch.addcmul(x, columns[0], first, value=sign)
    for column, one in zip(columns[1:], rest, strict=True):
        out.addcmul_(column, one, value=sign)
    return out
