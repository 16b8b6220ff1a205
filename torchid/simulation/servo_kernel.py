"""The loops of `servo_loop`, compiled: set-points, the rigid body of a tree of links, and steps.

Windows are stepped side by side, up to `LANES` of them, one set of servos after the other. All that
a step holds lies in one array, in slots of constant length: the compiler sees that slots do not
overlap, and takes several windows at a time. A matrix (n, n) of many windows lies by its cyclic
diagonals, entry i of the d-th being (i, (i + d) % n): a product with vectors that stand twice, one
behind the other, is then n long sums.

No set and no window is computed in another way for what is computed beside it. Everything is in
float64, on one CPU, without gradients. All stands in one file, because what is kept of the compiled
code is renewed with the file that it is of; constants of others are arguments. NUMBA_DISABLE_JIT=1
runs it as Python.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]
Vector = tuple[float, float, float]
Function = TypeVar("Function", bound=Callable[..., object])

THETA = 0.51
"""Share of a step at which forces are taken [1]: 1/2 is of second order, more is damped."""
SWEEPS, TOGETHER = 30, 3
"""Solutions of a step: most where the body is evaluated on the way; of every step near a body that
is known. One alone, with the accelerations of the step before, errs by milliradians where a joint
sets out."""
SETTLED = 1e-8
"""Change of positions by an acceleration in a step below which it stays as it is [rad]."""
STOP_STIFFNESS, STOP_SHARE = 200.0, 10.0
"""Of an end stop: so much [N m/rad], and no less than so many times the servo's gain [1]."""
STOP_INERTIA = 1e-3
"""Added to a rotor's where a stop is damped critically [kg m^2]."""
SLIGHT = 1e-6
"""Step of a finite difference [rad]."""
SERIES = 1e-3
"""|x| below which the series of `stumpff` are exact to rounding [1]."""

LOG2_E, LN2_HIGH, LN2_LOW = 1.4426950408889634, 0.6931471803691238, 1.9082149292705877e-10
"""1 / ln 2, and ln 2 in two parts, whole multiples of the first of which are exact."""
ROUNDING = 6755399441055744.0
"""1.5 2^52."""

LANES, SLOT = 16, 264
"""Windows side by side; room in a slot: an odd number of cache lines."""

# Parameters of a set by slots, those of COLUMNS first.
COLUMNS = (
    "kp", "kd", "integral", "damping", "armature", "delay", "offset", "coulomb", "stiction",
    "stribeck_speed", "motor_share", "load_share", "clip", "dead_zone", "stop_low", "stop_high",
    "damping_share", "stiction_share", "stribeck_exponent", "supply",
)  # fmt: skip
"""Parameters of servos that steps need, in this order."""
(
    KP, KD, INTEGRAL, DAMPING, ARMATURE, DELAY, OFFSET, COULOMB, STICTION, STRIBECK, MOTOR_SHARE,
    LOAD_SHARE, CLIP, DEAD_ZONE, LOW, HIGH, DAMPING_SHARE, STICTION_SHARE, EXPONENT, SUPPLY, PART,
    RATE, FADING, STOP, HARD, GAIN, OUTSIDE, INSIDE,
) = (k * SLOT for k in range(28))  # fmt: skip
PARAMETERS = 28
# What a step holds; Q to SUM are a state. Of A1 and AHEAD there are two copies.
(
    Q, V, A, SUM, X0, D0, D1, J0, J1, F0, F1, NEAR, DOMINANCE, LOAD, LACKING, LEAN, SOFT, DRIVE,
    REST, MORE, DRY, PUSH, SLOPE, ERROR, FREE, HELD, SLIP, POWER, W, V1, A1, AHEAD,
) = (k * SLOT for k in range(32))  # fmt: skip
SLOTS = 32


def _compiled(function: Function) -> Function:
    """Compiled when it is first called, and kept beside the source or in the user's cache, if
    either can be written."""
    # Infinities are limits that are none: no flag that denies them.
    compiled: Any = partial(
        numba.njit, nogil=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy"
    )
    try:
        return compiled(cache=True)(function)
    except RuntimeError:
        return compiled()(function)


@_compiled
def _between(x: float, low: float, high: float) -> float:
    x = low if x < low else x
    return high if x > high else x


# Set-points.


@_compiled
def profile_step(e: float, v: float, a: float, top: float, dt: float) -> tuple[float, float]:
    """As `servo_loop.profile_step`, of numbers."""
    side = 1.0 if e - v * abs(v) / (2 * a) >= 0 else -1.0
    peak = min(math.sqrt(max(side * a * e + v * v / 2, 0.0)), top)
    speed = side * v
    t_up = max((peak - speed) / a, 0.0)
    up, down = (speed + peak) / 2 * t_up, peak * peak / (2 * a)
    t_even = max((side * e - up - down) / max(peak, 1e-12), 0.0)
    first = min(t_up, dt)
    second = min(t_even, dt - first)
    third = min(peak / a, dt - first - second)
    now = speed + a * first
    way = speed * first + a * first * first / 2 + now * second + now * third - a * third**2 / 2
    return side * way, side * (now - a * third)


