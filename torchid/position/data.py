"""What logs of commands and positions become before servos are fitted to them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import torch

from torchid.dynamics.forward import gravity_torque
from torchid.effects.servo import INDEX, PARAMETERS
from torchid.errors import LogError
from torchid.log.checks import (
    SLOW_STEP_S,
    check_finite,
    check_joints,
    own_units,
    refuse_time,
)
from torchid.log.model import Log
from torchid.log.stamps import check_increasing
from torchid.position.rods import with_rods
from torchid.robot.inertia import InertialParameters
from torchid.robot.model import Robot
from torchid.simulation.servo_loop import Body, Tracks, Windows, body_near, compensation
from torchid.statistics.criteria import BODY_STD, SLIGHT_ERROR
from torchid.statistics.proportion import HALF_95
from torchid.typing import Bool, Float, Tensor

if TYPE_CHECKING:
    from torchid.position.in_mujoco import Beside

UNEVEN_RATE = 0.02
"""Share by which a rate may miss a multiple of `RATE` and count as one [1]."""
UNEVEN = 0.5
"""A step that differs from the median by more than this share of it is no jitter [1]."""
RATE = 100.0
"""What logs are thinned to, every second row or fewer, as far as they stay no slower [Hz]: commands
that are held longer than that are late by more than what is looked for."""
RATE_S = 0.08
"""Time over which a velocity is told [s]."""
WINDOW_S = 2.0
"""Length of the windows that fits and searches simulate [s]."""
STILL = 0.02
"""Slower than this a start is at rest: one count of a small servo's encoder in 0.1 s [rad/s]."""
SMALL = PARAMETERS[INDEX["kp"]].start
"""kp of a small servo [N m/rad]."""
BEARS, FRICTION = 0.2, 1.5
NO_STEP = 1e-9
"""Changes of a position below this are rounding [rad]."""
OUTWARDS = 3.0
JAW = 0.3
"""Share of the link before that a jaw weighs at most [1]."""
SHORTEST_S = 6.0
"""Shortest log that servos are sought in, of three windows [s]."""
GRAVITY_ROWS = 200
"""That tell which links a joint carries [1]."""
MOVES = 0.01
"""What varies by less, as a standard deviation within motions, does not move [rad]."""
GEARED = 1.7
"""Factor between commands and positions from which a search begins with it [1]."""
PROPORTIONAL = 0.95
"""Share of the commands' variance that a servo without limits explains, where it is one [1]."""


Usual = Mapping[str, Float[Tensor, " n"]]
"""By number that every servo has, the size (n,) up to which it is no cause."""


