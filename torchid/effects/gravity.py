"""Effects shaped like gravity: tilt, torque sensors that scale or mix, angles and geometry that are
off."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.digits import number
from torchid.dynamics.forward import gravity_torque
from torchid.effects.base import Coefficient, Columns, Effect, Example, ModelEffect, Motion
from torchid.effects.c_text import JOINTS, RIGID, add
from torchid.effects.variation import (
    ArmCoefficient,
    JointPairEffect,
    OneJointEffect,
    horizontal_axes,
    needed,
    on_joint,
    rigid_torque,
    secant_at,
    with_joint,
)
from torchid.robot.model import Robot
from torchid.robot.placement import pose, rotation_x, rotation_y

CALIBRATED = "measure the pose with an external instrument (tracker, gauge, level): calibration"
"""What settles errors of geometry."""


@dataclass(frozen=True)
class BaseTilt(ModelEffect):
    """Gravity has another direction in the base frame than the model's.

    The axes are perpendicular to the model's gravity: x and y of the base for gravity along -z.
    The columns are exact derivatives, because torque is linear in gravity.
    """

    name = "base_tilt"
    family = "gravity"
    branch = "surroundings"
    coefficients = (
        ArmCoefficient(
            "tilt_x", "rad", False, "gravity turned about the first horizontal axis", 0.35
        ),
        ArmCoefficient(
            "tilt_y", "rad", False, "gravity turned about the second horizontal axis", 0.35
        ),
    )
    meaning = "The base is not level, so gravity pulls in another direction."
    equation = (
        "tau(q; turned gravity) - tau(q; gravity) at rest, turned by tilt_x and tilt_y, linearised"
    )
    signature = "gravity-shaped on all joints at once, from one vector"
    experiment = "repeat the motion with joint 1 turned by 90 degrees"
    beyond = CALIBRATED
    remedy = "Turn the simulator's gravity vector by the tilt, or level the base."
    source = "eq. 2.11, linear in gravity; Featherstone 2008, Rigid Body Dynamics Algorithms, 5.3"
    example = Example((0.03, 0.03), "position")

    @classmethod
    def candidates(cls, robot: Robot) -> list[Effect]:
        """One, where there is gravity."""
        return [cls()] if bool(robot.gravity.norm() > 0) else []

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """Torque against gravity's derivative, axis x gravity, at rest (..., n, 2)."""
        arm = needed(robot, self.name)
        if not arm.gravity.norm() > 0:
            return motion.q.new_zeros(*motion.q.shape, 2)
        gravity = arm.gravity.double()
        turned = (torch.linalg.cross(axis, gravity) for axis in horizontal_axes(gravity))
        return torch.stack([gravity_torque(replace(arm, gravity=g), motion.q) for g in turned], -1)

    def plant(self, robot: Robot, values: Sequence[float]) -> Robot:
        """The arm with its gravity turned."""
        gravity = robot.gravity.double()
        if not gravity.norm() > 0:
            return robot
        first, second = horizontal_axes(gravity)
        x, y, z = (values[0] * first + values[1] * second).tolist()
        spin = torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.float64)
        return replace(robot, gravity=(torch.linalg.matrix_exp(spin) @ gravity).to(robot.gravity))


@dataclass(frozen=True)
class TorqueShare(OneJointEffect):
    """A joint's torque is measured with a share of a joint's torque in excess."""

    family = "gravity"
    branch = "sensing"
    of_sensor = True
    needs = frozenset({"torque"})

    @property
    def read(self) -> int:
        """The joint whose torque is read in excess: its own, unless it says another."""
        return self.joint

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """The torque that is read in excess, on the joint (T, n, 1)."""
        torque = motion.require("torque", self.name)
        return on_joint(torque[:, self.read], self.joint, torque.shape[1])

    def measured(
        self, motion: Motion, values: Sequence[float], robot: Robot | None = None
    ) -> Motion:
        """The joint's torque with that share in it."""
        torque = motion.require("torque", self.name)
        share = values[0] * torque[:, self.read]
        return motion._replace(torque=with_joint(torque, self.joint, share))

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        return add(self.joint, f"{number(values[0])} * loaded[{self.read}]")


@dataclass(frozen=True)
class TorqueGain(TorqueShare):
    """A joint's torque is measured with a wrong scale."""

    name = "torque_gain"
    usual = True
    coefficients = (
        Coefficient("gain", "1", False, "relative error of the torque's scale", 0.7, -0.5),
    )
    meaning = "The torque sensor's scale, or the drive's torque constant, is off."
    equation = "gain tau_j"
    signature = (
        "grows with the joint's own torque; a gain that all joints share is invisible without a "
        "known payload"
    )
    experiment = "repeat the motion with a known payload"
    beyond = experiment
    remedy = (
        "Divide the measured torque (or the torque constant) by 1 + gain; a known payload tells a "
        "gain that all joints share."
    )
    source = (
        "Gautier and Briot 2014, Global identification of joint drive gains and dynamic "
        "parameters of robots, J. Dyn. Sys. Meas. Control 136(5)"
    )
    example = Example((0.05,), "position")
    shared = True
    scale_of_torque = True