@_compiled
def set_points(
    u: Array, profile: Array, first: Rows, last: Rows, dt: float, repeated: bool, fastest: Array
) -> Array:
    """(n, S, T) of commands u (T, n) and profiles (S, n, 4), in motions from first to last rows;
    see `servo_loop.set_points`."""
    rows, n = u.shape
    out = np.empty((n, len(profile), rows))
    for j in range(n):
        for s in range(len(profile)):
            scale, a, top, lag = profile[s, j]
            x = out[j, s]
            for k in range(rows):
                x[k] = u[k, j] * scale
            if a < math.inf or top < math.inf:
                a, top = min(a, fastest[0]), min(top, fastest[1])
                for m in range(len(first)):
                    _limited(x, first[m], last[m], a, top, dt, repeated)
            if lag > 0:
                keep = math.exp(-dt / lag)
                for m in range(len(first)):
                    # How far behind the filter is, exactly for goals along straight lines.
                    behind, before = 0.0, x[first[m]]
                    for k in range(first[m], last[m] + 1):
                        behind = keep * behind + lag * (1 - keep) * (x[k] - before) / dt
                        before = x[k]
                        x[k] -= behind
    return out


@_compiled
def _limited(
    x: Array, first: int, last: int, a: float, top: float, dt: float, repeated: bool
) -> None:
    """Commands in place through limits of acceleration and of speed."""
    at, v, before = x[first], 0.0, math.nan
    for k in range(first, last):
        goal = x[k]
        x[k] = at
        way, v = profile_step(goal - at, v, a, top, dt)
        at += way
        if repeated and goal == before:
            at, v = goal, 0.0
        before = goal
    x[last] = at


# The rigid body.


class Tree(NamedTuple):
    """A robot's links, see `recursion.JointGeometry`, and what its joints feel of them.

    Attributes:
        parent, coordinate, ratio, offset, revolute: (L,) each.
        constant, cosine, sine: (L, 3, 3).
        before, after, axis: (L, 3).
        gravity, up: (3,) in the base frame [m/s^2]; the unit vector against it.
        pi: (L, 10) inertial parameters.
        felt: (L, 10) of them what gravity's torque is of.
        springs: (S, 4) joint, curvature, stiffness and torque at 0 of each; see `JointSpring`.
        link: whose points may touch a plane, or -1.
    """

    parent: Rows
    coordinate: Rows
    ratio: Array
    offset: Array
    revolute: npt.NDArray[np.bool_]
    constant: Array
    cosine: Array
    sine: Array
    before: Array
    after: Array
    axis: Array
    gravity: Array
    up: Array
    pi: Array
    felt: Array
    springs: Array
    link: int


class _Posture(NamedTuple):
    """Links on the way: rotations (L, 3, 3) from link to parent axes; offsets of their frames from
    the joints', angular velocities, angular accelerations, accelerations of the frames' origins,
    forces and moments (L, 3) in link axes; torques and two vectors (n,) of the coordinates."""

    rotation: Array
    offset: Array
    w: Array
    wd: Array
    a: Array
    force: Array
    moment: Array
    tau: Array
    still: Array
    unit: Array


_NOTHING: Any = (
    *np.empty((2, 0), np.int64), *np.empty((2, 0)), np.empty(0, np.bool_), *np.empty((3, 0, 3, 3)),
    *np.empty((3, 0, 3)), *np.empty((2, 3)), *np.empty((2, 0, 10)), np.empty((0, 4)), -1,
)  # fmt: skip
NO_TREE = Tree(*_NOTHING)
"""Where the body is known."""


@_compiled
def _posture(links: int, n: int) -> _Posture:
    x, y = np.zeros((7, links, 3)), np.zeros((3, n))
    return _Posture(np.zeros((links, 3, 3)), x[0], x[1], x[2], x[3], x[4], x[5], y[0], y[1], y[2])


@_compiled
def _of(x: Array, k: int) -> Vector:
    return x[k, 0], x[k, 1], x[k, 2]


@_compiled
def _put(x: Array, k: int, v: Vector) -> None:
    x[k, 0], x[k, 1], x[k, 2] = v


@_compiled
def _plus(a: Vector, b: Vector, scale: float) -> Vector:
    """a + scale b."""
    return a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]


@_compiled
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@_compiled
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@_compiled
def _carried(w: Vector, wd: Vector, r: Vector) -> Vector:
    """Acceleration of a point r that turns: wd x r + w x (w x r)."""
    return _plus(_cross(wd, r), _cross(w, _cross(w, r)), 1.0)


