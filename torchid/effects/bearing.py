"""Friction of bearings that grows with what they carry across the axis, not about it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.dynamics.newton_euler import joint_wrenches
from torchid.effects.base import Columns, Example, ModelEffect, Motion
from torchid.effects.variation import ArmCoefficient, OneJointEffect, needed, on_joint
from torchid.robot.model import JointType, Robot
from torchid.typing import Float


@dataclass(frozen=True)
class BearingMomentFriction(OneJointEffect):
    """Friction in proportion to the bending moment on the joint's bearing.

    The joint's internal wrench (eq. 2.13) has a moment across the axis, which the bearing carries.
    On a vertical first axis it is large where the torque about the axis is small.
    """

    name = "bearing_moment_friction"
    family = "sign"
    branch = "friction"
    detail = "grows with load"
    jumps = True
    of_bodies = True
    coefficients = (ArmCoefficient("mu_m", "1", True, "friction per bending moment", 0.5),)
    gloss = "friction that grows with the tilting moment of the load"
    meaning = "The bearing is tilted by a bending moment, and its friction grows with that moment."
    equation = "mu_m |m_across| sgn(dq), m the joint's internal moment"
    signature = "a step at reversals that grows with the arm's reach, also about a vertical axis"
    experiment = "repeat the same motion of the joint with the arm stretched out and folded"
    remedy = "Scale the joint's dry friction with the bending moment on its bearing."
    source = (
        "Bittencourt and Gunnarsson 2012, Static friction in a robot joint: modeling and "
        "identification of load and temperature effects (J. Dyn. Sys., Meas., Control 134); "
        "Palmgren 1959, Ball and Roller Bearing Engineering (friction in proportion to the load)"
    )
    example = Example((0.05,), "speed")

    @classmethod
    def load(cls, force: Float[Tensor, "*b 3"], moment: Float[Tensor, "*b 3"]) -> Tensor:
        """What the bearing carries (...), of a wrench in a frame whose z is the axis."""
        return moment[..., :2].norm(dim=-1)

    @classmethod
    def columns_of(
        cls, effects: Sequence[ModelEffect], motion: Motion, robot: Robot | None = None
    ) -> Iterator[Columns]:
        """Columns of several joints, whose wrenches are evaluated once."""
        arm = needed(robot, cls.name)
        wrenches = joint_wrenches(arm, *motion.state)
        for effect in effects:
            (j,) = effect.joints
            # The axis in the axes that the wrench is given in; then across and along it.
            axis = arm.after[j].to(wrenches)[:3, :3].T[:, 2]
            force, moment = (_about(x, axis) for x in wrenches[..., j, :].split(3, -1))
            sliding = arm.joint_types[j] is JointType.PRISMATIC
            load = force[..., :2].norm(dim=-1) if sliding else cls.load(force, moment)
            yield on_joint(load * motion.sign[..., j], j, arm.n)

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """The load times the direction (T, n, 1); on a prismatic joint the normal force."""
        return next(iter(self.columns_of([self], motion, robot)))


@dataclass(frozen=True)
class AxialLoadFriction(BearingMomentFriction):
    """Friction in proportion to the force along a joint's axis, which a thrust bearing carries."""

    name = "axial_load_friction"
    coefficients = (
        ArmCoefficient("r_a", "m", True, "friction per axial force: mu times radius", 0.1),
    )
    gloss = "friction that grows with the force along the joint's axis"
    meaning = "A thrust bearing carries the weight along the axis, and its friction grows with it."
    equation = "r_a |f_axial| sgn(dq), f the joint's internal force"
    signature = "a step at reversals that follows the force along the axis"
    experiment = "repeat the same motion of the joint with and without a payload, axis vertical"
    remedy = "Scale the joint's dry friction with the force along its axis."
    example = Example((0.01,), "speed")

    @classmethod
    def load(cls, force: Float[Tensor, "*b 3"], moment: Float[Tensor, "*b 3"]) -> Tensor:
        """The force along the axis."""
        return force[..., 2].abs()


def _about(vector: Float[Tensor, "*b 3"], axis: Float[Tensor, "3"]) -> Float[Tensor, "*b 3"]:
    """A vector's two components across an axis, of the right length, and the one along it."""
    along = vector @ axis
    across = (vector - along.unsqueeze(-1) * axis).norm(dim=-1)
    return torch.stack((across, torch.zeros_like(across), along), -1)
