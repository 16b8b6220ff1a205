"""Effects of bodies: a payload, and links whose inertial parameters are off."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.dynamics.regressor import regressor_chunks
from torchid.effects.base import Coefficient, Columns, Example, ModelEffect, Motion
from torchid.effects.variation import ArmCoefficient, OneJointEffect, needed
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import Robot
from torchid.typing import Float

WEIGHED = "weigh the load, or compare the link's parameters with CAD"
"""What settles errors of bodies."""

_DRAWN = (1.0, 0.0, 0.0, 0.1, 0.02, 0.0, 0.0, 0.02, 0.0, 0.01)
"""A body of a size to be seen."""

_ENTRIES = ("xx", "xy", "xz", "yy", "yz", "zz")


def _body(what: str, positive_mass: bool) -> tuple[Coefficient, ...]:
    """The ten parameters of a body in torchid's order, about the link frame's origin."""
    mass = ArmCoefficient("m", "kg", positive_mass, f"mass {what}")
    moments = (ArmCoefficient(f"m{a}", "kg m", False, f"first moment {what}, {a}") for a in "xyz")
    inertia = (
        ArmCoefficient(f"J{e}", "kg m^2", False, f"inertia {what} about the link frame, {e}")
        for e in _ENTRIES
    )
    return (mass, *moments, *inertia)


def link_columns(motion: Motion, robot: Robot, link: int) -> Float[Tensor, "T n 10"]:
    """Torque of all joints per unit of a link's ten parameters: its columns of the regressor."""
    q = motion.q
    out = q.new_zeros(*q.shape, PARAMETERS_PER_LINK)
    start = 0
    for chunk in regressor_chunks(robot, *motion.state):
        stop = start + chunk.like.shape[0]
        for i in range(link + 1):
            row = chunk.row(i, [(link, k) for k in range(PARAMETERS_PER_LINK)])
            out[start:stop, i] = row.T
        start = stop
    return out


def with_body(robot: Robot, link: int, values: Sequence[float], purpose: str) -> Robot:
    """The arm with ten parameters added to a link's."""
    pi = robot.require_parameters(purpose).pi.clone()
    pi[link] += torch.tensor(values, dtype=pi.dtype, device=pi.device)
    return robot.with_parameters(InertialParameters(pi))


@dataclass(frozen=True)
class Payload(ModelEffect):
    """A body fixed to the last link: ten parameters in that link's frame, about its origin."""

    name = "payload"
    family = "inertia"
    coefficients = _body("of the payload", positive_mass=True)
    meaning = "The arm carries a tool or load that the model does not know."
    equation = "Y_n (m, mx, my, mz, Jxx, Jxy, Jxz, Jyy, Jyz, Jzz)"
    signature = "on all joints that carry the tool; exactly an error of the last link"
    experiment = "repeat the motion with and without a known payload"
    beyond = WEIGHED
    remedy = "Add the body to the last link, or `torchid payload` on logs with it."
    source = (
        "eq. 2.18; Khalil, Gautier and Lemoine 2007, Identification of the payload inertial "
        "parameters of industrial manipulators, ICRA"
    )
    example = Example(_DRAWN, "acceleration")
    inertial = True

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """The last link's columns of the regressor (T, n, 10)."""
        arm = needed(robot, self.name)
        return link_columns(motion, arm, arm.n - 1)

    def plant(self, robot: Robot, values: Sequence[float]) -> Robot:
        """The arm with the payload on its last link."""
        return with_body(robot, robot.n - 1, values, "a payload")


@dataclass(frozen=True)
class LinkInertia(OneJointEffect):
    """The inertial parameters of one link differ from the model's.

    Attributes:
        joint: the joint that moves the link, from 0.
    """

    name = "link_inertia"
    family = "inertia"
    coefficients = _body("missing in the link", positive_mass=False)
    meaning = "The link's mass, centre of mass or inertia is not the model's."
    equation = "Y_j (m, mx, my, mz, Jxx, Jxy, Jxz, Jyy, Jyz, Jzz)"
    signature = "on the link's joint and those before it, with gravity and with acceleration"
    experiment = "compare the link's parameters with CAD, or weigh it"
    beyond = WEIGHED
    remedy = "Correct the link's inertial parameters: `torchid identify`, `extract`."
    source = "eq. 2.18; Atkeson, An and Hollerbach 1986, IJRR 5(3)"
    example = Example(_DRAWN, "acceleration")
    inertial = True

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """The link's columns of the regressor (T, n, 10)."""
        return link_columns(motion, needed(robot, self.name), self.joint)

    def plant(self, robot: Robot, values: Sequence[float]) -> Robot:
        """The arm with the link's parameters changed."""
        return with_body(robot, self.joint, values, "a change of a link")