@_compiled
def _out(m: Array, v: Vector) -> Vector:
    """m v."""
    return _dot(_of(m, 0), v), _dot(_of(m, 1), v), _dot(_of(m, 2), v)


@_compiled
def _in(m: Array, v: Vector) -> Vector:
    """m' v."""
    return (
        m[0, 0] * v[0] + m[1, 0] * v[1] + m[2, 0] * v[2],
        m[0, 1] * v[0] + m[1, 1] * v[1] + m[2, 1] * v[2],
        m[0, 2] * v[0] + m[1, 2] * v[1] + m[2, 2] * v[2],
    )


@_compiled
def _place(tree: Tree, q: Array, at: _Posture) -> None:
    """The rotations and offsets at q (n,)."""
    for k in range(len(tree.parent)):
        x = tree.ratio[k] * q[tree.coordinate[k]] + tree.offset[k]
        turns = tree.revolute[k]
        c, s = (math.cos(x), math.sin(x)) if turns else (0.0, 0.0)
        for i in range(3):
            for j in range(3):
                turned = tree.cosine[k, i, j] * c + tree.sine[k, i, j] * s
                at.rotation[k, i, j] = tree.constant[k, i, j] + turned
            at.offset[k, i] = tree.after[k, i] + (0.0 if turns else tree.axis[k, i] * x)


@_compiled
def _move(tree: Tree, dq: Array, ddq: Array, base: Vector, at: _Posture) -> None:
    """The links' velocities and accelerations from those (n,) of the coordinates and the base's
    acceleration: `recursion.kinematics` (eq. 2.12)."""
    for k in range(len(tree.parent)):
        p, axis, coordinate = tree.parent[k], _of(tree.axis, k), tree.coordinate[k]
        rate, change = tree.ratio[k] * dq[coordinate], tree.ratio[k] * ddq[coordinate]
        w, wd, a = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), base
        if p >= 0:
            w, wd = _of(at.w, p), _of(at.wd, p)
            a = _plus(_of(at.a, p), _carried(w, wd, _of(tree.before, k)), 1.0)
        rotation = at.rotation[k]
        w, wd, a = _in(rotation, w), _in(rotation, wd), _in(rotation, a)
        turning = _cross(w, axis)
        if tree.revolute[k]:
            wd = _plus(_plus(wd, axis, change), turning, rate)
            w = _plus(w, axis, rate)
        else:
            a = _plus(_plus(a, axis, change), turning, 2 * rate)
        _put(at.w, k, w)
        _put(at.wd, k, wd)
        _put(at.a, k, _plus(a, _carried(w, wd, _of(at.offset, k)), 1.0))


@_compiled
def _press(tree: Tree, pi: Array, at: _Posture) -> None:
    """Torques of the coordinates that move bodies pi (L, 10) so: `recursion.forces` (eq. 2.13)."""
    for k in range(len(tree.parent)):
        m, h = pi[k, 0], (pi[k, 1], pi[k, 2], pi[k, 3])
        w, wd, a = _of(at.w, k), _of(at.wd, k), _of(at.a, k)
        rows = (
            (pi[k, 4], pi[k, 5], pi[k, 6]),
            (pi[k, 5], pi[k, 7], pi[k, 8]),
            (pi[k, 6], pi[k, 8], pi[k, 9]),
        )
        spin = _dot(rows[0], w), _dot(rows[1], w), _dot(rows[2], w)
        moment = _dot(rows[0], wd), _dot(rows[1], wd), _dot(rows[2], wd)
        moment = _plus(_plus(moment, _cross(w, spin), 1.0), _cross(h, a), 1.0)
        _put(at.force, k, _plus(_carried(w, wd, h), a, m))
        _put(at.moment, k, moment)
    at.tau[:] = 0.0
    for k in range(len(tree.parent) - 1, -1, -1):
        # About the origin of the joint's frame.
        force = _of(at.force, k)
        moment = _plus(_of(at.moment, k), _cross(_of(at.offset, k), force), 1.0)
        own = _dot(_of(tree.axis, k), moment if tree.revolute[k] else force)
        at.tau[tree.coordinate[k]] += tree.ratio[k] * own
        p = tree.parent[k]
        if p >= 0:
            force = _out(at.rotation[k], force)
            moment = _out(at.rotation[k], moment)
            moment = _plus(moment, _cross(_of(tree.before, k), force), 1.0)
            _put(at.force, p, _plus(_of(at.force, p), force, 1.0))
            _put(at.moment, p, _plus(_of(at.moment, p), moment, 1.0))


