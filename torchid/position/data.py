"""What logs of commands and positions become before servos are fitted to them."""

from dataclasses import dataclass, field

import torch

from torchid.errors import LogError
from torchid.log.checks import FOLLOWS, velocity_agreement
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.simulation.servo import INDEX, PARAMETERS
from torchid.simulation.servo_loop import Body, Tracks, Windows, body_near
from torchid.typing import Float, Tensor

UNEVEN = 0.5
"""A step that differs from the median by more than this share of it is no jitter [1]."""
OTHER_UNIT = 0.2
"""A measured velocity that differs from the position's by more than this tells its unit [1]."""
STILL = 0.02
"""Slower than this a start is at rest: one count of a small servo's encoder in 0.1 s [rad/s]."""
SMALL = PARAMETERS[INDEX["kp"]].start
"""kp of a small servo [N m/rad]."""
BEARS, FRICTION = 0.2, 1.5
NO_STEP = 1e-9
"""Changes of a position below this are rounding [rad]."""
JAW = 0.3
"""Share of the link before that a jaw weighs at most [1]."""
SHORTEST_S = 10.0
"""Of less log no servo is told [s]."""


@dataclass(frozen=True, eq=False)
class PositionData:
    """Motions of an arm, in radians of the model.

    Attributes:
        robot, log: as given.
        scale: (n,) radians of the model per unit of the log, 1 unless the log's own velocities say
            otherwise.
        tracks: commands.
        q: (T, n) measured positions [rad].
        dq: (T, n) their rate, 0 where the joint is at rest [rad/s].
        body: the rigid body near the measured motion.
        strength: (n,) torques of each joint beside those of a small servo, where a fit starts [1].
        link: whose points may touch a plane, counted from 0.
        set_points: those found last, beside the profiles that they are of.
    """

    robot: Robot
    log: Log
    scale: Float[Tensor, " n"]
    tracks: Tracks
    q: Float[Tensor, "T n"]
    dq: Float[Tensor, "T n"]
    body: Body
    strength: Float[Tensor, " n"]
    link: int
    set_points: dict[bool, tuple[Tensor, Tensor]] = field(default_factory=dict, repr=False)

    @property
    def resolution(self) -> Float[Tensor, " n"]:
        """(n,) what rounding to an encoder's count leaves [rad]."""
        out = []
        for q in self.q.T:
            steps = q.diff().abs()
            steps = steps[steps > NO_STEP]
            out.append(steps.quantile(0.05) / 12**0.5 if len(steps) else q.new_tensor(0.0))
        return torch.stack(out)

    def start(self, windows: Windows) -> tuple[Tensor, Tensor]:
        """q and dq (W, n) at the first rows of windows."""
        return self.q[windows.start], self.dq[windows.start]


def tracks_of(log: Log, scale: Float[Tensor, " n"]) -> Tracks:
    """The commands of a log.

    Raises:
        LogError: it has none, or is not evenly sampled.
    """
    if log.u is None:
        raise LogError(
            f"{log.label} has no commands.",
            expected=f"columns u1..u{log.n}, commanded positions",
            available=["t", *log.signals],
        )
    steps = torch.cat([log.t[rows].diff() for rows in log.slices()])
    dt = float(steps.median())
    if not dt > 0 or bool(((steps - dt).abs() > UNEVEN * dt).any()):
        raise LogError(
            f"{log.label} is not evenly sampled.",
            got=f"steps of {float(steps.min()):.4g} to {float(steps.max()):.4g} s",
            expected=f"steps within {100 * UNEVEN:g} % of {dt:.4g} s",
            hint="cut the log where samples are missing, or number the parts in a column traj",
        )
    first = torch.tensor([rows.start for rows in log.slices()])
    last = torch.tensor([rows.stop - 1 for rows in log.slices()])
    return Tracks(log.u * scale, first, last, dt)


def scale_of(log: Log) -> Float[Tensor, " n"]:
    """(n,) radians per unit of q, where the log's own velocities are in another unit than q."""
    scale = torch.ones(log.n, dtype=torch.float64)
    for a in velocity_agreement(log):
        if a.correlation > FOLLOWS and abs(a.ratio - 1) > OTHER_UNIT:
            # The least-squares slope: velocities late or coarse make the ratio too large.
            scale[a.joint] = a.ratio * a.correlation
    return scale


def rates(q: Float[Tensor, "T n"], tracks: Tracks) -> Float[Tensor, "T n"]:
    """Velocity from two samples before to two after, 0 for a joint at rest [rad/s]."""
    dq = torch.zeros_like(q)
    dq[2:-2] = (q[4:] - q[:-4]) / (4 * tracks.dt)
    for rows in (*(tracks.first + k for k in (0, 1)), *(tracks.last - k for k in (0, 1))):
        dq[rows] = 0.0
    return torch.where(dq.abs() < STILL, 0.0, dq)


def prepare(robot: Robot, log: Log) -> PositionData:
    """Motions as the fit takes them.

    Args:
        robot: with inertial parameters.
        log: t, q and u.

    Raises:
        LogError: other joints than the robot's, no commands, uneven sampling, values that are not
            finite, or less than `SHORTEST_S`.
        RobotError: the robot has no inertial parameters.
    """
    if log.n != robot.n:
        raise LogError(
            f"{log.label} has another number of joints than robot '{robot.name}'.",
            got=f"{log.n} (q1..q{log.n})",
            expected=f"{robot.n} (q1..q{robot.n})",
        )
    robot.require_parameters("the torque of gravity on the servos")
    scale = scale_of(log)
    tracks = tracks_of(log, scale)
    if not bool(log.q.isfinite().all() & tracks.u.isfinite().all()):
        raise LogError(f"{log.label} has values of q or u that are no numbers.")
    if sum(log.duration) < SHORTEST_S:
        raise LogError(
            f"{log.label} is too short to tell servos from.",
            got=f"{sum(log.duration):.3g} s",
            expected=f"{SHORTEST_S:g} s",
        )
    q = log.q * scale
    dq = rates(q, tracks)
    link = _outermost(robot)
    body = body_near(robot, q, dq, link)
    strength = _strength(body, tracks.u - q)
    return PositionData(robot, log, scale, tracks, q, dq, body, strength, link)


def _strength(body: Body, error: Float[Tensor, "T n"]) -> Float[Tensor, " n"]:
    """(n,) what gravity's torque per position error says of kp, over that of a small servo; of
    joints without much load the median of the others'."""
    load, lag = (x.square().mean(0).sqrt() for x in (body.bias, error))
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
