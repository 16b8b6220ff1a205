"""Effects of bodies: a payload, links whose inertial parameters are off, and the drives' rotors."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.digits import number
from torchid.dynamics.regressor import regressor_chunks
from torchid.effects.base import Coefficient, Columns, Example, JointEffect, ModelEffect, Motion
from torchid.effects.c_text import add
from torchid.effects.variation import ArmCoefficient, OneJointEffect, needed
from torchid.robot.inertia import PARAMETERS_PER_LINK, InertialParameters
from torchid.robot.model import Robot

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


@dataclass(frozen=True)
class BodyEffect(ModelEffect):
    """Ten parameters added to those of a link, in that link's frame, about its origin."""

    family = "inertia"
    branch = "inertia"
    beyond = WEIGHED
    example = Example(_DRAWN, "acceleration")
    inertial = True

    def link(self, robot: Robot) -> int:
        """Index of the link, from 0."""
        return robot.n_links - 1

    def body(self, robot: Robot) -> int | None:
        """The link whose body it changes, from 0."""
        return self.link(robot)

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """The link's columns of the regressor (T, n, 10)."""
        arm = needed(robot, self.name)
        link, q = self.link(arm), motion.q
        out = q.new_zeros(*q.shape, PARAMETERS_PER_LINK)
        start = 0
        for chunk in regressor_chunks(arm, *motion.state):
            stop = start + chunk.like.shape[0]
            for i in [i for i, row in enumerate(chunk.rows) if link in row]:
                row = chunk.row(i, [(link, k) for k in range(PARAMETERS_PER_LINK)])
                out[start:stop, i] = row.T
            start = stop
        return out

    def plant(self, robot: Robot, values: Sequence[float] | Tensor) -> Robot:
        """The arm with the parameters added to its link's."""
        pi = robot.require_parameters(f"the effect {self.name}").pi.clone()
        pi[self.link(robot)] += torch.as_tensor(values, dtype=pi.dtype, device=pi.device)
        return robot.with_parameters(InertialParameters(pi))


@dataclass(frozen=True)
class Payload(BodyEffect):
    """A body fixed to the last link: ten parameters in that link's frame, about its origin."""

    name = "payload"
    coefficients = _body("of the payload", positive_mass=True)
    positions = True
    meaning = "The arm carries a tool or load that the model does not know."
    equation = "Y_n (m, mx, my, mz, Jxx, Jxy, Jxz, Jyy, Jyz, Jzz)"
    signature = "on all joints that carry the tool; exactly an error of the last link"
    experiment = "repeat the motion with and without a known payload"
    remedy = "Add the body to the last link, or `torchid payload` on logs with it."
    source = (
        "eq. 2.18; Khalil, Gautier and Lemoine 2007, Identification of the payload inertial "
        "parameters of industrial manipulators, ICRA"
    )


@dataclass(frozen=True)
class LinkEffect(BodyEffect, OneJointEffect):
    """A change of one link's parameters.

    Attributes:
        joint: the joint that moves the link, from 0.
    """

    def link(self, robot: Robot) -> int:
        """Index of the link, which is its joint's but for mimics before it."""
        return robot.own_links[self.joint]


@dataclass(frozen=True)
class LinkInertia(LinkEffect):
    """The inertial parameters of one link differ from the model's."""

    name = "link_inertia"
    coefficients = _body("missing in the link", positive_mass=False)
    meaning = "The link's mass, centre of mass or inertia is not the model's."
    equation = "Y_j (m, mx, my, mz, Jxx, Jxy, Jxz, Jyy, Jyz, Jzz)"
    signature = "on the link's joint and those before it, with gravity and with acceleration"
    experiment = "compare the link's parameters with CAD, or weigh it"
    remedy = "Correct the link's inertial parameters: `torchid identify`, `extract`."
    source = "eq. 2.18; Atkeson, An and Hollerbach 1986, IJRR 5(3)"


@dataclass(frozen=True)
class RotorInertia(JointEffect):
    """Torque in proportion to the joint's own acceleration: gear ratio squared times rotor inertia.

    On the first joints it cannot be told from the links' own inertia about the axis; the base
    parameters then carry both.
    """

    name = "rotor_inertia"
    bounds_key = "rotor_inertia"
    usual = True
    family = "inertia"
    branch = "inertia"
    coefficients = (Coefficient("Ia", "kg m^2", True, "reflected rotor inertia"),)
    servo = ("armature",)
    positions = True
    meaning = "The motor's rotor, seen through the gear, resists acceleration."
    equation = "Ia ddq"
    signature = "follows the joint's own acceleration; for the first joints exactly as J_zz does"
    experiment = "accelerate the joint hard in postures with a large and a small link inertia"
    remedy = "Set the joint's armature to Ia in the simulator."
    source = "Corke 2017, Robotics, Vision and Control, section 9.1.3"
    example = Example((0.5,), "acceleration")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """ddq."""
        return motion.ddq.unsqueeze(-1)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        return add(self.joint, f"{number(values[0])} * ddq[{self.joint}]")

    def attributes(self, values: Sequence[float]) -> dict[str, float] | None:
        """Armature."""
        return {"armature": values[0]} if values[0] >= 0 else None