@_compiled
def _stumpff(x: float) -> tuple[float, float]:
    """As `effects.spring.stumpff`, of a number."""
    if abs(x) < SERIES:
        return 1 - x / 2 * (1 - x / 12 * (1 - x / 30)), 1 - x / 6 * (1 - x / 20 * (1 - x / 42))
    root = math.sqrt(abs(x))
    if x < 0:
        return math.cosh(root), math.sinh(root) / root
    return math.cos(root), math.sin(root) / root


@_compiled
def _at_rest(tree: Tree, q: Array, at: _Posture) -> None:
    """The torques of gravity, as far as joints feel it, and of springs, where links are placed."""
    g = tree.gravity
    _move(tree, at.still, at.still, (-g[0], -g[1], -g[2]), at)
    _press(tree, tree.felt, at)
    for s in range(len(tree.springs)):
        j, curvature, stiffness, torque = tree.springs[s]
        x = q[int(j)]
        c, s1 = _stumpff(curvature * x * x)
        at.tau[int(j)] += stiffness * x * s1 + torque * c


@_compiled
def _heights(tree: Tree, row: Array, at: _Posture) -> None:
    """Into a row of 4 + 4 n numbers: the height of a homogeneous point of the link, and its
    derivatives by the coordinates.

    A base that accelerates upwards by 1 lifts every link by the upward unit vector; what holds a
    unit mass is then the derivative of its height, and what holds a unit first moment that of the
    height of a unit vector.
    """
    n = len(at.tau)
    _move(tree, at.still, at.still, (tree.up[0], tree.up[1], tree.up[2]), at)
    k = tree.link
    row[0], row[1], row[2] = at.a[k]
    row[3] = 0.0
    body = np.zeros_like(tree.pi)
    for c in range(4):
        body[k, (c + 1) % 4] = 1.0
        _press(tree, body, at)
        body[k, (c + 1) % 4] = 0.0
        for j in range(n):
            row[4 + 4 * j + c] = at.tau[j]
    while k >= 0:
        p = tree.parent[k]
        carrier = _of(at.a, p) if p >= 0 else (tree.up[0], tree.up[1], tree.up[2])
        row[3] += _dot(_of(at.a, k), _of(at.offset, k)) + _dot(carrier, _of(tree.before, k))
        k = p


@_compiled
def _body(tree: Tree, q: Array, dq: Array, row: Array, at: _Posture) -> None:
    """Into a row of `bodies`, with zeros for the stiffness."""
    n = len(q)
    nothing = (0.0, 0.0, 0.0)
    row[:] = 0.0
    _place(tree, q, at)
    for j in range(n):
        at.unit[j] = 1.0
        _move(tree, at.still, at.unit, nothing, at)
        _press(tree, tree.pi, at)
        at.unit[j] = 0.0
        for i in range(n):
            row[(j - i) % n * n + i] = at.tau[i]
    _move(tree, dq, at.still, nothing, at)
    _press(tree, tree.pi, at)
    bias = 2 * n * n + n
    for i in range(n):
        row[bias - n + i], row[bias + i] = q[i], at.tau[i]
    _at_rest(tree, q, at)
    for i in range(n):
        row[bias + i] += at.tau[i]
    if tree.link >= 0:
        _heights(tree, row[bias + n :], at)


@_compiled
def bodies(tree: Tree, q: Array, dq: Array) -> Array:
    """(T, F) the rigid body near a motion (T, n): see `servo_loop.Body`."""
    rows, n = q.shape
    out = np.empty((rows, 2 * n * n + 6 * n + 4))
    at, rest, there = _posture(len(tree.parent), n), np.empty(n), np.empty(n)
    for t in range(rows):
        _body(tree, q[t], dq[t], out[t], at)
        _at_rest(tree, q[t], at)
        rest[:], there[:] = at.tau, q[t]
        for j in range(n):
            there[j] += SLIGHT
            _place(tree, there, at)
            _at_rest(tree, there, at)
            there[j] = q[t, j]
            for i in range(n):
                out[t, n * n + (j - i) % n * n + i] = (at.tau[i] - rest[i]) / SLIGHT
    return out


# Steps.


class Runs(NamedTuple):
    """What is to be simulated.

    Attributes:
        tree: the robot, whose body is evaluated on the way if there are no rows.
        rows: (T, F) the body halfway from each row of the tracks to the next, or (0, F).
        joint: (P, W or 1, n, K) sets, parameters in the order of `COLUMNS`.
        plane: (P, W or 1, 5) see `servo.PLANE`.
        points: (n, S, T) set-points.
        owner: (P, W or 1) which of them a set has.
        jump_at: (n, S, T) when they jump between a row and the next, in samples; infinite where
            they go on lines. (0, 0, 0) if all do.
        summed: (P, W, n) torque of integral action where windows begin [N m].
        order: (W,) the windows, longest first.
        begin, start, length: (W,) first row of the motion of each, its own, and how many.
        q, dq: (W, n) state there [rad, rad/s].
        dt: sampling interval [s].
        parts, each: parts of a sample in which the body stays the same, and steps of those.
        contact_damping: of the plane [N s/m].
    """

    tree: Tree
    rows: Array
    joint: Array
    plane: Array
    points: Array
    owner: Rows
    jump_at: Array
    summed: Array
    order: Rows
    begin: Rows
    start: Rows
    length: Rows
    q: Array
    dq: Array
    dt: float
    parts: int
    each: int
    contact_damping: float


