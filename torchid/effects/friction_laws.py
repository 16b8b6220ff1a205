"""Friction beyond the paper's model: curved, falling with speed, growing with load, one-sided,
changing while the arm warms up.

Each law is one term that is added to `viscous_friction` and `coulomb_friction`, so that its
coefficient is zero where the plain model suffices.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.digits import number
from torchid.effects.base import Coefficient, Columns, Example, JointEffect, Motion, Shape
from torchid.effects.c_text import add
from torchid.log.movement import RESTING
from torchid.typing import Float


@dataclass(frozen=True)
class PowerLawFriction(JointEffect):
    """Friction whose growth with speed is curved: |dq|^a sgn dq.

    It is continuous at rest. F2 may be negative: beside viscous friction it is then lubricant that
    thins with speed, as harmonic drives show; the sum still resists motion at the speeds it was
    fitted to, not beyond.

    Attributes:
        a: exponent [1].
    """

    a: float = 2.0

    name = "power_law_friction"
    family = "speed"
    branch = "friction"
    detail = "bends at speed"
    coefficients = (Coefficient("F2", "N m (s/rad)^a", False, "curvature of the viscous friction"),)
    shapes = (Shape("a", "1", 1.1, 3.0, (1.5, 2.0, 2.5), "exponent of the speed"),)
    meaning = "Lubricant is churned (F2 > 0) or thinned (F2 < 0) at speed, so friction is curved."
    equation = "F2 |dq|^a sgn(dq)"
    signature = "a friction curve that bends at speed"
    experiment = "run the joint at speeds from slow to its limit"
    remedy = "Use a friction curve of speed, or set the joint's damping for the speeds of the task."
    source = (
        "Waiboer, Aarts and Jonker 2005, Velocity dependence of joint friction in robotic "
        "manipulators with gear transmissions (Multibody Dynamics, ECCOMAS); Wolf and Iskandar "
        "2018, Extending a dynamic friction model with nonlinear viscous and thermal dependency "
        "for a motor and harmonic drive gear (ICRA)"
    )
    example = Example((2.0,), "speed")

    def __post_init__(self) -> None:
        if not self.a > 0:
            raise ValueError(f"the exponent a must be positive, not {self.a}.")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """|dq|^a sgn dq; shapes: a."""
        (a,) = shapes
        return (torch.sign(motion.dq) * motion.dq.abs() ** a).unsqueeze(-1)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        speed = f"dq[{self.joint}]"
        power = f"pow(fabs({speed}), {number(self.a)})"
        return add(self.joint, f"{number(values[0])} * sign({speed}) * {power}")


@dataclass(frozen=True)
class StribeckFriction(JointEffect):
    """Friction in excess of Coulomb's at low speed: exp(-|dq/vs|^d) sgn dq.

    Attributes:
        vs: Stribeck speed [rad/s; m/s].
        d: exponent of the decay [1]; 2 is Gaussian, 1 exponential. Data seldom tell them apart, so
            no search is made over it.
    """

    vs: float = 0.1
    d: float = 2.0

    name = "stribeck_friction"
    usual = True
    family = "sign"
    branch = "friction"
    detail = "falls at low speed"
    jumps = True
    coefficients = (
        Coefficient("Fs", "N m", True, "breakaway friction in excess of Coulomb friction"),
    )
    shapes = (
        Shape(
            "vs", "rad/s", 0.005, 0.8, (0.03, 0.06, 0.1, 0.17, 0.3), "Stribeck speed", scale="speed"
        ),
    )
    servo = ("stiction", "stribeck_speed")
    positions = True
    gloss = "more friction at low speed"
    meaning = "At low speed the lubricant film breaks down, so friction is higher than at speed."
    equation = "Fs exp(-|dq/vs|^d) sgn(dq)"
    signature = "friction in excess at low speed, gone at a few vs"
    experiment = "run from a fifth of the Stribeck speed to five times it"
    remedy = "Add the Stribeck term to the simulator's friction, or keep clear of speeds below vs."
    source = (
        "Armstrong-Helouvry, Dupont and Canudas de Wit 1994, A survey of models, analysis tools "
        "and compensation methods for the control of machines with friction (Automatica 30), "
        "section 2.1; Bo and Pavelescu 1982"
    )
    example = Example((1.0,), "speed")

    def __post_init__(self) -> None:
        if not (self.vs > 0 and self.d > 0):
            raise ValueError(f"vs and d must be positive, not {self.vs} and {self.d}.")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """exp(-|dq/vs|^d) times the direction; shapes: vs, and d where it is not 2."""
        vs, *exponent = shapes
        d = exponent[0] if exponent else 2.0
        return (torch.exp(-((motion.dq / vs).abs() ** d)) * motion.sign).unsqueeze(-1)

    def columns(self, motion: Motion) -> Float[Tensor, "*batch C"]:
        """Column (..., 1) of the joint, with its own exponent."""
        shapes = (
            torch.as_tensor(v, dtype=motion.dq.dtype, device=motion.dq.device)
            for v in (self.vs, self.d)
        )
        return self.formula(motion, *shapes)[..., self.joint, :]

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        speed = f"dq[{self.joint}]"
        decay = f"exp(-pow(fabs({speed} / {number(self.vs)}), {number(self.d)}))"
        return add(self.joint, f"{number(values[0])} * {decay} * sign({speed})")


@dataclass(frozen=True)
class LoadDependentFriction(JointEffect):
    """Coulomb friction that grows with the torque the joint transmits: mu |tau| sgn dq.

    The torque is the model's, never the measured one, whose noise would explain itself. Gears and
    bearings carry the moments across the axis too; those are left out.
    """

    name = "load_dependent_friction"
    usual = True
    family = "sign"
    branch = "friction"
    detail = "grows with load"
    needs = frozenset({"torque"})
    jumps = True
    coefficients = (
        Coefficient("mu", "1", True, "friction as a fraction of the transmitted torque", 1.0),
    )
    servo = ("load_share",)
    positions = True
    meaning = "Tooth and bearing forces press harder under load, so friction rises."
    equation = "mu |tau| sgn(dq)"
    signature = "a step at reversals that is higher where the joint carries more"
    experiment = "repeat the same motion with two payloads, or in two postures"
    remedy = "Scale the joint's dry friction with its torque (a gear efficiency of about 1 - mu)."
    source = (
        "Bittencourt and Gunnarsson 2012, Static friction in a robot joint: modeling and "
        "identification of load and temperature effects (J. Dyn. Sys., Meas., Control 134)"
    )
    example = Example((0.05,), "speed")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """|torque of the model| times the direction."""
        return (motion.require("torque", cls.name).abs() * motion.sign).unsqueeze(-1)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        load, direction = f"fabs(loaded[{self.joint}])", f"sign(dq[{self.joint}])"
        return add(self.joint, f"{number(values[0])} * {load} * {direction}")


@dataclass(frozen=True)
class LoadDependentStribeck(StribeckFriction):
    """Friction in excess at low speed that grows with the torque the joint transmits:
    mus |tau| exp(-|dq/vs|^d) sgn dq; the torque is the model's."""

    name = "load_dependent_stribeck"
    usual = False
    detail = "falls at low speed under load"
    needs = frozenset({"torque"})
    coefficients = (
        Coefficient("mus", "1", True, "breakaway friction per transmitted torque", 1.0),
    )
    servo = ("stiction_share", "stribeck_speed")
    gloss = "more friction at low speed under load"
    meaning = "Tooth forces press the lubricant out at low speed, so friction rises with the load."
    equation = "mus |tau| exp(-|dq/vs|^d) sgn(dq)"
    signature = "friction in excess at low speed, more where the joint carries more"
    experiment = "run slowly and fast with two payloads, or in two postures"
    remedy = "Use friction that falls with speed and grows with load, or keep clear of low speeds."
    source = (
        "Duclusaud, Passault, Padois and Ly 2025, Extended friction models for the physics "
        "simulation of servo actuators (ICRA), model M4; of servos the load is what the gear "
        "transmits, the motor's torque less the external one"
    )
    example = Example((0.1,), "speed")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """The same times |torque of the model|."""
        load = motion.require("torque", cls.name).abs()
        return load.unsqueeze(-1) * super().formula(motion, *shapes)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        (plain,) = super().c_code(values)
        return [plain.replace(";", f" * fabs(loaded[{self.joint}]);")]


