"""A log's commands given to a model of its servos: where the arm would have gone.

Nothing of the measured motion is used but the starts. The rigid body is linearised about the last
simulated motion (the commands, at first) and simulated again until the motion stays as it is, which
solves the equations of motion exactly.
"""

import torch
from torch import Tensor

from torchid.errors import TorchidError
from torchid.robot.model import Robot
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import STEP, Tracks, Windows, body_near, rollout
from torchid.typing import Float

SETTLED = 1e-4
"""Change of positions from one pass to the next below which they stay as they are [rad]."""
PASSES = 6
FARTHEST = 50.0
"""Position beyond which an arm has run away [rad]."""


def replayed(
    robot: Robot,
    servos: Servos,
    tracks: Tracks,
    windows: Windows,
    q: Float[Tensor, "W n"],
    dq: Float[Tensor, "W n"],
    *,
    longest_step: float = STEP,
) -> Float[Tensor, "T n"]:
    """Positions (T, n) at all rows of the tracks, which the windows cover [rad].

    Args:
        robot: with inertial parameters.
        servos: one set, or one a window (W, 1, n, K).
        tracks: the commands.
        windows: stretches that each begin at q, dq.
        q, dq: states at the windows' first rows [rad, rad/s].
        longest_step: of the integration [s].

    Raises:
        TorchidError: the arm runs away.
        RobotError: the robot has no inertial parameters.
    """
    batch = servos
    if servos.joint.ndim == 2:
        batch = Servos(servos.joint[None], servos.plane[None], servos.link, servos.repeated)
    link = servos.link % robot.n if bool((servos.plane[..., 4] > 0).any()) else None
    motion = tracks.u.clone()
    for _ in range(PASSES):
        body = body_near(robot, motion, _rates(motion, tracks, windows), link)
        out = rollout(batch, body, tracks, windows, q, dq, longest_step=longest_step)[..., 0]
        found = motion.clone()
        for w, (a, length) in enumerate(
            zip(windows.start.tolist(), windows.length.tolist(), strict=True)
        ):
            found[a : a + length] = out[:length, w]
        if not bool((found.abs() < FARTHEST).all()):
            raise TorchidError(
                "the arm runs away from these commands.",
                hint="the model's gains are not of this robot, or its commands in another unit",
            )
        change = float((found - motion).abs().max())
        motion = found
        if change < SETTLED:
            break
    return motion


def _rates(q: Tensor, tracks: Tracks, windows: Windows) -> Tensor:
    """Central differences within each window [rad/s]."""
    dq = torch.zeros_like(q)
    dq[1:-1] = (q[2:] - q[:-2]) / (2 * tracks.dt)
    ends = windows.start + windows.length - 1
    dq[windows.start] = q[(windows.start + 1).clamp(max=len(q) - 1)] - q[windows.start]
    dq[ends] = q[ends] - q[(ends - 1).clamp(min=0)]
    for rows in (windows.start, ends):
        dq[rows] /= tracks.dt
    return dq