@dataclass(frozen=True, eq=False)
class PositionData:
    """Motions of an arm, in radians of the model.

    Attributes:
        robot: with the masses that it is given, or rods in their place.
        weighed: whether it was given any.
        log: as given, but for rows that are left out (`RATE`).
        scale: (n,) radians of the model per unit of the log, 1 unless the log's own velocities say
            otherwise.
        tracks: commands.
        held: how long a command of the log as given holds [s].
        q: (T, n) measured positions [rad].
        dq: (T, n) their rate, 0 where the joint is at rest [rad/s].
        body: the rigid body near the measured motion, halfway from each row to the next.
        strength: (n,) torques of each joint beside those of a small servo, where a fit starts [1].
        link: whose points may touch a plane, counted from 0.
        damping_share: (n,) of servos that are sought: how much of the damping their clip limits.
        beside: where the robot's file goes in its own simulator beside where its servos go in our
            kernel; None where no simulator is asked.
        set_points: those found last, beside the profiles that they are of.
    """

    robot: Robot
    weighed: bool
    log: Log
    scale: Float[Tensor, " n"]
    tracks: Tracks
    held: float
    q: Float[Tensor, "T n"]
    dq: Float[Tensor, "T n"]
    body: Body
    strength: Float[Tensor, " n"]
    link: int
    damping_share: Float[Tensor, " n"]
    beside: "Beside | None" = None
    set_points: dict[bool, tuple[Tensor, Tensor]] = field(default_factory=dict, repr=False)

    @property
    def slices(self) -> list[slice]:
        """Rows of each motion."""
        ends = zip(self.tracks.first.tolist(), self.tracks.last.tolist(), strict=True)
        return [slice(a, b + 1) for a, b in ends]

    @cached_property
    def still(self) -> Bool[Tensor, " n"]:
        """(n,) joints that never move: at rest an encoder may flicker between two counts."""
        return self.q.amax(0) - self.q.amin(0) < (2.5 * self.count).clamp(min=STILL)

    @property
    def count(self) -> Float[Tensor, " n"]:
        """(n,) of an encoder [rad]."""
        return self.resolution * 12**0.5

    @cached_property
    def resolution(self) -> Float[Tensor, " n"]:
        """(n,) what rounding to an encoder's count leaves [rad]."""
        out = []
        for q in self.q.T:
            steps = q.diff().abs()
            steps = steps[steps > NO_STEP]
            out.append(steps.quantile(0.05) / 12**0.5 if len(steps) else q.new_tensor(0.0))
        return torch.stack(out)

    @cached_property
    def slight(self) -> Float[Tensor, " n"]:
        """(n,) RMS errors that call for no cause [rad]: what rounding leaves, and so small a share
        of what parts positions from commands as a servo's own cycle and a bus's make."""
        apart = (self.tracks.u - self.q).square().mean(0)
        return (self.resolution**2 + SLIGHT_ERROR**2 * apart).sqrt()

    @cached_property
    def command_gain(self) -> Float[Tensor, " n"]:
        """(n,) how far a joint goes for its command, where commands are plainly of another size
        than positions: of actuators with a gear, say; 1 of other joints.

        A servo's command is its position, rate and acceleration, each times a number, and what is
        left of gravity and friction.
        """
        slow = [torch.gradient(self.dq[rows], dim=0)[0] / self.tracks.dt for rows in self.slices]
        columns = (self.q, self.dq, torch.cat(slow), self.dq.sign(), torch.ones_like(self.q))
        out = []
        for j, x in enumerate(torch.stack(columns, -1).unbind(1)):
            u = self.tracks.u[:, j]
            values = torch.linalg.lstsq(x, u, driver="gelsd").solution
            left, spread = (u - x @ values).square().mean(), u.var()
            gain = 1 / float(values[0]) if values[0] else 1.0
            least = min(float(self.q[:, j].std()), float(spread) ** 0.5)
            plain = bool(left < (1 - PROPORTIONAL) * spread) and least > MOVES
            far = not 1 / GEARED < gain < GEARED
            out.append(gain if plain and far else 1.0)
        return torch.tensor(out, dtype=torch.float64)

    @cached_property
    def torque_std(self) -> Float[Tensor, " n"]:
        """Standard deviation of the joints' torques that is the masses' alone, as a share [1]: what
        a robot's file says of its links is known to `BODY_STD`, of each link by itself."""
        pi = self.robot.require_parameters("gravity").pi
        rows = self.q[:: max(1, len(self.q) // GRAVITY_ROWS)]
        parts = torch.stack(
            [
                gravity_torque(
                    self.robot.with_parameters(InertialParameters(pi * one[:, None])), rows
                )
                for one in torch.eye(len(pi), dtype=pi.dtype)
            ]
        )
        whole = parts.sum(0)
        square = whole.square().sum(0)
        share = (parts * whole).sum(1) / square.clamp(min=1e-12)
        own = share.square().sum(0).sqrt().clamp(max=1.0)
        return BODY_STD * torch.where(square > 1e-9 * square.amax(), own, 1.0)

    @cached_property
    def usual(self) -> Usual:
        """Of delays and offsets.

        A command is held until the next one, half a sample late on average, from some instant of
        the bus's cycle on, which no row of a log tells. And of an arm's mean weight on a joint all
        that its masses may be wrong by is a constant torque; of rods nothing is known.
        """
        rows = self.q[:: max(1, len(self.q) // GRAVITY_ROWS)]
        weight = gravity_torque(self.robot, rows).mean(0).abs()
        unsure = HALF_95 * self.torque_std if self.weighed else torch.ones_like(weight)
        late = torch.full_like(weight, self.tracks.dt + 0.5 * self.held)
        return {"delay": late, "offset": unsure * weight}

    @property
    def outwards(self) -> Float[Tensor, "3"]:
        """A point in front of the outermost link: from its joint along its centre of mass, thrice
        as far [m, link's frame]."""
        com = self.robot.require_parameters("a point of the link").com[self.link].to(torch.float64)
        after = self.robot.after[self.link].to(torch.float64)
        joint = -after[:3, :3].T @ after[:3, 3]
        return joint + OUTWARDS * (com - joint)

    def start(self, windows: Windows) -> tuple[Tensor, Tensor]:
        """q and dq (W, n) at the first rows of windows."""
        return self.q[windows.start], self.dq[windows.start]


def tracks_of(log: Log, scale: Float[Tensor, " n"]) -> Tracks:
    """The commands of a log.

    A command that is not there (NaN) was not sent: the one before holds.

    Raises:
        LogError: it has none, or none where a motion begins; or it is not evenly sampled in
            seconds.
    """
    if log.u is None:
        raise LogError(
            f"{log.label} has no commands.",
            expected=f"columns u1..u{log.n}, commanded positions",
            available=["t", *log.signals],
        )
    check_increasing(log)
    u = _held(log)
    steps = torch.cat([log.t[rows].diff() for rows in log.slices()])
    dt = float(steps.median())
    if dt > SLOW_STEP_S:
        refuse_time(log, "does not look like seconds", dt)
    if not dt > 0 or bool(((steps - dt).abs() > UNEVEN * dt).any()):
        raise LogError(
            f"{log.label} is not evenly sampled.",
            got=f"steps of {float(steps.min()):.4g} to {float(steps.max()):.4g} s",
            expected=f"steps within {100 * UNEVEN:g} % of {dt:.4g} s",
            hint="cut the log where samples are missing, or number the parts in a column traj",
        )
    first = torch.tensor([rows.start for rows in log.slices()])
    last = torch.tensor([rows.stop - 1 for rows in log.slices()])
    return Tracks(u * scale, first, last, dt)


def _held(log: Log) -> Float[Tensor, "T n"]:
    """Commands, where one is missing the one before it of the motion."""
    assert log.u is not None
    known = log.u.isfinite()
    if bool(known.all()):
        return log.u
    row = torch.arange(log.samples)[:, None].expand_as(log.u)
    last = torch.where(known, row, -1).cummax(0).values
    first = torch.empty(log.samples, 1, dtype=torch.long)
    for rows in log.slices():
        first[rows] = rows.start
    none = last < first
    if bool(none.any()):
        k, j = none.nonzero()[0].tolist()
        motion = int(log.trajectory[k])
        count = int(none[log.slices()[motion], j].sum())
        raise LogError(
            f"{log.label}: '{log.names[motion]}' begins without commands.",
            got=f"no number in u{j + 1} in its first {count} rows",
            expected="a command from the first row on",
            hint="cut these rows: the command before them is not known",
        )
    return log.u.gather(0, last)


def missing_commands(log: Log) -> tuple[str, ...]:
    """What to say about commands that are not there, one sentence a joint."""
    if log.u is None:
        return ()
    out = []
    for j, gone in enumerate(~log.u.isfinite().T):
        if not bool(gone.any()):
            continue
        # The longest run of missing rows.
        runs = torch.where(gone, 0, 1).cumsum(0)[gone].bincount()
        step = log.steps[0].median
        out.append(
            f"joint {j + 1}: {int(gone.sum())} of {log.samples} commands are missing, at most "
            f"{float(runs.max()) * step:.3g} s of them in a row: the one before is held."
        )
    return tuple(out)


def rates(
    q: Float[Tensor, "T n"], tracks: Tracks, follows: Bool[Tensor, " m"]
) -> Float[Tensor, "T n"]:
    """Velocity by a cubic from a while before to as long after, for a fast motion turns within that
    time; 0 for a joint at rest, and where a recording begins or ends [rad/s].

    Args:
        q: positions.
        tracks: motions.
        follows: (m,) motions that go on where the one before ends.
    """
    dq, k = torch.zeros_like(q), max(1, round(RATE_S / 2 / tracks.dt))
    dq[k:-k] = (q[2 * k :] - q[: -2 * k]) / (2 * k * tracks.dt)
    rests = dq.abs() < STILL
    if k > 1:
        x = torch.arange(-k, k + 1, dtype=q.dtype)
        powers = x[:, None] ** torch.arange(4)
        dq[k:-k] = q.unfold(0, 2 * k + 1, 1) @ torch.linalg.pinv(powers)[1] / tracks.dt
    first, last = tracks.first[~follows], tracks.last[~follows.roll(-1)]
    for i in range(k):
        dq[torch.cat([first + i, last - i]).clamp(0, len(q) - 1)] = 0.0
    return dq.masked_fill(rests, 0.0)


def _thinned(log: Log, tracks: Tracks) -> tuple[Log, Tracks]:
    """Every k-th row, so that a log's rate is no reason for another answer."""
    k = math.floor((1 + UNEVEN_RATE) / (RATE * tracks.dt))
    if k < 2:
        return log, tracks
    rows = torch.cat([torch.arange(part.stop - part.start) % k == 0 for part in log.slices()])
    thin = log.select(rows)
    ends = torch.tensor([(part.start, part.stop - 1) for part in thin.slices()])
    return thin, Tracks(tracks.u[rows], ends[:, 0], ends[:, 1], k * tracks.dt)


def prepare(
    robot: Robot,
    log: Log,
    scale: Float[Tensor, " n"] | None = None,
    *,
    all_rows: bool = False,
) -> PositionData:
    """Motions as the fit takes them.

    Args:
        robot: links without inertial parameters are taken for rods (`with_rods`).
        log: t, q and u.
        scale: (n,) radians per unit of the log, where servos know them; as the log's own velocities
            say it if None.
        all_rows: whether a fast log is taken as it is, and not at `RATE`.

    Raises:
        LogError: other joints than the robot's, as `tracks_of`, positions that are not finite, no
            joint that moves, or less than `SHORTEST_S`.
    """
    check_joints(log, robot.name, robot.n)
    check_finite(log, commands=False)
    if scale is None:
        units = own_units(log)
        scale = torch.tensor([units.get(j, 1.0) for j in range(log.n)], dtype=torch.float64)
    tracks = tracks_of(log, scale)
    if sum(log.duration) < SHORTEST_S:
        raise LogError(
            f"{log.label} is too short to tell servos from.",
            got=f"{sum(log.duration):.3g} s",
            expected=f"{SHORTEST_S:g} s",
        )
    held = tracks.dt
    if not all_rows:
        log, tracks = _thinned(log, tracks)
    q = log.q * scale
    if bool((q.amax(0) - q.amin(0) < MOVES).all()):
        raise LogError(
            f"{log.label}: no joint moves.",
            got=f"positions vary by {float((q.amax(0) - q.amin(0)).max()):.3g} rad at most",
            expected="motions",
        )
    # Parts of one motion have one clock.
    gone = log.t[tracks.first] - log.t[tracks.last.roll(1)]
    dq = rates(q, tracks, (gone - tracks.dt).abs() < UNEVEN * tracks.dt)
    weighed = robot.parameters is not None
    robot = robot if weighed else with_rods(robot)
    link = _outermost(robot)
    body = body_near(robot, q, dq, link).midway(tracks.last)
    # How strong servos are follows from the arm's weight, compensated or not.
    strength = _strength(body.bias + compensation(robot, q), tracks.u - q)
    return PositionData(
        robot, weighed, log, scale, tracks, held, q, dq, body, strength, link,
        torch.zeros_like(strength),
    )  # fmt: skip


def _strength(bias: Float[Tensor, "T n"], error: Float[Tensor, "T n"]) -> Float[Tensor, " n"]:
    """(n,) what gravity's torque per position error says of kp, over that of a small servo; of
    joints without much load the median of the others'."""
    load, lag = (x.square().mean(0).sqrt() for x in (bias, error))
    bears = load > BEARS * load.amax()
    # Friction makes the error larger than the load does.
    kp = FRICTION * load / lag.clamp(min=1e-6)
    known = kp[bears] if bool(bears.any()) else kp.new_tensor([SMALL])
    return torch.where(bears, kp, known.median()).clamp(min=1e-3) / SMALL


def _outermost(robot: Robot) -> int:
    """The last link that is no jaw: what comes after it is much lighter."""
    mass = robot.require_parameters("the torque of gravity on the servos").mass
    jaw = robot.n > 1 and bool(mass[-1] < JAW * mass[-2])
    return robot.n - 2 if jaw else robot.n - 1
