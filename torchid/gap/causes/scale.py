"""How large a coefficient can be on one robot: masses beside its own, lengths beside its reach,
forces and torques beside those of its joints."""

from collections.abc import Sequence

import torch

from torchid.design.columns import Columns
from torchid.design.motion import velocity_lag
from torchid.effects.base import Effect
from torchid.effects.parameters import QUANTILE_OF
from torchid.robot.model import JointType
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
        signals = zip(*((s.tau, s.motion.dq, s.motion.ddq) for s in segments), strict=True)
        some = ([x[:: max(1, len(x) // QUANTILE_OF)].abs() for x in each] for each in signals)
        tau, dq, ddq = (torch.cat(x).quantile(0.99, 0) for x in some)
        limit = robot.limits.torque
        most = torch.zeros_like(tau) if limit is None else limit.to(tau).abs().amax(-1)
        self.torque = torch.maximum(tau, most.nan_to_num(0.0, 0.0))
        self.length = reach(robot)
        # At the arm's end a joint that slides makes its own force, one that turns needs its lever.
        slides = torch.tensor([kind is JointType.PRISMATIC for kind in robot.joint_types])
        self.force = float(torch.where(slides, self.torque, self.torque / self.length).max())
        # A file whose masses are far too small still has joints that carry them.
        carried = float(self.torque.max()) / (GRAVITY * self.length)
        masses = robot.require_parameters("a scale").mass[list(robot.bodies)]
        self.mass = max(carried, float(masses.clamp(min=0).sum()))
        # Of the model's torque and the logged one, joint by joint.
        model = torch.cat([m.require("torque", "a scale") for m in columns.motions])
        logged = torch.cat([s.tau for s in segments])
        self.products = (model * logged).sum(0), model.square().sum(0), logged.square().sum(0)
        # Positions say by how much measured velocities are late, to a sample.
        rate, cutoff, begun = columns.samples.rate, columns.samples.cutoff, slice(QUANTILE_OF)
        beside = [(s.motion.q[begun], s.motion.dq[begun]) for s in segments]
        self.lag = 1 / rate + max(abs(velocity_lag(*x, rate, cutoff)[0]) for x in beside)
        self._kept: dict[tuple[int, ...], dict[str, float]] = {}
        self.speed, self.acceleration = dq.clamp(min=1e-9), ddq.clamp(min=1e-9)

    def largest(self, effects: Sequence[Effect]) -> Float[Tensor, " C"]:
        """Of each coefficient of an effect, or of several that share them, what it is at most: on
        any arm, and by its unit on this one; inf where that says nothing."""
        effect = effects[0]
        joints = tuple(dict.fromkeys(j for e in effects for j in e.joints))
        own, of = list(joints) or slice(None), self._of_units(joints)
        on_robot = [BEYOND_ROBOT * of.get(c.unit, torch.inf) for c in effect.coefficients]
        largest = [most for _, most in effect.ranges]
        if effect.logs_late == "velocity":
            on_robot = [self.lag]
        if effect.scale_of_torque:
            both, model, logged = (x[own].sum() for x in self.products)
            # Where the model's torque explains most of the squares, at a scale beyond any gain:
            # torque in percent of its rating, say.
            if both > (1 + largest[0]) * model and both.square() > model * logged / 2:
                largest = [torch.inf]
        return torch.minimum(*torch.tensor([on_robot, largest], dtype=torch.float64))

    def _of_units(self, joints: tuple[int, ...]) -> dict[str, float]:
        """Of some joints, or all, what is usual, by unit."""
        if joints not in self._kept:
            own = list(joints) or slice(None)
            torque, mass, length = self.torque[own], self.mass, self.length
            inertia = max(mass * length**2, float((torque / self.acceleration[own]).max()))
            self._kept[joints] = {
                "kg": mass, "kg m": mass * length, "kg m^2": inertia, "m": length,
                "N m": float(torque.max()), "N m s/rad": float((torque / self.speed[own]).max()),
                "N": self.force,
            }  # fmt: skip
        return self._kept[joints]