@dataclass(frozen=True)
class AsymmetricFriction(JointEffect):
    """Friction that differs between the directions: dF |sgn dq| + dFv |dq|.

    Coulomb friction is Fc + dF one way and Fc - dF the other; viscous friction likewise. While the
    joint moves the first column is 1, exactly that of `torque_offset`; only where the joint dwells
    do they differ: there an offset stays, and friction is undetermined, which is written as 0 where
    |dq| < RESTING. The dead band is needed since a measured dq is never exactly 0.
    """

    name = "asymmetric_friction"
    family = "constant"
    branch = "friction"
    detail = "differs by direction"
    jumps = True
    coefficients = (
        Coefficient("dF", "N m", False, "Coulomb friction: half of forward minus backward"),
        Coefficient("dFv", "N m s/rad", False, "viscous friction: half of forward minus backward"),
    )
    meaning = (
        "Worm or preloaded gears and seals resist one direction of motion more than the other."
    )
    equation = "dF |sgn(dq)| + dFv |dq|"
    signature = "an offset while the joint moves, none while it dwells"
    experiment = "run the mirrored motion, and let the joint dwell"
    remedy = (
        "Give the simulator one friction curve a direction: Fc + dF, Fv + dFv forwards and "
        "Fc - dF, Fv - dFv backwards."
    )
    source = (
        "Armstrong-Helouvry 1991, Control of Machines with Friction (direction-dependent friction "
        "of the PUMA 560)"
    )
    example = Example((1.0, 0.5), "speed")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """Whether the joint moves, and |dq|."""
        speed = motion.dq.abs()
        moves = motion.sign.abs() * (speed >= RESTING).to(speed)
        return torch.stack((moves, speed), -1)

    def c_code(self, values: Sequence[float]) -> list[str]:
        """The equation as C."""
        speed = f"fabs(dq[{self.joint}])"
        moves = f"({speed} >= {number(RESTING)} ? 1.0 : 0.0)"
        return add(self.joint, f"{number(values[0])} * {moves} + {number(values[1])} * {speed}")


