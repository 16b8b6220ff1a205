"""Set-points of position servos as they are made at run time, for any simulator whose actuators
follow a position.

    points = SetPoints(torchid.ServoArm.read("arm_corrected_effects.yaml").servos, dt=0.02)
    for command in policy:                      # every dt
        for ctrl in points.feed(command, 10):   # ten steps of the physics
            data.ctrl[:] = ctrl
            mujoco.mj_step(model, data)

A servo follows a set-point of limited acceleration and speed, not the command, and answers to the
set-point's rate: kp (x - q) + kd (dx - dq) = kp (x + kd / kp dx - q) - kd dq, of which the last is
in the simulator's file. Plain numpy, batched over environments.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch

from torchid.errors import TorchidError
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import FASTEST, profile_step
from torchid.typing import Float

AT_RUN_TIME = ("kd", "acceleration", "speed")
"""Parameters of servos that set-points at run time make true."""


class SetPoints:
    """What servos make of commands that come every dt and hold until the next.

    Args:
        servos: one set, of n joints.
        dt: from one command to the next [s].

    Raises:
        TorchidError: dt is no time.
    """

    def __init__(self, servos: Servos, dt: float):
        if not 0 < dt < float("inf"):
            raise TorchidError("commands come one after the other.", got=dt, expected="dt > 0 s")
        kp, kd, scale, a, top = (
            servos.of(name).numpy() for name in ("kp", "kd", "scale", "acceleration", "speed")
        )
        self.dt, self.repeated = dt, servos.repeated
        self.limited = np.isfinite(a) | np.isfinite(top)
        self._limits = np.minimum(a, FASTEST[0]), np.minimum(top, FASTEST[1])
        self._scale, self._ahead = scale, kd / np.maximum(kp, 1e-300)
        self._lines = self.limited | (kd > 0)
        self._state: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    @property
    def late(self) -> Float[torch.Tensor, " n"]:
        """(n,) by how much the control is later than straight lines from one command to the next,
        in the mean [s]: a command that is held by half of dt; a line that ends where the command
        is, by all of it. A limited set-point knows no more than the last command either way."""
        late = np.where(self.limited, 0.0, np.where(self._lines, self.dt, self.dt / 2))
        return torch.from_numpy(late)

    def reset(self, environments: Sequence[int] | slice | None = None) -> None:
        """Begin anew at the next command: in some environments, or in all."""
        if environments is None or self._state is None:
            self._state = None
            return
        self._state[2][environments] = np.nan

    def feed(self, command: npt.ArrayLike, steps: int) -> np.ndarray:
        """(steps, ..., n) what to control to in each step of the physics until the next command.

        Args:
            command: (..., n) [rad; m].
            steps: of the physics in dt.
        """
        goal = np.asarray(command, dtype=np.float64) * self._scale
        if self._state is None:
            self._state = goal.copy(), np.zeros_like(goal), np.full_like(goal, np.nan)
        x, v, last = self._state
        new = np.isnan(last)
        x, v, last = np.where(new, goal, x), np.where(new, 0.0, v), np.where(new, goal, last)
        way, v = profile_step(goal - x, v, *self._limits, self.dt)
        after = np.where(self.limited, x + way, goal)
        if self.repeated:
            same = (goal == last) & ~new
            after, v = np.where(same, goal, after), np.where(same, 0.0, v)
        self._state = after, v, goal
        rate = np.where(self._lines, after - x, 0.0)
        along = (np.arange(steps) / steps).reshape(-1, *(1,) * goal.ndim)
        points = np.where(self._lines, x + along * rate, goal)
        return (points + self._ahead * rate / self.dt) / self._scale
