"""Joint control as arms have it: feed-forward of a nominal model, and PD."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.dynamics.forward import mass_matrix
from torchid.effects.base import Motion
from torchid.effects.registry import model_torque, nominal_effects
from torchid.errors import TorchidError
from torchid.robot.model import Robot
from torchid.typing import Float


@dataclass(frozen=True)
class Controller:
    """tau = tau_nominal(reference) + Kp (q_ref - q) + Kd (dq_ref - dq), joint by joint.

    Kp = w^2 I and Kd = 2 z w I with the joint's mean inertia I along the reference: the diagonal
    of the nominal mass matrix with the nominal rotor inertias. It acts on the true motion without
    delay, between sampling instants too.

    Attributes:
        natural_frequency: w / 2 pi [Hz].
        damping: z [1].
        torque_limit: largest absolute torque [N m; N], one for all joints or one a joint; None for
            no limit.
        feed_forward: whether the nominal model is used.
    """

    natural_frequency: float = 5.0
    damping: float = 1.0
    torque_limit: float | tuple[float, ...] | None = None
    feed_forward: bool = True

    def __post_init__(self) -> None:
        if not (0 < self.natural_frequency < math.inf and 0 <= self.damping < math.inf):
            raise TorchidError(
                "a controller needs a natural frequency and a damping.",
                got=f"{self.natural_frequency} Hz, damping {self.damping}",
                expected="a frequency > 0 Hz and a damping >= 0",
            )

    def gains(
        self, robot: Robot, q: Float[Tensor, "*batch n"]
    ) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
        """Kp [N m/rad; N/m] and Kd [N m s/rad; N s/m] for a reference through positions q.

        Raises:
            RobotError: the robot has no nominal parameters.
        """
        places = q.reshape(-1, robot.n)
        # 200: of the reference, for the mean inertia
        places = places[:: max(1, len(places) // 200)]
        inertia = mass_matrix(robot, places).diagonal(dim1=-2, dim2=-1).mean(0).abs()
        for effect, values in nominal_effects(robot):
            if armature := (effect.attributes(values) or {}).get("armature"):
                inertia[effect.joints[0]] += armature
        # 0.02: of the largest joint inertia: gains of light joints are not smaller than for this
        # much, as friction would hold them
        inertia = inertia.clamp(min=0.02 * float(inertia.max()))
        w = 2 * math.pi * self.natural_frequency
        return w * w * inertia, 2 * self.damping * w * inertia

    def limit(self, n: int) -> Float[Tensor, " n"] | None:
        """Largest absolute torques (n,), or None.

        Raises:
            TorchidError: another number of limits than joints, or one that is not positive.
        """
        if self.torque_limit is None:
            return None
        given = self.torque_limit
        limits = given if isinstance(given, tuple) else (given,) * n
        if len(limits) != n or not all(x > 0 for x in limits):
            raise TorchidError(
                "a torque limit is positive, one for all joints or one a joint.",
                got=given,
                expected=f"{n} numbers > 0",
            )
        return torch.tensor(limits, dtype=torch.float64)

    def feed(
        self, robot: Robot, reference: Motion, gains: tuple[Tensor, Tensor]
    ) -> Float[Tensor, "T n"]:
        """The part of the torque that the reference determines: all but -Kp q - Kd dq.

        Args:
            robot: the nominal one.
            reference: (T, n) with t.
            gains: Kp and Kd.
        """
        stiffness, damping = gains
        feed = stiffness * reference.q + damping * reference.dq
        if not self.feed_forward:
            return feed
        return feed + model_torque(robot, nominal_effects(robot), reference)