class _Lanes(NamedTuple):
    """Windows side by side: m of them, of n joints.

    Attributes:
        who, at: (m,) which, and the row of each whose sample ends next.
        w: what a step holds, by slots.
        body: (n n, m) matrices by cyclic diagonals, mass then stiffness, and (2 n, m) the position
            that they are of and the bias.
        a, s: (P, ...) parameters and states of sets, by slots.
        deep, hard: (m,) how far below a plane its point is where the body is near, and stiffness.
    """

    who: Rows
    at: Rows
    w: Array
    body: Array
    a: Array
    s: Array
    deep: Array
    hard: Array


@_compiled
def _parameters(a: Array, joint: Array, i: int, dt: float, h: float) -> None:
    """Write the parameters (K,) of one servo, and what follows from them, into place i of a set's
    slots."""
    for k in range(len(joint)):
        a[k * SLOT + i] = joint[k]
    kp, kd = a[KP + i], a[KD + i]
    behind = a[DELAY + i] / dt
    a[DELAY + i] = math.floor(behind)
    a[PART + i] = behind - a[DELAY + i]
    a[RATE + i] = kd / dt
    # Of speeds, in the exponent of what fades with them.
    a[FADING + i] = -1 / a[STRIBECK + i]
    stop = max(STOP_SHARE * kp, STOP_STIFFNESS)
    a[STOP + i] = stop
    a[HARD + i] = stop * THETA * h + 2 * math.sqrt(stop * (a[ARMATURE + i] + STOP_INERTIA))
    # What a step takes from the torque of a servo that goes at its mean velocity.
    inside = a[DAMPING_SHARE + i] * a[DAMPING + i]
    a[GAIN + i] = kp * (THETA * h) + kd + inside
    a[OUTSIDE + i] = a[DAMPING + i] - inside
    a[INSIDE + i] = kd + inside


@_compiled
def _aim(run: Runs, lanes: _Lanes, p: int, n: int, m: int) -> bool:
    """Three set-points around the delayed instant of a sample, as the first and the differences to
    the two after it; before a motion its first. Whether any jumps."""
    w, a, jumps = lanes.w, lanes.a[p], len(run.jump_at) > 0
    jumping = False
    for j in range(n):
        for lane in range(m):
            i, o = j * m + lane, lanes.who[lane]
            points = run.points[j, run.owner[p, o if run.owner.shape[1] > 1 else 0]]
            begin, k = run.begin[o], lanes.at[lane] - int(a[DELAY + i]) - 2
            k0, k1, k2 = max(k, begin), max(k + 1, begin), max(k + 2, begin)
            w[X0 + i] = points[k0]
            w[D0 + i] = points[k1] - points[k0]
            w[D1 + i] = points[k2] - points[k1]
            if jumps:
                jump_at = run.jump_at[j, run.owner[p, o if run.owner.shape[1] > 1 else 0]]
                w[J0 + i], w[J1 + i] = jump_at[k0], jump_at[k1] + 1
                w[F0 + i] = w[D0 + i] if jump_at[k0] < math.inf else 0.0
                w[F1 + i] = w[D1 + i] if jump_at[k1] < math.inf else 0.0
                jumping = jumping or jump_at[k0] < math.inf or jump_at[k1] < math.inf
    return jumping


@_compiled
def _take(row: Array, lanes: _Lanes, lane: int, n: int, m: int) -> None:
    """A row of the body's into lane lane."""
    for c in range(2 * n * n + 2 * n):
        lanes.body[c * m + lane] = row[c]
    for i in range(n):
        lanes.w[NEAR + i * m + lane] = row[2 * n * n + i]
        outweighs = 0.0
        for d in range(1, n):
            outweighs += abs(row[d * n + i])
        lanes.w[DOMINANCE + i * m + lane] = outweighs


@_compiled
def _reach(row: Array, plane: Array, lanes: _Lanes, lane: int, n: int, m: int) -> None:
    """How far below the plane (5,) the point of lane lane is by a row of the body's, and slopes."""
    x, y, z, level, lanes.hard[lane] = plane
    up = row[2 * n * n + 2 * n :]
    lanes.deep[lane] = level - (up[0] * x + up[1] * y + up[2] * z + up[3])
    for j in range(n):
        s = up[4 + 4 * j : 8 + 4 * j]
        lanes.w[SLOPE + j * m + lane] = s[0] * x + s[1] * y + s[2] * z + s[3]


