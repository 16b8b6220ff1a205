"""A log's commands given to a model of its servos: where the arm would have gone.

Nothing of the measured motion is used but the starts, and what led to them.
"""

from dataclasses import replace

from torch import Tensor

from torchid.errors import TorchidError
from torchid.robot.model import Robot
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import STEP, Tracks, Windows, rollout
from torchid.typing import Float


def replayed(
    robot: Robot,
    servos: Servos,
    tracks: Tracks,
    windows: Windows,
    q: Float[Tensor, "W n"],
    dq: Float[Tensor, "W n"],
    *,
    measured: Float[Tensor, "T n"] | None = None,
    longest_step: float = STEP,
) -> Float[Tensor, "T n"]:
    """Positions (T, n) at all rows of the tracks, which the windows cover [rad]; without gradients.

    Args:
        robot: with inertial parameters.
        servos: one set, or one a window (W, 1, n, K).
        tracks: the commands.
        windows: stretches that each begin at q, dq.
        q, dq: states at the windows' first rows [rad, rad/s].
        measured: positions until then, for servos with integral action; see `rollout`.
        longest_step: of the integration [s].

    Raises:
        TorchidError: the arm runs away.
        RobotError: the robot has no inertial parameters.
    """
    batch = servos
    if servos.joint.ndim == 2:
        batch = replace(servos, joint=servos.joint[None], plane=servos.plane[None])
    out = rollout(
        batch, robot, tracks, windows, q, dq, measured=measured, longest_step=longest_step
    )[..., 0]
    motion = windows.on_rows(out, tracks.u.clone())
    # 50.0: position beyond which an arm has run away [rad]
    if not bool((motion.abs() < 50.0).all()):
        raise TorchidError(
            "the arm runs away from these commands.",
            hint="the model's gains are not of this robot, or its commands in another unit",
        )
    return motion
