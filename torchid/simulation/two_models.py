"""Which of several models is the better simulator? Short simulations from many instants of the log.

All start from measured positions and velocities, are driven by the measured torque, and are
compared with the measured positions a while later (multiple shooting; Bock and Plitt 1984). Replay
of torque in open loop drifts whatever the model, since nothing corrects an error once made; so
horizons are short, and errors saturate.
"""

from collections.abc import Sequence

import torch

from torchid.robot.model import Robot
from torchid.simulation.open_loop import rollout
from torchid.simulation.shooting import Windows
from torchid.typing import Float, Tensor

HORIZONS = (0.1, 0.5, 2.0)
"""After which positions are compared [s]."""

DIVERGED = 1.0
"""Position error of a joint at which a simulation has lost the arm [rad or m]. Larger ones count as
this, so that one runaway does not decide a mean."""


def simulated(robot: Robot, windows: Windows) -> Float[Tensor, "B T n"]:
    """Positions of a model at the samples of all windows [rad; m]; NaN where it has lost the arm.

    Raises:
        RobotError: it has no parameters, or an effect that does not exist.
    """
    q0, dq0, dt = windows.q[:, 0], windows.dq[:, 0], windows.dt
    # 4e-3: of the simulation [s]
    return rollout(robot, (), q0, dq0, windows.tau, dt, windows.t0, longest_step=4e-3).q


def errors_after(
    horizon: float, positions: Sequence[Float[Tensor, "B T n"] | None], windows: Windows
) -> tuple[int, list[Float[Tensor, " n"] | None]]:
    """How many windows are as long as a horizon [s], and the RMS (n,) of each model's position
    error after it [rad; m]; None of a model without positions, and where no window is as long."""
    step = max(1, round(horizon / windows.dt))
    use = windows.steps >= step
    if not bool(use.any()):
        return 0, [None] * len(positions)
    # What is not a number has diverged.
    off = [None if q is None else (q - windows.q)[use, step].abs() for q in positions]
    return int(use.sum()), [
        None if x is None else torch.where(x < DIVERGED, x, DIVERGED).square().mean(0).sqrt()
        for x in off
    ]
