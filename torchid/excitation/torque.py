"""Torque limits of a planned motion, by a model of the arm.

Torque is no function of one joint's motion: it couples the joints, and gravity stays however small
or slow the motion (see `restriction`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.effects.base import JointEffect, Motion
from torchid.effects.registry import Valued, model_torque, nominal_effects
from torchid.errors import RobotError
from torchid.excitation.fourier import FourierTrajectory, midpoints
from torchid.excitation.restriction import Restriction
from torchid.excitation.trajectories import Sinusoid
from torchid.identification.base_parameters import nominal_values
from torchid.identification.model import full_set
from torchid.identification.values import Prior
from torchid.robot.model import JointType, Robot
from torchid.typing import Bool, Float, Tensor

MARGIN = 0.01
"""Share of the usable torque that is left free, for what happens between instants."""

NOMINAL, CORRECTED = "nominal parameters", "corrected model"
"""Models, for people: the robot's own, and that of a diagnosis."""


@dataclass(frozen=True, eq=False)
class TorqueUse:
    """What motions ask of the drives.

    Attributes:
        source: the model that predicts it.
        largest: (n,) size of the torque that comes nearest to its limit [N m; N].
        limits: (n, 2) [N m; N], infinite where there is none.
        share: (n,) of the limit.
        frictionless: joints (from 0) whose forecast has no friction in it.
    """

    source: str
    largest: Float[Tensor, " n"]
    limits: Float[Tensor, "n 2"]
    share: Float[Tensor, " n"]
    frictionless: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class TorqueLimits(Restriction):
    """Torque limits, and a model that predicts the torque.

    Attributes:
        robot: with limits and parameters.
        effects: of the model.
        source: what the model is, for people.
        usage: share of the limits that may be used.
    """

    robot: Robot
    effects: tuple[Valued, ...]
    source: str = NOMINAL
    usage: float = 1.0

    @classmethod
    def of(
        cls, robot: Robot, effects: Sequence[Valued], source: str, usage: float
    ) -> "TorqueLimits | None":
        """With those of the effects that a planned motion determines; None without limits or
        parameters.

        Raises:
            RobotError: limits that do not contain 0.
        """
        known = tuple(p for p in effects if not p[0].needs & {"age", "velocity"})
        checked = robot.parameters is not None and has_torque_limits(robot)
        return cls(robot, known, source, usage) if checked else None

    @property
    def limits(self) -> Float[Tensor, "n 2"]:
        """Lower and upper (n, 2) [N m; N]."""
        assert self.robot.limits.torque is not None
        return self.robot.limits.torque.double()

    @property
    def usable(self) -> Float[Tensor, "n 2"]:
        """What of the limits a planned motion may use (n, 2), its margin left."""
        return self.usage * (1 - MARGIN) * self.limits

    def torque(self, motion: Motion) -> Float[Tensor, "*batch T n"]:
        """Torque of the model along motions (..., T, n), `t` (T,)."""
        if motion.q.ndim > 2 and not all(isinstance(e, JointEffect) for e, _ in self.effects):
            each = zip(*(x.flatten(0, -3) for x in motion.state), strict=True)
            parts = [self.torque(Motion(q, dq, ddq, t=motion.t)) for q, dq, ddq in each]
            return torch.stack(parts).reshape(motion.q.shape)
        return model_torque(self.robot, self.effects, motion)

    def penalty(self, trajectory: FourierTrajectory) -> Float[Tensor, "*batch"]:
        """What a search pays for torque beyond the limits; differentiable, 0 within them."""
        # 150: instants of a trajectory during the search
        t = midpoints(trajectory.duration, 150)
        # 0.02: the search's instants are further apart
        excess = self._shares(self._along(trajectory, t)) / (1 - 0.02) - 1
        # 2.0: beside the logarithm of a condition number, for torque of twice its limit
        return 2.0 * excess.clamp(min=0).sum(-1)

    def fits(self, trajectory: FourierTrajectory | Sinusoid) -> Bool[Tensor, "*batch"]:
        """Whether each motion keeps the torque limits at every instant."""
        with torch.no_grad():
            shares = self._shares(self._along(trajectory, _instants(trajectory)))
        return (shares <= 1).all(-1)

    def strain(self, q: Float[Tensor, "K n"]) -> Float[Tensor, " K"]:
        """The largest share of what is usable that gravity and friction take at rest."""
        return self._shares(self._at_rest(q)).amax(-1)

    def use(self, trajectories: Sequence[FourierTrajectory | Sinusoid]) -> TorqueUse:
        """The largest torque that several motions need of every joint."""
        torques = [self._along(x, _instants(x)).reshape(-1, self.robot.n) for x in trajectories]
        tau = torch.cat(torques)
        size, rows = _of_limit(tau, self.limits).max(0)
        largest = tau[rows, torch.arange(self.robot.n)].abs()
        rubbing = {j for e, _ in self.effects if "friction" in e.name for j in e.joints}
        smooth = tuple(j for j in range(self.robot.n) if j not in rubbing)
        return TorqueUse(self.source, largest, self.limits, size, smooth)

    def _along(self, trajectory: FourierTrajectory | Sinusoid, t: Tensor) -> Tensor:
        return self.torque(trajectory.at(t)._replace(t=t))

    def _shares(self, tau: Float[Tensor, "*batch T n"]) -> Float[Tensor, "*batch n"]:
        """Largest share of what is usable, over time."""
        return _of_limit(tau, self.usable).amax(-2)

    def _at_rest(self, q: Float[Tensor, "K n"]) -> Float[Tensor, "K 2 n"]:
        """Torque when motion is about to begin, either way."""
        still = torch.zeros_like(q)
        static = [
            p for p in self.effects if "t" not in p[0].needs and not getattr(p[0], "memory", False)
        ]
        ways = [Motion(q, still, still, still + way) for way in (-1.0, 1.0)]
        return torch.stack([model_torque(self.robot, static, way) for way in ways], -2)

    def impossible(self, q: Float[Tensor, " n"]) -> RobotError:
        """Which joint gravity and friction alone ask too much of."""
        both = self._at_rest(q.unsqueeze(0))
        j = int(self._shares(both).argmax())
        still = torch.zeros_like(q)
        gravity = float(inverse_dynamics(self.robot, q, still, still)[j].abs())
        way = int(_of_limit(both, self.usable)[0, :, j].argmax())
        whole = float(both[0, way, j])
        unit = "N" if self.robot.joint_types[j] is JointType.PRISMATIC else "N m"
        limit = float(self.limits[j, int(whole > 0)])
        return RobotError(
            f"robot '{self.robot.name}': no motion keeps the torque limit of joint {j + 1}.",
            got=f"{gravity:.4g} {unit} for gravity alone, {abs(whole):.4g} with friction, in the "
            f"posture that asks least of the drives, by the {self.source}",
            expected=f"below {self.usage * (1 - MARGIN) * abs(limit):.4g} {unit}, of a limit of "
            f"{abs(limit):.4g}",
            hint="check the limit, the parameters and the direction of gravity: torchid robot"
            + ("; `usage=...` says which share of the limit may be used" if self.usage < 1 else ""),
        )


