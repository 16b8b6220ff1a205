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

Loops over samples are compiled (`servo_kernel`), on the CPU and in float64: nothing here has a
gradient.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchid.dynamics.forward import gravity_torque
from torchid.dynamics.recursion import chain_geometry
from torchid.effects.registry import nominal_effects
from torchid.effects.servo import INDEX
from torchid.effects.spring import JointSpring
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import Robot
from torchid.simulation.servo import Servos
from torchid.typing import Bool, Float, Int

STEP = 0.005
"""Longest step, and longest time for which the rigid body is what it is in its middle [s]."""
NEARLY = 0.05
"""Share of a step by which steps may be longer: clocks of logs are not exact [1]."""
CONTACT_DAMPING = 20.0
"""Of the plane [N s/m]."""
PROFILE = ("scale", "acceleration", "speed", "lag")
FASTEST = (1e6, 1e4)
"""Acceleration [rad/s^2] and speed [rad/s] of set-points that are as good as not limited."""
LONE, MIDDLE = 3.0, 0.5
"""Times the changes before and after it from which a change of a set-point is a jump; and when that
is, in samples, where nothing tells [1]."""
_SLIGHT = 1e-6
"""Changes of a set-point that are rounding [rad]."""


@dataclass(frozen=True, eq=False)
class Body:
    """The rigid body's torque near a motion q: M(q) ddq + bias + stiffness (q' - q).

    Attributes:
        rows: (T, F) of each instant: mass matrix [kg m^2] and stiffness, the derivative of
            gravity's and the springs' torque [N m/rad], by cyclic diagonals (entry i of the d-th is
            (i, (i + d) % n)); q [rad]; bias, the torque at zero acceleration [N m]; height of a
            homogeneous point of the link that may touch a plane, and (n, 4) its derivative by the
            joints.
        n: number of joints.
    """

    rows: Float[Tensor, "T F"]
    n: int

    @property
    def bias(self) -> Float[Tensor, "T n"]:
        """(T, n) [N m]."""
        return self.rows[:, 2 * self.n**2 + self.n :][:, : self.n]

    @property
    def height(self) -> Float[Tensor, "T 4"]:
        """(T, 4) [m; 1 of the unit vectors]."""
        return self.rows[:, 2 * self.n**2 + 2 * self.n :][:, :4]

    def midway(self, last: Int[Tensor, " m"]) -> "Body":
        """It between each instant and the next one, for steps from one to the other; at the last
        instants of motions as it is there."""
        after = torch.arange(1, len(self.rows) + 1)
        after[last] = last
        return Body((self.rows + self.rows[after]) / 2, self.n)


def body_near(
    robot: Robot, q: Float[Tensor, "T n"], dq: Float[Tensor, "T n"], link: int | None
) -> Body:
    """The rigid body linearised about a motion, with the heights of a link's points if asked.

    Raises:
        RobotError: the robot has no inertial parameters.
    """
    from torchid.simulation import servo_kernel as kernel

    rows = kernel.bodies(_tree(robot, link), _array(q), _array(dq))
    return Body(torch.from_numpy(rows), robot.n)


def _tree(robot: Robot, link: int | None) -> Any:
    """The robot as compiled code has it."""
    from torchid.simulation import servo_kernel as kernel

    geometry = chain_geometry(robot)
    pi = _array(robot.require_parameters("motions of its servos").pi)
    felt = pi.copy()
    if robot.compensated is not None:
        felt[:, :4] -= _array(robot.compensated)
    springs = [
        (effect.joint, effect.curvature, *values)
        for effect, values in nominal_effects(robot)
        if isinstance(effect, JointSpring)
    ]

    def of(name: str, kind: type = float) -> np.ndarray:
        return np.array([getattr(joint, name) for joint in geometry.joints], kind)

    return kernel.Tree(
        of("parent", int), of("coordinate", int), of("ratio"), of("offset"), of("revolute", bool),
        of("constant"), of("cosine"), of("sine"), of("previous_offset"), of("link_offset"),
        of("axis"), np.array(geometry.gravity), _array(upwards(robot)), pi, felt,
        np.array(springs, float).reshape(-1, 4), -1 if link is None else link,
    )  # fmt: skip