@dataclass(frozen=True)
class TorqueCrosstalk(TorqueShare, JointPairEffect):
    """A joint's torque sensor also reads some of another joint's torque."""

    name = "torque_crosstalk"
    coefficients = (
        Coefficient("C", "1", False, "share of the source joint's torque that is read", 0.9),
    )
    gloss = "load on one joint shows on another's sensor"
    meaning = "Load on one joint deforms the torque sensor of another."
    equation = "C tau_i with i the source_joint"
    signature = "follows another joint's torque"
    experiment = "move one joint at a time"
    beyond = "load one joint alone with a known weight"
    remedy = (
        "Subtract C times the source joint's torque from the measured one, or calibrate the "
        "sensors together."
    )
    source = (
        "off-diagonal terms of a calibration matrix: Siciliano et al. 2009, Robotics: Modelling, "
        "Planning and Control, section 5.4.1"
    )
    example = Example((0.2,), "position", {"source_joint": 3})

    @property
    def read(self) -> int:
        """The source joint."""
        return self.source_joint

    @property
    def reads(self) -> tuple[int, ...]:
        """The source joint."""
        return (self.source_joint,)


@dataclass(frozen=True)
class EncoderOffset(OneJointEffect):
    """The true position of a joint is the measured one plus an offset.

    The column is a secant of the model's torque, [tau(q + at) - tau(q)] / at: exact for an offset
    of `at`, and off by half of d2tau/dq2 (offset - at) for another.

    Attributes:
        at: offset the secant is taken at [rad or m].
    """

    at: float = 0.03

    name = "encoder_offset"
    family = "gravity"
    branch = "sensing"
    of_sensor = True
    coefficients = (
        Coefficient("offset", "rad", False, "true position minus the measured one", 0.35),
    )
    meaning = "The joint's zero is not where the encoder says it is."
    equation = "tau(q + offset e_j, dq, ddq) - tau(q, dq, ddq)"
    signature = "gravity-shaped and on several joints; unobservable on a vertical first joint"
    experiment = "move all joints through postures with different gravity loads"
    beyond = CALIBRATED
    remedy = "Add the offset to the joint's position, or calibrate its zero."
    source = (
        "first variation of eq. 2.15 in q; Mooring, Roth and Driels 1991, Fundamentals of "
        "Manipulator Calibration, chapter 2"
    )
    example = Example((0.03,), "position")
    linearised = True

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """Secant of the torque of all joints over the joint's position (T, n, 1)."""
        arm = needed(robot, self.name)
        at = secant_at(self.at, 1e-6)
        q, dq, ddq = motion.state
        moved = rigid_torque(arm, with_joint(q.double(), self.joint, at), dq, ddq)
        return ((moved - rigid_torque(arm, q, dq, ddq)) / at).to(q).unsqueeze(-1)

    def measured(
        self, motion: Motion, values: Sequence[float], robot: Robot | None = None
    ) -> Motion:
        """The joint's position as its encoder says."""
        return motion._replace(q=with_joint(motion.q, self.joint, -values[0]))

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        at = secant_at(self.at, 1e-6)
        change = f"{number(values[0] / at)} * (there[i] - here[i])"
        return [
            f"for (i = 0; i < {JOINTS}; i++) moved[i] = q[i];",
            f"moved[{self.joint}] += {number(at)};",
            f"{RIGID}(moved, dq, ddq, there);",
            f"{RIGID}(q, dq, ddq, here);",
            f"for (i = 0; i < {JOINTS}; i++) tau[i] += {change};",
        ]


@dataclass(frozen=True)
class KinematicError(OneJointEffect):
    """The joint's frame is not where the model has it in the link before.

    Translations and rotations are in axes of the joint frame, whose z is the joint's axis. The
    rotation about z is left out for it is the encoder offset of a revolute joint, as dz is of a
    prismatic one. Joint 1's translations have no torque; its rotations tilt the base.

    Attributes:
        step: half the width of the central secants [m; rad].
    """

    step: float = 1e-4

    name = "kinematic_error"
    family = "gravity"
    branch = "transmission"
    coefficients = (
        ArmCoefficient("dx", "m", False, "joint frame displaced along its x", 0.05),
        ArmCoefficient("dy", "m", False, "joint frame displaced along its y", 0.05),
        ArmCoefficient(
            "dz", "m", False, "joint frame displaced along its z, the joint's axis", 0.05
        ),
        ArmCoefficient("rx", "rad", False, "joint frame turned about its x", 0.1),
        ArmCoefficient("ry", "rad", False, "joint frame turned about its y", 0.1),
    )
    meaning = "Link lengths or the joint axes' directions differ from the model's."
    equation = (
        "the change of tau(q, dq, ddq) with joint j's frame moved by dx, dy, dz and turned by rx, "
        "ry, linearised"
    )
    signature = "follows the posture, on the joint and those before it"
    experiment = "cover many postures, also stretched out and folded"
    beyond = CALIBRATED
    remedy = "Calibrate the kinematics, and move the joint's frame in the model."
    source = (
        "first variation of eq. 2.15 in the pose of a joint; Hayati and Mirmirani 1985, Improving "
        "the absolute positioning accuracy of robot manipulators, J. Robotic Systems 2(4)"
    )
    example = Example((0.02, 0.0, 0.0, 0.0, 0.0), "position")
    of_bodies = True

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """Central secants of the torque of all joints (T, n, 5)."""
        arm = needed(robot, self.name)
        columns = []
        for unit in torch.eye(5, dtype=torch.float64) * self.step:
            ahead, behind = (self.plant(arm, (s * unit).tolist()) for s in (1.0, -1.0))
            change = rigid_torque(ahead, *motion.state) - rigid_torque(behind, *motion.state)
            columns.append(change / (2 * self.step))
        return torch.stack(columns, -1).to(motion.q)

    def plant(self, robot: Robot, values: Sequence[float]) -> Robot:
        """The arm with the joint's frame displaced, then turned about x, then about its new y."""
        turn = rotation_x(values[3]) @ rotation_y(values[4])
        before = robot.before.clone()
        before[self.joint] = before[self.joint] @ pose(turn, values[:3]).to(before)
        return replace(robot, before=before)
