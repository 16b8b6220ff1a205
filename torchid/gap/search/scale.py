"""How large a coefficient can be on one robot: masses beside its own, lengths beside its reach,
forces and torques beside those of its joints."""

import torch

from torchid.design.columns import Columns
from torchid.effects.base import Effect
from torchid.effects.parameters import QUANTILE_OF
from torchid.robot.shapes import reach
from torchid.statistics.criteria import BEYOND_ROBOT
from torchid.typing import Float, Tensor

GRAVITY = 9.81
"""[m/s^2]"""


class Scale:
    """Sizes of a robot on a log.

    Args:
        columns: at the robot's model.
    """

    def __init__(self, columns: Columns):
        robot, segments = columns.model.robot, columns.samples.segments
        tau, dq, ddq = (
            torch.cat([x[:: max(1, len(x) // QUANTILE_OF)].abs() for x in signals]).quantile(
                0.99, 0
            )
            for signals in zip(*((s.tau, s.motion.dq, s.motion.ddq) for s in segments), strict=True)
        )
        limit = robot.limits.torque
        most = torch.zeros_like(tau) if limit is None else limit.to(tau).abs().amax(-1)
        self.torque = torch.maximum(tau, most.nan_to_num(0.0, 0.0))
        self.length = reach(robot)
        # A file whose masses are far too small still has joints that carry them.
        carried = float(self.torque.max()) / (GRAVITY * self.length)
        masses = robot.require_parameters("a scale").mass[list(robot.bodies)]
        self.mass = max(carried, float(masses.clamp(min=0).sum()))
        self.speed, self.acceleration = dq.clamp(min=1e-9), ddq.clamp(min=1e-9)

    def largest(self, effect: Effect) -> Float[Tensor, " C"]:
        """Of each coefficient what it is at most, by its unit; inf where that says nothing."""
        own = list(effect.joints) or slice(None)
        torque, mass, length = self.torque[own], self.mass, self.length
        inertia = max(mass * length**2, float((torque / self.acceleration[own]).max()))
        of = {
            "kg": mass, "kg m": mass * length, "kg m^2": inertia, "m": length,
            "N m": float(torque.max()), "N m s/rad": float((torque / self.speed[own]).max()),
        }  # fmt: skip
        sizes = [BEYOND_ROBOT * of.get(c.unit, torch.inf) for c in effect.coefficients]
        return torch.tensor(sizes, dtype=torch.float64)