@_compiled
def _settle_in(lanes: _Lanes, p: int, n: int, m: int, wait: float, h: float) -> None:
    """The load in the middle of a part of a sample, and factors of the velocities.

    Where coupling outweighs a joint's own inertia, as much is added on both sides of the equation,
    here with this step's acceleration, there with the last one's.
    """
    w, a, body, size = lanes.w, lanes.a[p], lanes.body, n * m
    for i in range(size):
        way = w[Q + i] + w[V + i] * wait - w[NEAR + i]
        w[AHEAD + i], w[AHEAD + size + i] = way, way
        w[LOAD + i] = body[2 * n * size + size + i]
    for d in range(n):
        # As arrays of their own, whose products are taken several at a time.
        stiffness, ahead = body[(n + d) * size :], w[AHEAD + d * m :]
        for i in range(size):
            w[LOAD + i] += stiffness[i] * ahead[i]
    for i in range(size):
        own = body[i] + a[ARMATURE + i]
        w[LACKING + i] = max(w[DOMINANCE + i] - own, 0.0)
        w[LEAN + i] = (own + w[LACKING + i]) / (THETA * h)
        w[SOFT + i] = w[LEAN + i] + a[OUTSIDE + i]
        w[PUSH + i] = 0.0


@_compiled
def _drive(w: Array, a: Array, size: int, z: int, steps: int, jumping: bool) -> None:
    """The servos' torque of joints at rest in step z of a sample, and all others but friction,
    coupling and contact.

    Within a sample the delayed set-point bends once. Its rate is the mean over the step, so that it
    changes with the delay without a jump; a jump is, too.
    """
    for i in range(size):
        part, rate = a[PART + i], a[RATE + i]
        at = 1 - part + (z + THETA) / steps
        near, far = min(at, 1.0), max(at - 1, 0.0)
        later = rate * _between(z + 1 - part * steps, 0.0, 1.0)
        error = w[X0 + i] - w[Q + i] + near * w[D0 + i] + far * w[D1 + i]
        if jumping:
            error += (_between((at - w[J0 + i]) * steps + 0.5, 0.0, 1.0) - near) * w[F0 + i]
            error += (_between((at - w[J1 + i]) * steps + 0.5, 0.0, 1.0) - far) * w[F1 + i]
        error -= _between(error, -a[DEAD_ZONE + i], a[DEAD_ZONE + i])
        w[ERROR + i] = error
        drive = error * a[KP + i] + (rate - later) * w[D0 + i] + later * w[D1 + i]
        w[DRIVE + i] = drive + w[SUM + i]
        w[REST + i] = a[OFFSET + i] - w[LOAD + i] + w[LEAN + i] * w[V + i]
        # Critically damped end stops.
        beyond = w[Q + i] - _between(w[Q + i], a[LOW + i], a[HIGH + i])
        w[REST + i] -= a[STOP + i] * beyond
        w[MORE + i] = a[HARD + i] if beyond != 0 else 0.0


@_compiled
def _touch(lanes: _Lanes, n: int, m: int, h: float, damping: float) -> None:
    """Torques of the plane. One without stiffness is none: it does not damp, either."""
    w, size = lanes.w, n * m
    for i in range(size):
        w[W + i] = w[SLOPE + i] * (w[Q + i] + w[V + i] * (THETA * h) - w[NEAR + i])
        w[V1 + i] = w[SLOPE + i] * w[V + i] * damping
        w[PUSH + i] = 0.0
    for j in range(1, n):
        deeper, faster = w[W + j * m :], w[V1 + j * m :]
        for lane in range(m):
            w[W + lane] += deeper[lane]
            w[V1 + lane] += faster[lane]
    touching = False
    for lane in range(m):
        depth = lanes.deep[lane] - w[W + lane]
        force = max(lanes.hard[lane] * depth - w[V1 + lane], 0.0)
        w[FREE + lane] = force if depth > 0 and lanes.hard[lane] > 0 else 0.0
        touching = touching or w[FREE + lane] > 0
    if not touching:
        return
    for j in range(1, n):
        force_too = w[FREE + j * m :]
        for lane in range(m):
            force_too[lane] = w[FREE + lane]
    for i in range(size):
        slope, force = w[SLOPE + i], w[FREE + i]
        w[PUSH + i] = slope * force
        w[REST + i] += slope * force
        w[MORE + i] += slope * slope * damping if force > 0 else 0.0


