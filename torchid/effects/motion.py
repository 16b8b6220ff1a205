"""What effects see of an arm: the motion of its joints, and signals that came with it."""

from typing import NamedTuple

import torch
from torch import Tensor


class Motion(NamedTuple):
    """Motion of all joints.

    Attributes:
        q, dq, ddq: (..., n) [rad, rad/s, rad/s^2; m for prismatic joints].
        direction: (..., n) sign of each joint's motion, where it is known better than from the
            sign of dq: measured velocity is noise at standstill.
        t: (...,) [s] since the arm was switched on or the log began; where it is known.
        torque: (..., n) torque of the model along this motion [N m; N], never a measured one;
            where it is known.
        age: (..., n) [s] by which the measured torque is older than its stamp, where samples were
            held; where it is known.
        lag: (..., n) by which the link's own encoder is behind the motor's [rad; m]; where a log
            has both.
    """

    q: Tensor
    dq: Tensor
    ddq: Tensor
    direction: Tensor | None = None
    t: Tensor | None = None
    torque: Tensor | None = None
    age: Tensor | None = None
    lag: Tensor | None = None

    @property
    def state(self) -> tuple[Tensor, Tensor, Tensor]:
        """q, dq, ddq: what a rigid body feels."""
        return self.q, self.dq, self.ddq

    @property
    def sign(self) -> Tensor:
        """Direction of motion (..., n): as given, else the sign of dq."""
        return torch.sign(self.dq) if self.direction is None else self.direction.to(self.dq)

    def to(self, device: torch.device | str) -> "Motion":
        """The motion on another device."""
        return Motion(*(None if x is None else x.to(device) for x in self))  # type: ignore[arg-type]

    def part(self, rows: slice) -> "Motion":
        """The motion at some of the instants (first axis)."""
        return Motion(*(None if x is None else x[rows] for x in self))  # type: ignore[arg-type]

    def every(self, step: int) -> "Motion":
        """The motion at every so many instants."""
        return self.part(slice(None, None, step))

    def require(self, what: str, effect: str) -> Tensor:
        """`t`, `torque` or `age`, which an effect needs; ValueError (a programmer's) without it."""
        value: Tensor | None = getattr(self, what)
        if value is None:
            raise ValueError(f"{effect} needs the motion's {what}.")
        return value