def _array(x: Tensor) -> np.ndarray:
    """As compiled code takes it."""
    x = x.detach().cpu().contiguous()
    return (x.double() if x.is_floating_point() else x).numpy()


def upwards(robot: Robot) -> Float[Tensor, "3"]:
    """Unit vector against gravity; a robot without gravity has no floor, but z."""
    up = -robot.gravity.double() if bool(robot.gravity.any()) else torch.eye(3).double()[2]
    return up / up.norm()


def compensation(robot: Robot, q: Float[Tensor, "T n"]) -> Float[Tensor, "T n"]:
    """Torque of the weight that servos do not feel [N m]."""
    if robot.compensated is None:
        return torch.zeros_like(q)
    pi = torch.nn.functional.pad(robot.compensated, (0, PARAMETERS_PER_LINK - 4))
    return gravity_torque(robot, q, InertialParameters(pi))


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
    profile: Float[Tensor, "S n 4"], tracks: Tracks, *, repeated: bool
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
    """
    from torchid.simulation import servo_kernel as kernel

    u, limits, first, last = map(_array, (tracks.u, profile, tracks.first, tracks.last))
    fastest = np.array(FASTEST)
    out = kernel.set_points(u, limits, first, last, tracks.dt, repeated, fastest)
    return torch.from_numpy(out)


def jumps(points: Float[Tensor, "*D T"]) -> Bool[Tensor, "*D T"]:
    """Whether a set-point jumps between a row and the next, and does not go along a line."""
    change = points.diff().abs()
    near = torch.nn.functional.pad(change, (1, 1))
    lone = change > LONE * torch.maximum(near[..., :-2], near[..., 2:]) + _SLIGHT
    return torch.nn.functional.pad(lone, (0, 1))


def profiles_of(servos: Servos) -> Float[Tensor, "S n 4"]:
    """What makes the set-points of every set of servos."""
    return servos.joint[..., [INDEX[name] for name in PROFILE]].flatten(0, -3)


def profile_step(e: Tensor, v: Tensor, a: Tensor, top: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """How far the fastest way to rest at a distance e goes within dt, and its velocity then."""
    # Towards the goal, unless the braking distance is longer than what is left.
    side = torch.where(e - v * abs(v) / (2 * a) >= 0, 1.0, -1.0)
    peak = torch.minimum((side * a * e + v * v / 2).clamp(min=0).sqrt(), top)
    speed = side * v
    t_up = ((peak - speed) / a).clamp(min=0)
    # The way while it speeds up and while it brakes; the rest at constant speed.
    up, down = (speed + peak) / 2 * t_up, peak * peak / (2 * a)
    t_even = ((side * e - up - down) / peak.clamp(min=1e-12)).clamp(min=0)
    first = t_up.clamp(max=dt)
    second = torch.minimum(t_even, dt - first)
    third = torch.minimum(peak / a, dt - first - second)
    way = speed * first + a * first * first / 2
    now = speed + a * first
    way = way + now * second + now * third - a * third * third / 2
    return side * way, side * (now - a * third)


@torch.inference_mode()
def rollout(
    servos: Servos,
    body: Body | Robot,
    tracks: Tracks,
    windows: Windows,
    q: Float[Tensor, "W n"],
    dq: Float[Tensor, "W n"],
    *,
    points: Float[Tensor, "n S T"] | None = None,
    owner: Int[Tensor, " P"] | None = None,
    measured: Float[Tensor, "T n"] | None = None,
    longest_step: float = STEP,
) -> Float[Tensor, "L W n P"]:
    """Positions of arms that start at q, dq and are given the commands of a log.

    Args:
        servos: (P, n, K) for P sets on every window, or (W, 1, n, K) for one set a window.
        body: halfway from each row of the tracks to the next (`Body.midway`); or the robot, whose
            body is evaluated on the way.
        tracks: the commands.
        windows: W stretches of them.
        q, dq: state at the first row of each window [rad, rad/s].
        points: set-points, if known.
        owner: which row of them each set has (default: 0, 1, ...).
        measured: positions, whose errors until a window begins are what an integrating servo has
            summed by then; without them it begins where the arm would stand still [rad].
        longest_step: of the integration [s].

    Returns:
        (L, W, n, P) at the rows of each window; NaN after its last.

    Raises:
        RobotError: a robot without inertial parameters.
    """
    from torchid.simulation import servo_kernel as kernel

    # (P, W or 1, ...) of sets and windows.
    each = servos.joint.ndim == 4
    joint, plane = (x.transpose(0, 1) if each else x[:, None] for x in (servos.joint, servos.plane))
    if points is None:
        profiles, owner = profiles_of(servos).unique(dim=0, return_inverse=True)
        points = set_points(profiles, tracks, repeated=servos.repeated)
    whose = torch.arange(len(servos.joint)) if owner is None else owner
    whose = whose[None] if each else whose[:, None]
    lone = jumps(points)
    jump_at = points.new_empty(0, 0, 0)
    if bool(lone.any()):
        at = torch.full_like(points[0, 0], MIDDLE) if tracks.jump_at is None else tracks.jump_at
        jump_at = torch.where(lone, at, math.inf)
    summed = torch.zeros(len(joint), *q.shape)
    if bool((servos.of("integral") > 0).any()):
        summed = _summed(joint, body, tracks, windows, q, points, whose, measured)
    # A body that is not known beforehand is evaluated in each part of a sample.
    if isinstance(body, Robot):
        touching = bool((servos.plane[..., 4] > 0).any())
        tree, rows = _tree(body, servos.link % body.n if touching else None), q.new_empty(0, 0)
        parts = max(1, math.ceil(tracks.dt / STEP - NEARLY))
    else:
        tree, rows, parts = kernel.NO_TREE, body.rows, 1
    given = (
        rows, joint[..., [INDEX[name] for name in kernel.COLUMNS]], plane, points, whose, jump_at,
        summed, windows.length.argsort(descending=True, stable=True),
        tracks.first[windows.motion], windows.start, windows.length, q, dq,
    )  # fmt: skip
    each_part = math.ceil(tracks.dt / parts / longest_step - NEARLY)
    out = np.full((int(windows.length.max()), *q.shape, len(joint)), math.nan)
    runs: Any = tree, *map(_array, given), tracks.dt, parts, each_part, CONTACT_DAMPING
    kernel.simulate(kernel.Runs(*runs), out)
    return torch.from_numpy(out)


def _summed(
    joint: Float[Tensor, "P V n K"],
    body: Body | Robot,
    tracks: Tracks,
    windows: Windows,
    q: Float[Tensor, "W n"],
    points: Float[Tensor, "n S T"],
    owner: Int[Tensor, "P V"],
    measured: Float[Tensor, "T n"] | None,
) -> Float[Tensor, "P W n"]:
    """Torque of integral action where windows begin, of motions that began at rest: there the servo
    bore the load."""
    kp, integral, delay, offset = (
        joint[..., INDEX[name]] for name in ("kp", "integral", "delay", "offset")
    )
    first, rows = tracks.first[windows.motion], windows.start
    began = q if measured is None else measured[first]
    if isinstance(body, Robot):
        bias = body_near(body, began, torch.zeros_like(began), None).bias
    else:
        bias = body.bias[first]
    x = points.permute(1, 2, 0)[owner, first]
    held = torch.where(integral > 0, bias - offset - kp * (x - began), 0.0)
    if measured is None:
        return held

    # Sums over time of the set-points, late as they are, and of what was measured.
    def until(series: Tensor) -> Tensor:
        middle = (series[..., 1:] + series[..., :-1]) / 2
        return torch.nn.functional.pad(middle.cumsum(-1), (1, 0))

    first, rows = first[:, None], rows[:, None]
    behind = torch.minimum(delay / tracks.dt, rows - first)
    late = rows - behind
    before = late.floor().long()
    sums, joints = until(points), torch.arange(len(points))
    low, high, zero = (
        sums[joints, owner[..., None], torch.maximum(k, first)] for k in (before, before + 1, first)
    )
    goals = torch.lerp(low, high, late - before) - zero + behind * x
    way = until(measured.T).T
    return held + integral * tracks.dt * (goals - (way[rows[:, 0]] - way[first[:, 0]]))