@_compiled
def _exp(x: float) -> float:
    """exp x of x <= 0, to rounding: several at a time, as `math.exp` is not. A sum with 1.5 2^52
    has the nearest integer in its last bits, which are those of an exponent, moved."""
    x = max(x, -700.0)
    shifted = np.float64(x * LOG2_E + ROUNDING)
    whole = shifted - ROUNDING
    y = x - whole * LN2_HIGH - whole * LN2_LOW
    out = 1 / 6227020800.0
    for factor in (479001600, 39916800, 3628800, 362880, 40320, 5040, 720, 120, 24, 6, 2, 1, 1):
        out = out * y + 1 / factor
    return out * np.int64((shifted.view(np.int64) + 1023) << 52).view(np.float64)


@_compiled
def _feed(w: Array, a: Array, n: int, m: int) -> None:
    """The share of its voltage that the supply has left, 1 - sum / S of the torques that it leaves:
    1 / (1 + sum / S) of those at full voltage, f = 1 - f sum / S."""
    for lane in range(m):
        total = 0.0
        for i in range(lane, n * m, m):
            total += abs(
                _between(w[DRIVE + i] - a[INSIDE + i] * w[V + i], -a[CLIP + i], a[CLIP + i])
            )
        for i in range(lane, n * m, m):
            w[POWER + i] = 1 / (1 + total / a[SUPPLY + i])


@_compiled
def _resist(w: Array, a: Array, size: int, fades: bool, bends: bool) -> None:
    """The most that dry friction can hold now, of the torques of the motor, from outside, and their
    difference, which the gear transmits."""
    for i in range(size):
        motor = _between(w[DRIVE + i] - a[INSIDE + i] * w[V + i], -a[CLIP + i], a[CLIP + i])
        motor *= w[POWER + i]
        external = w[PUSH + i] - w[LOAD + i]
        shared = abs(a[LOAD_SHARE + i] * external - a[MOTOR_SHARE + i] * motor)
        w[DRY + i] = a[COULOMB + i] + shared
        w[HELD + i] = a[STICTION + i] + a[STICTION_SHARE + i] * abs(external - motor)
        w[SLIP + i] = abs(w[V + i]) * a[FADING + i]
    if bends:
        for i in range(size):
            w[SLIP + i] = -((-w[SLIP + i]) ** a[EXPONENT + i])
    if fades:
        for i in range(size):
            w[DRY + i] += w[HELD + i] * _exp(w[SLIP + i])


@_compiled
def _solve(lanes: _Lanes, p: int, n: int, m: int, h: float, sweeps: int, settled: float) -> None:
    """Mean velocities of a step, and velocities and accelerations at its end: friction holds a
    joint if it can, the servo gives no more than it can, and coupling has the accelerations of the
    solution before, until they are those of this step or `sweeps` are made."""
    w, a, body, size = lanes.w, lanes.a[p], lanes.body, n * m
    for i in range(size):
        soft = w[SOFT + i] + w[MORE + i]
        w[SLIP + i], w[HELD + i] = 1 / soft, 1 / (soft + a[GAIN + i] * w[POWER + i])
        w[A1 + i], w[A1 + size + i] = w[A + i], w[A + i]
    for _ in range(sweeps):
        for i in range(size):
            w[FREE + i] = w[REST + i] + w[LACKING + i] * w[A1 + i]
        for d in range(1, n):
            coupling, of = body[d * size :], w[A1 + d * m :]
            for i in range(size):
                w[FREE + i] -= coupling[i] * of[i]
        for i in range(size):
            free, drive, dry = w[FREE + i], w[DRIVE + i], w[DRY + i]
            total = free + drive * w[POWER + i]
            mean = (total - _between(total, -dry, dry)) * w[HELD + i]
            torque = drive - a[GAIN + i] * mean
            held = _between(torque, -a[CLIP + i], a[CLIP + i])
            total = free + held * w[POWER + i]
            slipping = (total - _between(total, -dry, dry)) * w[SLIP + i]
            mean = slipping if torque != held else mean
            # What is held is at rest.
            v = (mean - (1 - THETA) * w[V + i]) / THETA if mean != 0 else 0.0
            w[W + i], w[V1 + i] = mean, v
            w[FREE + i] = (v - w[V + i]) / h
        change = 0.0
        if settled > 0:
            for i in range(size):
                change = max(change, abs(w[FREE + i] - w[A1 + i]))
        for i in range(size):
            w[A1 + i], w[A1 + size + i] = w[FREE + i], w[FREE + i]
        if change * h * h < settled:
            break


@_compiled
def _advance(w: Array, a: Array, size: int, h: float) -> None:
    """To the end of a step."""
    for i in range(size):
        more = w[SUM + i] + a[INTEGRAL + i] * h * (w[ERROR + i] - w[W + i] * (THETA * h))
        # What the servo cannot give is not summed.
        w[SUM + i] = _between(more, -a[CLIP + i], a[CLIP + i])
        w[Q + i] += w[W + i] * h
        w[V + i], w[A + i] = w[V1 + i], w[A1 + i]