def nominal_torque_limits(robot: Robot, *, usage: float = 1.0) -> TorqueLimits | None:
    """Torque limits by the robot's own parameters and effects; None without limits or parameters.

    Raises:
        RobotError: limits that do not contain 0.
    """
    return TorqueLimits.of(robot, nominal_effects(robot), NOMINAL, usage)


def identified_torque_limits(
    robot: Robot, prior: Prior, *, usage: float = 1.0
) -> TorqueLimits | None:
    """Torque limits by identified base parameters; None without limits.

    A base parameter that the log did not determine has its nominal value, 0 if there is none.

    Raises:
        RobotError: limits that do not contain 0.
    """
    values, source = prior.values, "identified base parameters"
    if unknown := int((~prior.known).sum()):
        nominal = robot.parameters is not None
        other = nominal_values(robot, prior.base) if nominal else torch.zeros_like(values)
        values = torch.where(prior.known, values, other)
        source += f" ({unknown} not determined: {'nominal' if nominal else '0'})"
    parameters, effects = full_set(prior.base, prior.effects, values)
    return TorqueLimits.of(replace(robot, parameters=parameters), effects, source, usage)


def has_torque_limits(robot: Robot) -> bool:
    """Whether some joint's torque is limited.

    Raises:
        RobotError: limits that do not contain 0.
    """
    limits = robot.limits.torque
    if limits is None or not bool(torch.isfinite(limits).any()):
        return False
    if bool(((limits[:, 0] >= 0) | (limits[:, 1] <= 0)).any()):
        raise RobotError(
            f"robot '{robot.name}': torque limits that do not contain 0 let no drive rest.",
            got=limits.tolist(),
        )
    return True


def _of_limit(tau: Float[Tensor, "*batch n"], limits: Float[Tensor, "n 2"]) -> Tensor:
    """Torque as a share of the limit on its side (..., n)."""
    return torch.maximum(tau / limits[:, 1], tau / limits[:, 0])


def _instants(trajectory: FourierTrajectory | Sinusoid) -> Float[Tensor, " T"]:
    """Times from 0 to the duration at which torque is checked."""
    d = trajectory.duration
    # 100.0 Hz: at least, of the instants that torque is checked at
    # 250: instants a period of the fastest harmonic, at least
    # 500: instants at least
    count = math.ceil(max(500, 100.0 * d, 250 * d * trajectory.fastest))
    return torch.linspace(0, d, count + 1, dtype=torch.float64)
