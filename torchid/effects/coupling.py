"""Wrist gears whose motor turns with two joints."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.digits import number
from torchid.effects.base import Coefficient, Columns, Effect, Example, Motion, Shape
from torchid.effects.c_text import add
from torchid.effects.variation import JointPairEffect
from torchid.robot.model import Robot


@dataclass(frozen=True)
class GearCoupling(JointPairEffect):
    """The motor of `joint` (j) also turns with `source_joint` (i), at w = dq_j + ratio dq_i.

    Its friction and inertia, Ia dw + Fv w + Fc sign(w), act on both joints by virtual work. What
    the joints' own viscous friction, Coulomb friction and rotor inertia say already is left out:

        on j:  Iam ratio ddq_i + Fvm ratio dq_i + Fcm (sign(w) - sign(dq_j))
        on i:  Iam ratio ddq_j + Fvm ratio dq_j + Fcm ratio sign(w)

    With ratio 1 this is the coupling of joints 6 and 5 of Staubli's arms. It adds torque of its
    own, and changes neither the arm's bodies nor what is measured.

    Attributes:
        ratio: turns of the motor with joint i per turn with joint j.
    """

    ratio: float = 1.0

    name = "gear_coupling"
    family = "speed"
    branch = "transmission"
    needs = frozenset()
    jumps = True
    coefficients = (
        Coefficient("Fvm", "N m s/rad", True, "viscous friction of the coupled motor"),
        Coefficient("Iam", "kg m^2", True, "inertia of the coupled motor, seen at the joint"),
        Coefficient("Fcm", "N m", True, "Coulomb friction of the coupled motor"),
    )
    shapes = (
        Shape(
            "ratio",
            "1",
            -1.0,
            1.0,
            (1.0, -1.0),
            "turns of the motor with the source joint per turn with its own",
            logarithmic=False,
        ),
    )
    gloss = "one motor turns two joints"
    meaning = "A wrist motor drives its joint through another, so it turns with both."
    equation = (
        "on j: Iam ratio ddq_i + Fvm ratio dq_i + Fcm (sgn(w) - sgn(dq_j));  "
        "on i: Iam ratio ddq_j + Fvm ratio dq_j + Fcm ratio sgn(w);  w = dq_j + ratio dq_i"
    )
    signature = "friction of one joint that follows another joint's speed"
    experiment = "move the joint alone, then its neighbour alone"
    remedy = (
        "Put friction and rotor inertia on the motor's speed dq_j + ratio dq_i in the simulator "
        "(a joint equality or a tendon), not on the joint's."
    )
    source = (
        "Gautier, Janot and Vandanjon 2013, A new closed-loop output error method for parameter "
        "identification of robot dynamics, IEEE Trans. Control Systems Technology 21(2): joints 5 "
        "and 6 of the TX40"
    )
    example = Example((1.0, 0.0, 0.6), "speed", {"source_joint": 2})

    @property
    def joints(self) -> tuple[int, ...]:
        """The motor's joint, and the one it also turns with."""
        return (self.joint, self.source_joint)

    @classmethod
    def candidates(cls, robot: Robot) -> list[Effect]:
        """Neighbours of the same kind, either way round, turning with or against each other."""
        kinds = robot.joint_types
        return [
            cls(j, i, ratio)
            for j in robot.driven
            for i in robot.neighbours(j)
            if kinds[i] is kinds[j] and i in robot.driven
            for ratio in cls.shapes[0].grid
        ]

    def torque_columns(self, motion: Motion, robot: Robot | None = None) -> Columns:
        """Torque on both joints per unit of Fvm, Iam, Fcm (..., n, 3)."""
        j, i = self.joint, self.source_joint
        dq, ddq, r = motion.dq, motion.ddq, self.ratio
        motor = torch.sign(dq[..., j] + r * dq[..., i])
        out = dq.new_zeros(*dq.shape, 3)
        on_j = (r * dq[..., i], r * ddq[..., i], motor - motion.sign[..., j])
        on_i = (r * dq[..., j], r * ddq[..., j], r * motor)
        out[..., j, :], out[..., i, :] = torch.stack(on_j, -1), torch.stack(on_i, -1)
        return out

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        j, i, r = self.joint, self.source_joint, number(self.ratio)
        fvm, iam, fcm = (number(x) for x in values)
        motor = f"sign(dq[{j}] + {r} * dq[{i}])"
        on_j = f"{r} * ({fvm} * dq[{i}] + {iam} * ddq[{i}]) + {fcm} * ({motor} - sign(dq[{j}]))"
        on_i = f"{r} * ({fvm} * dq[{j}] + {iam} * ddq[{j}] + {fcm} * {motor})"
        return add(j, on_j) + add(i, on_i)