@_compiled
def simulate(run: Runs, out: Array) -> None:
    """Into positions (L, W, n, P) at the rows of windows; see `servo_loop.rollout`."""
    count, n = run.q.shape
    sets, each_own = len(run.joint), run.joint.shape[1] > 1
    known = len(run.rows) > 0
    steps = run.parts * run.each
    h = run.dt / steps
    wait = run.each * h / 2
    sweeps, settled = (TOGETHER, 0.0) if known else (SWEEPS, SETTLED)
    # What takes the longest, and is left out where no set has it.
    fades = bool((run.joint[..., STICTION // SLOT] > 0).any())
    fades = fades or bool((run.joint[..., STICTION_SHARE // SLOT] > 0).any())
    bends = fades and bool((run.joint[..., EXPONENT // SLOT] != 1).any())
    touches = bool((run.plane[..., 4] > 0).any())
    sags = bool((run.joint[..., SUPPLY // SLOT] < math.inf).any())
    # A body that is evaluated costs more than all else: one window after the other.
    most = max(1, min(LANES, SLOT // (2 * n))) if known else 1
    w, a = np.zeros(SLOTS * SLOT + SLOT), np.zeros((sets, PARAMETERS * SLOT))
    w[POWER : POWER + SLOT] = 1.0
    s, body = np.zeros((sets, 4 * SLOT)), np.zeros((2 * n * n + 2 * n) * most)
    deep, hard = np.zeros((2, most))
    who, at = np.zeros(most, np.int64), np.zeros(most, np.int64)
    lanes = _Lanes(who, at, w, body, a, s, deep, hard)
    row, posture = np.zeros(2 * n * n + 6 * n + 4), _posture(len(run.tree.parent), n)
    q, dq, alike = np.zeros(n), np.zeros(n), np.zeros(sets, np.bool_)
    for w0 in range(0, count, most):
        m = min(most, count - w0)
        size = n * m
        for lane in range(m):
            who[lane] = o = run.order[w0 + lane]
            for p in range(sets):
                for j in range(n):
                    i = j * m + lane
                    _parameters(a[p], run.joint[p, o if each_own else 0, j], i, run.dt, h)
                    s[p, Q + i], s[p, V + i], s[p, A + i] = run.q[o, j], run.dq[o, j], 0.0
                    s[p, SUM + i] = run.summed[p, o, j]
                    out[0, o, j, p] = run.q[o, j]
        # Sets that have set-points and delays as the one before has: theirs are looked up once.
        for p in range(1, sets):
            delays = a[p, DELAY : DELAY + size] == a[p - 1, DELAY : DELAY + size]
            alike[p] = (run.owner[p] == run.owner[p - 1]).all() and delays.all()
        jumping = False
        for k in range(1, run.length[who[0]]):
            for lane in range(m):
                # Windows that have ended stand still.
                at[lane] = run.start[who[lane]] + min(k, run.length[who[lane]] - 1)
                if known:
                    _take(run.rows[at[lane] - 1], lanes, lane, n, m)
            for p in range(sets):
                own = a[p]
                for slot in (Q, V, A, SUM):
                    for i in range(size):
                        w[slot + i] = s[p, slot + i]
                if not alike[p]:
                    jumping = _aim(run, lanes, p, n, m)
                for z in range(steps):
                    if z % run.each == 0:
                        if not known:
                            for j in range(n):
                                dq[j] = w[V + j] + w[A + j] * wait
                                q[j] = w[Q + j] + (w[V + j] + dq[j]) * (wait / 2)
                            _body(run.tree, q, dq, row, posture)
                            _take(row, lanes, 0, n, m)
                        if touches:
                            for lane in range(m):
                                near = run.rows[at[lane] - 1] if known else row
                                o = who[lane] if run.plane.shape[1] > 1 else 0
                                _reach(near, run.plane[p, o], lanes, lane, n, m)
                        _settle_in(lanes, p, n, m, wait, h)
                    _drive(w, own, size, z, steps, jumping)
                    if touches:
                        _touch(lanes, n, m, h, run.contact_damping)
                    if sags:
                        _feed(w, own, n, m)
                    _resist(w, own, size, fades, bends)
                    _solve(lanes, p, n, m, h, sweeps, settled)
                    _advance(w, own, size, h)
                for slot in (Q, V, A, SUM):
                    for i in range(size):
                        s[p, slot + i] = w[slot + i]
                for lane in range(m):
                    if k < run.length[who[lane]]:
                        for j in range(n):
                            out[k, who[lane], j, p] = w[Q + j * m + lane]