@dataclass(frozen=True)
class ThermalFrictionDrift(JointEffect):
    """Friction between its cold and its warm value: (dFv dq + dFc sgn dq) (1 - exp(-t/T)).

    The gear's temperature follows the heat of friction and motor with one time constant; friction
    follows temperature linearly. Added to `viscous_friction` and `coulomb_friction`, whose
    coefficients are then the cold ones. On a log much shorter than T only the slopes dFv/T and
    dFc/T can be told.

    Attributes:
        T: time constant [s].
    """

    T: float = 60.0

    name = "thermal_friction_drift"
    family = "time"
    branch = "friction"
    detail = "drifts with time or temperature"
    needs = frozenset({"t"})
    jumps = True
    coefficients = (
        Coefficient("dFv", "N m s/rad", False, "viscous friction: warm minus cold"),
        Coefficient("dFc", "N m", False, "Coulomb friction: warm minus cold"),
    )
    shapes = (
        Shape("T", "s", 5.0, 1000.0, (15.0, 30.0, 60.0, 120.0, 240.0), "time constant of warming"),
    )
    meaning = "Grease thins as the gear warms up, so friction drifts (mostly falls) along the log."
    equation = "(dFv dq + dFc sgn(dq)) (1 - exp(-t/T))"
    signature = "a slow trend with the shape of friction"
    experiment = "repeat one motion cold, warm and cold again"
    beyond = experiment
    remedy = (
        "Warm the arm up before it is used or measured, or use the friction of its working "
        "temperature: Fv + dFv, Fc + dFc."
    )
    source = (
        "Bittencourt and Gunnarsson 2012, Static friction in a robot joint: modeling and "
        "identification of load and temperature effects (J. Dyn. Sys., Meas., Control 134)"
    )
    example = Example((-0.5, -0.5), "time")
    by_motion = False

    def __post_init__(self) -> None:
        if not self.T > 0:
            raise ValueError(f"the time constant T must be positive, not {self.T}.")

    @classmethod
    def formula(cls, motion: Motion, *shapes: Tensor) -> Columns:
        """dq and the direction, times 1 - exp(-t/T); shapes: T."""
        (constant,) = shapes
        t = motion.require("t", cls.name).to(motion.dq).unsqueeze(-1)
        warmth = -torch.expm1(-t / constant)
        return torch.stack((motion.dq * warmth, motion.sign * warmth), -1)
